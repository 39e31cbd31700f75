#include "track/rolling_angles.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "track/internal/bisquare.h"
#include "track/internal/frame_turns.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr int kOrder = 4;  // coefficients a place and direction
using Frames = std::span<const std::vector<RollingObservation>>;

// Uniform cubic B-splines at a fraction of a knot interval.
std::array<double, kOrder> BasisAt(double t) {
  const double s = 1 - t, t2 = t * t, t3 = t2 * t;
  return {s * s * s / 6, (3 * t3 - 6 * t2 + 4) / 6, (-3 * t3 + 3 * t2 + 3 * t + 1) / 6, t3 / 6};
}

// The splines of a place: values at the coefficients (row, column) to (row + 3, column + 3).
struct Splines {
  int row = 0, column = 0;
  std::array<double, kOrder> along, across;
};

Splines SplinesAt(const RollingAngles& grid, double place_rad, double y_mm) {
  const double u = (place_rad - grid.first_place_rad) / grid.knot_rad;
  const double v = (y_mm - grid.first_y_mm) / grid.knot_mm;
  Splines at;
  at.column = std::clamp(static_cast<int>(std::floor(u)), 0, grid.coefficients.width() - kOrder);
  at.row = std::clamp(static_cast<int>(std::floor(v)), 0, grid.coefficients.height() - kOrder);
  at.along = BasisAt(u - at.column);
  at.across = BasisAt(v - at.row);
  return at;
}

double ValueAt(const Splines& at, const Image<double>& coefficients) {
  double value = 0;
  for (int r = 0; r < kOrder; ++r) {
    for (int c = 0; c < kOrder; ++c) {
      value += at.across[static_cast<std::size_t>(r)] * at.along[static_cast<std::size_t>(c)] *
               coefficients(at.row + r, at.column + c);
    }
  }
  return value;
}

// Grid, number of coefficients and who sees what.
void LayOut(Frames frames, const RollingAnglesOptions& options, RollingAngles& out) {
  double low = kNone, high = kNone, left = kNone, right = kNone;
  for (const auto& frame : frames) {
    for (const RollingObservation& o : frame) {
      low = std::fmin(low, o.place_rad);
      high = std::fmax(high, o.place_rad);
      left = std::fmin(left, o.y_mm);
      right = std::fmax(right, o.y_mm);
    }
  }
  out.knot_rad = options.knot_rad;
  out.knot_mm = options.knot_mm;
  if (!std::isfinite(low)) return;
  out.first_place_rad = low;
  out.first_y_mm = left;
  const int columns = static_cast<int>((high - low) / out.knot_rad) + 1;
  const int rows = static_cast<int>((right - left) / out.knot_mm) + 1;
  out.coefficients = Image<double>({columns + kOrder - 1, rows + kOrder - 1}, 0);
  out.seen = Image<int>({columns, rows}, 0);
  for (const auto& frame : frames) {
    std::set<std::pair<int, int>> cells;
    for (const RollingObservation& o : frame) {
      const Splines at = SplinesAt(out, o.place_rad, o.y_mm);
      cells.insert({at.row, at.column});
    }
    for (const auto& [r, c] : cells) ++out.seen(r, c);
  }
}

// The normal equations of delta, all theta eliminated, for one set of weights; solved for as many
// right sides as wanted.
class Equations {
 public:
  Equations(Frames frames, const std::vector<std::vector<double>>& weights,
            const RollingAngles& grid)
      : frames_(frames), weights_(weights), grid_(grid) {
    columns_ = grid.coefficients.width();
    size_ = static_cast<Eigen::Index>(grid.coefficients.pixel_count());
    Eigen::MatrixXd N = Eigen::MatrixXd::Zero(size_, size_);
    for (std::size_t f = 0; f < frames.size(); ++f) {
      Eigen::VectorXd v = Eigen::VectorXd::Zero(size_);
      double sum = 0;
      for (std::size_t i = 0; i < frames[f].size(); ++i) {
        const double w = weights[f][i];
        if (w == 0) continue;
        sum += w;
        const Row row = RowOf(frames[f][i]);
        for (std::size_t a = 0; a < kTerms; ++a) {
          v[row.index[a]] += w * row.value[a];
          for (std::size_t b = 0; b < kTerms; ++b) {
            N(row.index[a], row.index[b]) += w * row.value[a] * row.value[b];
          }
        }
      }
      if (sum > 0) N -= v * v.transpose() / sum;
      sums_.push_back(sum);
      coupling_.push_back(std::move(v));
    }
    Regularise(N);
    factor_.compute(N);
  }

  struct Solution {
    Eigen::VectorXd delta, theta;
  };

  // psi(f, i): the left sides.
  template <typename Psi>
  Solution Solve(const Psi& psi) const {
    Eigen::VectorXd rhs = Eigen::VectorXd::Zero(size_);
    Eigen::VectorXd z = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(frames_.size()));
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      for (std::size_t i = 0; i < frames_[f].size(); ++i) {
        const double w = weights_[f][i];
        if (w == 0) continue;
        const double value = w * psi(f, i);
        const Row row = RowOf(frames_[f][i]);
        for (std::size_t a = 0; a < kTerms; ++a) rhs[row.index[a]] -= row.value[a] * value;
        z[static_cast<Eigen::Index>(f)] += value;
      }
      if (sums_[f] > 0) rhs += coupling_[f] * (z[static_cast<Eigen::Index>(f)] / sums_[f]);
    }
    Solution out;
    out.delta = factor_.solve(rhs);
    out.theta = z;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      const auto at = static_cast<Eigen::Index>(f);
      out.theta[at] = sums_[f] > 0 ? (z[at] + coupling_[f].dot(out.delta)) / sums_[f] : kNone;
    }
    return out;
  }

  Image<double> ImageOf(const Eigen::VectorXd& delta) const {
    Image<double> image(grid_.coefficients.size(), 0);
    std::copy(delta.data(), delta.data() + delta.size(), image.values().begin());
    return image;
  }

 private:
  static constexpr std::size_t kTerms = kOrder * kOrder;
  struct Row {
    std::array<Eigen::Index, kTerms> index;
    std::array<double, kTerms> value;
  };

  Row RowOf(const RollingObservation& o) const {
    const Splines at = SplinesAt(grid_, o.place_rad, o.y_mm);
    Row row;
    for (std::size_t r = 0; r < kOrder; ++r) {
      for (std::size_t c = 0; c < kOrder; ++c) {
        row.index[r * kOrder + c] = (at.row + static_cast<Eigen::Index>(r)) * columns_ + at.column +
                                    static_cast<Eigen::Index>(c);
        row.value[r * kOrder + c] = at.across[r] * at.along[c];
      }
    }
    return row;
  }

  // Where nothing is seen the splines go on straight; and the free constant is held at nothing.
  // Both weigh next to nothing against what is seen.
  void Regularise(Eigen::MatrixXd& N) const {
    constexpr double kStraight = 1e-7, kHeld = 1e-10;
    const double unit = std::max(N.trace() / static_cast<double>(size_), 1e-300);
    const Eigen::Index rows = size_ / columns_;
    const auto bend = [&](Eigen::Index at, Eigen::Index step) {
      const Eigen::Index index[3] = {at - step, at, at + step};
      const double value[3] = {1, -2, 1};
      for (int a = 0; a < 3; ++a) {
        for (int b = 0; b < 3; ++b) N(index[a], index[b]) += kStraight * unit * value[a] * value[b];
      }
    };
    for (Eigen::Index r = 0; r < rows; ++r) {
      for (Eigen::Index c = 0; c < columns_; ++c) {
        if (c > 0 && c + 1 < columns_) bend(r * columns_ + c, 1);
        if (r > 0 && r + 1 < rows) bend(r * columns_ + c, columns_);
      }
    }
    N.diagonal().array() += kHeld * unit;
  }

  Frames frames_;
  const std::vector<std::vector<double>>& weights_;
  const RollingAngles& grid_;
  Eigen::Index columns_ = 0, size_ = 0;
  std::vector<double> sums_;
  std::vector<Eigen::VectorXd> coupling_;
  Eigen::LDLT<Eigen::MatrixXd> factor_;
};

// Places on both sides of the centre: pairs (centre + u, centre - u) at each y.
struct SymmetricPlaces {
  std::vector<std::array<double, 3>> pairs;  // after, before, y
};

SymmetricPlaces PlacesAbout(const RollingAngles& grid, double centre_rad) {
  SymmetricPlaces out;
  const double far = grid.knot_rad * (grid.seen.width() + 1);
  for (int r = 0; r < 2 * grid.seen.height(); ++r) {
    const double y = grid.first_y_mm + (r + 0.5) / 2 * grid.knot_mm;
    for (double u = grid.knot_rad / 4; u < far; u += grid.knot_rad / 2) {
      if (std::isfinite(grid.Ahead(centre_rad + u, y)) &&
          std::isfinite(grid.Ahead(centre_rad - u, y))) {
        out.pairs.push_back({centre_rad + u, centre_rad - u, y});
      }
    }
  }
  return out;
}

double MeanEven(const RollingAngles& grid, const SymmetricPlaces& places,
                const Image<double>& coefficients, double* rms = nullptr) {
  double sum = 0, squares = 0;
  for (const auto& [after, before, y] : places.pairs) {
    const double even = (ValueAt(SplinesAt(grid, after, y), coefficients) +
                         ValueAt(SplinesAt(grid, before, y), coefficients)) /
                        2;
    sum += even;
    squares += even * even;
  }
  const auto n = static_cast<double>(std::max<std::size_t>(1, places.pairs.size()));
  if (rms != nullptr) *rms = std::sqrt(std::max(0.0, squares / n - (sum / n) * (sum / n)));
  return sum / n;
}

// Where the radial deformation is most symmetric. The middle of what is seen where there is none.
double CentreOf(const RollingAngles& grid, const Image<double>& radial) {
  constexpr double kDeformed_mm = 1;
  const double middle = grid.first_place_rad + grid.knot_rad * grid.seen.width() / 2;
  const auto asymmetry = [&](double centre) {
    double sum = 0;
    const SymmetricPlaces places = PlacesAbout(grid, centre);
    for (const auto& [after, before, y] : places.pairs) {
      const double off =
          ValueAt(SplinesAt(grid, after, y), radial) - ValueAt(SplinesAt(grid, before, y), radial);
      sum += off * off;
    }
    return places.pairs.empty() ? std::numeric_limits<double>::infinity()
                                : sum / static_cast<double>(places.pairs.size());
  };
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const auto& [after, before, y] : PlacesAbout(grid, middle).pairs) {
    for (const double place : {after, before}) {
      const double value = ValueAt(SplinesAt(grid, place, y), radial);
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  if (!(high - low > kDeformed_mm)) return middle;
  // A third of what is seen to either side, then finer.
  double best = middle, reach = grid.knot_rad * grid.seen.width() / 6;
  constexpr int kRounds = 5, kEachSide = 6;
  for (int round = 0; round < kRounds; ++round) {
    const double from = best;
    double least = std::numeric_limits<double>::infinity();
    for (int k = -kEachSide; k <= kEachSide; ++k) {
      const double centre = from + reach * k / kEachSide;
      const double value = asymmetry(centre);
      if (value < least) {
        least = value;
        best = centre;
      }
    }
    reach /= kEachSide / 2.0;
  }
  return best;
}

// Of a frame's mean: what its blocks say of it, but not less than the noise.
double SigmaOf(const std::vector<RollingObservation>& frame, const std::vector<double>& weights,
               const std::vector<double>& residuals) {
  std::map<int, double> blocks;
  double sum = 0, noise = 0;
  for (std::size_t i = 0; i < frame.size(); ++i) {
    if (weights[i] == 0) continue;
    blocks[frame[i].block] += weights[i] * residuals[i];
    sum += weights[i];
    noise += weights[i] * weights[i] * frame[i].sigma_rad * frame[i].sigma_rad;
  }
  double scattered = 0;
  for (const auto& [block, score] : blocks) scattered += score * score;
  const auto n = static_cast<double>(blocks.size());
  if (n > 1) scattered *= n / (n - 1);
  return std::sqrt(std::max(noise, scattered)) / sum;
}

// Fine, as far as points are dense: so that some lie about each place.
internal::PlaceLattice LatticeOf(Frames frames, const RollingAngles& out) {
  constexpr double kFinest = 1.0 / 3;    // of the knots
  constexpr double kPointsAPlace = 0.9;  // of a frame, in a square of the lattice
  double points = 0, cells = 0;
  for (const auto& frame : frames) points += static_cast<double>(frame.size());
  for (const int seen : out.seen.values()) cells += seen;
  const double spacing = std::max(kFinest, std::sqrt(kPointsAPlace * cells / points));  // in knots
  return {out.first_place_rad,
          out.first_y_mm,
          out.knot_rad * spacing,
          out.knot_mm * spacing,
          {static_cast<int>(out.seen.width() / spacing) + 1,
           static_cast<int>(out.seen.height() / spacing) + 1}};
}

// Holds the angles of one deformation for all frames against the turns from frame to frame
// (RollingAngles::steady). Where these contradict, the angles are theirs from then on, as a whole
// where the others have them in the middle.
void FollowTurns(Frames frames, const std::vector<std::vector<double>>& residuals,
                 std::span<const double> times, RollingAngles& out) {
  // They contradict a turn that has much more support, and is other by so many sigmas.
  constexpr double kAgree = 0.8, kTold = 4;
  const internal::PlaceLattice lattice = LatticeOf(frames, out);
  std::vector<std::size_t> known;
  std::vector<internal::AngleField> fields;
  std::vector<double> model, when;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    if (!std::isfinite(out.frames[f].angle_rad)) continue;
    std::vector<internal::PlacedAngle> points;
    for (std::size_t i = 0; i < frames[f].size(); ++i) {
      const RollingObservation& o = frames[f][i];
      points.push_back({o.place_rad, o.y_mm, residuals[f][i], o.sigma_rad});
    }
    known.push_back(f);
    fields.push_back(internal::FieldOf(points, lattice));
    model.push_back(out.frames[f].angle_rad);
    when.push_back(times.empty() ? static_cast<double>(f) : times[f]);
  }
  const std::vector<internal::FrameTurn> turns = internal::SteadyTurns(fields, model, when);
  for (std::size_t k = 0; k < turns.size(); ++k) {
    const double as_they_are = internal::SupportOf(fields[k], fields[k + 1], 0);
    if (as_they_are < kAgree * turns[k].support &&
        std::abs(turns[k].turn_rad) > kTold * turns[k].sigma_rad) {
      out.steady = false;
    }
  }
  // What places disagree by counts in any case; seen from the middle of the recording.
  double spread = 0, squares = 0;
  std::vector<double> changes(1, 0.0);
  for (std::size_t k = 0; k < turns.size(); ++k) {
    RollingAngle& frame = out.frames[known[k + 1]];
    frame.turn_spread_rad = turns[k].spread_rad;
    spread += turns[k].spread_rad / 2;
    squares += turns[k].sigma_rad * turns[k].sigma_rad;
    changes.push_back(changes.back() + turns[k].turn_rad);
  }
  out.sigma_common_rad = std::hypot(out.sigma_common_rad, spread);
  if (out.steady) return;
  out.sigma_common_rad = std::hypot(out.sigma_common_rad, std::sqrt(squares));
  const double middle = Median(changes);
  for (std::size_t k = 0; k < known.size(); ++k) {
    out.frames[known[k]].angle_rad += changes[k] - middle;
    if (k > 0) {
      out.frames[known[k]].sigma_rad =
          std::hypot(out.frames[known[k]].sigma_rad, turns[k - 1].sigma_rad);
    }
  }
}

}  // namespace

void RollingAnglesOptions::Check() const {
  if (!(knot_rad > 0 && knot_mm > 0)) {
    throw UsageError("The knots of the deformation must lie apart by more than 0.");
  }
  if (!(outlier_sigmas > 0)) throw UsageError("An outlier must be off by more than 0 sigmas.");
}

double RollingAngles::SpeedSpread(std::size_t frame, double since, double until) const {
  const double before = since > 0 ? frames[frame].turn_spread_rad / since : 0;
  const double after = until > 0 ? frames[frame + 1].turn_spread_rad / until : 0;
  return std::max(before, after);
}

double RollingAngles::Ahead(double place_rad, double y_mm) const {
  const int column = static_cast<int>(std::floor((place_rad - first_place_rad) / knot_rad));
  const int row = static_cast<int>(std::floor((y_mm - first_y_mm) / knot_mm));
  if (column < 0 || row < 0 || column >= seen.width() || row >= seen.height() ||
      seen(row, column) == 0) {
    return kNone;
  }
  return ValueAt(SplinesAt(*this, place_rad, y_mm), coefficients);
}

RollingAngles FindRollingAngles(Frames frames, std::span<const Eigen::MatrixXf> psi_along,
                                const RollingAnglesOptions& options,
                                std::span<const double> times) {
  options.Check();
  if ((!psi_along.empty() && psi_along.size() != frames.size()) ||
      (!times.empty() && times.size() != frames.size())) {
    throw std::invalid_argument("times and the changes of psi must be of as many frames");
  }
  RollingAngles out;
  out.frames.assign(frames.size(), {kNone, kNone, 0});
  LayOut(frames, options, out);
  if (out.seen.empty()) return out;
  std::vector<std::vector<double>> weights, residuals;
  for (const auto& frame : frames) {
    weights.emplace_back();
    for (const RollingObservation& o : frame) {
      weights.back().push_back(1 / (o.sigma_rad * o.sigma_rad));
    }
    residuals.emplace_back(frame.size(), 0.0);
  }
  // The scale falls with the residuals, from wide to what they scatter by in the end.
  constexpr int kRounds = 12;
  constexpr double kSigmaOfMedian = 1.4826;
  Equations::Solution solution;
  std::optional<Equations> equations;
  for (int round = 0;; ++round) {
    equations.emplace(frames, weights, out);
    solution = equations->Solve([&](std::size_t f, std::size_t i) { return frames[f][i].psi_rad; });
    out.coefficients = equations->ImageOf(solution.delta);
    std::vector<double> sizes;
    for (std::size_t f = 0; f < frames.size(); ++f) {
      const double theta = solution.theta[static_cast<Eigen::Index>(f)];
      for (std::size_t i = 0; i < frames[f].size(); ++i) {
        const RollingObservation& o = frames[f][i];
        residuals[f][i] =
            o.psi_rad - theta + ValueAt(SplinesAt(out, o.place_rad, o.y_mm), out.coefficients);
        if (std::isfinite(theta)) sizes.push_back(std::abs(residuals[f][i] / o.sigma_rad));
      }
    }
    if (sizes.empty()) return out;
    out.scatter = kSigmaOfMedian * Median(std::move(sizes));
    if (round == kRounds) break;
    const double scale = std::max(out.scatter, 1e-12) * options.outlier_sigmas;
    for (std::size_t f = 0; f < frames.size(); ++f) {
      for (std::size_t i = 0; i < frames[f].size(); ++i) {
        const double sigma = frames[f][i].sigma_rad;
        weights[f][i] = internal::Bisquare(residuals[f][i] / sigma, scale) / (sigma * sigma);
      }
    }
  }
  const Equations::Solution radial =
      equations->Solve([&](std::size_t f, std::size_t i) { return -frames[f][i].radial_mm; });
  out.centre_rad = CentreOf(out, equations->ImageOf(radial.delta));
  const SymmetricPlaces places = PlacesAbout(out, out.centre_rad);
  const double constant = MeanEven(out, places, out.coefficients, &out.sigma_common_rad);
  out.sigma_common_rad *= RollingAngles::kHidden;
  for (double& c : out.coefficients.values()) c -= constant;
  int counted = 0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    RollingAngle& frame = out.frames[f];
    frame.angle_rad = solution.theta[static_cast<Eigen::Index>(f)] - constant;
    if (!std::isfinite(frame.angle_rad)) continue;
    ++counted;
    frame.sigma_rad = SigmaOf(frames[f], weights[f], residuals[f]);
    for (std::size_t i = 0; i < weights[f].size(); ++i) {
      frame.used_share += weights[f][i] * frames[f][i].sigma_rad * frames[f][i].sigma_rad;
    }
    frame.used_share /= static_cast<double>(frames[f].size());
  }
  for (RollingAngle& frame : out.frames) frame.sigma_rad *= std::sqrt(1 + 1.0 / counted);
  FollowTurns(frames, residuals, times, out);
  const Eigen::Index modes = psi_along.empty() ? 0 : psi_along[0].cols();
  out.along_modes.resize(modes, static_cast<Eigen::Index>(frames.size()));
  for (Eigen::Index k = 0; k < modes; ++k) {
    const Equations::Solution moved = equations->Solve([&](std::size_t f, std::size_t i) {
      return static_cast<double>(psi_along[f](static_cast<Eigen::Index>(i), k));
    });
    const double shift = MeanEven(out, places, equations->ImageOf(moved.delta));
    out.along_modes.row(k) = (moved.theta.array() - shift).transpose();
  }
  return out;
}

}  // namespace plumbline
