#include "io/wheel_file.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "io/internal/array_writer.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/rig_group.h"
#include "io/internal/wheel_tags_group.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;
namespace {

using hdf5::Id;
using hdf5::Shape;
using internal::ReadDoubles;
using Writer = internal::ArrayWriter;
constexpr const char* kFormat = "plumbline-wheel";
constexpr hsize_t kMaxFrames = 100'000;

template <typename T>
using RowMajor = Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

std::vector<double> Flat(const Eigen::MatrixXd& matrix) {
  std::vector<double> values(static_cast<std::size_t>(matrix.size()));
  Eigen::Map<RowMajor<double>>(values.data(), matrix.rows(), matrix.cols()) = matrix;
  return values;
}

// --- writing

void WriteAxis(Writer& out, hid_t file, const WheelReference& wheel) {
  const Id group = hdf5::CreateGroup(file, "/wheel");
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  hdf5::SetInteger(group.get(), "closed", wheel.closed ? 1 : 0);
  hdf5::SetNumber(group.get(), "misclosure_rad", wheel.misclosure_rad);
  hdf5::SetNumber(group.get(), "sigma0", wheel.sigma0);
  hdf5::SetInteger(group.get(), "observations", wheel.observations);
  hdf5::SetInteger(group.get(), "outliers", wheel.outliers);
  if (wheel.right_delay) {
    hdf5::SetNumber(group.get(), "right_delay_s", wheel.right_delay->value_s);
    hdf5::SetNumber(group.get(), "sigma_right_delay_s", wheel.right_delay->sigma_s);
  }
  const std::string order = ", of a rotation about the wheel's x, y, z (rad) and distance (mm)";
  out.Doubles("/wheel/rotation", "1", "turns wheel axes at angle 0 into those of the rig", {3, 3},
              Flat(wheel.axis.rotation));
  out.Number("/wheel/distance", "mm", "of the left camera from the wheel axis",
             wheel.axis.distance_mm);
  const Eigen::Vector3d axis = wheel.axis.direction_in_rig();
  out.Doubles("/wheel/axis", "1", "unit vector along the wheel axis, in the rig", {3},
              {axis.x(), axis.y(), axis.z()});
  out.Doubles("/wheel/axis_covariance_random", "1", "random covariance" + order, {4, 4},
              Flat(wheel.cov_axis_random));
  out.Doubles("/wheel/axis_covariance_calibration", "1", "covariance from the calibration" + order,
              {4, 4}, Flat(wheel.cov_axis_calibration));
  out.Doubles("/wheel/axis_along_modes", "1",
              "what one sigma of each calibration mode adds" + order,
              {static_cast<hsize_t>(wheel.axis_along_modes.rows()), 4},
              Flat(wheel.axis_along_modes), {"/rig/mode"});
}

void WriteFrames(Writer& out, hid_t file, const WheelReference& wheel) {
  const Id group = hdf5::CreateGroup(file, "/frames");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "angle_rad");
  hdf5::SetTexts(group.get(), "axes", {"index"});
  const auto n = static_cast<hsize_t>(wheel.frames.size());
  std::vector<std::int64_t> index;
  std::vector<std::int32_t> matches;
  std::vector<std::uint8_t> status;
  std::vector<double> time, angle, random, calibration;
  for (const WheelFrame& frame : wheel.frames) {
    index.push_back(frame.index);
    time.push_back(frame.time_s);
    matches.push_back(frame.matches);
    status.push_back(static_cast<std::uint8_t>(frame.status));
    angle.push_back(frame.angle_rad);
    random.push_back(frame.sigma_random_rad);
    calibration.push_back(frame.sigma_calibration_rad);
  }
  const std::string axis = "/frames/index";
  out.Scale<std::int64_t>(axis, "1", "number of the frame in the recording", index);
  out.Doubles("/frames/time_s", "s", "from the first frame; NaN without a clock", {n}, time,
              {axis});
  out.Doubles("/frames/angle_rad", "rad", "wheel angle from the first placed frame", {n}, angle,
              {axis});
  out.Doubles("/frames/angle_rad_errors_random", "rad", "one standard deviation, from noise", {n},
              random, {axis});
  out.Doubles("/frames/angle_rad_errors_calibration", "rad",
              "one standard deviation, from the calibration", {n}, calibration, {axis});
  out.Array<std::int32_t>("/frames/matches", "1", "matches of points in both images", {n}, matches,
                          {axis});
  out.Doubles("/frames/angle_covariance_random", "rad2", "of all angles together, from noise",
              {n, n}, Flat(wheel.cov_angles_random_rad2), {axis, axis});
  if (wheel.cov_axis_angles_random.size() > 0) {
    out.Doubles("/frames/axis_covariance_random", "1",
                "random covariance of the angle with axis and distance, in the order of "
                "/wheel/axis_covariance_random",
                {n, 4}, Flat(wheel.cov_axis_angles_random.transpose()), {axis});
  }
  out.Doubles("/frames/angle_along_modes", "rad", "what one sigma of each calibration mode adds",
              {static_cast<hsize_t>(wheel.angles_along_modes_rad.rows()), n},
              Flat(wheel.angles_along_modes_rad), {"/rig/mode", axis});
  const Id type = hdf5::EnumType(kWheelFrameStatusNames);
  const Id dataset = hdf5::CreateDataset(
      file, {"/frames/status", "1", "what became of the frame", {n}, {}}, type.get());
  if (n > 0) {
    hdf5::Check(H5Dwrite(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, status.data()),
                "writing the status of frames");
  }
  hdf5::AttachScales(file, dataset, {axis});
}

void WriteProfile(Writer& out, hid_t file, const WheelProfile& profile) {
  const Id group = hdf5::CreateGroup(file, "/profile");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "radius");
  hdf5::SetTexts(group.get(), "axes", {"y"});
  const auto n = static_cast<hsize_t>(profile.y_mm.size());
  const std::string axis = "/profile/y";
  out.Scale<double>(axis, "mm", "place along the wheel axis, from the point nearest to the camera",
                    profile.y_mm);
  out.Doubles("/profile/radius", "mm", "mean distance of the inner surface from the axis", {n},
              profile.radius_mm, {axis});
  out.Doubles("/profile/radius_errors_random", "mm", "one standard deviation, from noise", {n},
              profile.sigma_random_mm, {axis});
  out.Doubles("/profile/radius_errors_calibration", "mm",
              "one standard deviation, from the calibration", {n}, profile.sigma_calibration_mm,
              {axis});
  out.Doubles("/profile/scatter", "mm", "rms of single points about the mean", {n},
              profile.scatter_mm, {axis});
  const std::vector<std::int32_t> points(profile.points.begin(), profile.points.end());
  out.Array<std::int32_t>("/profile/points", "1", "points in the mean", {n}, points, {axis});
  out.Number("/profile/crown_radius", "mm", "largest mean radius", profile.crown_radius_mm);
  out.Number("/profile/crown_radius_errors_random", "mm", "one standard deviation, from noise",
             profile.sigma_crown_random_mm);
  out.Number("/profile/crown_radius_errors_calibration", "mm",
             "one standard deviation, from the calibration", profile.sigma_crown_calibration_mm);
  out.Number("/profile/crown_y", "mm", "where it is along the axis", profile.crown_y_mm);
}

template <typename T>
void WriteImages(Writer& out, const std::string& path, const std::string& long_name,
                 const WheelReference& wheel, GrayImage WheelReferenceView::*image) {
  std::vector<T> values;
  for (const WheelReferenceView& view : wheel.views) {
    const std::vector<std::uint16_t>& grey = (view.*image).grey.values();
    values.insert(values.end(), grey.begin(), grey.end());
  }
  const ImageSize size = (wheel.views.front().*image).size();
  const auto rows = static_cast<hsize_t>(size.height), columns = static_cast<hsize_t>(size.width);
  out.Array<T>(path, "1", long_name, {wheel.views.size(), rows, columns}, values, {"/views/frame"},
               {1, rows, columns});
}

template <typename T, int kComponents>
void WritePoints(Writer& out, const std::string& path, const std::string& units,
                 const std::string& long_name, const WheelReference& wheel,
                 Image<Eigen::Matrix<T, kComponents, 1>> WheelReferenceView::*image) {
  std::vector<T> values;
  for (const WheelReferenceView& view : wheel.views) {
    for (const auto& v : (view.*image).values()) values.insert(values.end(), v.begin(), v.end());
  }
  const ImageSize size = wheel.views.front().point_mm.size();
  const Shape shape = {wheel.views.size(), static_cast<hsize_t>(size.height),
                       static_cast<hsize_t>(size.width), kComponents};
  out.Array<T>(path, units, long_name, shape, values, {"/views/frame"},
               {1, shape[1], shape[2], shape[3]});
}

void WriteViews(Writer& out, hid_t file, const WheelReference& wheel) {
  const WheelReferenceView& first = wheel.views.front();
  const Id group = hdf5::CreateGroup(file, "/views");
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  hdf5::SetInteger(group.get(), "bits", first.left.bits);
  hdf5::SetInteger(group.get(), "step_px", first.step_px);
  hdf5::SetInteger(group.get(), "first_x_px", first.first_px.x());
  hdf5::SetInteger(group.get(), "first_y_px", first.first_px.y());
  std::vector<std::int32_t> frames;
  std::vector<double> angles;
  for (const WheelReferenceView& view : wheel.views) {
    frames.push_back(view.frame);
    angles.push_back(view.angle_rad);
  }
  out.Scale<std::int32_t>("/views/frame", "1", "place of the view in /frames", frames);
  out.Doubles("/views/angle_rad", "rad", "wheel angle of the view", {angles.size()}, angles,
              {"/views/frame"});
  const auto write = [&]<typename T>(T) {
    WriteImages<T>(out, "/views/left", "left reference images", wheel, &WheelReferenceView::left);
    WriteImages<T>(out, "/views/right", "right reference images", wheel,
                   &WheelReferenceView::right);
  };
  if (first.left.bits > 8) {
    write(std::uint16_t{});
  } else {
    write(std::uint8_t{});
  }
  WritePoints<double, 3>(out, "/views/point", "mm",
                         "undeformed points at the pixels of the grid, in the wheel frame", wheel,
                         &WheelReferenceView::point_mm);
  WritePoints<float, 6>(out, "/views/point_covariance", "mm2",
                        "random covariance of the points: xx xy xz yy yz zz", wheel,
                        &WheelReferenceView::cov_random_mm2);
  WritePoints<float, 3>(out, "/views/point_errors_calibration", "mm",
                        "one standard deviation of the points, from the calibration", wheel,
                        &WheelReferenceView::sigma_calibration_mm);
}

// --- reading

double ReadNumber(hid_t file, const std::string& path) { return ReadDoubles(file, path, {})[0]; }

Eigen::MatrixXd ReadMatrix(hid_t file, const std::string& path, hsize_t rows, hsize_t columns) {
  const std::vector<double> values = ReadDoubles(file, path, {rows, columns});
  return Eigen::Map<const RowMajor<double>>(values.data(), static_cast<Eigen::Index>(rows),
                                            static_cast<Eigen::Index>(columns));
}

// The mode of its sigma is the last one.
void ReadDelay(hid_t group, WheelReference& wheel) {
  constexpr double kNotSaid = 2 * RightDelay::kMost_s;
  const RightDelay delay{hdf5::GetNumber(group, "right_delay_s", kNotSaid),
                         hdf5::GetNumber(group, "sigma_right_delay_s", 0)};
  if (delay.value_s == kNotSaid) return;
  try {
    delay.Check();
  } catch (const UsageError& error) {
    throw hdf5::Error(std::string("/wheel: ") + error.what());
  }
  wheel.right_delay = delay;
  if (delay.sigma_s > 0) wheel.delay_mode = wheel.rig.modes.count() - 1;
}

void ReadAxis(hid_t file, WheelReference& wheel) {
  const Id group = hdf5::OpenGroup(file, "/wheel");
  wheel.closed = hdf5::GetNumber(group.get(), "closed", 0) != 0;
  wheel.misclosure_rad = hdf5::GetNumber(group.get(), "misclosure_rad", 0);
  wheel.sigma0 = hdf5::GetNumber(group.get(), "sigma0", 0);
  wheel.observations = static_cast<std::int64_t>(hdf5::GetNumber(group.get(), "observations", 0));
  wheel.outliers = static_cast<std::int64_t>(hdf5::GetNumber(group.get(), "outliers", 0));
  ReadDelay(group.get(), wheel);
  wheel.axis.rotation = ReadMatrix(file, "/wheel/rotation", 3, 3);
  wheel.axis.distance_mm = ReadNumber(file, "/wheel/distance");
  const Eigen::Matrix3d& R = wheel.axis.rotation;
  const double skew = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  // Written so that NaN is refused too.
  if (!(skew < 1e-6 && R.determinant() > 0 && wheel.axis.distance_mm > 0)) {
    throw hdf5::Error("/wheel/rotation and /wheel/distance are no axis");
  }
  wheel.cov_axis_random = ReadMatrix(file, "/wheel/axis_covariance_random", 4, 4);
  wheel.cov_axis_calibration = ReadMatrix(file, "/wheel/axis_covariance_calibration", 4, 4);
  wheel.axis_along_modes =
      ReadMatrix(file, "/wheel/axis_along_modes", static_cast<hsize_t>(wheel.rig.modes.count()), 4);
}

void ReadFrames(hid_t file, WheelReference& wheel) {
  Shape shape;
  const auto angle = hdf5::ReadArray<double>(file, "/frames/angle_rad", &shape, kMaxFrames);
  const auto random = ReadDoubles(file, "/frames/angle_rad_errors_random", shape);
  const auto calibration = ReadDoubles(file, "/frames/angle_rad_errors_calibration", shape);
  const auto matches = ReadDoubles(file, "/frames/matches", shape);
  const auto index = ReadDoubles(file, "/frames/index", shape);
  const auto time = ReadDoubles(file, "/frames/time_s", shape);
  const Id dataset = hdf5::OpenDataset(file, "/frames/status");
  std::vector<std::uint8_t> status(angle.size());
  if (hdf5::ShapeOf(dataset) != shape) throw hdf5::Error("/frames/status has another size");
  const Id type = hdf5::EnumType(kWheelFrameStatusNames);
  if (!status.empty()) {
    hdf5::Check(H5Dread(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, status.data()),
                "reading /frames/status");
  }
  for (std::size_t f = 0; f < angle.size(); ++f) {
    if (status[f] >= kWheelFrameStatusNames.size()) {
      throw hdf5::Error("/frames/status holds what is no status");
    }
    wheel.frames.push_back({static_cast<std::int64_t>(index[f]), time[f],
                            static_cast<WheelFrameStatus>(status[f]), angle[f], random[f],
                            calibration[f], static_cast<int>(matches[f])});
  }
  wheel.cov_angles_random_rad2 =
      ReadMatrix(file, "/frames/angle_covariance_random", angle.size(), angle.size());
  if (hdf5::Exists(file, "/frames/axis_covariance_random")) {
    wheel.cov_axis_angles_random =
        ReadMatrix(file, "/frames/axis_covariance_random", angle.size(), 4).transpose();
  }
  wheel.angles_along_modes_rad =
      ReadMatrix(file, "/frames/angle_along_modes", static_cast<hsize_t>(wheel.rig.modes.count()),
                 angle.size());
}

void ReadProfile(hid_t file, WheelProfile& profile) {
  Shape shape;
  profile.y_mm = hdf5::ReadArray<double>(file, "/profile/y", &shape, kMaxFrames);
  profile.radius_mm = ReadDoubles(file, "/profile/radius", shape);
  profile.sigma_random_mm = ReadDoubles(file, "/profile/radius_errors_random", shape);
  profile.sigma_calibration_mm = ReadDoubles(file, "/profile/radius_errors_calibration", shape);
  profile.scatter_mm = ReadDoubles(file, "/profile/scatter", shape);
  for (const double n : ReadDoubles(file, "/profile/points", shape)) {
    profile.points.push_back(static_cast<int>(n));
  }
  profile.crown_radius_mm = ReadNumber(file, "/profile/crown_radius");
  profile.crown_y_mm = ReadNumber(file, "/profile/crown_y");
  profile.sigma_crown_random_mm = ReadNumber(file, "/profile/crown_radius_errors_random");
  profile.sigma_crown_calibration_mm = ReadNumber(file, "/profile/crown_radius_errors_calibration");
}

// One image of each view, converted to T; all of one size, which is given back.
template <typename T, typename Put>
ImageSize ReadStack(hid_t file, const std::string& path, std::size_t views, hsize_t components,
                    const Put& put) {
  Shape shape;
  const std::vector<T> values = hdf5::ReadArray<T>(file, path, &shape);
  if (shape.size() < 3 || shape[0] != views || hdf5::ElementCount(shape) == 0 ||
      (components == 0 ? shape.size() != 3 : shape.size() != 4 || shape[3] != components)) {
    throw hdf5::Error(path + " does not hold one image a view");
  }
  const ImageSize size{static_cast<int>(shape[2]), static_cast<int>(shape[1])};
  const std::size_t each = values.size() / views;
  for (std::size_t v = 0; v < views; ++v) put(v, size, values.data() + v * each, each);
  return size;
}

template <typename T, int kComponents>
void ReadPoints(hid_t file, const std::string& path, WheelReference& wheel,
                Image<Eigen::Matrix<T, kComponents, 1>> WheelReferenceView::*image) {
  const auto put = [&](std::size_t v, ImageSize size, const T* values, std::size_t) {
    auto& to = wheel.views[v].*image;
    to = Image<Eigen::Matrix<T, kComponents, 1>>(size, Eigen::Matrix<T, kComponents, 1>::Zero());
    for (std::size_t i = 0; i < to.pixel_count(); ++i) {
      to.data()[i] = Eigen::Map<const Eigen::Matrix<T, kComponents, 1>>(values + i * kComponents);
    }
  };
  ReadStack<T>(file, path, wheel.views.size(), kComponents, put);
}

void ReadViews(hid_t file, WheelReference& wheel) {
  const Id group = hdf5::OpenGroup(file, "/views");
  const auto whole = [&](const char* name) {
    return static_cast<int>(hdf5::GetNumber(group.get(), name, 0));
  };
  Shape shape;
  const auto angles = hdf5::ReadArray<double>(file, "/views/angle_rad", &shape, kMaxFrames);
  const auto frames = ReadDoubles(file, "/views/frame", shape);
  const int bits = whole("bits");
  if (angles.empty() || bits < 8 || bits > 16 || whole("step_px") < 1) {
    throw hdf5::Error("/views holds no reference images");
  }
  wheel.views.resize(angles.size());
  for (std::size_t v = 0; v < angles.size(); ++v) {
    WheelReferenceView& view = wheel.views[v];
    view.frame = static_cast<int>(frames[v]);
    if (view.frame < 0 || static_cast<std::size_t>(view.frame) >= wheel.frames.size()) {
      throw hdf5::Error("/views/frame names a frame that is not there");
    }
    view.angle_rad = angles[v];
    view.step_px = whole("step_px");
    view.first_px = {whole("first_x_px"), whole("first_y_px")};
  }
  for (const bool right : {false, true}) {
    const auto image = right ? &WheelReferenceView::right : &WheelReferenceView::left;
    const auto put = [&](std::size_t v, ImageSize size, const std::int32_t* values, std::size_t n) {
      GrayImage& to = wheel.views[v].*image;
      to = {Image<std::uint16_t>(size), bits};
      for (std::size_t i = 0; i < n; ++i) {
        to.grey.data()[i] = static_cast<std::uint16_t>(values[i]);
      }
    };
    const std::string path = right ? "/views/right" : "/views/left";
    const ImageSize size = ReadStack<std::int32_t>(file, path, angles.size(), 0, put);
    if (size != (right ? wheel.rig.right : wheel.rig.left).size()) {
      throw hdf5::Error(path + " is not of the size of the rig's images");
    }
  }
  ReadPoints<double, 3>(file, "/views/point", wheel, &WheelReferenceView::point_mm);
  ReadPoints<float, 6>(file, "/views/point_covariance", wheel, &WheelReferenceView::cov_random_mm2);
  ReadPoints<float, 3>(file, "/views/point_errors_calibration", wheel,
                       &WheelReferenceView::sigma_calibration_mm);
  for (const WheelReferenceView& view : wheel.views) {
    if (view.cov_random_mm2.size() != view.point_mm.size() ||
        view.sigma_calibration_mm.size() != view.point_mm.size()) {
      throw hdf5::Error("the points of /views and their errors have different grids");
    }
  }
}

}  // namespace

void WriteWheelFile(const fs::path& path, const WheelReference& wheel,
                    const std::string& recipe_toml, const std::vector<fs::path>& inputs) {
  if (wheel.views.empty()) throw std::invalid_argument("WriteWheelFile: there is no view");
  const std::string described = internal::DescribeInputs(inputs);
  try {
    internal::WriteDurably(path, [&](const fs::path& temporary) {
      Id file = hdf5::CreateFile(temporary);
      internal::WriteRootAttributes(file.get(), kFormat, recipe_toml, described);
      internal::WriteRigGroup(file.get(), wheel.rig, {});
      Writer out(file.get());
      WriteAxis(out, file.get(), wheel);
      WriteFrames(out, file.get(), wheel);
      WriteProfile(out, file.get(), wheel.profile);
      WriteViews(out, file.get(), wheel);
      internal::WriteWheelTags(file.get(), wheel.tags, wheel.rig.modes.count());
      file.Close("closing the file");
    });
  } catch (const hdf5::Error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}", path.string(), error.what()));
  }
}

bool IsWheelFile(const fs::path& path) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) return false;
  try {
    const Id file = hdf5::OpenForeignFile(path);
    return hdf5::GetText(file.get(), "format") == kFormat;
  } catch (const hdf5::Error&) {
    return false;
  }
}

WheelReference ReadWheelFile(const fs::path& path) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) {
    throw InputError(fmt::format(
        "There is no wheel file {}; plumbline reference makes one from a recording of the lifted, "
        "slowly turning wheel.",
        path.string()));
  }
  const auto refuse = [&](const char* reason) {
    return InputError(fmt::format("{} cannot be read as a wheel file: {}", path.string(), reason));
  };
  try {
    const Id file = hdf5::OpenForeignFile(path);
    if (hdf5::GetText(file.get(), "format") != kFormat) {
      throw hdf5::Error(fmt::format("its root attribute format is not {}", kFormat));
    }
    WheelReference wheel{.rig = internal::ReadRigGroup(file.get())};
    ReadAxis(file.get(), wheel);
    ReadFrames(file.get(), wheel);
    ReadProfile(file.get(), wheel.profile);
    ReadViews(file.get(), wheel);
    wheel.tags = internal::ReadWheelTags(file.get(), wheel.rig.modes.count());
    return wheel;
  } catch (const hdf5::Error& error) {
    throw refuse(error.what());
  } catch (const std::invalid_argument& error) {  // impossible camera parameters
    throw refuse(error.what());
  } catch (const InputError& error) {  // unknown lens model
    throw refuse(error.what());
  }
}

}  // namespace plumbline
