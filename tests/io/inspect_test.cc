#include "io/inspect.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "tests/io/damaged_copies.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::ElementsAre;
using testing::ExpectFindings;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

SeriesFrame FrameWithoutSurface() {
  SeriesFrame bad = testing::SmallFrame(1);
  bad.problem = "left1.png is truncated";
  bad.surface = Surface{};
  bad.ground = GroundRecord{};
  bad.ground.problem = "no surface";
  return bad;
}

// Frames 0 and 2 have surfaces, frame 1 has none.
fs::path WriteThreeFrames(const fs::path& file) {
  SeriesHeader header = testing::SmallHeader();
  header.rig_extras.arrays = {
      {"board/point_id", "1", "number of the point", {2}, {0, 1}, {}},
      {"board/points", "mm", "target points", {2, 3}, {0, 0, 0, 10, 0, 1}, {"board/point_id"}}};
  SeriesWriter writer(file, header);
  writer.Commit(testing::SmallFrame(0));
  writer.Commit(FrameWithoutSurface());
  writer.Commit(testing::SmallFrame(2));
  writer.Close();
  return file;
}

TEST(Inspect, CountsWhatASeriesHolds) {
  const FileSummary summary = Inspect(WriteThreeFrames(testing::TestFolder() / "run.h5"));
  EXPECT_EQ(summary.frames, 3);
  EXPECT_EQ(summary.frames_with_surface, 2);
  EXPECT_EQ(summary.frames_with_ground, 2);
  EXPECT_EQ(summary.points, 56);
  EXPECT_EQ(summary.grid_columns, 7);
}

TEST(Validate, FindsNothingInWholeFiles) {
  const fs::path folder = testing::TestFolder();
  EXPECT_THAT(Validate(WriteThreeFrames(folder / "run.h5")), IsEmpty());
  SeriesFrame frame = testing::SmallFrame(0);
  const auto no_sigma = Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN());
  frame.surface.sigma_calibration_mm(0, 0) = no_sigma;  // the rays of one point, bent too far
  SeriesWriter one(folder / "one.h5", testing::SmallHeader());
  one.Commit(frame);
  one.Close();
  EXPECT_THAT(Validate(folder / "one.h5"), IsEmpty());
  SeriesHeader header = testing::SmallHeader();
  header.rig.modes = {};
  SeriesWriter(folder / "empty.h5", header).Close();
  EXPECT_THAT(Validate(folder / "empty.h5"), IsEmpty());
  WriteRigFile(folder / "rig.h5", testing::SmallRig());
  EXPECT_THAT(Validate(folder / "rig.h5"), IsEmpty());
}

TEST(Validate, FindsWhatIsMissingInASeries) {
  ExpectFindings(
      WriteThreeFrames(testing::TestFolder() / "run.h5"),
      {{"del f['surface/position'].attrs['units']", "/surface/position has no units"},
       {"f['frames/left_id'].attrs['long_name'] = ''", "/frames/left_id has no long_name"},
       {"del f['rig/board/points'].attrs['units']", "/rig/board/points has no units"},
       {"del f['surface/status'].attrs['DIMENSION_LIST']",
        "dimension 0 of /surface/status has no axis"},
       {"f['ground/rms'].dims[0].detach_scale(f['frames/index'])",
        "dimension 0 of /ground/rms has no axis"},
       {"del f['ground']", "there is no group /ground"},
       {"del f['ground/rms']", "there is no dataset /ground/rms"},
       {"del f['grid/row']", "there is no dataset /grid/row"},
       {"del f.attrs['inputs']", "the file has no attribute inputs"},
       {"del f.attrs['recipe']", "the file has no attribute recipe"},
       {"del f['surface'].attrs['signal']", "/surface has no attribute signal"},
       {"f['surface'].attrs['signal'] = 'depth'", "/surface names the dataset depth"},
       {"del f['rig/left'].attrs['lens_model']", "/rig/left has no attribute lens_model"}});
}

TEST(Validate, FindsShapesThatDisagree) {
  ExpectFindings(
      WriteThreeFrames(testing::TestFolder() / "run.h5"),
      {{"f['surface/status'].resize(2, axis=0)",
        "/surface/status holds 2 x 5 x 7, which should be 3 frames x 5 rows x 7 columns"},
       {"f['surface/status'].resize(2, axis=0)",
        "dimension 0 of /surface/status has 2 entries and an axis of 3"},
       {"del f['surface/correlation']; f['surface/correlation'] = np.zeros((3, 5))",
        "/surface/correlation holds 3 x 5, which should be 3 frames x 5 rows x 7 columns"},
       {"del f['ground/normal']; f['ground/normal'] = np.zeros((3, 4))",
        "/ground/normal holds 3 x 4, which should be 3 frames x 3"},
       {"del f['grid/step_px']; f['grid/step_px'] = np.zeros(2, 'i4')",
        "/grid/step_px holds 2, which should be one value"},
       {"del f['frames/time_s']; f['frames/time_s'] = np.zeros(4)",
        "/frames/time_s holds 4, which should be 3 frames"},
       {"del f['rig/mode']; f['rig/mode'] = np.zeros(4)", "/rig/modes holds 5 x 24"}});
}

TEST(Validate, FindsValuesThatTheirStatusDenies) {
  ExpectFindings(
      WriteThreeFrames(testing::TestFolder() / "run.h5"),
      {{"f['surface/position'][2, 0, 3] = 5", "frame 2: 1 points have a position that"},
       {"f['surface/position_errors'][2, 0, 3, 1] = 5", "frame 2: 1 points have a combined sigma"},
       {"f['surface/position'][0, 0, :2, 2] = np.nan",
        "frame 0: 2 points have the status ok and no position"},
       {"f['surface/position_errors_random'][0, 0, 0] = np.inf",
        "frame 0: 1 points have the status ok and no random sigma"},
       {"f['surface/position_errors_calibration'][0] = np.nan",
        "frame 0: 28 points have the status ok and no calibration sigma"},
       {"f['surface/status'][0, 0, 3] = 0", "frame 0: 1 points have the status ok and no position"},
       {"f['surface/status'][0, 0, 0] = 7", "frame 0: 1 points have a position that"},
       {"f['surface/status'][0, 0, 0] = 77", "frame 0: 1 points have an unknown status"},
       {"f['surface/status'][1, 2, 2] = 0",
        "frame 1: 1 points have the status ok in a frame without a surface"},
       {"f['frames/status'][1] = 0",
        "frame 1 holds a surface and yet a reason why not: left1.png is truncated"},
       {"f['ground/rms'][1] = 1", "frame 1: no ground plane was found, and /ground/rms holds"},
       {"f['ground/normal'][0, 2] = np.nan", "frame 0: a ground plane was found and has no normal"},
       {"f['ground/status'][1] = 0", "frame 1: a ground plane was found and has no offset"}});
}

fs::path WriteAllGroups(const fs::path& file) {
  SeriesWriter writer(file, testing::FullHeader());
  for (int i = 0; i < 3; ++i) writer.Commit(testing::FullFrame(i));
  writer.Close();
  return file;
}

TEST(Validate, FindsWhatIsMissingInOptionalGroups) {
  ExpectFindings(
      WriteAllGroups(testing::TestFolder() / "run.h5"),
      {{"del f['displacement'].attrs['reference']", "/displacement has no attribute reference"},
       {"f['displacement'].attrs['reference'] = 'first'",
        "the attribute reference of /displacement is \"first\", which means nothing"},
       {"del f['grid'].attrs['points']", "/grid has no attribute points"},
       {"f['grid'].attrs['points'] = 'pixel'", "the attribute points of /grid is \"pixel\""},
       {"del f['strain'].attrs['vsg_mm']", "/strain has no attribute vsg_mm"},
       {"f['strain'].attrs['measure'] = 'cauchy'",
        "the attribute measure of /strain is \"cauchy\""},
       {"f['strain'].attrs['strain_axes'] = '1,0'",
        "the attribute strain_axes of /strain is \"1,0\""},
       {"del f['survey'].attrs['frames']", "/survey has no attribute frames"},
       {"del f['survey/tags']", "there is no dataset /survey/tags"},
       {"del f['displacement'].attrs['rigid_motion_removed']",
        "/displacement has no attribute rigid_motion_removed"},
       {"del f['strain/status']", "there is no dataset /strain/status"},
       {"del f['strain/covariance']", "there is no dataset /strain/covariance"},
       {"del f['match/left_share']", "there is no dataset /match/left_share"},
       {"del f['match'].attrs['signal']", "/match has no attribute signal"},
       {"del f['rig_watch/change_errors']", "there is no dataset /rig_watch/change_errors"},
       {"del f['rigid_motion'].attrs['frame']", "/rigid_motion has no attribute frame"},
       {"del f['velocity'].attrs['frame']", "/velocity has no attribute frame"},
       {"del f['slip'].attrs['convention']", "/slip has no attribute convention"},
       {"del f['slip'].attrs['axes']", "/slip has no attribute axes"},
       {"del f['displacement/value'].attrs['frame']", "/displacement/value has no attribute frame"},
       {"del f['displacement/value_errors']", "there is no dataset /displacement/value_errors"},
       {"del f['strain/principal']", "there is no dataset /strain/principal"},
       {"del f['wheel/axis_covariance_random']",
        "there is no dataset /wheel/axis_covariance_random"},
       {"del f['wheel/radius_errors'].attrs['units']", "/wheel/radius_errors has no units"},
       {"del f['patch/contour_first']", "there is no dataset /patch/contour_first"},
       {"del f['slip/problem']", "there is no dataset /slip/problem"},
       {"f['strain/angle'].resize(2, axis=0)",
        "/strain/angle holds 2 x 5 x 7, which should be 3 frames x 5 rows x 7 columns"},
       {"f['patch/contour'].resize(7, axis=0)",
        "/patch/contour holds 7 x 2, which should be 8 contour points x 2"},
       {"del f['channels/Fz/time_s']", "there is no dataset /channels/Fz/time_s"},
       {"del f['channels/Fz'].attrs['signal']", "/channels/Fz has no attribute signal"},
       {"del f['channels/Fz/value']; f['channels/Fz/value'] = np.zeros(3)",
        "/channels/Fz/value holds 3, which should be 4 samples of /channels/Fz"},
       {"f['channels/x'] = np.zeros(3)", "opening /channels/x"}});
}

TEST(Validate, FindsValuesThatDoNotBelongInOptionalGroups) {
  ExpectFindings(
      WriteAllGroups(testing::TestFolder() / "run.h5"),
      {{"f['displacement/value'][2, 0, 3] = 5",
        "frame 2: 1 points have a displacement that their status denies"},
       {"f['displacement/value'][2, 0, 0, 1] = np.inf",
        "frame 2: 1 points have a displacement that is infinite or lacks a component"},
       {"f['slip/velocity'][2, 0, 0, 1] = np.nan",
        "frame 2: 1 points have a velocity that is infinite or lacks a component"},
       {"f['displacement/value_errors_random'][2, 0, 0] = np.nan",
        "frame 2: 1 points have the status ok and no random sigma of the displacement"},
       {"f['displacement/value_errors_random'][2, 0, 1] = 1",
        "frame 2: 1 points have a random sigma of the displacement that their missing "
        "displacement denies"},
       {"f['strain/value_errors_calibration'][1] = np.nan",
        "frame 1: 27 points have the status ok and no calibration sigma of the strain"},
       {"f['strain/value_errors'][1, 0, 0, 0] = np.inf",
        "frame 1: 1 points have a combined sigma of the strain that is infinite"},
       {"f['strain/principal'][1, 0, 0] = np.nan", "have the status ok and no principal strain"},
       {"f['strain/value'][2, 0, 0] = np.nan",
        "frame 2: 1 points have the status ok and no strain"},
       {"f['strain/status'][2, 0, 0] = 10",
        "frame 2: 1 points have a strain that their status denies"},
       {"f['strain/max_shear'][2, 0, 0] = np.nan", "have the status ok and no largest shear"},
       {"f['strain/von_mises_errors'][2, 0, 1] = 1",
        "frame 2: 1 points have a value of /strain/von_mises_errors that their status denies"},
       {"f['match/right_displacement'][2, 0, 0] = np.nan",
        "frame 2: 1 points have a match and no match in the right image"},
       {"f['match/left_displacement'][2, 0, 3] = 1",
        "frame 2: 1 points have a match and no match in the right image"},
       {"f['match/left_displacement'][2, 0, 0, 1] = np.nan",
        "frame 2: 1 points have a match that is infinite or lacks a component"},
       {"f['survey/right_covariance'][0, 0, 3] = np.nan",
        "frame 0: 1 points have a match of the survey and no covariance in the right image"},
       {"f['survey/view'][0] = np.nan", "frame 0: a place on the wheel was found and has no view"},
       {"f['velocity/value_errors_random'][2, 0, 0] = np.nan",
        "frame 2: 1 points have the status ok and no random sigma of the velocity"},
       {"f['rigid_motion/rotation'][0, 1] = np.nan",
        "frame 0: a rigid motion was found and has no rotation"},
       {"f['rig_watch/right_from_left'][0, 1, 1] = np.nan",
        "frame 0: a pose of the right camera was found and has no right_from_left"},
       {"f['rig_watch/alarm'][1] = 1",
        "frame 1: no pose of the right camera was found, and /rig_watch/alarm holds a value"},
       {"f['wheel/axis'][1, 2] = np.nan", "frame 1: a wheel was found and has no axis"},
       {"f['wheel/speed'][1] = np.inf", "frame 1: /wheel/speed holds an infinite value"},
       {"f['patch/area_mm2'][1] = 1",
        "frame 1: no contact patch was found, and /patch/area_mm2 holds a value"},
       {"f['patch/status'][1] = 0", "frame 1 holds a contact patch and yet a reason why not"},
       {"f['patch/contour_count'][1] = 2",
        "frame 1: no contact patch was found, and it has a contour"},
       {"f['patch/contour_first'][2] = 6", "frame 2: its contour cannot be read"},
       {"f['patch/contour'][4, 0] = np.nan",
        "frame 2: its contour holds values that are no numbers"},
       {"f['slip/angle_rad'][0] = np.nan", "frame 0: a wheel slip was found and has no angle_rad"},
       {"f['channels/Fz/time_s'][2] = -1", "/channels/Fz: its time 2 is no number or goes back"}});
}

TEST(Validate, FindsWhatIsWrongInARigFile) {
  const fs::path file = testing::TestFolder() / "rig.h5";
  RigFileExtras extras;
  extras.arrays = {{"residuals", "pixel", "residuals", {2, 2}, {0.5, -1, 2, 3}, {}}};
  WriteRigFile(file, testing::SmallRig(), extras);
  ExpectFindings(
      file,
      {{"del f['rig/residuals'].attrs['units']", "/rig/residuals has no units"},
       {"del f['rig/modes'].attrs['long_name']", "/rig/modes has no long_name"},
       {"del f['rig/modes'].attrs['DIMENSION_LIST']", "dimension 1 of /rig/modes has no axis"},
       {"del f['rig/left/cameramodel']", "there is no dataset /rig/left/cameramodel"},
       {"del f['rig/parameter']; f['rig/parameter'] = np.zeros(3)",
        "/rig/parameter holds 3, which should be 24 parameters"},
       {"f['rig/modes'][0, 0] = np.nan", "/rig/modes holds values that are no numbers"},
       {"del f.attrs['created']", "the file has no attribute created"},
       {"f.attrs['format'] = 'something'", "neither a series nor a rig"},
       {"f.attrs['format_version'] = 99", "format version 99"}});
}

TEST(Validate, FindsTheFolderOfAnUnfinishedRun) {
  const fs::path file = WriteThreeFrames(testing::TestFolder() / "run.h5");
  fs::create_directory(file.string() + ".parts");
  EXPECT_THAT(Validate(file), ElementsAre(HasSubstr("run.h5.parts is left over")));
  std::ofstream(file.string() + ".parts/journal") << 'x';
  EXPECT_THAT(Validate(file), ElementsAre(HasSubstr("run.h5.parts holds the frames of a run")));
}

TEST(Validate, AFileThatDoesNotOpenIsOneFinding) {
  const fs::path file = WriteThreeFrames(testing::TestFolder() / "run.h5");
  fs::resize_file(file, 5000);
  EXPECT_THAT(Validate(file), ElementsAre(HasSubstr("run.h5 cannot be read")));
  EXPECT_THAT(Validate("/nowhere/run.h5"), ElementsAre(HasSubstr("/nowhere/run.h5")));
}

}  // namespace
}  // namespace plumbline
