// The optional groups of a series: what is written, refused, and left out.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "calib/error.h"
#include "io/inspect.h"
#include "io/series_reader.h"
#include "io/series_writer.h"
#include "tests/io/series_comparison.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::ElementsAre;
using testing::FullFrame;
using testing::FullHeader;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::SmallFrame;
using testing::SmallHeader;
using testing::TestFolder;

SeriesFrame FrameWithoutSurface() {
  SeriesFrame frame;
  frame.problem = "left1.png is truncated";
  frame.wheel.problem = frame.patch.problem = frame.slip.problem = frame.rigid_motion.problem =
      frame.rig_watch.problem = "no surface";
  return frame;
}

void Write(const fs::path& file, const SeriesHeader& header,
           const std::vector<SeriesFrame>& frames) {
  SeriesWriter writer(file, header);
  for (const SeriesFrame& frame : frames) writer.Commit(frame);
  writer.Close();
}

TEST(SeriesGroups, ReadBackWhatWasWritten) {
  const fs::path file = TestFolder() / "run.h5";
  const std::vector<SeriesFrame> frames = {FullFrame(0), FrameWithoutSurface(), FullFrame(1),
                                           FullFrame(2)};
  const SeriesHeader header = FullHeader();
  Write(file, header, frames);
  const SeriesReader reader(file);
  ASSERT_EQ(reader.frame_count(), 4);
  for (std::size_t i = 0; i < 4; ++i) {
    testing::ExpectSameFrame(frames[i], reader.Frame(static_cast<std::int64_t>(i)));
  }
  EXPECT_EQ(reader.contents(), header.contents);
  EXPECT_EQ(reader.grid_points(), "material");
  EXPECT_EQ(reader.displacement_reference(), "frame 10");
  EXPECT_TRUE(reader.rigid_motion_removed());
  EXPECT_EQ(reader.strain_measure(), "green_lagrange");
  EXPECT_EQ(reader.strain_axes(), "material");
  EXPECT_EQ(reader.vsg_px(), 27);
  EXPECT_EQ(reader.vsg_mm(), 5.5);
  EXPECT_EQ(reader.slip_convention(), "ISO 8855");
  const std::vector<Channel> channels = reader.channels();
  ASSERT_EQ(channels.size(), 2u);
  EXPECT_EQ(channels[0].name, "Fz");
  EXPECT_EQ(channels[0].units, "N");
  EXPECT_EQ(channels[0].long_name, "vertical force");
  EXPECT_EQ(channels[0].time_s, header.channels[0].time_s);
  EXPECT_EQ(channels[0].value, header.channels[0].value);
  EXPECT_EQ(channels[0].clock_offset_s, header.channels[0].clock_offset_s);
  EXPECT_EQ(channels[0].sigma_clock_offset_s, header.channels[0].sigma_clock_offset_s);
  EXPECT_TRUE(std::isnan(channels[1].clock_offset_s));  // not known
  EXPECT_EQ(channels[1].units, "1");                    // where there is none
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(SeriesGroups, HoldTheMatchesOfThePairThatDisplacementsCountFrom) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesHeader header = FullHeader();
  const SeriesFrame first = FullFrame(3);
  header.reference = ReferenceMatches{"left_3", first.match, first.surface.status};
  header.reference->status(2, 3) = Status::kLowTexture;
  header.reference->status.data()[1] = Status::kMasked;  // has no match
  {
    SeriesWriter writer(file, header);
    writer.Commit(FullFrame(0));
    writer.Close();
  }
  EXPECT_THAT(Validate(file), IsEmpty());
  const std::optional<ReferenceMatches> read = SeriesReader(file).reference();
  ASSERT_TRUE(read);
  EXPECT_EQ(read->left_id, "left_3");
  EXPECT_EQ(read->status.values(), header.reference->status.values());
  EXPECT_TRUE(std::isnan(read->match.right_gradient(2, 3)(0, 1)));
  for (std::size_t i = 0; i < read->status.pixel_count(); ++i) {
    if (read->status.data()[i] != Status::kOk) continue;
    EXPECT_EQ(read->match.left_displacement_px.data()[i],
              first.match.left_displacement_px.data()[i]);
    EXPECT_EQ(read->match.right_gradient.data()[i], first.match.right_gradient.data()[i]);
    EXPECT_EQ(read->match.right_cov_px2.data()[i], first.match.right_cov_px2.data()[i]);
    EXPECT_EQ(read->match.left_reference_share.data()[i],
              first.match.left_reference_share.data()[i]);
  }
  header.reference->match.left_gradient = {};
  EXPECT_THROW(SeriesWriter(TestFolder() / "other.h5", header), std::invalid_argument);
}

TEST(SeriesGroups, AreEachOptional) {
  const fs::path folder = TestFolder();
  for (const auto flag :
       {&SeriesContents::covariance, &SeriesContents::displacement, &SeriesContents::strain,
        &SeriesContents::wheel, &SeriesContents::patch, &SeriesContents::slip,
        &SeriesContents::matches, &SeriesContents::velocity, &SeriesContents::rigid_motion,
        &SeriesContents::rig_watch, &SeriesContents::rig_rotation, &SeriesContents::deformation,
        &SeriesContents::material, &SeriesContents::strain_windows, &SeriesContents::wheel_channel,
        &SeriesContents::placement}) {
    SeriesHeader header = SmallHeader();
    header.contents.*flag = true;
    if (header.contents.strain_windows) header.contents.strain = true;
    const fs::path file = folder / (Names(header.contents).back() + ".h5");
    Write(file, header, {FullFrame(0)});  // which holds more than is to be written
    const SeriesReader reader(file);
    EXPECT_EQ(reader.contents(), header.contents);
    const SeriesFrame frame = reader.Frame(0);
    EXPECT_EQ(!frame.displacement.value_mm.empty(), header.contents.displacement);
    EXPECT_EQ(!frame.slip.velocity_mm_s.empty(), header.contents.slip);
    EXPECT_EQ(frame.wheel.found, header.contents.wheel);
    EXPECT_EQ(!frame.match.right_gradient.empty(), header.contents.matches);
    EXPECT_EQ(!frame.velocity.value_mm_s.empty(), header.contents.velocity);
    EXPECT_EQ(!frame.material.position_mm.empty(), header.contents.material);
    EXPECT_EQ(!frame.strain.status.empty(), header.contents.strain);
    EXPECT_EQ(!frame.strain.window_points.empty(), header.contents.strain_windows);
    EXPECT_EQ(!frame.strain.sigma_model.empty(), header.contents.strain_windows);
    EXPECT_EQ(frame.rigid_motion.found, header.contents.rigid_motion);
    EXPECT_EQ(frame.rig_watch.found, header.contents.rig_watch);
    EXPECT_EQ(frame.rig_rotation.found, header.contents.rig_rotation);
    EXPECT_EQ(frame.deformation.found, header.contents.deformation);
    EXPECT_EQ(frame.wheel_channel.found, header.contents.wheel_channel);
    EXPECT_EQ(frame.placement.found, header.contents.placement);
    EXPECT_EQ(frame.patch.contour_mm.size(), header.contents.patch ? 3u : 0u);
    EXPECT_THAT(Validate(file), IsEmpty());
  }
}

TEST(SeriesGroups, AnEmptyRunHasThemToo) {
  const fs::path file = TestFolder() / "run.h5";
  Write(file, FullHeader(), {});
  EXPECT_EQ(SeriesReader(file).contents(), FullHeader().contents);
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(SeriesGroups, AFrameWithoutAFieldReadsAsNaN) {
  const fs::path file = TestFolder() / "run.h5";
  Write(file, FullHeader({700, 401}), {FullFrame(0, {700, 401}), [] {
                                         SeriesFrame frame = FullFrame(1, {700, 401});
                                         frame.displacement = {};
                                         return frame;
                                       }()});
  const SeriesReader reader(file);
  testing::ExpectSameFrame(FullFrame(0, {700, 401}), reader.Frame(0));
  const SeriesFrame frame = reader.Frame(1);
  ASSERT_EQ(frame.displacement.value_mm.size(), (ImageSize{700, 401}));
  for (const Eigen::Vector3f& u : frame.displacement.value_mm.values()) {
    ASSERT_TRUE(u.array().isNaN().all());
  }
  testing::ExpectSameStrain(FullFrame(1, {700, 401}).strain, frame.strain);
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(SeriesGroups, AValueThatIsNotFiniteIsNaNWithItsSigmas) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesFrame frame = FullFrame(0);
  const float infinity = std::numeric_limits<float>::infinity();
  frame.displacement.value_mm(0, 0).y() = infinity;
  frame.strain.sigma_calibration(0, 2).x() = infinity;
  frame.slip.velocity_mm_s(0, 3) = Eigen::Vector3f(1, 2, 3);  // no surface there
  frame.wheel.speed_rad_s = infinity;
  frame.surface.position_mm(0, 4).x() = infinity;
  Write(file, FullHeader(), {frame});
  const SeriesFrame back = SeriesReader(file).Frame(0);
  EXPECT_TRUE(back.displacement.value_mm(0, 0).array().isNaN().all());
  EXPECT_TRUE(back.displacement.sigma_random_mm(0, 0).array().isNaN().all());
  EXPECT_TRUE(std::isnan(back.strain.sigma_calibration(0, 2).x()));
  EXPECT_EQ(back.strain.value(0, 2), frame.strain.value(0, 2));
  EXPECT_TRUE(back.slip.velocity_mm_s(0, 3).array().isNaN().all());
  EXPECT_TRUE(std::isnan(back.wheel.speed_rad_s));
  EXPECT_EQ(back.surface.status(0, 4), Status::kFailedVerification);
  EXPECT_TRUE(back.displacement.value_mm(0, 4).array().isNaN().all());
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(SeriesGroups, TheStrainGoesByItsOwnStatus) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesFrame frame = FullFrame(0);
  frame.strain.status(0, 0) = Status::kExtrapolated;  // with a value
  frame.strain.value(0, 2).x() = std::numeric_limits<float>::infinity();
  frame.strain.status(0, 3) = Status::kOk;  // from its neighbours: no surface there
  frame.strain.value(0, 3) = Eigen::Vector3f(1e-3f, 2e-3f, 0);
  frame.strain.sigma_random(0, 3).setConstant(1e-4f);
  frame.strain.sigma_calibration(0, 3).setConstant(1e-4f);
  frame.strain.cov_random(0, 3).setConstant(1e-8f);
  SeriesHeader header = FullHeader();
  header.strain_measure = "hencky";
  header.strain_axes = "0.5,-1,0";
  Write(file, header, {frame});
  const SeriesReader reader(file);
  EXPECT_EQ(reader.strain_measure(), "hencky");
  EXPECT_EQ(reader.strain_axes(), "0.5,-1,0");
  const StrainField back = reader.Frame(0).strain;
  EXPECT_TRUE(back.value(0, 0).array().isNaN().all());
  EXPECT_TRUE(std::isnan(back.sigma_random_von_mises(0, 0)));
  EXPECT_EQ(back.status(0, 2), Status::kFailedVerification);
  EXPECT_TRUE(back.value(0, 2).array().isNaN().all());
  EXPECT_EQ(back.value(0, 3), frame.strain.value(0, 3));
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(SeriesGroups, FilesOfVersion1StillRead) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesHeader header = FullHeader();
  header.contents = {true, true, true, true, true, true};
  Write(file, header, {FullFrame(0), FrameWithoutSurface()});
  const auto made = testing::RunPython(R"py(
import sys, h5py
with h5py.File(sys.argv[1], 'r+') as f:
    f.attrs['format_version'] = 1
    del f['displacement'].attrs['rigid_motion_removed']
    f['strain'].attrs['signal'] = 'green_lagrange'
    known = ('green_lagrange', 'principal', 'angle', 'frame', 'row', 'col', 'component', 'principal_component')
    for name in list(f['strain']):
        if name not in known and not name.startswith('green_lagrange_'): del f['strain'][name]
print(len(f) if f else 'made', end='')
)py",
                                       file.string());
  ASSERT_EQ(made.output, "made");
  EXPECT_THAT(Validate(file), IsEmpty());
  const StrainField back = SeriesReader(file).Frame(0).strain;
  testing::ExpectSamePoints(FullFrame(0).strain.value, back.value);
  testing::ExpectSamePoints(FullFrame(0).strain.sigma_calibration, back.sigma_calibration);
  testing::ExpectSameBits(FullFrame(0).strain.status, back.status);
  EXPECT_TRUE(back.cov_random.empty());
  EXPECT_TRUE(SeriesReader(file).Frame(1).strain.status.empty());
}

TEST(SeriesGroups, RefuseWhatDoesNotFitTheGrid) {
  SeriesWriter writer(TestFolder() / "run.h5", FullHeader());
  for (const auto& spoil : std::vector<void (*)(SeriesFrame&)>{
           [](SeriesFrame& f) { f.displacement.sigma_random_mm = {}; },
           [](SeriesFrame& f) {
             f.strain = FullFrame(0, {8, 5}).strain;
           },
           [](SeriesFrame& f) { f.strain.status = {}; },
           [](SeriesFrame& f) { f.strain.cov_random = {}; },
           [](SeriesFrame& f) {
             f.strain.sigma_random_von_mises = Image<float>({8, 5});
           },
           [](SeriesFrame& f) { f.match.right_cov_px2 = {}; },
           [](SeriesFrame& f) { f.velocity.sigma_random_mm_s = {}; },
           [](SeriesFrame& f) { f.slip.sigma_calibration_mm_s = {}; },
           [](SeriesFrame& f) { f.surface.cov_random_mm2 = {}; }}) {
    SeriesFrame frame = FullFrame(0);
    spoil(frame);
    EXPECT_THROW(writer.Commit(frame), std::invalid_argument);
  }
  writer.Commit(FullFrame(0));
  writer.Close();
}

TEST(SeriesGroups, RefuseChannelsAndAttributesThatMeanNothing) {
  const fs::path file = TestFolder() / "run.h5";
  const auto reason = [&](const std::vector<Channel>& channels) -> std::string {
    SeriesHeader header = SmallHeader();
    header.channels = channels;
    try {
      SeriesWriter writer(file, header);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(reason({{"F/z", "N", "force", {0}, {1}}}), HasSubstr("'F/z' cannot be stored"));
  EXPECT_THAT(reason({{"", "N", "force", {0}, {1}}}), HasSubstr("its name"));
  EXPECT_THAT(reason({{"Fz", "N", "force", {0, 1}, {1}}}), HasSubstr("2 times and 1 values"));
  EXPECT_THAT(reason({{"Fz", "N", "force", {0, 2, 1}, {1, 1, 1}}}), HasSubstr("time 2 (1 s)"));
  EXPECT_THAT(reason({{"Fz", "N", "", {0}, {1}}, {"Fz", "N", "", {0}, {1}}}),
              HasSubstr("another one has that name"));
  EXPECT_EQ(reason({{"Fz", "N", "", {0, 0, 1}, {1, NAN, 1}}}), "");
  SeriesHeader header = SmallHeader();
  header.grid_points = "pixels";
  EXPECT_THROW(SeriesWriter(file, header), std::invalid_argument);
  header = SmallHeader();
  header.displacement_reference = "frame";
  EXPECT_THROW(SeriesWriter(file, header), std::invalid_argument);
  header = SmallHeader();
  header.strain_measure = "cauchy";
  EXPECT_THROW(SeriesWriter(file, header), std::invalid_argument);
  for (const char* axes : {"x", "1,0", "1,0,0,0", "0,0,0", "1,nan,0", "1,0,0 "}) {
    header = SmallHeader();
    header.strain_axes = axes;
    EXPECT_THROW(SeriesWriter(file, header), std::invalid_argument) << axes;
  }
  EXPECT_FALSE(fs::exists(file.string() + ".parts"));
}

TEST(SeriesGroups, AreNamedInTheSummary) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesHeader header = FullHeader();
  header.contents.wheel = false;
  Write(file, header, {FullFrame(0)});
  EXPECT_THAT(
      Inspect(file).Text(),
      HasSubstr("also holds: covariance, displacement, strain, patch, slip, matches, velocity, "
                "rigid_motion, rig_watch, rig_rotation, deformation, material, strain_windows, "
                "wheel_channel, placement, survey, channels (Fz, empty)\n"));
  Write(TestFolder() / "plain.h5", SmallHeader(), {SmallFrame(0)});
  EXPECT_THAT(Inspect(TestFolder() / "plain.h5").Text(), ::testing::Not(HasSubstr("also")));
  EXPECT_THAT(Names(header.contents),
              ElementsAre("covariance", "displacement", "strain", "patch", "slip", "matches",
                          "velocity", "rigid_motion", "rig_watch", "rig_rotation", "deformation",
                          "material", "strain_windows", "wheel_channel", "placement", "survey"));
}

TEST(PrincipalStrain, IsThatOfMohrsCircle) {
  const PrincipalStrain shear = PrincipalOf({0, 0, 0.01f});
  EXPECT_FLOAT_EQ(shear.strain[0], 0.01f);
  EXPECT_FLOAT_EQ(shear.strain[1], -0.01f);
  EXPECT_FLOAT_EQ(shear.angle_rad, static_cast<float>(M_PI / 4));
  EXPECT_FLOAT_EQ(PrincipalOf({0, 0.02f, 0}).angle_rad, static_cast<float>(M_PI / 2));
  EXPECT_FLOAT_EQ(PrincipalOf({0, 0.02f, 0}).strain[0], 0.02f);
  EXPECT_TRUE(std::isnan(PrincipalOf({0.01f, 0.01f, 0}).angle_rad));
  EXPECT_FLOAT_EQ(PrincipalOf({0.01f, 0.01f, 0}).strain[1], 0.01f);
}

}  // namespace
}  // namespace plumbline
