#include "io/internal/series_tables.h"

#include <array>
#include <cmath>
#include <functional>
#include <limits>

namespace plumbline::internal {
namespace {

using hdf5::Id;
using Frames = std::vector<SeriesFrame>;

template <typename T, typename Get>
std::vector<T> Column(const Frames& frames, const Get& get) {
  std::vector<T> column;
  for (const SeriesFrame& frame : frames) column.push_back(static_cast<T>(get(frame)));
  return column;
}

void WriteEnum(hid_t file, const std::string& path, const std::string& long_name,
               std::span<const std::string_view> names, const std::vector<std::uint8_t>& values) {
  const Id dataset = CreateEnumDataset(file, {path, "1", long_name, {values.size()}, {}}, names, 0);
  if (!values.empty()) {
    const Id type = hdf5::EnumType(names);
    hdf5::Check(H5Dwrite(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
                "writing a column");
  }
  hdf5::AttachScales(file, dataset, {"/frames/index"});
}

void WriteFrames(hid_t file, const Frames& frames, const std::vector<std::uint8_t>& has_surface) {
  const hsize_t F = frames.size();
  const Id group = hdf5::CreateGroup(file, "/frames");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "time_s");
  hdf5::SetTexts(group.get(), "axes", {"index"});
  hdf5::MakeScale(hdf5::WriteArray<std::int64_t>(
                      file, {"/frames/index", "1", "position in the recording, from 0", {F}, {}},
                      Column<std::int64_t>(frames, [](const auto& f) { return f.index; })),
                  "frame");
  const std::vector<std::string> axis = {"/frames/index"};
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<double>(file, {"/frames/time_s", "s", "time of the frame", {F}, {}},
                               Column<double>(frames, [](const auto& f) { return f.time_s; })),
      axis);
  const auto texts = [&](const std::string& path, const std::string& long_name, auto get) {
    hdf5::AttachScales(
        file,
        hdf5::WriteTexts(file, {path, "1", long_name, {F}, {}}, Column<std::string>(frames, get)),
        axis);
  };
  texts("/frames/left_id", "left image", [](const auto& f) { return f.left_id; });
  texts("/frames/right_id", "right image", [](const auto& f) { return f.right_id; });
  texts("/frames/problem", "why there is no surface; empty if there is one",
        [](const auto& f) { return f.problem; });
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<std::int32_t>(
          file, {"/frames/dropped_before", "1", "frames lost just before this one", {F}, {}},
          Column<std::int32_t>(frames, [](const auto& f) { return f.dropped_before; })),
      axis);
  std::vector<std::uint8_t> status;
  for (const std::uint8_t has : has_surface) status.push_back(has != 0 ? 0 : 1);
  WriteEnum(file, "/frames/status", "whether the frame holds a surface", kFrameStatusNames, status);
  WriteEnum(file, "/frames/surface_frame", "frame that the positions are given in",
            kSurfaceFrameNames,
            Column<std::uint8_t>(frames, [](const auto& f) { return f.surface.frame; }));
}

// One number, vector or matrix of the ground a frame.
struct GroundField {
  std::string name, units, long_name;
  hdf5::Shape shape;                // of one frame
  std::vector<std::string> scales;  // of its dimensions
  std::function<Eigen::MatrixXd(const GroundRecord&)> get;
};

double OffsetSigma(const GroundRecord& g, const Eigen::Matrix3d& cov) {
  // A rotation (a, b) about e1, e2 turns the normal by b e1 - a e2; the plane goes through the
  // centroid, so the offset at the origin moves by that times the centroid, and by the offset's
  // own.
  const Eigen::Vector3d c = g.centroid_in_rig_mm;
  const Eigen::RowVector3d J(-g.e2_in_rig.dot(c), g.e1_in_rig.dot(c), 1);
  return std::sqrt((J * cov * J.transpose()).value());
}

Eigen::MatrixXd Scalar(double value) { return Eigen::MatrixXd::Constant(1, 1, value); }

std::vector<GroundField> GroundFields(hid_t file) {
  const std::string xyz = "/ground/component", par = "/ground/plane_parameter",
                    angle = "/ground/angle", index = hdf5::IndexScale(file, 4);
  using G = const GroundRecord&;
  return {
      {"offset",
       "mm",
       "distance of the plane from the rig's origin along its normal",
       {},
       {},
       [](G g) { return Scalar(g.offset_mm); }},
      {"offset_errors_random",
       "mm",
       "standard deviation from independent noise",
       {},
       {},
       [](G g) { return Scalar(OffsetSigma(g, g.cov_random)); }},
      {"offset_errors_calibration",
       "mm",
       "standard deviation from the calibration",
       {},
       {},
       [](G g) { return Scalar(OffsetSigma(g, g.cov_calibration)); }},
      {"normal",
       "1",
       "unit normal of the plane, towards the rig, in the rig frame",
       {3},
       {xyz},
       [](G g) { return g.normal_in_rig; }},
      {"covariance_random",
       "1",
       "random covariance of (rotation about e1 and e2 in rad, offset at "
       "the centroid in mm)",
       {3, 3},
       {par, par},
       [](G g) { return g.cov_random; }},
      {"covariance_calibration",
       "1",
       "calibration covariance of (rotation about e1 and e2 in rad, "
       "offset at the centroid in mm)",
       {3, 3},
       {par, par},
       [](G g) { return g.cov_calibration; }},
      {"e1",
       "1",
       "first axis of the covariances, in the rig frame",
       {3},
       {xyz},
       [](G g) { return g.e1_in_rig; }},
      {"e2",
       "1",
       "second axis of the covariances, in the rig frame",
       {3},
       {xyz},
       [](G g) { return g.e2_in_rig; }},
      {"centroid",
       "mm",
       "where the covariances' offset is meant, in the rig frame",
       {3},
       {xyz},
       [](G g) { return g.centroid_in_rig_mm; }},
      {"ground_from_rig",
       "mm",
       "rigid motion from the rig to the ground frame: rotation (without "
       "unit), translation in mm",
       {4, 4},
       {index, index},
       [](G g) { return g.ground_from_rig.Matrix(); }},
      {"angles_rad",
       "rad",
       "how the rig stands over the ground",
       {3},
       {angle},
       [](G g) { return AnglesOf(g).angle_rad; }},
      {"angles_rad_errors_random",
       "rad",
       "standard deviation from independent noise",
       {3},
       {angle},
       [](G g) { return AnglesOf(g).sigma_random_rad; }},
      {"angles_rad_errors_calibration",
       "rad",
       "standard deviation from the calibration",
       {3},
       {angle},
       [](G g) { return AnglesOf(g).sigma_calibration_rad; }},
      {"rms",
       "mm",
       "rms distance of the inliers from the plane",
       {},
       {},
       [](G g) { return Scalar(g.rms_mm); }},
      {"inlier_fraction",
       "1",
       "share of the points that lie on the plane",
       {},
       {},
       [](G g) { return Scalar(g.inlier_fraction); }},
  };
}

void WriteLabels(hid_t file, const std::string& path, const std::string& label,
                 const std::string& long_name, const std::vector<std::string>& names) {
  hdf5::MakeScale(hdf5::WriteTexts(file, {path, "1", long_name, {names.size()}, {}}, names), label);
}

void WriteGround(hid_t file, const Frames& frames) {
  const Id group = hdf5::CreateGroup(file, "/ground");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "offset");
  hdf5::SetTexts(group.get(), "axes", {"frame"});
  hdf5::HardLink(file, "/frames/index", "/ground/frame");
  WriteLabels(file, "/ground/component", "component", "component of the vector", {"x", "y", "z"});
  WriteLabels(file, "/ground/plane_parameter", "plane_parameter", "parameter of the plane",
              {"rotation_about_e1_rad", "rotation_about_e2_rad", "offset_at_centroid_mm"});
  WriteLabels(file, "/ground/angle", "angle",
              "tilt about the rig's x axis, tilt about its y axis, angle to the optical axis",
              {"tilt_x", "tilt_y", "inclination"});
  for (const GroundField& field : GroundFields(file)) {
    hdf5::Shape shape = field.shape;
    shape.insert(shape.begin(), frames.size());
    std::vector<double> values;
    for (const SeriesFrame& frame : frames) {
      Eigen::MatrixXd value = field.get(frame.ground);
      if (!frame.ground.found) value.setConstant(std::numeric_limits<double>::quiet_NaN());
      for (Eigen::Index r = 0; r < value.rows(); ++r) {
        for (Eigen::Index c = 0; c < value.cols(); ++c) values.push_back(value(r, c));
      }
    }
    std::vector<std::string> scales = field.scales;
    scales.insert(scales.begin(), "/frames/index");
    hdf5::AttachScales(
        file,
        hdf5::WriteArray<double>(
            file, {"/ground/" + field.name, field.units, field.long_name, shape, {}}, values),
        scales);
  }
  WriteEnum(file, "/ground/status", "whether a ground plane was found", kGroundStatusNames,
            Column<std::uint8_t>(frames, [](const auto& f) { return f.ground.found ? 0 : 1; }));
  hdf5::AttachScales(
      file,
      hdf5::WriteTexts(file,
                       {"/ground/problem",
                        "1",
                        "why there is no plane; empty if there is one",
                        {frames.size()},
                        {}},
                       Column<std::string>(frames, [](const auto& f) { return f.ground.problem; })),
      {"/frames/index"});
}

}  // namespace

Id CreateEnumDataset(hid_t file, const hdf5::DatasetSpec& spec,
                     std::span<const std::string_view> names, std::uint8_t fill) {
  const Id type = hdf5::EnumType(names);
  Id dataset = hdf5::CreateDataset(file, spec, type.get(), &fill);
  std::string meanings;
  for (const std::string_view name : names) {
    if (!meanings.empty()) meanings += ' ';
    meanings += name;
  }
  hdf5::SetText(dataset.get(), "flag_meanings", meanings);
  const hsize_t n = names.size();
  std::vector<std::uint8_t> values(n);
  for (std::size_t i = 0; i < n; ++i) values[i] = static_cast<std::uint8_t>(i);
  const Id space(hdf5::Check(H5Screate_simple(1, &n, nullptr), "attribute"));
  const Id attribute(hdf5::Check(H5Acreate2(dataset.get(), "flag_values", H5T_NATIVE_UINT8,
                                            space.get(), H5P_DEFAULT, H5P_DEFAULT),
                                 "attribute"));
  hdf5::Check(H5Awrite(attribute.get(), H5T_NATIVE_UINT8, values.data()), "attribute");
  return dataset;
}

void WriteFrameTables(hid_t file, const Frames& frames,
                      const std::vector<std::uint8_t>& has_surface) {
  WriteFrames(file, frames, has_surface);
  WriteGround(file, frames);
}

}  // namespace plumbline::internal
