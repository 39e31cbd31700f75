#include "fit/lift_off.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "calib/error.h"

namespace plumbline {
namespace {

using Terms = LiftOffLine::Terms;
constexpr int kTerms = LiftOffLine::kTerms;
constexpr int kRounds = 6, kSteps = 40;
constexpr double kStart_mm = 0.3;  // gap at which points tell where to begin
constexpr double kStartK = 0.005, kStartM = -0.15;

// The place of n, which is held: what the matches make of the gap's first hundredths would tell it
// wrong.
constexpr Eigen::Index kNext = 2;

// A frame's own unknowns: a0..a4, and (where the thickness is not known) the plane by which its
// ground is off, at the first three terms of the basis. In common: log k, m, n, what is to be added
// to each entry of the thickness.
constexpr int kPlane = 3, kOwn = kTerms + kPlane, kLaw = LiftOffLaw::kParameters;
using Own = Eigen::Matrix<double, kOwn, 1>;
using OwnNormal = Eigen::Matrix<double, kOwn, kOwn>;

struct Common {
  LiftOffLaw law;
  Eigen::VectorXd added_mm;
};

struct Point {
  double gap, d;
  Terms basis;
  ThicknessShares shares;

  double Of(const Eigen::VectorXd& added_mm) const {
    double sum = 0;
    for (int k = 0; k < shares.count && added_mm.size() > 0; ++k) {
      const auto at = static_cast<std::size_t>(k);
      sum += shares.share[at] * added_mm[static_cast<Eigen::Index>(shares.first + at)];
    }
    return sum;
  }
};

// Of a least squares sum.
struct Normal {
  explicit Normal(Eigen::Index common)
      : cross(Eigen::MatrixXd::Zero(kOwn, common)),
        common(Eigen::MatrixXd::Zero(common, common)),
        right(Eigen::VectorXd::Zero(common)) {}
  OwnNormal own = OwnNormal::Zero();
  Own own_right = Own::Zero();
  Eigen::MatrixXd cross, common;
  Eigen::VectorXd right;
};

// How the gap by the law goes with the unknowns.
struct Row {
  Own own = Own::Zero();
  LiftOffLaw::Parameters law = LiftOffLaw::Parameters::Zero();
  std::array<double, 4> thickness{};

  void AddTo(const Point& point, double residual, Normal* n) const {
    n->own += own * own.transpose();
    n->own_right += residual * own;
    n->cross.leftCols<kLaw>() += own * law.transpose();
    n->common.topLeftCorner<kLaw, kLaw>() += law * law.transpose();
    n->right.head<kLaw>() += residual * law;
    if (n->right.size() == kLaw) return;
    const int count = point.shares.count;
    const Eigen::Index first = kLaw + static_cast<Eigen::Index>(point.shares.first);
    const Eigen::Map<const Eigen::VectorXd> by(thickness.data(), count);
    n->cross.middleCols(first, count) += own * by.transpose();
    n->common.block(0, first, kLaw, count) += law * by.transpose();
    n->common.block(first, 0, count, kLaw) += by * law.transpose();
    n->common.block(first, first, count, count) += by * by.transpose();
    n->right.segment(first, count) += residual * by;
  }
};

Terms BasisAt(const Eigen::Vector2d& at_mm, const Eigen::Vector2d& middle_mm) {
  const Eigen::Vector2d p = (at_mm - middle_mm) / LiftOffLine::kLength_mm;
  Terms basis;
  basis << 1, p.x(), p.y(), p.x() * p.x() - p.y() * p.y(), p.x() * p.y();
  return basis;
}

double GapOf(double q, const LiftOffLaw& law, int power) {
  const double mq = law.m * q;
  return q <= 0 ? 0 : std::exp(law.log_k) * std::pow(q, power) * (1 + mq * (1 + law.n * mq));
}

// The gap over the thickness as it was said, and its derivatives.
double GapAt(const Point& point, const Own& own, const Common& common, int power, Row* row) {
  const LiftOffLaw& law = common.law;
  const double added = point.Of(common.added_mm);
  const double q = point.d - added - point.basis.dot(own.head<kTerms>());
  double gap = 0, slope = 0;
  if (row != nullptr) *row = {};
  if (q > 0) {
    gap = GapOf(q, law, power);
    const double k = std::exp(law.log_k), below = std::pow(q, power - 1);
    const double mq = law.m * q;
    slope = k * below * (power + mq * (power + 1 + (power + 2) * law.n * mq));
    if (row != nullptr) {
      row->law << gap, k * below * q * q * (1 + 2 * law.n * mq), k * below * q * mq * mq;
    }
  }
  if (row != nullptr) row->own.head<kTerms>() = -slope * point.basis;
  if (common.added_mm.size() == 0) return gap;
  if (row != nullptr) {
    row->own.tail<kPlane>() = point.basis.head<kPlane>();
    for (std::size_t k = 0; k < row->thickness.size(); ++k) {
      row->thickness[k] = (1 - slope) * point.shares.share[k];
    }
  }
  return gap + added + point.basis.head<kPlane>().dot(own.tail<kPlane>());
}

// The fit in one frame: its points, its own terms, and which points are near the boundary.
class Boundary {
 public:
  // prior: of the thickness, where that is not known.
  Boundary(const LiftOffFrame& frame, const LiftOffOptions& options, const ThicknessPrior* prior,
           double sigma_mm)
      : options_(options), free_(prior != nullptr) {
    if (free_) farthest_mm_ = kFarthest * std::hypot(sigma_mm, prior->sigma_mm);
    const auto size = frame.position_mm->size();
    if (frame.undeformed_mm->size() != size || frame.thickness_mm->size() != size ||
        (free_ && frame.shares->size() != size)) {
      throw std::invalid_argument("lift-off: images of different grids");
    }
    std::vector<std::size_t> touching;
    for (std::size_t i = 0; i < frame.position_mm->pixel_count(); ++i) {
      const double gap = frame.position_mm->data()[i].z() - frame.thickness_mm->data()[i];
      const double d = frame.undeformed_mm->data()[i].z() - frame.thickness_mm->data()[i];
      if (!std::isfinite(gap) || !std::isfinite(d) || d < options.least_d_mm) continue;
      all_.push_back({gap, d, Terms::Zero(), free_ ? frame.shares->data()[i] : ThicknessShares{}});
      places_.push_back(i);
      if (std::abs(gap) < kStart_mm + farthest_mm_) {
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
    own_[0] = start_mm_[start_mm_.size() * 9 / 10] - 2;
  }

  bool Begun() const { return !start_mm_.empty(); }
  Own& own() { return own_; }
  LiftOffLine Line() const {
    LiftOffLine line = line_;
    line.a = own_.head<kTerms>();
    line.points = static_cast<int>(used_.size());
    return line;
  }
  std::size_t count() const { return used_.size(); }

  // Takes the points within the rim (all that touch, where they are to tell the thickness) and up
  // to the largest gap, by where the undeformed tyre is: noise has no say in it.
  void Select(const Common& common) {
    const LiftOffLaw& law = common.law;
    double reach = 0;
    const double step = 0.05;
    while (reach < 12 && GapOf(reach, law, options_.power) < options_.largest_gap_mm &&
           (reach == 0 ||
            GapOf(reach + step, law, options_.power) > GapOf(reach, law, options_.power))) {
      reach += step;
    }
    used_.clear();
    std::size_t touching = 0, off = 0;
    for (const Point& point : all_) {
      const double q = point.d - point.Of(common.added_mm) - point.basis.dot(own_.head<kTerms>());
      if (q >= reach || (!free_ && q <= -options_.inside_mm)) continue;
      if (free_ && q <= -options_.inside_mm) {
        ++touching;
        if (std::abs(point.gap - GapAt(point, own_, common, options_.power, nullptr)) >
            farthest_mm_) {
          ++off;
          continue;
        }
      }
      used_.push_back(point);
    }
    lies_flat_ = static_cast<double>(off) <= kMostOff * static_cast<double>(touching);
  }
  // Whether all but a few of the points that should touch do, as the last Select() has it.
  bool lies_flat() const { return lies_flat_; }

  // The sum of squares; with `normal`, that is added to it.
  double Accumulate(const Own& own, const Common& common, Normal* normal) const {
    double cost = 0;
    Row row;
    for (const Point& point : used_) {
      const double residual =
          point.gap - GapAt(point, own, common, options_.power, normal != nullptr ? &row : nullptr);
      cost += residual * residual;
      if (normal != nullptr) row.AddTo(point, residual, normal);
    }
    // Without it the plane is none of the unknowns.
    if (normal != nullptr && !free_) normal->own.bottomRightCorner<kPlane, kPlane>().setIdentity();
    return cost;
  }

 private:
  // Of the thickness' and the noise's sigmas, for a point that touches; and how many may be off, as
  // over an obstacle many are.
  static constexpr double kFarthest = 5, kMostOff = 0.02;
  const LiftOffOptions& options_;
  bool free_, lies_flat_ = true;
  double farthest_mm_ = 0;
  std::vector<Point> all_, used_;
  std::vector<std::size_t> places_;
  std::vector<double> start_mm_;
  LiftOffLine line_;
  Own own_ = Own::Zero();
};

// Gauss-Newton, damped, over what frames have in common (unless that is held) and each frame's own
// terms, which are eliminated.
class Adjustment {
 public:
  // prior: of what is added to the thickness, with the weight of a residual.
  Adjustment(std::vector<Boundary>& frames, Eigen::Index common, bool hold)
      : frames_(frames), size_(common), hold_(hold) {}
  void SetPrior(const Eigen::VectorXd& expected_mm, double weight) {
    expected_mm_ = expected_mm;
    weight_ = weight;
  }

  // In rounds, each with the points that the one before shows. Returns the normal matrix of what is
  // in common.
  Eigen::MatrixXd Solve(Common* common) {
    Eigen::MatrixXd information;
    for (int round = 0; round < kRounds; ++round) {
      for (Boundary& frame : frames_) frame.Select(*common);
      information = SolveWithThesePoints(common);
    }
    return information;
  }

 private:
  struct Step {
    std::vector<Own> own;
    Common common;
  };

  double CostOf(const Step& at) const {
    double cost = 0;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      cost += frames_[f].Accumulate(at.own[f], at.common, nullptr);
    }
    if (weight_ > 0) cost += weight_ * (at.common.added_mm - expected_mm_).squaredNorm();
    return cost;
  }

  Step StepFrom(const Step& at, double damping, Eigen::MatrixXd* information) const {
    Eigen::MatrixXd reduced = Eigen::MatrixXd::Zero(size_, size_);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(size_);
    *information = reduced;
    std::vector<OwnNormal> inverse;
    std::vector<Normal> all;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      Normal& normal = all.emplace_back(size_);
      frames_[f].Accumulate(at.own[f], at.common, &normal);
      *information +=
          normal.common - normal.cross.transpose() * normal.own.ldlt().solve(normal.cross);
      normal.own.diagonal() *= 1 + damping;
      inverse.push_back(normal.own.ldlt().solve(OwnNormal::Identity()));
      reduced += normal.common;
      reduced.diagonal() += damping * normal.common.diagonal();
      reduced -= normal.cross.transpose() * inverse[f] * normal.cross;
      right += normal.right - normal.cross.transpose() * (inverse[f] * normal.own_right);
    }
    reduced.row(kNext).setZero();
    reduced.col(kNext).setZero();
    reduced(kNext, kNext) = 1;
    right[kNext] = 0;
    if (weight_ > 0) {
      const Eigen::Index entries = size_ - kLaw;
      information->bottomRightCorner(entries, entries).diagonal().array() += weight_;
      reduced.bottomRightCorner(entries, entries).diagonal().array() += weight_;
      right.tail(entries) += weight_ * (expected_mm_ - at.common.added_mm);
    }
    Eigen::VectorXd step = Eigen::VectorXd::Zero(size_);
    if (!hold_) step = reduced.ldlt().solve(right);
    Step next = at;
    next.common.law.log_k += step[0];
    next.common.law.m += step[1];
    if (size_ > kLaw) next.common.added_mm += step.tail(size_ - kLaw);
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      next.own[f] += inverse[f] * (all[f].own_right - all[f].cross * step);
    }
    return next;
  }

  Eigen::MatrixXd SolveWithThesePoints(Common* common) {
    Step at{{}, *common};
    for (Boundary& frame : frames_) at.own.push_back(frame.own());
    double cost = CostOf(at), damping = 1e-3;
    Eigen::MatrixXd information;
    for (int step = 0; step < kSteps; ++step) {
      Step next = StepFrom(at, damping, &information);
      const double then = CostOf(next);
      if (then < cost) {
        const bool done = cost - then < 1e-9 * cost;
        at = std::move(next);
        cost = then;
        damping = std::max(1e-9, damping / 5);
        if (done) break;
      } else {
        damping *= 5;
        if (damping > 1e5) break;
      }
    }
    *common = at.common;
    for (std::size_t f = 0; f < frames_.size(); ++f) frames_[f].own() = at.own[f];
    return information;
  }

  std::vector<Boundary>& frames_;
  Eigen::Index size_;
  bool hold_;
  Eigen::VectorXd expected_mm_;
  double weight_ = 0;
};

// Of what is in common, n being held at a value with a sigma of its own, which moves the others.
Eigen::MatrixXd CovarianceOf(Eigen::MatrixXd information, double variance, double sigma_n) {
  const Eigen::VectorXd by_n = information.col(kNext);
  information.row(kNext).setZero();
  information.col(kNext).setZero();
  information(kNext, kNext) = 1;
  Eigen::MatrixXd inverse =
      information.ldlt().solve(Eigen::MatrixXd::Identity(by_n.size(), by_n.size()));
  inverse(kNext, kNext) = 0;
  Eigen::VectorXd along = -inverse * by_n;
  along[kNext] = 1;
  return variance * inverse + sigma_n * sigma_n * along * along.transpose();
}

std::nullopt_t No(std::string* why, std::string reason) {
  if (why != nullptr) *why = std::move(reason);
  return std::nullopt;
}

}  // namespace

void LiftOffOptions::Check() const {
  if (power < 2 || power > 6) throw UsageError("A gap begins with a power of 2 to 6.");
  if (!(largest_gap_mm > 0) || !(inside_mm > 0) || !(sigma_next_term >= 0) ||
      !(max_scatter_mm > 0) || least_points < 10) {
    throw UsageError(
        "The gap, rim and scatter of the law of lift-off must be positive, the sigma of its next "
        "term "
        "0 or more, its points 10 or more.");
  }
}

LiftOffLaw FitLiftOffLaw(std::span<const LiftOffFrame> frames, double sigma_mm,
                         double correlation_area_points, const LiftOffOptions& options) {
  return FitLawAndThickness(frames, sigma_mm, correlation_area_points, nullptr, options).law;
}

std::optional<double> DepthInContact(const LiftOffFrame& frame, const LiftOffOptions& options) {
  Boundary boundary(frame, options, nullptr, 0);
  if (!boundary.Begun()) return std::nullopt;
  return boundary.own()[0] - options.inside_mm;
}

LawAndThickness FitLawAndThickness(std::span<const LiftOffFrame> frames, double sigma_mm,
                                   double correlation_area_points, const ThicknessPrior* prior,
                                   const LiftOffOptions& options) {
  options.Check();
  Common common{{std::log(kStartK), kStartM, options.next_term}, {}};
  if (prior != nullptr) common.added_mm.setZero(prior->expected_mm.size());
  std::vector<Boundary> boundaries;
  for (const LiftOffFrame& frame : frames) {
    Boundary boundary(frame, options, prior, sigma_mm);
    if (!boundary.Begun()) continue;
    boundary.Select(common);
    if (boundary.lies_flat()) boundaries.push_back(std::move(boundary));
  }
  if (boundaries.empty()) throw InputError("No frame has points near the ground.");
  const Eigen::Index entries = common.added_mm.size();
  const double variance = sigma_mm * sigma_mm * correlation_area_points;
  Adjustment adjustment(boundaries, kLaw + entries, false);
  if (prior != nullptr) {
    adjustment.SetPrior(prior->expected_mm, variance / std::pow(prior->sigma_mm, 2));
  }
  const Eigen::MatrixXd information = adjustment.Solve(&common);
  std::size_t points = 0;
  for (const Boundary& boundary : boundaries) points += boundary.count();
  if (points < static_cast<std::size_t>(options.least_points)) {
    throw InputError(
        fmt::format("Only {} points are near where the tyre leaves the ground.", points));
  }
  LawAndThickness found{common.law, common.added_mm, {}, {}};
  const Eigen::MatrixXd cov = CovarianceOf(information, variance, options.sigma_next_term);
  found.law.cov = cov.topLeftCorner<kLaw, kLaw>();
  if (prior == nullptr) return found;
  found.cov_mm2 = cov.bottomRightCorner(entries, entries);
  const Eigen::MatrixXd cross = cov.topRightCorner(kLaw, entries);
  found.d_law_d_thickness = found.cov_mm2.ldlt().solve(cross.transpose()).transpose();
  found.law.cov -= found.d_law_d_thickness * cross.transpose();
  return found;
}

std::optional<LiftOffLine> FindLiftOffLine(const LiftOffFrame& frame, const LiftOffLaw& law,
                                           double sigma_mm, double correlation_area_points,
                                           const LiftOffOptions& options, std::string* why) {
  options.Check();
  std::vector<Boundary> one;
  one.emplace_back(frame, options, nullptr, sigma_mm);
  if (!one.front().Begun()) return No(why, "no point is near the ground");
  Common held{law, {}};
  (void)Adjustment(one, kLaw, true).Solve(&held);
  LiftOffLine line = one.front().Line();
  if (line.points < options.least_points) {
    return No(why,
              fmt::format("only {} points are near where the tyre leaves the ground", line.points));
  }
  Normal normal(kLaw);
  const double cost = one.front().Accumulate(one.front().own(), held, &normal);
  line.scatter_mm = std::sqrt(cost / line.points);
  const auto own = normal.own.topLeftCorner<kTerms, kTerms>().ldlt();
  line.cov = sigma_mm * sigma_mm * correlation_area_points *
             own.solve(Eigen::Matrix<double, kTerms, kTerms>::Identity());
  line.d_a_d_law = -own.solve(normal.cross.topRows<kTerms>());
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
