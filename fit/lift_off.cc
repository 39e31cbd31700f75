#include "fit/lift_off.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "calib/error.h"

namespace plumbline {
namespace {

using Terms = LiftOffLine::Terms;
constexpr int kTerms = LiftOffLine::kTerms;
constexpr int kAll = kTerms + 2;
using Row = Eigen::Matrix<double, kAll, 1>;
using Normal = Eigen::Matrix<double, kAll, kAll>;
constexpr double kLength_mm = 100;
constexpr int kRounds = 6, kSteps = 40;
constexpr double kStart_mm = 0.3;  // gap at which points tell where to begin
constexpr double kStartK = 0.005, kStartM = -0.1;

struct Point {
  double gap, d;
  Terms basis;
};

Terms BasisAt(const Eigen::Vector2d& at_mm, const Eigen::Vector2d& middle_mm) {
  const Eigen::Vector2d p = (at_mm - middle_mm) / kLength_mm;
  Terms basis;
  basis << 1, p.x(), p.y(), p.x() * p.x() - p.y() * p.y(), p.x() * p.y();
  return basis;
}

double GapOf(double q, const LiftOffLaw& law, int power) {
  return q <= 0 ? 0 : std::exp(law.log_k) * std::pow(q, power) * (1 + law.m * q);
}

// The gap and its derivative by a0..a4, log k, m.
double GapAt(const Point& point, const Terms& a, const LiftOffLaw& law, int power, Row* row) {
  const double q = point.d - point.basis.dot(a);
  row->setZero();
  if (q <= 0) return 0;
  const double gap = GapOf(q, law, power);
  const double k = std::exp(law.log_k), below = std::pow(q, power - 1);
  row->head<kTerms>() = -k * below * (power + (power + 1) * law.m * q) * point.basis;
  (*row)[kTerms] = gap;
  (*row)[kTerms + 1] = k * below * q * q;
  return gap;
}

// The fit in one frame: its points, its own terms, and which points are near the boundary.
class Boundary {
 public:
  Boundary(const LiftOffFrame& frame, const LiftOffOptions& options) : options_(options) {
    const auto size = frame.position_mm->size();
    if (frame.undeformed_mm->size() != size || frame.thickness_mm->size() != size) {
      throw std::invalid_argument("lift-off: images of different grids");
    }
    std::vector<std::size_t> touching;
    for (std::size_t i = 0; i < frame.position_mm->pixel_count(); ++i) {
      const double gap = frame.position_mm->data()[i].z() - frame.thickness_mm->data()[i];
      const double d = frame.undeformed_mm->data()[i].z() - frame.thickness_mm->data()[i];
      if (!std::isfinite(gap) || !std::isfinite(d) || d < options.least_d_mm) continue;
      all_.push_back({gap, d, Terms::Zero()});
      places_.push_back(i);
      if (std::abs(gap) < kStart_mm) {
        touching.push_back(i);
        start_mm_.push_back(d);
      }
    }
    for (const std::size_t i : touching) {
      line_.middle_mm +=
          frame.position_mm->data()[i].head<2>() / static_cast<double>(touching.size());
    }
    for (std::size_t k = 0; k < all_.size(); ++k) {
      all_[k].basis = BasisAt(frame.position_mm->data()[places_[k]].head<2>(), line_.middle_mm);
    }
    if (start_mm_.empty()) return;
    // Most of what touches lies deeper; the mirrors of the few that lie higher are noise.
    std::sort(start_mm_.begin(), start_mm_.end());
    line_.a[0] = start_mm_[start_mm_.size() * 9 / 10] - 2;
  }

  bool Begun() const { return !start_mm_.empty(); }
  LiftOffLine& line() { return line_; }
  std::size_t count() const { return used_.size(); }

  // Takes the points within the rim and up to the largest gap, by where the undeformed tyre is:
  // noise has no say in it.
  void Select(const LiftOffLaw& law) {
    double reach = 0;
    const double step = 0.05;
    while (reach < 12 && GapOf(reach, law, options_.power) < options_.largest_gap_mm &&
           (reach == 0 ||
            GapOf(reach + step, law, options_.power) > GapOf(reach, law, options_.power))) {
      reach += step;
    }
    used_.clear();
    for (const Point& point : all_) {
      const double q = point.d - point.basis.dot(line_.a);
      if (q > -options_.inside_mm && q < reach) used_.push_back(point);
    }
  }

  // Adds to the normal equations of terms and law.
  double Accumulate(const Terms& a, const LiftOffLaw& law, Normal* normal, Row* right) const {
    double cost = 0;
    Row row;
    for (const Point& point : used_) {
      const double residual = point.gap - GapAt(point, a, law, options_.power, &row);
      cost += residual * residual;
      if (normal == nullptr) continue;
      *normal += row * row.transpose();
      *right += residual * row;
    }
    return cost;
  }

 private:
  const LiftOffOptions& options_;
  std::vector<Point> all_, used_;
  std::vector<std::size_t> places_;
  std::vector<double> start_mm_;
  LiftOffLine line_;
};

// Gauss-Newton, damped, over the law (unless it is held) and each frame's terms, which are
// eliminated. Returns the law's normal matrix.
Eigen::Matrix2d Solve(std::vector<Boundary>& frames, LiftOffLaw* law, bool hold) {
  using Cross = Eigen::Matrix<double, kTerms, 2>;
  double damping = 1e-3;
  const auto cost_of = [&](const std::vector<Terms>& a, const LiftOffLaw& tried) {
    double cost = 0;
    for (std::size_t f = 0; f < frames.size(); ++f) {
      cost += frames[f].Accumulate(a[f], tried, nullptr, nullptr);
    }
    return cost;
  };
  std::vector<Terms> a;
  for (Boundary& frame : frames) a.push_back(frame.line().a);
  double cost = cost_of(a, *law);
  Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
  for (int step = 0; step < kSteps; ++step) {
    Eigen::Matrix2d law_normal = Eigen::Matrix2d::Zero();
    Eigen::Vector2d law_right = Eigen::Vector2d::Zero();
    information.setZero();
    std::vector<Eigen::Matrix<double, kTerms, kTerms>> inverse;
    std::vector<Terms> right;
    std::vector<Cross> cross;
    for (std::size_t f = 0; f < frames.size(); ++f) {
      Normal normal = Normal::Zero();
      Row all_right = Row::Zero();
      frames[f].Accumulate(a[f], *law, &normal, &all_right);
      const Eigen::Matrix<double, kTerms, kTerms> plain = normal.topLeftCorner<kTerms, kTerms>();
      cross.push_back(normal.topRightCorner<kTerms, 2>());
      right.push_back(all_right.head<kTerms>());
      information +=
          normal.bottomRightCorner<2, 2>() - cross[f].transpose() * plain.ldlt().solve(cross[f]);
      normal.diagonal() *= 1 + damping;
      inverse.push_back(normal.topLeftCorner<kTerms, kTerms>().ldlt().solve(
          Eigen::Matrix<double, kTerms, kTerms>::Identity()));
      law_normal += normal.bottomRightCorner<2, 2>() - cross[f].transpose() * inverse[f] * cross[f];
      law_right += all_right.tail<2>() - cross[f].transpose() * inverse[f] * right[f];
    }
    const Eigen::Vector2d law_step =
        hold ? Eigen::Vector2d::Zero().eval() : law_normal.ldlt().solve(law_right).eval();
    LiftOffLaw tried = *law;
    tried.log_k += law_step[0];
    tried.m += law_step[1];
    std::vector<Terms> moved = a;
    for (std::size_t f = 0; f < frames.size(); ++f) {
      moved[f] += inverse[f] * (right[f] - cross[f] * law_step);
    }
    const double next = cost_of(moved, tried);
    if (next < cost) {
      const bool done = cost - next < 1e-9 * cost;
      a = moved;
      *law = tried;
      cost = next;
      damping = std::max(1e-9, damping / 5);
      if (done) break;
    } else {
      damping *= 5;
      if (damping > 1e5) break;
    }
  }
  for (std::size_t f = 0; f < frames.size(); ++f) frames[f].line().a = a[f];
  return information;
}

Eigen::Matrix2d SolveInRounds(std::vector<Boundary>& frames, LiftOffLaw* law, bool hold) {
  Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
  for (int round = 0; round < kRounds; ++round) {
    for (Boundary& frame : frames) frame.Select(*law);
    information = Solve(frames, law, hold);
  }
  return information;
}

std::nullopt_t No(std::string* why, std::string reason) {
  if (why != nullptr) *why = std::move(reason);
  return std::nullopt;
}

}  // namespace

void LiftOffOptions::Check() const {
  if (power < 2 || power > 6) throw UsageError("A gap begins with a power of 2 to 6.");
  if (!(largest_gap_mm > 0) || !(inside_mm > 0) || !(max_scatter_mm > 0) || least_points < 10) {
    throw UsageError(
        "The gap, rim and scatter of the law of lift-off must be positive, its points 10 or more.");
  }
}

LiftOffLaw FitLiftOffLaw(std::span<const LiftOffFrame> frames, double sigma_mm,
                         double correlation_area_points, const LiftOffOptions& options) {
  options.Check();
  std::vector<Boundary> boundaries;
  for (const LiftOffFrame& frame : frames) {
    Boundary boundary(frame, options);
    if (boundary.Begun()) boundaries.push_back(std::move(boundary));
  }
  if (boundaries.empty()) throw InputError("No frame has points near the ground.");
  LiftOffLaw law{std::log(kStartK), kStartM, Eigen::Matrix2d::Zero()};
  const Eigen::Matrix2d information = SolveInRounds(boundaries, &law, false);
  std::size_t points = 0;
  for (const Boundary& boundary : boundaries) points += boundary.count();
  if (points < static_cast<std::size_t>(options.least_points)) {
    throw InputError(
        fmt::format("Only {} points are near where the tyre leaves the ground.", points));
  }
  law.cov = sigma_mm * sigma_mm * correlation_area_points * information.inverse();
  return law;
}

std::optional<LiftOffLine> FindLiftOffLine(const LiftOffFrame& frame, const LiftOffLaw& law,
                                           double sigma_mm, double correlation_area_points,
                                           const LiftOffOptions& options, std::string* why) {
  options.Check();
  std::vector<Boundary> one;
  one.emplace_back(frame, options);
  if (!one.front().Begun()) return No(why, "no point is near the ground");
  LiftOffLaw held = law;
  SolveInRounds(one, &held, true);
  LiftOffLine line = one.front().line();
  line.points = static_cast<int>(one.front().count());
  if (line.points < options.least_points) {
    return No(why,
              fmt::format("only {} points are near where the tyre leaves the ground", line.points));
  }
  Normal normal = Normal::Zero();
  Row right = Row::Zero();
  const double cost = one.front().Accumulate(line.a, law, &normal, &right);
  line.scatter_mm = std::sqrt(cost / line.points);
  const auto own = normal.topLeftCorner<kTerms, kTerms>().ldlt();
  line.cov = sigma_mm * sigma_mm * correlation_area_points *
             own.solve(Eigen::Matrix<double, kTerms, kTerms>::Identity());
  line.d_a_d_law = -own.solve(normal.topRightCorner<kTerms, 2>());
  if (!(line.scatter_mm <= options.max_scatter_mm)) {
    return No(why, fmt::format("the gap scatters by {:.2f} mm about the law of lift-off",
                               line.scatter_mm));
  }
  return line;
}

std::optional<ContactPatch> PatchWithin(const LiftOffFrame& frame, const LiftOffLine& line) {
  Image<Eigen::Vector3d> q = *frame.position_mm;
  for (std::size_t i = 0; i < q.pixel_count(); ++i) {
    Eigen::Vector3d& at = q.data()[i];
    at.z() = frame.undeformed_mm->data()[i].z() - frame.thickness_mm->data()[i] -
             BasisAt(at.head<2>(), line.middle_mm).dot(line.a);
  }
  return FindContactPatch(q, Image<double>(q.size(), 0), {.threshold_mm = 0});
}

}  // namespace plumbline
