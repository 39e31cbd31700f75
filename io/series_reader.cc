#include "io/series_reader.h"

#include <fmt/format.h>

#include <cstring>
#include <stdexcept>
#include <type_traits>

#include "calib/error.h"
#include "io/internal/hdf5.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_tables.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;

namespace {

// A frame of 16 384 by 16 384 points, three numbers each, is the largest that is read.
constexpr hsize_t kMaxFrameElements = hsize_t{3} << 28;
constexpr hsize_t kMaxFrames = 100'000'000;

template <typename Element, typename Scalar>
Image<Element> ToImage(ImageSize size, const std::vector<Scalar>& values) {
  Element zero{};
  if constexpr (std::is_class_v<Element>) zero.setZero();
  Image<Element> image(size, zero);
  if (values.size() * sizeof(Scalar) != image.pixel_count() * sizeof(Element)) {
    throw hdf5::Error("a dataset of /surface is not of the grid's size");
  }
  if (!values.empty()) {
    std::memcpy(static_cast<void*>(image.data()), values.data(), values.size() * sizeof(Scalar));
  }
  return image;
}

template <typename Matrix>
Matrix ToMatrix(const std::vector<double>& values) {
  using RowMajor =
      Eigen::Matrix<double, Matrix::RowsAtCompileTime, Matrix::ColsAtCompileTime,
                    Matrix::ColsAtCompileTime == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
  if (values.size() != static_cast<std::size_t>(Matrix::SizeAtCompileTime)) {
    throw hdf5::Error("a dataset of /ground has the wrong size");
  }
  return Eigen::Map<const RowMajor>(values.data());
}

}  // namespace

struct SeriesReader::Impl {
  fs::path path;
  hdf5::Id file;
  SeriesFacts facts;
  Image<Eigen::Vector2f> grid;
  int step_px = 0;
  int subset_px = 0;
  std::vector<std::int64_t> index;
  std::vector<double> time_s;
  std::vector<std::string> left_id, right_id, problem;
  std::vector<std::uint8_t> status, surface_frame, ground_status;
  std::vector<std::int32_t> dropped_before;
  std::vector<std::string> ground_problem;

  // Runs a reader, and says which file it was where something is wrong.
  template <typename Read>
  auto Reading(const Read& read) const {
    const auto refuse = [&](const char* reason) {
      return InputError(fmt::format("{} cannot be read as a series: {}", path.string(), reason));
    };
    try {
      return read();
    } catch (const hdf5::Error& error) {
      throw refuse(error.what());
    } catch (const std::invalid_argument& error) {  // impossible camera parameters
      throw refuse(error.what());
    }
  }

  void Open() {
    file = hdf5::OpenForeignFile(path);
    const std::string format = hdf5::GetText(file.get(), "format");
    if (format != "plumbline-series") {
      throw hdf5::Error(format.empty() ? "it has no attribute `format`"
                                       : fmt::format("it is of the format {}", format));
    }
    const double version = hdf5::GetNumber(file.get(), "format_version", 0);
    if (!(version >= 1 && version <= static_cast<double>(internal::kFormatVersion))) {
      throw hdf5::Error(fmt::format("it is of version {}; this program reads up to {}", version,
                                    internal::kFormatVersion));
    }
    facts = {hdf5::GetText(file.get(), "created"), hdf5::GetText(file.get(), "software"),
             hdf5::GetText(file.get(), "recipe"), hdf5::GetText(file.get(), "inputs")};
    ReadGrid();
    ReadFrames();
  }

  void ReadGrid() {
    hdf5::Shape shape;
    const auto values =
        hdf5::ReadArray<float>(file.get(), "/grid/pixel", &shape, kMaxFrameElements);
    if (shape.size() != 3 || shape[2] != 2) throw hdf5::Error("/grid/pixel is not (row, col, 2)");
    grid =
        ToImage<Eigen::Vector2f>({static_cast<int>(shape[1]), static_cast<int>(shape[0])}, values);
    const auto one = [&](const char* name) {
      return hdf5::ReadArray<std::int32_t>(file.get(), name, nullptr, 1).at(0);
    };
    step_px = one("/grid/step_px");
    subset_px = one("/grid/subset_px");
  }

  void ReadFrames() {
    const hid_t f = file.get();
    index = hdf5::ReadArray<std::int64_t>(f, "/frames/index", nullptr, kMaxFrames);
    time_s = hdf5::ReadArray<double>(f, "/frames/time_s", nullptr, kMaxFrames);
    left_id = hdf5::ReadTexts(f, "/frames/left_id");
    right_id = hdf5::ReadTexts(f, "/frames/right_id");
    problem = hdf5::ReadTexts(f, "/frames/problem");
    status = ReadEnum("/frames/status");
    surface_frame = ReadEnum("/frames/surface_frame");
    dropped_before =
        hdf5::ReadArray<std::int32_t>(f, "/frames/dropped_before", nullptr, kMaxFrames);
    ground_status = ReadEnum("/ground/status");
    ground_problem = hdf5::ReadTexts(f, "/ground/problem");
    const std::size_t n = index.size();
    for (const std::size_t size : {time_s.size(), left_id.size(), right_id.size(), problem.size(),
                                   status.size(), surface_frame.size(), dropped_before.size(),
                                   ground_status.size(), ground_problem.size()}) {
      if (size != n) throw hdf5::Error("the columns of /frames and /ground differ in length");
    }
  }

  std::vector<std::uint8_t> ReadEnum(const std::string& name) const {
    const hdf5::Id dataset = hdf5::OpenDataset(file.get(), name);
    const hdf5::Id type(hdf5::Check(H5Dget_type(dataset.get()), "dataset type"));
    const hsize_t n = hdf5::ElementCount(hdf5::ShapeOf(dataset));
    if (H5Tget_size(type.get()) != 1 || n > kMaxFrames) throw hdf5::Error(name + " holds no bytes");
    std::vector<std::uint8_t> values(n);
    if (n > 0) {
      hdf5::Check(H5Dread(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
                  "reading a column");
    }
    return values;
  }

  template <typename T>
  std::vector<T> Slab(const std::string& name, std::size_t i) const {
    return hdf5::ReadSlab<T>(hdf5::OpenDataset(file.get(), name), i, kMaxFrameElements);
  }

  Surface ReadSurface(std::size_t i) const {
    const ImageSize size = grid.size();
    Surface s;
    s.position_mm = ToImage<Eigen::Vector3f>(size, Slab<float>("/surface/position", i));
    s.sigma_random_mm =
        ToImage<Eigen::Vector3f>(size, Slab<float>("/surface/position_errors_random", i));
    s.sigma_calibration_mm =
        ToImage<Eigen::Vector3f>(size, Slab<float>("/surface/position_errors_calibration", i));
    s.correlation = ToImage<float>(size, Slab<float>("/surface/correlation", i));
    s.epipolar_px = ToImage<float>(size, Slab<float>("/surface/epipolar_px", i));
    const auto codes =
        hdf5::ReadSlabBytes(hdf5::OpenDataset(file.get(), "/surface/status"), i, kMaxFrameElements);
    for (const std::uint8_t code : codes) {
      if (code >= kStatusNames.size()) throw hdf5::Error("/surface/status holds unknown codes");
    }
    s.status = ToImage<Status>(size, codes);
    if (hdf5::Exists(file.get(), "/surface/covariance")) {
      s.cov_random_mm2 =
          ToImage<Eigen::Matrix<float, 6, 1>>(size, Slab<float>("/surface/covariance", i));
    }
    return s;
  }

  GroundRecord ReadGround(std::size_t i) const {
    GroundRecord g;
    g.found = ground_status[i] == 0;
    g.problem = ground_problem[i];
    if (!g.found) return g;
    const auto get = [&](const char* name) {
      return Slab<double>(std::string("/ground/") + name, i);
    };
    using Eigen::Matrix3d;
    using Eigen::Vector3d;
    g.normal_in_rig = ToMatrix<Vector3d>(get("normal"));
    g.offset_mm = get("offset").at(0);
    g.cov_random = ToMatrix<Matrix3d>(get("covariance_random"));
    g.cov_calibration = ToMatrix<Matrix3d>(get("covariance_calibration"));
    const auto motion = ToMatrix<Eigen::Matrix4d>(get("ground_from_rig"));
    g.ground_from_rig.rotation = motion.topLeftCorner<3, 3>();
    g.ground_from_rig.translation_mm = motion.topRightCorner<3, 1>();
    g.rms_mm = get("rms").at(0);
    g.inlier_fraction = get("inlier_fraction").at(0);
    g.e1_in_rig = ToMatrix<Vector3d>(get("e1"));
    g.e2_in_rig = ToMatrix<Vector3d>(get("e2"));
    g.centroid_in_rig_mm = ToMatrix<Vector3d>(get("centroid"));
    return g;
  }
};

SeriesReader::SeriesReader(const fs::path& file) : impl_(std::make_unique<Impl>()) {
  std::error_code ignored;
  if (!fs::is_regular_file(file, ignored)) {
    throw InputError(fmt::format("there is no series {}", file.string()));
  }
  impl_->path = file;
  impl_->Reading([&] { impl_->Open(); });
}

SeriesReader::~SeriesReader() = default;

const SeriesFacts& SeriesReader::facts() const { return impl_->facts; }
StereoRig SeriesReader::rig() const {
  return impl_->Reading([&] { return internal::ReadRigGroup(impl_->file.get()); });
}
Image<Eigen::Vector2f> SeriesReader::grid_px() const { return impl_->grid; }
int SeriesReader::step_px() const { return impl_->step_px; }
int SeriesReader::subset_px() const { return impl_->subset_px; }
std::int64_t SeriesReader::frame_count() const {
  return static_cast<std::int64_t>(impl_->index.size());
}

SeriesFrame SeriesReader::Frame(std::int64_t i) const {
  if (i < 0 || i >= frame_count()) throw std::out_of_range("SeriesReader::Frame");
  const auto k = static_cast<std::size_t>(i);
  SeriesFrame frame;
  frame.index = impl_->index[k];
  frame.time_s = impl_->time_s[k];
  frame.left_id = impl_->left_id[k];
  frame.right_id = impl_->right_id[k];
  frame.problem = impl_->problem[k];
  frame.dropped_before = impl_->dropped_before[k];
  impl_->Reading([&] {
    if (impl_->status[k] == 0) frame.surface = impl_->ReadSurface(k);
    frame.ground = impl_->ReadGround(k);
  });
  frame.surface.frame = impl_->surface_frame[k] == 0 ? SurfaceFrame::kRig : SurfaceFrame::kGround;
  return frame;
}

}  // namespace plumbline
