#include "calib/calibration_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <utility>

#include "calib/error.h"
#include "calib/internal/calibration_advice.h"
#include "calib/optimization_inputs.h"
#include "calib/projection_uncertainty.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

constexpr double kDegrees = 180 / M_PI;
constexpr std::size_t kWorstShown = 5;

// A patch of points around the middle of the common field at the working distance, in the rig
// frame: two of them the length apart.
std::array<Eigen::Vector3d, 5> Patch(const Calibration& c, double length_mm) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double count = 0;
  for (const PairResult& p : c.pairs) {
    if (!p.used) continue;
    centre += p.left_from_board * c.target_mm[c.target_mm.size() / 2];
    ++count;
  }
  centre *= c.working_distance_mm / centre.norm();
  const double h = length_mm / 2;
  return {centre + Eigen::Vector3d(-h, 0, 0), centre + Eigen::Vector3d(h, 0, 0), centre,
          centre + Eigen::Vector3d(0, -h, 0), centre + Eigen::Vector3d(0, h, 0)};
}

// Takes out the rigid motion (small angles) that carries `to` best onto `from`, and returns what is
// left of the middle point.
Eigen::Vector3d WithoutRigidMotion(const std::array<Eigen::Vector3d, 5>& from,
                                   const std::array<Eigen::Vector3d, 5>& to) {
  Eigen::Matrix3Xd a(3, 5), b(3, 5);
  for (Eigen::Index i = 0; i < 5; ++i) {
    a.col(i) = to[static_cast<std::size_t>(i)];
    b.col(i) = from[static_cast<std::size_t>(i)];
  }
  const Eigen::Matrix4d fit = Eigen::umeyama(a, b, false);
  return fit.topLeftCorner<3, 3>() * to[2] + fit.topRightCorner<3, 1>() - from[2];
}

void AppendWorst(const Calibration& c, std::string& text) {
  std::vector<const PairResult*> used, dropped;
  for (const PairResult& p : c.pairs) {
    if (p.used) used.push_back(&p);
    if (!p.problem.empty()) dropped.push_back(&p);
  }
  const auto worst = [](const PairResult* p) { return std::max(p->left_rms_px, p->right_rms_px); };
  std::sort(used.begin(), used.end(),
            [&](const PairResult* a, const PairResult* b) { return worst(a) > worst(b); });
  auto out = std::back_inserter(text);
  fmt::format_to(out, "\nWorst photographs (rms per component, left and right; points left out)\n");
  for (std::size_t i = 0; i < std::min(kWorstShown, used.size()); ++i) {
    fmt::format_to(out, "  {:<28} {:.3f}  {:.3f} px  {} of {}\n", used[i]->left_name,
                   used[i]->left_rms_px, used[i]->right_rms_px, used[i]->outliers,
                   used[i]->left_points + used[i]->right_points);
  }
  if (dropped.empty()) return;
  fmt::format_to(out, "\nLeft out\n");
  for (const PairResult* p : dropped)
    fmt::format_to(out, "  {} and {}: {}\n", p->left_name, p->right_name, p->problem);
}

void AppendCoverage(const Calibration& c, std::string& text) {
  auto out = std::back_inserter(text);
  const Image<int> left = CoverageMap(c, 0), right = CoverageMap(c, 1);
  fmt::format_to(
      out, "\nCoverage, points a cell (. none, + up to 9, * up to 99, # more): left, right\n");
  const auto symbol = [](int n) { return n == 0 ? '.' : n < 10 ? '+' : n < 100 ? '*' : '#'; };
  for (int r = 0; r < left.height(); ++r) {
    text += "  ";
    for (int x = 0; x < left.width(); ++x) text += symbol(left(r, x));
    text += "   ";
    for (int x = 0; x < right.width(); ++x) text += symbol(right(r, x));
    text += '\n';
  }
}

void AppendTarget(const Calibration& c, std::string& text) {
  auto out = std::back_inserter(text);
  const std::string verdict =
      c.options.rigid_target
          ? "held at its nominal shape"
          : fmt::format(
                "off its nominal shape by {:.1f} um rms in the plane and {:.1f} um out of it",
                1e3 * c.target_rms_in_plane_mm, 1e3 * c.target_rms_out_of_plane_mm);
  fmt::format_to(out,
                 "Board              {}; {:.0f} % of the residual's variance was fixed to it "
                 "({:.4f} px rms if rigid)\n",
                 verdict, 100 * c.fixed_to_board_share, c.rigid_rms_px);
}

// How sure each camera is about where it sees a point at the working distance: in the middle and
// near a corner of its image.
void AppendProjection(const Calibration& c, std::string& text) {
  auto out = std::back_inserter(text);
  if (c.optimization_inputs == nullptr) return;  // the board is no regular grid
  try {
    const ProjectionUncertainty uncertainty(*c.optimization_inputs);
    for (int camera : {0, 1}) {
      const Camera& lens = camera == 0 ? c.rig.left : c.rig.right;
      const Eigen::Vector2d corner(0.95 * lens.size().width, 0.95 * lens.size().height);
      fmt::format_to(out, "{:<19}", camera == 0 ? "Projection" : "");
      for (const auto& [place, pixel] :
           {std::pair{"middle", Eigen::Vector2d(0.5 * corner)}, std::pair{"corner", corner}}) {
        const Eigen::Vector3d point = c.working_distance_mm * lens.Unproject(pixel);
        if (!point.allFinite()) continue;
        const auto sigma = [](const Eigen::Matrix2d& cov) { return std::sqrt(0.5 * cov.trace()); };
        fmt::format_to(out, "{}{} {:.4f} px ({:.4f})",
                       place == std::string("middle") ? (camera == 0 ? "left " : "right ") : ", ",
                       place, sigma(uncertainty.CrossReprojection(camera, point)),
                       sigma(uncertainty.MeanPcam(camera, point)));
      }
      text += camera == 0 ? " by cross-reprojection (by mrcal's mean-pcam),\n"
                          : "; independent noise, the board taken as refined\n";
    }
  } catch (const InputError& error) {
    fmt::format_to(out, "Projection         {}\n", error.what());
  }
}

}  // namespace

Image<int> CoverageMap(const Calibration& calibration, int camera, int columns, int rows) {
  Image<int> map({columns, rows}, 0);
  const ImageSize size = camera == 0 ? calibration.rig.left.size() : calibration.rig.right.size();
  for (const CalibrationResidual& r : calibration.residuals) {
    if (r.camera != camera || r.outlier) continue;
    const int x =
        std::clamp(static_cast<int>((r.pixel.x() + 0.5) * columns / size.width), 0, columns - 1);
    const int y =
        std::clamp(static_cast<int>((r.pixel.y() + 0.5) * rows / size.height), 0, rows - 1);
    ++map(y, x);
  }
  return map;
}

WorkingUncertainty UncertaintyAtWorkingDistance(const Calibration& c) {
  WorkingUncertainty u;
  u.length_mm = 0.1 * c.working_distance_mm;
  const auto patch = Patch(c, u.length_mm);
  std::array<Eigen::Vector2d, 5> left, right;
  for (std::size_t i = 0; i < 5; ++i) {
    left[i] = c.rig.left.Project(patch[i]);
    right[i] = c.rig.right.Project(c.rig.right_from_left * patch[i]);
  }
  // Random: matching noise in the right image against the left, each point by itself.
  StereoObservation observation;
  observation.cov_px2 = Eigen::Matrix4d::Identity() * u.matching_sigma_px * u.matching_sigma_px;
  Eigen::Matrix3d cov[2];
  for (std::size_t i = 0; i < 2; ++i) {
    observation.left = left[i];
    observation.right = right[i];
    cov[i] = Triangulate(c.rig, observation).cov_mm2;
  }
  u.sigma_point_random_mm = cov[0].diagonal().cwiseSqrt();
  u.sigma_length_random_mm = std::sqrt(cov[0](0, 0) + cov[1](0, 0));
  const auto at = [&](const StereoRig& rig) {
    const std::vector<Eigen::Vector3d> points = TriangulatePoints(rig, left, right);
    return std::array<Eigen::Vector3d, 5>{points[0], points[1], points[2], points[3], points[4]};
  };
  const auto nominal = at(c.rig);
  Eigen::Vector3d point_variance = Eigen::Vector3d::Zero();
  double length_variance = 0;
  for (int k = 0; k < c.rig.modes.count(); ++k) {
    const auto moved = at(c.rig.AlongMode(k));
    const double change = (moved[0] - moved[1]).norm() - (nominal[0] - nominal[1]).norm();
    if (c.rig.modes.has_scale_mode && k == c.rig.modes.count() - 1) {
      u.sigma_length_scale_mm = std::abs(change);
      continue;
    }
    length_variance += change * change;
    point_variance += WithoutRigidMotion(nominal, moved).cwiseAbs2();
  }
  u.sigma_length_calibration_mm = std::sqrt(length_variance);
  u.sigma_point_calibration_mm = point_variance.cwiseSqrt();
  return u;
}

std::string CalibrationReport(const Calibration& c) {
  std::string text;
  auto out = std::back_inserter(text);
  const auto used =
      std::count_if(c.pairs.begin(), c.pairs.end(), [](const PairResult& p) { return p.used; });
  double least_tilt = M_PI, most_tilt = 0;
  for (const PairResult& p : c.pairs) {
    if (!p.used) continue;
    least_tilt = std::min(least_tilt, p.tilt_rad);
    most_tilt = std::max(most_tilt, p.tilt_rad);
  }
  fmt::format_to(out, "Board              {}, {} of {} pairs used, {} points, {} left out\n",
                 c.board.Word(), used, c.pairs.size(), c.point_count, c.outlier_count);
  fmt::format_to(out, "Lens model         {}{}\n", c.rig.left.model().Name(),
                 c.model_scores.empty() ? "" : " (chosen by cross-validation)");
  for (const ModelScore& s : c.model_scores)
    fmt::format_to(out, "                     {:<20} held-out rms {:.4f} px\n", s.model.Name(),
                   s.held_out_rms_px);
  fmt::format_to(
      out,
      "Residual           left {:.4f} px, right {:.4f} px, joint {:.4f} px (rms per component)\n",
      c.left_rms_px, c.right_rms_px, c.joint_rms_px);
  AppendTarget(c, text);
  const double scale_baseline = c.scale_sigma * c.rig.baseline_mm();
  fmt::format_to(
      out, "Baseline           {:.4f} mm, sigma {:.4f} mm, and {:.4f} mm from the board's scale\n",
      c.rig.baseline_mm(), c.sigma_baseline_mm, scale_baseline);
  fmt::format_to(out, "Angle              {:.4f} deg, sigma {:.4f} deg\n", c.angle_rad * kDegrees,
                 c.sigma_angle_rad * kDegrees);
  fmt::format_to(out, "Working distance   {:.1f} mm; board tilted by {:.0f} to {:.0f} deg\n",
                 c.working_distance_mm, least_tilt * kDegrees, most_tilt * kDegrees);
  if (c.halves) {
    fmt::format_to(out,
                   "Even against odd   baseline {:+.4f} mm (one sigma of it: {:.4f}), angle "
                   "{:+.4f} deg ({:.4f})\n",
                   c.halves->baseline_difference_mm, c.halves->baseline_expected_mm,
                   c.halves->angle_difference_rad * kDegrees,
                   c.halves->angle_expected_rad * kDegrees);
  }
  AppendProjection(c, text);
  const WorkingUncertainty u = UncertaintyAtWorkingDistance(c);
  fmt::format_to(
      out, "\nAt the working distance (one sigma; random part for {:.2f} px of matching noise)\n",
      u.matching_sigma_px);
  fmt::format_to(
      out,
      "  a length of {:.0f} mm  {:.4f} mm random, {:.4f} mm common, {:.4f} mm from the scale\n",
      u.length_mm, u.sigma_length_random_mm, u.sigma_length_calibration_mm,
      u.sigma_length_scale_mm);
  fmt::format_to(
      out, "  a point, x y z      {:.4f} {:.4f} {:.4f} mm random, {:.4f} {:.4f} {:.4f} mm common\n",
      u.sigma_point_random_mm.x(), u.sigma_point_random_mm.y(), u.sigma_point_random_mm.z(),
      u.sigma_point_calibration_mm.x(), u.sigma_point_calibration_mm.y(),
      u.sigma_point_calibration_mm.z());
  AppendWorst(c, text);
  AppendCoverage(c, text);
  if (!c.warnings.empty()) text += "\nPlease note\n";
  for (const std::string& w : c.warnings) fmt::format_to(out, "  - {}\n", w);
  fmt::format_to(out, "\nWould improve it most: {}.\n", internal::BestImprovement(c));
  return text;
}

}  // namespace plumbline
