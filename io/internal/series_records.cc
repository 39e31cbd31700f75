#include "io/internal/series_records.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace plumbline::internal {
namespace {

using Axes = std::vector<std::string>;

struct Label {
  std::string name, units, long_name;
};

Eigen::MatrixXd ToMatrix(double value) { return Eigen::MatrixXd::Constant(1, 1, value); }
template <int R, int C>
Eigen::MatrixXd ToMatrix(const Eigen::Matrix<double, R, C>& value) {
  return value;
}

void FromMatrix(const Eigen::MatrixXd& matrix, double* value) { *value = matrix(0, 0); }
void FromMatrix(const Eigen::MatrixXd& matrix, bool* value) { *value = matrix(0, 0) > 0; }
template <int R, int C>
void FromMatrix(const Eigen::MatrixXd& matrix, Eigen::Matrix<double, R, C>* value) {
  *value = matrix;
}

// Describes the group that holds one member of SeriesFrame.
template <typename Record>
class GroupBuilder {
 public:
  GroupBuilder(RecordGroup group, Record SeriesFrame::*record)
      : group_(std::move(group)), record_(record) {
    group_.found = [record](const SeriesFrame& frame) { return (frame.*record).found; };
    group_.problem = [record](const SeriesFrame& frame) { return (frame.*record).problem; };
    group_.set_found = [record](bool found, std::string problem, SeriesFrame* frame) {
      (frame->*record).found = found;
      (frame->*record).problem = std::move(problem);
    };
  }

  RecordField& Derived(const Label& label, std::function<Eigen::MatrixXd(const Record&)> get,
                       const Axes& axes = {}) {
    RecordField field{label.name, label.units, label.long_name, axes, {}, false, {}, {}};
    for (const std::string& axis : axes) field.shape.push_back(LengthOf(axis));
    field.get = [record = record_, get = std::move(get)](const SeriesFrame& frame) {
      return get(frame.*record);
    };
    group_.fields.push_back(std::move(field));
    return group_.fields.back();
  }

  template <typename Value>
  RecordField& Stored(const Label& label, Value Record::*value, const Axes& axes = {}) {
    RecordField& field = Derived(
        label, [value](const Record& record) { return ToMatrix(record.*value); }, axes);
    field.set = [record = record_, value](const Eigen::MatrixXd& matrix, SeriesFrame* frame) {
      FromMatrix(matrix, &(frame->*record.*value));
    };
    return field;
  }

  // A rigid motion as a matrix (4, 4).
  void Motion(const Label& label, Rigid3 Record::*motion) {
    RecordField& field = Derived(
        label, [motion](const Record& record) { return (record.*motion).Matrix(); }, {"4", "4"});
    field.needed = true;
    field.set = [record = record_, motion](const Eigen::MatrixXd& m, SeriesFrame* frame) {
      frame->*record.*motion = {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
    };
  }

  // A value with both of its sigmas, and what follows from these.
  template <typename Value>
  void Measured(const Label& label, Value Record::*value, Value Record::*sigma_random,
                Value Record::*sigma_calibration, const Axes& axes = {}, bool needed = false) {
    Stored(label, value, axes).needed = needed;
    Stored(RandomOf(label), sigma_random, axes);
    Stored(CalibrationOf(label), sigma_calibration, axes);
    Combined(label, axes);
  }

  // Sigmas that follow from the covariances of the record.
  void DerivedSigmas(
      const Label& label, Eigen::Matrix3d Record::*cov_random,
      Eigen::Matrix3d Record::*cov_calibration,
      const std::function<Eigen::MatrixXd(const Record&, const Eigen::Matrix3d&)>& sigma,
      const Axes& axes = {}) {
    Derived(
        RandomOf(label), [=](const Record& r) { return sigma(r, r.*cov_random); }, axes);
    Derived(
        CalibrationOf(label), [=](const Record& r) { return sigma(r, r.*cov_calibration); }, axes);
    Combined(label, axes);
  }

  RecordGroup Take() { return std::move(group_); }

 private:
  static Label RandomOf(const Label& label) {
    return {label.name + "_errors_random", label.units, std::string(kRandomSigma)};
  }
  static Label CalibrationOf(const Label& label) {
    return {label.name + "_errors_calibration", label.units, std::string(kCalibrationSigma)};
  }

  // Of the last two fields.
  void Combined(const Label& label, const Axes& axes) {
    const auto a = (group_.fields.end() - 2)->get, b = (group_.fields.end() - 1)->get;
    RecordField& field =
        Derived({label.name + "_errors", label.units, std::string(kCombinedSigma)}, {}, axes);
    field.get = [a, b](const SeriesFrame& frame) -> Eigen::MatrixXd {
      return (a(frame).array().square() + b(frame).array().square()).sqrt();
    };
  }

  Eigen::Index LengthOf(const std::string& axis) const {
    for (const RecordAxis& named : group_.axes) {
      if (named.name == axis) return static_cast<Eigen::Index>(named.labels.size());
    }
    return std::stol(axis);
  }

  RecordGroup group_;
  Record SeriesFrame::*record_;
};

RecordAxis Components(std::vector<std::string> labels) {
  return {"component", "component of the vector", std::move(labels)};
}

double OffsetSigma(const GroundRecord& g, const Eigen::Matrix3d& cov) {
  // A rotation (a, b) about e1, e2 turns the normal by b e1 - a e2; the plane goes through the
  // centroid, so the offset at the origin moves by that times the centroid, and by the offset's
  // own.
  const Eigen::Vector3d c = g.centroid_in_rig_mm;
  const Eigen::RowVector3d J(-g.e2_in_rig.dot(c), g.e1_in_rig.dot(c), 1);
  return std::sqrt((J * cov * J.transpose()).value());
}

RecordGroup GroundGroup() {
  using G = GroundRecord;
  RecordGroup group{"/ground", "ground plane", "offset", nullptr, {}, {}, {}, {}, {}};
  group.axes = {Components({"x", "y", "z"}),
                {"plane_parameter",
                 "parameter of the plane",
                 {"rotation_about_e1_rad", "rotation_about_e2_rad", "offset_at_centroid_mm"}},
                {"angle",
                 "tilt about the rig's x axis, tilt about its y axis, angle to the optical axis",
                 {"tilt_x", "tilt_y", "inclination"}}};
  const Axes xyz = {"component"}, matrix = {"plane_parameter", "plane_parameter"};
  GroupBuilder<G> add(std::move(group), &SeriesFrame::ground);
  const Label offset = {"offset", "mm",
                        "distance of the plane from the rig's origin along its normal"};
  add.Stored(offset, &G::offset_mm).needed = true;
  add.DerivedSigmas(
      offset, &G::cov_random, &G::cov_calibration,
      [](const G& g, const Eigen::Matrix3d& cov) { return ToMatrix(OffsetSigma(g, cov)); });
  add.Stored({"normal", "1", "unit normal of the plane, towards the rig, in the rig frame"},
             &G::normal_in_rig, xyz)
      .needed = true;
  const std::string order =
      " covariance of (rotation about e1 and e2 in rad, offset at the "
      "centroid in mm)";
  add.Stored({"covariance_random", "1", "random" + order}, &G::cov_random, matrix);
  add.Stored({"covariance_calibration", "1", "calibration" + order}, &G::cov_calibration, matrix);
  add.Stored({"e1", "1", "first axis of the covariances, in the rig frame"}, &G::e1_in_rig, xyz);
  add.Stored({"e2", "1", "second axis of the covariances, in the rig frame"}, &G::e2_in_rig, xyz);
  add.Stored({"centroid", "mm", "where the covariances' offset is meant, in the rig frame"},
             &G::centroid_in_rig_mm, xyz);
  add.Motion(
      {"ground_from_rig", "mm",
       "rigid motion from the rig to the ground frame: rotation (without unit), translation in mm"},
      &G::ground_from_rig);
  const Label angles = {"angles_rad", "rad", "how the rig stands over the ground"};
  add.Derived(angles, [](const G& g) { return AnglesOf(g).angle_rad; }, {"angle"});
  add.DerivedSigmas(angles, &G::cov_random, &G::cov_calibration,
                    [](G g, const Eigen::Matrix3d& cov) {
                      g.cov_random = cov;
                      return AnglesOf(g).sigma_random_rad;
                    },
                    {"angle"});
  add.Stored({"rms", "mm", "rms distance of the inliers from the plane"}, &G::rms_mm);
  add.Stored({"inlier_fraction", "1", "share of the points that lie on the plane"},
             &G::inlier_fraction);
  return add.Take();
}

RecordGroup WheelGroup() {
  using W = WheelRecord;
  RecordGroup group{"/wheel", "wheel", "angle_rad", &SeriesContents::wheel, {}, {}, {}, {}, {}};
  group.axes = {Components({"x", "y", "z"})};
  const Axes xyz = {"component"}, matrix = {"component", "component"};
  GroupBuilder<W> add(std::move(group), &SeriesFrame::wheel);
  add.Measured({"angle_rad", "rad", "angle that the wheel has turned about its axis"},
               &W::angle_rad, &W::sigma_random_angle_rad, &W::sigma_calibration_angle_rad);
  add.Measured({"speed", "rad/s", "angular speed about the axis"}, &W::speed_rad_s,
               &W::sigma_random_speed_rad_s, &W::sigma_calibration_speed_rad_s);
  const Label axis = {"axis", "1", "unit vector along the axis, in the ground frame"};
  add.Stored(axis, &W::axis, xyz).needed = true;
  add.DerivedSigmas(
      axis, &W::cov_axis_random, &W::cov_axis_calibration,
      [](const W&, const Eigen::Matrix3d& cov) -> Eigen::MatrixXd {
        return cov.diagonal().cwiseSqrt();
      },
      xyz);
  add.Stored({"axis_covariance_random", "1", "random covariance of the axis"}, &W::cov_axis_random,
             matrix);
  add.Stored({"axis_covariance_calibration", "1", "calibration covariance of the axis"},
             &W::cov_axis_calibration, matrix);
  add.Measured({"centre", "mm", "centre of the wheel, in the ground frame"}, &W::centre_mm,
               &W::sigma_random_centre_mm, &W::sigma_calibration_centre_mm, xyz, true);
  add.Measured({"radius", "mm", "radius of the wheel"}, &W::radius_mm, &W::sigma_random_radius_mm,
               &W::sigma_calibration_radius_mm);
  return add.Take();
}

RecordGroup PatchGroup() {
  using P = PatchRecord;
  RecordGroup group{"/patch", "contact patch", "area_mm2", &SeriesContents::patch, {}, {}, {}, {},
                    {}};
  group.axes = {Components({"x", "y"})};
  GroupBuilder<P> add(std::move(group), &SeriesFrame::patch);
  add.Measured({"area_mm2", "mm2", "area of the contact patch"}, &P::area_mm2,
               &P::sigma_random_area_mm2, &P::sigma_calibration_area_mm2, {}, true);
  add.Measured({"length_mm", "mm", "length along the direction of travel (x of the ground frame)"},
               &P::length_mm, &P::sigma_random_length_mm, &P::sigma_calibration_length_mm);
  add.Measured({"width_mm", "mm", "width across the direction of travel (y of the ground frame)"},
               &P::width_mm, &P::sigma_random_width_mm, &P::sigma_calibration_width_mm);
  add.Measured({"centroid", "mm", "centroid of the contact patch, in the ground frame"},
               &P::centroid_mm, &P::sigma_random_centroid_mm, &P::sigma_calibration_centroid_mm,
               {"component"});
  add.Stored({"threshold_mm", "mm", "height that decides what is in contact"}, &P::threshold_mm);
  add.Stored({"d_area_d_threshold_mm", "mm", "change of the area (mm2) with the threshold (mm)"},
             &P::d_area_d_threshold_mm);
  return add.Take();
}

RecordGroup SlipGroup() {
  using S = SlipRecord;
  RecordGroup group{"/slip", "wheel slip", "", &SeriesContents::slip, {}, {}, {}, {}, {}};
  GroupBuilder<S> add(std::move(group), &SeriesFrame::slip);
  add.Measured({"ratio", "1", "longitudinal slip ratio, by the group's convention"}, &S::ratio,
               &S::sigma_random_ratio, &S::sigma_calibration_ratio);
  add.Measured({"angle_rad", "rad", "slip angle, by the group's convention"}, &S::angle_rad,
               &S::sigma_random_angle_rad, &S::sigma_calibration_angle_rad, {}, true);
  add.Measured({"speed", "mm/s", "speed of the wheel over the ground"}, &S::speed_mm_s,
               &S::sigma_random_speed_mm_s, &S::sigma_calibration_speed_mm_s);
  add.Measured({"effective_radius_mm", "mm", "travel a radian of the wheel"},
               &S::effective_radius_mm, &S::sigma_random_effective_radius_mm,
               &S::sigma_calibration_effective_radius_mm);
  add.Measured({"ratio_by_channel", "1",
                "longitudinal slip ratio by the vehicle-speed channel in place of the patch"},
               &S::ratio_by_channel, &S::sigma_random_ratio_by_channel,
               &S::sigma_calibration_ratio_by_channel);
  add.Stored({"sticking", "1", "points in contact that stick to the ground"}, &S::sticking);
  add.Stored({"sliding", "1", "points in contact that slide over the ground"}, &S::sliding);
  add.Stored({"undecided", "1", "points in contact of which neither can be told"}, &S::undecided);
  return add.Take();
}

RecordGroup RigRotationGroup() {
  using R = RigRotationRecord;
  RecordGroup group{"/rig_rotation",
                    "rotation of the rig",
                    "pitch_rad",
                    &SeriesContents::rig_rotation,
                    {},
                    {},
                    {},
                    {},
                    {}};
  group.may_lack = true;  // a height, on an obstacle
  GroupBuilder<R> add(std::move(group), &SeriesFrame::rig_rotation);
  add.Measured({"pitch_rad", "rad",
                "turn about the wheel's axis from the wheel frame's z to the ground's normal"},
               &R::pitch_rad, &R::sigma_random_pitch_rad, &R::sigma_calibration_pitch_rad, {},
               true);
  add.Measured({"roll_rad", "rad", "turn of the ground about the wheel's heading"}, &R::roll_rad,
               &R::sigma_random_roll_rad, &R::sigma_calibration_roll_rad, {}, true);
  add.Measured({"height_mm", "mm", "height of the wheel frame's origin above the ground"},
               &R::height_mm, &R::sigma_random_height_mm, &R::sigma_calibration_height_mm);
  add.Stored({"lean", "1", "0: all from the frame's own plane, 1: all from other frames"}, &R::lean)
      .needed = true;
  return add.Take();
}

RecordGroup DeformationGroup() {
  using D = DeformationRecord;
  RecordGroup group{"/deformation",
                    "deformation of the wheel",
                    "deflection_mm",
                    &SeriesContents::deformation,
                    {},
                    {},
                    {},
                    {},
                    {}};
  group.axes = {Components({"x", "y", "z"})};
  GroupBuilder<D> add(std::move(group), &SeriesFrame::deformation);
  add.Measured({"loaded_radius_mm", "mm",
                "distance of the wheel's centre from the ground along the wheel's plane"},
               &D::loaded_radius_mm, &D::sigma_random_loaded_radius_mm,
               &D::sigma_calibration_loaded_radius_mm, {}, true);
  add.Measured({"deflection_mm", "mm", "rise of the inner surface under the wheel's centre"},
               &D::deflection_mm, &D::sigma_random_deflection_mm,
               &D::sigma_calibration_deflection_mm);
  add.Measured({"longitudinal_mm", "mm",
                "shift of the carcass along the wheel's heading, mean over the contact patch"},
               &D::longitudinal_mm, &D::sigma_random_longitudinal_mm,
               &D::sigma_calibration_longitudinal_mm);
  add.Measured({"lateral_mm", "mm",
                "shift of the carcass to the left of the heading, mean over the contact patch"},
               &D::lateral_mm, &D::sigma_random_lateral_mm, &D::sigma_calibration_lateral_mm);
  add.Measured({"radial_mm", "mm", "largest approach of the material to the wheel's axis"},
               &D::radial_mm, &D::sigma_random_radial_mm, &D::sigma_calibration_radial_mm);
  add.Stored({"radial_at", "mm", "where that is, in the ground frame"}, &D::radial_at_mm,
             {"component"});
  return add.Take();
}

RecordGroup PlacementGroup() {
  using P = PlacementRecord;
  RecordGroup group{"/placement",
                    "place on the wheel",
                    "placed_by",
                    &SeriesContents::placement,
                    {},
                    {},
                    {},
                    {},
                    {}};
  GroupBuilder<P> add(std::move(group), &SeriesFrame::placement);
  add.Stored({"placed_by", "1",
              "how the frame was found on the wheel: 1, followed from the frames before; 2, by its "
              "tags; 3, by its features"},
             &P::placed_by)
      .needed = true;
  add.Stored({"tags", "1", "tags of the wheel that both images show"}, &P::tags);
  add.Stored({"rim_tags", "1", "those of them that are on the rim"}, &P::rim_tags);
  add.Stored({"unknown_tags", "1", "tags that the wheel's reference does not have"},
             &P::unknown_tags);
  add.Stored({"tag_angle_rad", "rad", "angle of the wheel by its tags, 0 to 2 pi"},
             &P::tag_angle_rad);
  add.Measured(
      {"twist_rad", "rad", "how far the surface is turned ahead of the rim, of the whole run"},
      &P::twist_rad, &P::sigma_random_twist_rad, &P::sigma_calibration_twist_rad);
  return add.Take();
}

RecordGroup SurveyGroup() {
  using S = SurveyRecord;
  RecordGroup group{"/survey", "place on the wheel", "", &SeriesContents::survey, {}, {}, {}, {},
                    {}};
  GroupBuilder<S> add(std::move(group), &SeriesFrame::survey);
  add.Stored(
         {"view", "1", "view of the wheel's reference, from 0, that the frame was matched with"},
         &S::view)
      .needed = true;
  add.Stored({"near_rad", "rad", "angle of the wheel near which the frame was looked for"},
             &S::near_rad)
      .needed = true;
  add.Stored({"spacing_px", "pixel", "distance between points, in the view's left image"},
             &S::spacing_px)
      .needed = true;
  return add.Take();
}

RecordGroup RigidMotionGroup() {
  using M = RigidMotionRecord;
  RecordGroup group{"/rigid_motion",
                    "rigid motion",
                    "translation",
                    &SeriesContents::rigid_motion,
                    {},
                    {},
                    {},
                    {},
                    {}};
  group.in_surface_frame = true;
  group.axes = {Components({"x", "y", "z"})};
  GroupBuilder<M> add(std::move(group), &SeriesFrame::rigid_motion);
  add.Measured({"rotation", "rad",
                "rotation of the whole surface since the reference, axis times angle; about its "
                "centroid"},
               &M::rotation_rad, &M::sigma_random_rotation_rad, &M::sigma_calibration_rotation_rad,
               {"component"}, true);
  add.Measured({"translation", "mm", "way of the whole surface's centroid since the reference"},
               &M::translation_mm, &M::sigma_random_translation_mm,
               &M::sigma_calibration_translation_mm, {"component"}, true);
  return add.Take();
}

RecordGroup RigWatchGroup() {
  using W = RigWatchRecord;
  RecordGroup group{"/rig_watch",
                    "pose of the right camera",
                    "epipolar_rms_px",
                    &SeriesContents::rig_watch,
                    {},
                    {},
                    {},
                    {},
                    {}};
  group.axes = {{"pose_parameter",
                 "parameter of the pose",
                 {"rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "translation_x_mm",
                  "translation_y_mm", "translation_z_mm"}}};
  GroupBuilder<W> add(std::move(group), &SeriesFrame::rig_watch);
  add.Stored({"epipolar_mean_px", "pixel", "mean signed distance from the epipolar lines"},
             &W::epipolar_mean_px);
  add.Stored({"epipolar_rms_px", "pixel", "rms distance from the epipolar lines"},
             &W::epipolar_rms_px)
      .needed = true;
  add.Stored({"epipolar_sigma_px", "pixel",
              "rms distance from the epipolar lines that the noise of the matches lets expect"},
             &W::epipolar_sigma_px);
  add.Stored({"chi2_calibration", "1", "chi-squared of this pose less the calibrated one"},
             &W::chi2_calibration);
  add.Stored({"chi2_first", "1", "chi-squared of this pose less that of the first frame"},
             &W::chi2_first);
  add.Measured({"change", "1",
                "pose of this frame less the calibrated one: rotation vector in rad, translation "
                "in mm"},
               &W::change, &W::sigma_random_change, &W::sigma_calibration_change,
               {"pose_parameter"});
  add.Stored({"refined", "1", "1: the pose of this frame was used, 0: the calibrated one"},
             &W::refined)
      .needed = true;
  add.Stored({"alarm", "1", "1: the right camera has moved against the left one, 0: it has not"},
             &W::alarm)
      .needed = true;
  add.Motion(
      {"right_from_left", "mm",
       "rigid motion from the left to the right camera that was used in this frame: rotation "
       "(without unit), translation in mm"},
      &W::right_from_left);
  return add.Take();
}

RecordGroup WheelChannelGroup() {
  using W = WheelChannelRecord;
  RecordGroup group{"/wheel_channel",
                    "channel of the wheel's speed in its angle",
                    "lean",
                    &SeriesContents::wheel_channel,
                    {},
                    {},
                    {},
                    {},
                    {}};
  GroupBuilder<W> add(std::move(group), &SeriesFrame::wheel_channel);
  add.Stored({"lean", "1",
              "share of the wheel's turn since the frame before that follows the channel; 0: "
              "images tell all of it"},
             &W::lean);
  return add.Take();
}

}  // namespace

const std::vector<RecordGroup>& RecordGroups() {
  static const std::vector<RecordGroup> groups = {
      GroundGroup(),       WheelGroup(),     PatchGroup(),       SlipGroup(),
      RigidMotionGroup(),  RigWatchGroup(),  RigRotationGroup(), DeformationGroup(),
      WheelChannelGroup(), PlacementGroup(), SurveyGroup()};
  return groups;
}

}  // namespace plumbline::internal
