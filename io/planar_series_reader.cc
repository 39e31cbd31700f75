#include "io/planar_series_reader.h"

#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "io/internal/planar_header.h"
#include "io/internal/planar_layout.h"
#include "io/internal/series_file.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;

using internal::PointPart;

struct PlanarSeriesReader::Impl {
  internal::SeriesFile file;
  PlanarSeriesHeader header;
  std::vector<std::int64_t> index, reference_index;
  std::vector<double> time_s;
  std::vector<std::string> id, problem;
  std::vector<std::uint8_t> status;
  std::vector<std::int32_t> dropped_before;

  explicit Impl(const fs::path& path) : file(path, internal::SeriesFile::Kind::kPlanar) {
    file.Reading([&] {
      header = internal::ReadPlanarHeader(file.id(), file.ReadGrid());
      header.recipe_toml = file.facts().recipe_toml;
      ReadFrames();
    });
  }

  void ReadFrames() {
    using internal::kMaxFrames;
    const hid_t f = file.id();
    index = hdf5::ReadArray<std::int64_t>(f, "/frames/index", nullptr, kMaxFrames);
    time_s = hdf5::ReadArray<double>(f, "/frames/time_s", nullptr, kMaxFrames);
    id = hdf5::ReadTexts(f, "/frames/id");
    problem = hdf5::ReadTexts(f, "/frames/problem");
    dropped_before =
        hdf5::ReadArray<std::int32_t>(f, "/frames/dropped_before", nullptr, kMaxFrames);
    reference_index =
        hdf5::ReadArray<std::int64_t>(f, "/frames/reference_index", nullptr, kMaxFrames);
    status = file.ReadEnum("/frames/status");
    file.CheckLengths("/frames", index.size(),
                      {time_s.size(), id.size(), problem.size(), dropped_before.size(),
                       reference_index.size(), status.size()});
  }

  // Frame i of a dataset of points.
  template <typename Element, typename Scalar = float>
  Image<Element> Points(std::uint8_t group, PointPart part, std::size_t i) const {
    const std::string path = internal::PlanarPoints().FieldOf(group, part).Path();
    return file.Points<Element, Scalar>(path, i, header.grid);
  }

  PlanarField ReadField(std::size_t i) const {
    constexpr std::uint8_t group = internal::kPlanarDisplacement;
    PlanarField field;
    field.first_px = header.first_px;
    field.step_px = header.step_px;
    field.subset_px = header.subset_px;
    field.order = header.order;
    field.displacement_px = Points<Eigen::Vector2d, double>(group, PointPart::kValue, i);
    field.gradient = Points<Eigen::Matrix2f>(group, PointPart::kGradient, i);
    for (Eigen::Matrix2f& G : field.gradient.values()) G.transposeInPlace();  // row by row there
    field.cov_displacement_px2 = Points<Eigen::Vector3f>(group, PointPart::kCovariance, i);
    field.cov_gradient = ReadGradientCovariance(i);
    field.zncc = Points<float>(group, PointPart::kCorrelation, i);
    field.iterations = file.Bytes("/displacement/iterations", i, header.grid);
    field.status = file.Statuses("/displacement/status", i, header.grid);
    return field;
  }

  Image<Eigen::Matrix<float, 10, 1>> ReadGradientCovariance(std::size_t i) const {
    using Triangle = Eigen::Matrix<float, 10, 1>;
    constexpr std::uint8_t group = internal::kPlanarDisplacement;
    if (header.contents.gradient_covariance) {
      return Points<Triangle>(group, PointPart::kGradientCovariance, i);
    }
    const auto sigmas = Points<Eigen::Vector4f>(group, PointPart::kGradientRandom, i);
    Image<Triangle> covariance(header.grid,
                               Triangle::Constant(std::numeric_limits<float>::quiet_NaN()));
    for (std::size_t k = 0; k < sigmas.pixel_count(); ++k) {
      covariance.data()[k]({0, 4, 7, 9}) = sigmas.data()[k].cwiseAbs2();
    }
    return covariance;
  }

  PlanarStrainRecord ReadStrain(std::size_t i) const {
    constexpr std::uint8_t group = internal::kPlanarStrain;
    return {Points<Eigen::Vector3f>(group, PointPart::kValue, i),
            Points<Eigen::Matrix<float, 6, 1>>(group, PointPart::kCovariance, i),
            file.Statuses("/strain/status", i, header.grid)};
  }
};

PlanarSeriesReader::PlanarSeriesReader(const fs::path& file)
    : impl_(std::make_unique<Impl>(file)) {}

PlanarSeriesReader::~PlanarSeriesReader() = default;

const SeriesFacts& PlanarSeriesReader::facts() const { return impl_->file.facts(); }
const PlanarSeriesHeader& PlanarSeriesReader::header() const { return impl_->header; }
std::int64_t PlanarSeriesReader::frame_count() const {
  return static_cast<std::int64_t>(impl_->index.size());
}

PlanarSeriesFrame PlanarSeriesReader::Frame(std::int64_t i) const {
  if (i < 0 || i >= frame_count()) throw std::out_of_range("PlanarSeriesReader::Frame");
  const auto k = static_cast<std::size_t>(i);
  PlanarSeriesFrame frame;
  frame.index = impl_->index[k];
  frame.time_s = impl_->time_s[k];
  frame.id = impl_->id[k];
  frame.problem = impl_->problem[k];
  frame.dropped_before = impl_->dropped_before[k];
  frame.reference_index = impl_->reference_index[k];
  if (impl_->status[k] != 0) return frame;
  impl_->file.Reading([&] {
    frame.field = impl_->ReadField(k);
    if (impl_->header.contents.strain) frame.strain = impl_->ReadStrain(k);
  });
  return frame;
}

bool IsPlanarSeries(const fs::path& file) {
  try {
    return internal::IsPlanar(hdf5::OpenForeignFile(file).get());
  } catch (const hdf5::Error& error) {
    throw InputError(fmt::format("{} cannot be read: {}", file.string(), error.what()));
  }
}

}  // namespace plumbline
