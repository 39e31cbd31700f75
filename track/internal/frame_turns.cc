#include "track/internal/frame_turns.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "calib/median.h"
#include "track/internal/bisquare.h"

namespace plumbline::internal {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// Places that both frames show.
struct Differences {
  std::vector<double> turn_rad, sigma_rad;
  std::vector<std::pair<int, int>> cluster;
  double typical_rad = 0;  // sigma

  Differences(const AngleField& a, const AngleField& b) {
    constexpr int kCluster = 8;  // places: the fits of neighbours share points
    for (int r = 0; r < a.angle_rad.height(); ++r) {
      for (int c = 0; c < a.angle_rad.width(); ++c) {
        const double turn = b.angle_rad(r, c) - a.angle_rad(r, c);
        if (!std::isfinite(turn)) continue;
        turn_rad.push_back(turn);
        sigma_rad.push_back(std::hypot(a.sigma_rad(r, c), b.sigma_rad(r, c)));
        cluster.emplace_back(r / kCluster, c / kCluster);
      }
    }
    if (!turn_rad.empty()) typical_rad = Median(sigma_rad);
  }

  // Of one place for a turn. One that hardly knows counts less, in proportion.
  double Weight(std::size_t i, double turn) const {
    constexpr double kScale = 4.7;
    const double sigma = std::max(sigma_rad[i], typical_rad);
    return typical_rad / sigma * Bisquare(turn_rad[i] - turn, kScale * sigma);
  }
  double Support(double turn) const {
    double sum = 0;
    for (std::size_t i = 0; i < turn_rad.size(); ++i) sum += Weight(i, turn);
    return sum;
  }

  // The mean that the places about it have.
  FrameTurn Refined(double turn) const;
};

FrameTurn Differences::Refined(double turn) const {
  constexpr int kRounds = 10;
  FrameTurn out;
  for (int round = 0; round < kRounds; ++round) {
    double sum = 0, weights = 0;
    for (std::size_t i = 0; i < turn_rad.size(); ++i) {
      const double w = Weight(i, turn);
      sum += w * turn_rad[i];
      weights += w;
    }
    turn = sum / weights;
  }
  std::map<std::pair<int, int>, double> scores;
  std::vector<double> off;
  for (std::size_t i = 0; i < turn_rad.size(); ++i) {
    const double w = Weight(i, turn);
    out.support += w;
    if (w > 0) scores[cluster[i]] += w * (turn_rad[i] - turn);
    off.push_back(std::abs(turn_rad[i] - turn));
  }
  double scattered = 0;
  for (const auto& [at, score] : scores) scattered += score * score;
  out.turn_rad = turn;
  // What clusters share with their neighbours, by sampling. Of one alone the scatter says nothing.
  constexpr double kShared = 1.3;
  const auto n = static_cast<double>(scores.size());
  out.sigma_rad = n > 1 ? kShared * std::sqrt(scattered * n / (n - 1)) / out.support
                        : typical_rad / std::sqrt(std::max(out.support, 1e-12));
  double all = 0;
  for (const double sigma : sigma_rad) all += typical_rad / std::max(sigma, typical_rad);
  constexpr double kSigmaOfMedian = 1.4826;  // of a normal distribution
  out.spread_rad = kSigmaOfMedian * Median(std::move(off)) * (1 - out.support / all);
  return out;
}

}  // namespace

AngleField FieldOf(std::span<const PlacedAngle> points, const PlaceLattice& lattice) {
  constexpr double kReach = 1.5;         // spacings
  constexpr int kLeast = 6;              // points
  constexpr double kLargestShare = 0.5;  // of one point's variance that is left: it is surrounded
  struct Sums {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    double squares = 0, noise = 0, weights = 0;
    int count = 0;
  };
  Image<Sums> sums(lattice.size, Sums{});
  for (const PlacedAngle& p : points) {
    const double u = (p.place_rad - lattice.first_rad) / lattice.spacing_rad;
    const double v = (p.y_mm - lattice.first_mm) / lattice.spacing_mm;
    const int left = std::max(0, static_cast<int>(std::ceil(u - kReach)));
    const int right = std::min(lattice.size.width - 1, static_cast<int>(std::floor(u + kReach)));
    const int low = std::max(0, static_cast<int>(std::ceil(v - kReach)));
    const int high = std::min(lattice.size.height - 1, static_cast<int>(std::floor(v + kReach)));
    for (int r = low; r <= high; ++r) {
      for (int c = left; c <= right; ++c) {
        const double du = (u - c) / kReach, dv = (v - r) / kReach;
        const double w = (1 - du * du) * (1 - dv * dv);
        const Eigen::Vector3d row(1, du, dv);
        Sums& s = sums(r, c);
        s.normal += w * row * row.transpose();
        s.right += w * p.angle_rad * row;
        s.squares += w * p.angle_rad * p.angle_rad;
        s.noise += w * p.sigma_rad * p.sigma_rad;
        s.weights += w;
        ++s.count;
      }
    }
  }
  AngleField out{Image<double>(lattice.size, kNone), Image<double>(lattice.size, kNone)};
  for (std::size_t i = 0; i < sums.pixel_count(); ++i) {
    const Sums& s = sums.data()[i];
    if (s.count < kLeast) continue;
    const Eigen::LDLT<Eigen::Matrix3d> factor(s.normal);
    const Eigen::Matrix3d inverse = factor.solve(Eigen::Matrix3d::Identity());
    const double share = inverse(0, 0);
    if (!(factor.isPositive() && share > 0 && share < kLargestShare)) continue;
    const Eigen::Vector3d plane = inverse * s.right;
    const double left_over = std::max(0.0, s.squares - plane.dot(s.right)) / s.weights;
    out.angle_rad.data()[i] = plane[0];
    out.sigma_rad.data()[i] = std::sqrt(share * std::max(left_over, s.noise / s.weights));
  }
  return out;
}

std::vector<FrameTurn> TurnsBetween(const AngleField& a, const AngleField& b) {
  constexpr std::size_t kMost = 12;
  const Differences between(a, b);
  std::vector<std::pair<double, double>> starts;  // support, turn
  for (const double turn : between.turn_rad) starts.emplace_back(between.Support(turn), turn);
  std::sort(starts.begin(), starts.end(), std::greater<>());
  std::vector<FrameTurn> out;
  for (const auto& [support, turn] : starts) {
    const auto known = [&, at = turn](const FrameTurn& t) {
      return std::abs(t.turn_rad - at) < 4 * between.typical_rad;
    };
    if (std::any_of(out.begin(), out.end(), known)) continue;
    const FrameTurn refined = between.Refined(turn);
    if (std::any_of(out.begin(), out.end(), [&](const FrameTurn& t) {
          return std::abs(t.turn_rad - refined.turn_rad) < between.typical_rad;
        })) {
      continue;
    }
    out.push_back(refined);
    if (out.size() == kMost) break;
  }
  std::sort(out.begin(), out.end(),
            [](const FrameTurn& x, const FrameTurn& y) { return x.support > y.support; });
  return out;
}

std::vector<FrameTurn> SteadyTurns(std::span<const AngleField> fields,
                                   std::span<const double> model_rad,
                                   std::span<const double> times) {
  // What a turn with all the support is worth against changes of speed, and the relative change
  // from which on these count.
  constexpr double kWorth = 3, kChange = 0.01;
  struct Candidate {
    FrameTurn turn;
    double speed = 0, score = 0;
    std::size_t from = 0;  // the best one before
  };
  std::vector<std::vector<Candidate>> steps;
  for (std::size_t f = 0; f + 1 < fields.size(); ++f) {
    std::vector<FrameTurn> turns = TurnsBetween(fields[f], fields[f + 1]);
    if (turns.empty()) turns.push_back(FrameTurn{});
    const double most = std::max(turns.front().support, 1e-12);
    std::vector<Candidate> now;
    for (const FrameTurn& turn : turns) {
      Candidate c;
      c.turn = turn;
      c.speed = (model_rad[f + 1] - model_rad[f] + turn.turn_rad) / (times[f + 1] - times[f]);
      c.score = kWorth * turn.support / most;
      double best = -std::numeric_limits<double>::infinity();
      for (std::size_t k = 0; !steps.empty() && k < steps.back().size(); ++k) {
        const Candidate& before = steps.back()[k];
        const double size = std::max(std::abs(before.speed), 1e-12);
        const double change = (c.speed - before.speed) / (kChange * size);
        const double score = before.score - std::log1p(change * change);
        if (score > best) {
          best = score;
          c.from = k;
        }
      }
      if (!steps.empty()) c.score += best;
      now.push_back(c);
    }
    steps.push_back(std::move(now));
  }
  std::vector<FrameTurn> out(steps.size());
  if (steps.empty()) return out;
  const auto less = [](const Candidate& x, const Candidate& y) { return x.score < y.score; };
  std::size_t at = static_cast<std::size_t>(
      std::max_element(steps.back().begin(), steps.back().end(), less) - steps.back().begin());
  for (std::size_t f = steps.size(); f-- > 0;) {
    out[f] = steps[f][at].turn;
    at = steps[f][at].from;
  }
  return out;
}

double SupportOf(const AngleField& a, const AngleField& b, double turn_rad) {
  return Differences(a, b).Support(turn_rad);
}

}  // namespace plumbline::internal
