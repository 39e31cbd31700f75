#include "track/rolling_slip.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "calib/error.h"
#include "calib/median.h"
#include "match/planar_field.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kTukey = 4.685;
// Median distance of points of a plane from their centre, in sigmas of one axis.
constexpr double kMedianDistance = 1.1774;
constexpr int kMostRounds = 30;
constexpr double kSettled = 1e-9;   // relative
constexpr double kLeastAway = 0.2;  // of the points

struct Candidate {
  std::size_t place = 0;
  Eigen::Vector2d velocity;
};

double PlanarSigma(const MaterialVelocity& velocity, std::size_t i) {
  const Eigen::Matrix3d cov = CovarianceOf(velocity.cov_random_mm2_s2.data()[i]);
  return std::sqrt((cov(0, 0) + cov(1, 1)) / 2);
}

// The velocity that most others are near to.
Eigen::Vector2d Densest(const std::vector<Candidate>& points, double near) {
  std::size_t most = 0, best = 0;
  for (std::size_t a = 0; a < points.size(); ++a) {
    std::size_t count = 0;
    for (const Candidate& b : points) count += (b.velocity - points[a].velocity).norm() < near;
    if (count > most) {
      most = count;
      best = a;
    }
  }
  return points[best].velocity;
}

// Weights, of sum 1, of points about the velocity that most of those near `centre` have.
std::vector<double> Biweight(const std::vector<Candidate>& points, double least,
                             Eigen::Vector2d centre) {
  std::vector<double> weights(points.size());
  for (int round = 0; round < kMostRounds; ++round) {
    std::vector<double> near;
    for (const Candidate& p : points) {
      const double d = (p.velocity - centre).norm();
      if (d < 3 * kTukey * least) near.push_back(d);
    }
    const double scale = std::clamp(Median(std::move(near)) / kMedianDistance, least, 3 * least);
    double sum = 0;
    Eigen::Vector2d next = Eigen::Vector2d::Zero();
    for (std::size_t k = 0; k < points.size(); ++k) {
      const double u = (points[k].velocity - centre).norm() / (kTukey * scale);
      weights[k] = u < 1 ? std::pow(1 - u * u, 2) : 0;
      sum += weights[k];
      next += weights[k] * points[k].velocity;
    }
    next /= sum;
    for (double& w : weights) w /= sum;
    const double moved = (next - centre).norm();
    centre = next;
    if (moved < kSettled * centre.norm()) break;
  }
  return weights;
}

// Those that are further than `distance` from all that move otherwise (weight 0).
std::vector<Candidate> AwayFromOthers(const std::vector<Candidate>& points,
                                      const std::vector<double>& weights,
                                      const Image<Eigen::Vector3d>& point_mm, double distance_mm) {
  std::vector<Candidate> away;
  for (std::size_t a = 0; a < points.size(); ++a) {
    bool apart = weights[a] > 0;
    for (std::size_t b = 0; apart && b < points.size(); ++b) {
      apart = weights[b] > 0 ||
              (point_mm.data()[points[a].place] - point_mm.data()[points[b].place]).norm() >
                  distance_mm;
    }
    if (apart) away.push_back(points[a]);
  }
  return away;
}

// Weights of sum 1 of the points that tell the velocity of sticking material; interval_s: that
// velocities are a mean over.
Image<double> StickingWeights(const MaterialVelocity& velocity, std::vector<Candidate> points,
                              const Image<Eigen::Vector3d>& point_mm, double interval_s) {
  std::vector<double> sigmas;
  sigmas.reserve(points.size());
  for (const Candidate& p : points) sigmas.push_back(PlanarSigma(velocity, p.place));
  const double sigma = Median(std::move(sigmas));
  double speed = 0;
  for (const Candidate& p : points) speed = std::max(speed, p.velocity.norm());
  // Without noise velocities still differ a little.
  const double least = std::max(sigma, 1e-4 * speed);
  const Eigen::Vector2d start = Densest(points, 3 * least);
  std::vector<double> weights = Biweight(points, least, start);
  std::vector<Candidate> away = AwayFromOthers(points, weights, point_mm, speed * interval_s / 2);
  if (static_cast<double>(away.size()) > kLeastAway * static_cast<double>(points.size())) {
    points = std::move(away);
    weights = Biweight(points, least, start);
  }
  Image<double> image(velocity.size(), 0.0);
  for (std::size_t k = 0; k < points.size(); ++k) image.data()[points[k].place] = weights[k];
  return image;
}

class Wheel {
 public:
  // The velocity of sticking material, and the frame that it and the axis are told in.
  Wheel(const MaterialVelocity& velocity, const MeanVelocity& sticking, const WheelTurning& wheel,
        const Eigen::Matrix3d& ground_from_rig)
      : velocity_(velocity), sticking_(sticking), wheel_(wheel), turn_(ground_from_rig) {
    axis_ = turn_ * wheel.axis.direction_in_rig();
    heading_ = Eigen::Vector3d(axis_.y(), -axis_.x(), 0).normalized();
    left_ = {-heading_.y(), heading_.x(), 0};
  }

  Eigen::Vector3d over_ground() const { return -sticking_.value_mm_s; }
  double forwards() const { return heading_.dot(over_ground()); }
  double sideways() const { return left_.dot(over_ground()); }

  // Errors of what changes so by the wheel's velocity along its heading and to the left, and by how
  // fast it turns. A turn of the heading to the left by one radian adds sideways() to the first and
  // takes forwards() from the second.
  ErrorSum Of(double by_forwards, double by_sideways, double by_turning = 0) const {
    const Eigen::RowVector3d by_velocity =
        -(by_forwards * heading_ + by_sideways * left_).transpose();
    const double by_heading = by_forwards * sideways() - by_sideways * forwards();
    // The heading turns as the axis' projection does.
    const double length2 = axis_.head<2>().squaredNorm();
    const Eigen::RowVector3d by_axis =
        by_heading * Eigen::RowVector3d(-axis_.y(), axis_.x(), 0) / length2;
    const Eigen::Matrix3d by_turn = -Skew(axis_);  // turn x axis
    ErrorSum errors(sticking_.along_common.cols(), sticking_.along_modes.cols());
    errors.AddIndependent(by_velocity * sticking_.cov_independent * by_velocity.transpose());
    errors.AddCommon(by_velocity * sticking_.along_common +
                     by_axis * by_turn * Columns(velocity_.turn_along_common_rad));
    if (by_turning != 0) {
      errors.AddScalar(by_turning, wheel_.speed_rad_s);
      if (wheel_.speed_along_common_rad_s.size() > 0) {
        errors.AddCommon(by_turning * wheel_.speed_along_common_rad_s);
      }
    }
    errors.AddModes(by_velocity * sticking_.along_modes +
                    by_axis * by_turn * Columns(velocity_.turn_along_modes_rad));
    // The wheel's own axis: direction = rotation (e_y + it x e_y).
    const Eigen::Matrix3d by_own = turn_ * wheel_.axis.rotation * -Skew(Eigen::Vector3d::UnitY());
    const Eigen::RowVector3d own = by_axis * by_own;
    errors.AddIndependent(own * wheel_.cov_axis_random.topLeftCorner<3, 3>() * own.transpose());
    const Eigen::Index modes = sticking_.along_modes.cols();
    if (modes > 0 && wheel_.axis_along_modes.rows() == modes) {
      errors.AddModes(own * wheel_.axis_along_modes.leftCols(3).transpose());
    }
    return errors;
  }

 private:
  static Eigen::Matrix3Xd Columns(const std::vector<Eigen::Vector3d>& vectors) {
    Eigen::Matrix3Xd columns(3, static_cast<Eigen::Index>(vectors.size()));
    for (std::size_t k = 0; k < vectors.size(); ++k) {
      columns.col(static_cast<Eigen::Index>(k)) = vectors[k];
    }
    return columns;
  }

  const MaterialVelocity& velocity_;
  const MeanVelocity& sticking_;
  const WheelTurning& wheel_;
  Eigen::Matrix3d turn_;
  Eigen::Vector3d axis_, heading_, left_;
};

// Sticking material over each interval: from both neighbours, from one of them.
std::array<Eigen::Vector3d, 4> StickingOverIntervals(const MaterialVelocity& velocity,
                                                     const Image<double>& weight) {
  std::array<Eigen::Vector3d, 4> mean;
  mean.fill(Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < weight.pixel_count(); ++i) {
    const double w = weight.data()[i];
    if (w == 0) continue;
    mean[static_cast<std::size_t>(VelocityFrom::kBoth)] += w * velocity.value_mm_s.data()[i];
    mean[static_cast<std::size_t>(VelocityFrom::kBefore)] += w * velocity.before_mm_s.data()[i];
    mean[static_cast<std::size_t>(VelocityFrom::kAfter)] += w * velocity.after_mm_s.data()[i];
  }
  return mean;
}

void MapMotion(const MaterialVelocity& velocity, const Image<std::uint8_t>& contact,
               const Image<double>& weight, double threshold_mm_s, double sigmas,
               RollingSlip& slip) {
  const auto sticking = StickingOverIntervals(velocity, weight);
  for (std::size_t i = 0; i < contact.pixel_count(); ++i) {
    const VelocityFrom from = velocity.from.data()[i];
    if (contact.data()[i] == 0 || from == VelocityFrom::kNone) continue;
    const Eigen::Vector3d moves =
        velocity.value_mm_s.data()[i] - sticking[static_cast<std::size_t>(from)];
    slip.over_ground_mm_s.data()[i] = moves;
    const double size = moves.head<2>().norm();
    const double sigma = PlanarSigma(velocity, i);
    slip.sigma_over_ground_mm_s.data()[i] = static_cast<float>(sigma);
    ContactMotion& motion = slip.motion.data()[i];
    if (size - sigmas * sigma > threshold_mm_s) {
      motion = ContactMotion::kSliding;
      ++slip.sliding;
    } else if (size + sigmas * sigma < threshold_mm_s) {
      motion = ContactMotion::kSticking;
      ++slip.sticking;
    } else {
      motion = ContactMotion::kUndecided;
      ++slip.undecided;
    }
  }
}

void SetRatios(const Wheel& wheel, const WheelTurning& turning,
               const std::optional<MeasuredScalar>& radius,
               const std::optional<MeasuredScalar>& channel, RollingSlip& slip) {
  const double v = wheel.forwards(), u = wheel.sideways();
  const double omega = turning.speed_rad_s.value, speed = std::hypot(v, u);
  if (radius) {
    const double ratio = omega * radius->value / v - 1;
    ErrorSum errors = wheel.Of(-(ratio + 1) / v, 0, (ratio + 1) / omega);
    errors.AddScalar((ratio + 1) / radius->value, *radius);
    slip.ratio = errors.Of(ratio);
  }
  if (channel) {
    ErrorSum excess = wheel.Of(-v / speed, -u / speed);
    excess.AddScalar(1, *channel);
    slip.channel_excess_mm_s = excess.Of(channel->value - speed);
  }
  if (radius && channel) {
    // The channel gives the size of the velocity, the patch its direction: v = channel cos(alpha).
    const double ahead = channel->value * v / speed, ratio = omega * radius->value / ahead - 1;
    ErrorSum errors = wheel.Of(-(ratio + 1) * u * u / (v * speed * speed),
                               (ratio + 1) * u / (speed * speed), (ratio + 1) / omega);
    errors.AddScalar((ratio + 1) / radius->value, *radius);
    errors.AddScalar(-(ratio + 1) / channel->value, *channel);
    slip.ratio_by_channel = errors.Of(ratio);
  }
  if (!radius) {
    slip.problem = fmt::format(
        "the slip ratio is not known: it counts from the radius of free rolling; give it, or "
        "measure a run without drive or brake{}",
        channel ? " (the vehicle's speed alone does not tell it)" : "");
  }
}

}  // namespace

void RollingSlipOptions::Check() const {
  if (!(sliding_share > 0 && sliding_share < 1)) {
    throw UsageError(fmt::format(
        "The share of the speed above which material slides lies between 0 and 1; {} does not.",
        sliding_share));
  }
  if (!(sigmas >= 0)) throw UsageError("Sliding is told by 0 sigmas or more.");
  if (least_points < 3) throw UsageError("The velocity of the ground needs 3 points or more.");
}

RollingSlip MeasureSlip(const MaterialVelocity& velocity, const FrameTriple& frames,
                        const WheelTurning& wheel, const Image<std::uint8_t>& contact,
                        const NeighbourCorrelation& neighbours,
                        const std::optional<MeasuredScalar>& free_rolling_radius_mm,
                        const std::optional<MeasuredScalar>& channel_mm_s,
                        const RollingSlipOptions& options) {
  options.Check();
  if (contact.size() != velocity.size() || frames.now == nullptr) {
    throw std::invalid_argument("MeasureSlip: velocity and contact are of different grids");
  }
  RollingSlip slip;
  slip.convention = options.convention;
  slip.motion = Image<ContactMotion>(velocity.size(), ContactMotion::kNoContact);
  slip.over_ground_mm_s = Image<Eigen::Vector3d>(velocity.size(), Eigen::Vector3d::Constant(kNaN));
  slip.sigma_over_ground_mm_s = Image<float>(velocity.size(), static_cast<float>(kNaN));
  // Velocities over one and the same interval: of both neighbours, or of the one that is there.
  const VelocityFrom wanted = frames.before == nullptr  ? VelocityFrom::kAfter
                              : frames.after == nullptr ? VelocityFrom::kBefore
                                                        : VelocityFrom::kBoth;
  std::vector<Candidate> points;
  for (std::size_t i = 0; i < contact.pixel_count(); ++i) {
    if (contact.data()[i] == 0 || velocity.from.data()[i] != wanted) continue;
    points.push_back({i, velocity.value_mm_s.data()[i].head<2>()});
  }
  if (points.size() < static_cast<std::size_t>(options.least_points)) {
    slip.problem = fmt::format(
        "the speed over the ground is not known: {} points of the contact patch have a velocity, "
        "{} are needed; the patch is out of view or the frames beside this one are missing",
        points.size(), options.least_points);
    return slip;
  }
  const double interval_s = (frames.after != nullptr ? frames.after : frames.now)->time_s -
                            (frames.before != nullptr ? frames.before : frames.now)->time_s;
  const Image<double> weight =
      StickingWeights(velocity, points, frames.now->points.point_mm, interval_s);
  int used = 0;
  for (const Candidate& p : points) used += weight.data()[p.place] > 0 ? 1 : 0;
  slip.used_share = used / static_cast<double>(points.size());
  const MeanVelocity sticking = MeanOf(velocity, frames, weight, neighbours);
  const Wheel over(velocity, sticking, wheel, frames.now->ground.frame_from_rig.rotation);
  const double v = over.forwards(), u = over.sideways(), speed = std::hypot(v, u);
  const double omega = wheel.speed_rad_s.value;
  if (used < options.least_points || !(v > 0) || !(omega > 0)) {
    slip.problem = used < options.least_points
                       ? fmt::format(
                             "the speed over the ground is not known: no {} points of the contact "
                             "patch move alike; all of it may slide",
                             options.least_points)
                       : "slip is not known: the wheel does not roll forwards in this frame";
    return slip;
  }
  slip.found = true;
  slip.velocity_mm_s = over.over_ground();
  slip.speed_mm_s = over.Of(v / speed, u / speed).Of(speed);
  const double sign = options.convention == SlipConvention::kSaeJ670 ? -1 : 1;
  slip.slip_angle_rad =
      over.Of(-sign * u / (speed * speed), sign * v / (speed * speed)).Of(sign * std::atan2(u, v));
  slip.effective_radius_mm = over.Of(1 / omega, 0, -v / (omega * omega)).Of(v / omega);
  SetRatios(over, wheel, free_rolling_radius_mm, channel_mm_s, slip);
  MapMotion(velocity, contact, weight, options.sliding_share * speed, options.sigmas, slip);
  return slip;
}

std::optional<MeasuredScalar> FreeRollingRadius(std::span<const RollingSlip> run) {
  std::vector<const MeasuredScalar*> radii;
  for (const RollingSlip& slip : run) {
    if (slip.found && slip.effective_radius_mm.sigma_random > 0) {
      radii.push_back(&slip.effective_radius_mm);
    }
  }
  if (radii.size() < 2) return std::nullopt;
  double weights = 0, mean = 0;
  Eigen::VectorXd along = Eigen::VectorXd::Zero(radii.front()->along_modes.size());
  for (const MeasuredScalar* r : radii) {
    const double w = 1 / (r->sigma_random * r->sigma_random);
    weights += w;
    mean += w * r->value;
    along += w * r->along_modes;
  }
  mean /= weights;
  double squares = 0;
  for (const MeasuredScalar* r : radii) squares += std::pow((r->value - mean) / r->sigma_random, 2);
  const double scatter = std::max(1.0, squares / static_cast<double>(radii.size() - 1));
  return MeasuredScalar{mean, std::sqrt(scatter / weights), along / weights};
}

std::optional<MeasuredScalar> SpeedFromChannel(const SampledSignal& channel_mm_s, double time_s,
                                               double averaging_s, const ClockOffset& offset,
                                               double sigma_mm_s) {
  const std::vector<double>& t = channel_mm_s.time_s;
  const double begin = time_s + offset.offset_s - averaging_s / 2, end = begin + averaging_s;
  if (t.size() < 2 || !(averaging_s > 0) || !(begin >= t.front() && end <= t.back())) {
    return std::nullopt;
  }
  // Weights of the samples in the mean of the lines that join them, and how that goes with time.
  std::vector<double> weight(t.size(), 0.0), slope(t.size(), 0.0);
  for (std::size_t i = 0; i + 1 < t.size(); ++i) {
    const double length = t[i + 1] - t[i];
    const auto share = [&](double at) { return (at - t[i]) / length; };
    if (end >= t[i] && end <= t[i + 1]) {
      slope[i] += (1 - share(end)) / averaging_s;
      slope[i + 1] += share(end) / averaging_s;
    }
    if (begin >= t[i] && begin <= t[i + 1]) {
      slope[i] -= (1 - share(begin)) / averaging_s;
      slope[i + 1] -= share(begin) / averaging_s;
    }
    const double from = std::max(begin, t[i]), to = std::min(end, t[i + 1]);
    if (!(to > from)) continue;
    const double middle = share((from + to) / 2), part = (to - from) / averaging_s;
    weight[i] += (1 - middle) * part;
    weight[i + 1] += middle * part;
  }
  double mean = 0, squares = 0, change = 0;
  for (std::size_t i = 0; i < t.size(); ++i) {
    if (weight[i] == 0 && slope[i] == 0) continue;
    mean += weight[i] * channel_mm_s.value[i];
    squares += weight[i] * weight[i];
    change += slope[i] * channel_mm_s.value[i];
  }
  if (!std::isfinite(mean)) return std::nullopt;
  return MeasuredScalar{
      mean, std::hypot(sigma_mm_s * std::sqrt(squares), change * offset.sigma_s), {}};
}

}  // namespace plumbline
