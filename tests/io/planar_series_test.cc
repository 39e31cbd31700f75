// The series of one camera: what is written and read again, and what is refused.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "calib/error.h"
#include "io/inspect.h"
#include "io/series_reader.h"
#include "tests/io/planar_fixture.h"
#include "tests/io/series_fixture.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::BadPlanarFrame;
using testing::ExpectSamePlanarFrame;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::PlanarFrame;
using testing::PlanarHeader;
using testing::TestFolder;
using testing::WritePlanar;

TEST(PlanarSeries, ReadsBackWhatWasWritten) {
  const fs::path file = TestFolder() / "run.h5";
  std::ofstream(TestFolder() / "in.txt") << "abc";
  PlanarSeriesHeader header = PlanarHeader();
  header.inputs = {TestFolder() / "in.txt"};
  const std::vector<PlanarSeriesFrame> frames = {PlanarFrame(0), BadPlanarFrame(), PlanarFrame(2)};
  WritePlanar(file, header, frames);
  const PlanarSeriesReader reader(file);
  ASSERT_EQ(reader.frame_count(), 3);
  for (std::size_t i = 0; i < 3; ++i) {
    ExpectSamePlanarFrame(frames[i], reader.Frame(static_cast<std::int64_t>(i)));
  }
  EXPECT_THROW(reader.Frame(3), std::out_of_range);
  const PlanarSeriesHeader& back = reader.header();
  EXPECT_EQ(back.grid, header.grid);
  EXPECT_EQ(back.first_px, header.first_px);
  EXPECT_EQ(back.step_px, 8);
  EXPECT_EQ(back.subset_px, 33);
  EXPECT_EQ(back.order, 2);
  EXPECT_EQ(back.subset_shape, "circle");
  EXPECT_EQ(back.interpolation, "quintic");
  EXPECT_EQ(back.prefilter, "gaussian");
  EXPECT_EQ(back.prefilter_sigma_px, 0.5);
  EXPECT_EQ(back.reference, "frame 10");
  EXPECT_EQ(back.reference_id, "first.png");
  EXPECT_EQ(back.strain_measure, "hencky");
  EXPECT_EQ(back.vsg_px, 65);
  EXPECT_EQ(back.window_points, 5);
  EXPECT_EQ(back.camera.image_size, (ImageSize{640, 480}));
  EXPECT_EQ(back.camera.bits, 12);
  EXPECT_EQ(back.camera.noise.offset_grey2, 2.5);
  EXPECT_EQ(back.camera.noise.slope_grey, 0.03);
  EXPECT_EQ(back.camera.noise_source, "static frames");
  EXPECT_EQ(back.contents, header.contents);
  EXPECT_EQ(back.recipe_toml, header.recipe_toml);
  EXPECT_EQ(reader.facts().recipe_toml, header.recipe_toml);
  EXPECT_THAT(reader.facts().inputs_json,
              HasSubstr("\"size\": 3, \"sha256\": "
                        "\"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\""));
  EXPECT_THAT(Validate(file), IsEmpty());
}

// As `plumbline analyse` does: nothing but the strain changes.
TEST(PlanarSeries, HeadsASeriesOfTheSameFramesWithAnotherStrain) {
  const fs::path folder = TestFolder();
  PlanarSeriesHeader header = PlanarHeader();
  header.contents.strain = false;
  WritePlanar(folder / "in.h5", header, {PlanarFrame(0), BadPlanarFrame(), PlanarFrame(2)});
  const PlanarSeriesReader in(folder / "in.h5");
  EXPECT_TRUE(in.Frame(0).strain.status.empty());
  PlanarSeriesHeader other = in.header();
  other.contents.strain = true;
  other.strain_measure = "small";
  PlanarSeriesWriter writer(folder / "out.h5", other);
  for (std::int64_t i = 0; i < in.frame_count(); ++i) {
    PlanarSeriesFrame frame = in.Frame(i);
    if (frame.problem.empty()) frame.strain = PlanarFrame(i).strain;
    writer.Commit(frame);
  }
  writer.Close();
  const PlanarSeriesReader out(folder / "out.h5");
  ExpectSamePlanarFrame(PlanarFrame(0), out.Frame(0));
  ExpectSamePlanarFrame(BadPlanarFrame(), out.Frame(1));
  ExpectSamePlanarFrame(PlanarFrame(2), out.Frame(2));
  EXPECT_EQ(out.header().strain_measure, "small");
  EXPECT_THAT(Validate(folder / "out.h5"), IsEmpty());
}

TEST(PlanarSeries, WithoutTheGradientsCovarianceKeepsTheirSigmas) {
  const fs::path file = TestFolder() / "run.h5";
  PlanarSeriesHeader header = PlanarHeader();
  header.contents = {};
  WritePlanar(file, header, {PlanarFrame(0)});
  const PlanarSeriesFrame frame = PlanarSeriesReader(file).Frame(0);
  const Eigen::Matrix<float, 10, 1>& cov = frame.field.cov_gradient(0, 0);
  for (const auto& [place, variance] :
       {std::pair{0, 1e-8f}, std::pair{4, 4e-8f}, std::pair{7, 9e-8f}, std::pair{9, 16e-8f}}) {
    EXPECT_FLOAT_EQ(cov[place], variance);
  }
  for (const int place : {1, 2, 3, 5, 6, 8}) EXPECT_TRUE(std::isnan(cov[place]));
  EXPECT_TRUE(frame.strain.status.empty());
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(PlanarSeries, HoldsLargeFramesCutIntoBands) {
  const fs::path file = TestFolder() / "run.h5";
  const PlanarSeriesHeader header =
      PlanarHeader({300, 401});  // 87 rows a band: the last one is cut
  WritePlanar(file, header, {PlanarFrame(3, header)});
  ExpectSamePlanarFrame(PlanarFrame(3, header), PlanarSeriesReader(file).Frame(0));
}

TEST(PlanarSeries, AFrameWithoutStrainReadsAsMasked) {
  const fs::path file = TestFolder() / "run.h5";
  PlanarSeriesFrame frame = PlanarFrame(0);
  frame.strain = {};
  WritePlanar(file, PlanarHeader(), {frame});
  const PlanarSeriesFrame back = PlanarSeriesReader(file).Frame(0);
  EXPECT_EQ(back.strain.status(2, 2), Status::kMasked);
  EXPECT_TRUE(back.strain.strain(2, 2).array().isNaN().all());
  EXPECT_EQ(back.field.status(2, 2), Status::kOk);
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(PlanarSeries, NeverStoresAValueThatItsStatusDenies) {
  const fs::path file = TestFolder() / "run.h5";
  PlanarSeriesFrame frame = PlanarFrame(0);
  const float infinity = std::numeric_limits<float>::infinity();
  frame.field.status(0, 0) = Status::kLowTexture;    // with a value
  frame.field.displacement_px(0, 1).x() = infinity;  // "ok"
  frame.field.gradient(0, 2).setConstant(infinity);  // of a point that is there
  frame.field.zncc(0, 4) = infinity;
  frame.strain.strain(0, 5).z() = NAN;  // "ok"
  WritePlanar(file, PlanarHeader(), {frame});
  const PlanarSeriesFrame back = PlanarSeriesReader(file).Frame(0);
  EXPECT_TRUE(back.field.displacement_px(0, 0).array().isNaN().all());
  EXPECT_TRUE(back.field.cov_displacement_px2(0, 0).array().isNaN().all());
  EXPECT_EQ(back.field.iterations(0, 0), frame.field.iterations(0, 0));
  EXPECT_EQ(back.field.status(0, 1), Status::kFailedVerification);
  EXPECT_TRUE(std::isnan(back.field.displacement_px(0, 1).y()));
  EXPECT_TRUE(back.field.gradient(0, 2).array().isNaN().all());
  EXPECT_EQ(back.field.status(0, 2), Status::kOk);
  EXPECT_TRUE(std::isnan(back.field.zncc(0, 4)));
  EXPECT_EQ(back.strain.status(0, 5), Status::kFailedVerification);
  EXPECT_TRUE(std::isnan(back.strain.strain(0, 5).x()));
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(PlanarSeries, AnEmptyRunIsAValidFile) {
  const fs::path file = TestFolder() / "run.h5";
  WritePlanar(file, PlanarHeader(), {});
  EXPECT_EQ(PlanarSeriesReader(file).frame_count(), 0);
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(PlanarSeries, RefusesFieldsThatDoNotFit) {
  PlanarSeriesWriter writer(TestFolder() / "run.h5", PlanarHeader());
  EXPECT_THROW(writer.Commit(PlanarFrame(0, PlanarHeader({8, 5}))), std::invalid_argument);
  for (const auto& spoil : std::vector<void (*)(PlanarSeriesFrame&)>{
           [](PlanarSeriesFrame& f) { f.field.first_px.x() += 1; },
           [](PlanarSeriesFrame& f) { f.field.step_px = 7; },
           [](PlanarSeriesFrame& f) { f.field.order = 1; },
           [](PlanarSeriesFrame& f) { f.field.cov_gradient = {}; },
           [](PlanarSeriesFrame& f) {
             f.field.iterations = Image<std::uint8_t>({5, 7});
           },
           [](PlanarSeriesFrame& f) { f.strain.covariance = {}; }}) {
    PlanarSeriesFrame frame = PlanarFrame(0);
    spoil(frame);
    EXPECT_THROW(writer.Commit(frame), std::invalid_argument);
  }
  writer.Commit(PlanarFrame(0));
  writer.Close();
}

TEST(PlanarSeries, RefusesHeadersThatMeanNothing) {
  const fs::path file = TestFolder() / "run.h5";
  for (const auto& [spoil, part] :
       std::vector<std::pair<void (*)(PlanarSeriesHeader&), const char*>>{
           {[](PlanarSeriesHeader& h) {
              h.grid = {0, 5};
            },
            "grid"},
           {[](PlanarSeriesHeader& h) { h.step_px = 0; }, "step_px"},
           {[](PlanarSeriesHeader& h) { h.order = 3; }, "order"},
           {[](PlanarSeriesHeader& h) { h.subset_shape = "round"; }, "subset_shape"},
           {[](PlanarSeriesHeader& h) { h.prefilter = "box"; }, "prefilter"},
           {[](PlanarSeriesHeader& h) { h.prefilter_sigma_px = NAN; }, "prefilter_sigma_px"},
           {[](PlanarSeriesHeader& h) { h.reference = "wheel"; }, "reference"},
           {[](PlanarSeriesHeader& h) { h.strain_measure = "log"; }, "strain_measure"},
           {[](PlanarSeriesHeader& h) { h.camera.bits = 0; }, "bits"}}) {
    PlanarSeriesHeader header = PlanarHeader();
    spoil(header);
    try {
      PlanarSeriesWriter writer(file, header);
      ADD_FAILURE() << part;
    } catch (const std::invalid_argument& error) {
      EXPECT_THAT(error.what(), HasSubstr(part));
    }
  }
  EXPECT_FALSE(fs::exists(file.string() + ".parts"));
}

TEST(PlanarSeries, IsToldFromTheSeriesOfARig) {
  const fs::path folder = TestFolder();
  WritePlanar(folder / "planar.h5", PlanarHeader(), {PlanarFrame(0)});
  SeriesWriter(folder / "stereo.h5", testing::SmallHeader()).Close();
  EXPECT_TRUE(IsPlanarSeries(folder / "planar.h5"));
  EXPECT_FALSE(IsPlanarSeries(folder / "stereo.h5"));
  const auto reason = [](const auto& read) -> std::string {
    try {
      read();
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(reason([&] { SeriesReader{folder / "planar.h5"}; }), HasSubstr("of a single camera"));
  EXPECT_THAT(reason([&] { PlanarSeriesReader{folder / "stereo.h5"}; }), HasSubstr("stereo rig"));
  EXPECT_THAT(reason([&] { PlanarSeriesReader{folder / "none.h5"}; }), HasSubstr("none.h5"));
}

TEST(PlanarSeries, SigmasOfPrincipalStrainsMatchFiniteDifferences) {
  const Eigen::Vector3f strain(2e-3f, -1e-3f, 7e-4f);
  Eigen::Matrix<float, 6, 1> covariance;
  covariance << 4e-10f, 1e-10f, -2e-10f, 9e-10f, 3e-10f, 5e-10f;
  Eigen::Matrix3d cov;
  cov << 4, 1, -2, 1, 9, 3, -2, 3, 5;
  cov *= 1e-10;
  // In double, and scaled: differences of floats would not do.
  const auto principal = [&](const Eigen::VectorXd& e) -> Eigen::VectorXd {
    const double mean = (e[0] + e[1]) / 2, half = (e[0] - e[1]) / 2, r = std::hypot(half, e[2]);
    return Eigen::Vector3d(mean + r, mean - r, std::atan2(e[2], half) / 2);
  };
  const Eigen::MatrixXd J =
      testing::NumericJacobian(principal, Eigen::VectorXd(strain.cast<double>() * 1e3));
  const Eigen::Vector3d expected = (J * cov * J.transpose()).diagonal().cwiseSqrt();
  const PrincipalStrainSigma sigma = SigmaOfPrincipal(strain, covariance);
  EXPECT_NEAR(sigma.strain[0], expected[0], 1e-5 * expected[0]);
  EXPECT_NEAR(sigma.strain[1], expected[1], 1e-5 * expected[1]);
  EXPECT_NEAR(sigma.angle_rad, 1e3 * expected[2], 1e-5 * 1e3 * expected[2]);
  EXPECT_TRUE(std::isnan(SigmaOfPrincipal({1e-3f, 1e-3f, 0}, covariance).angle_rad));
}

}  // namespace
}  // namespace plumbline
