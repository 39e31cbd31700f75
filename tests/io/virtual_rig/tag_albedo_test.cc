#include "io/virtual_rig/tag_albedo.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>
#include <opencv2/aruco.hpp>
#include <set>
#include <vector>

#include "calib/detect_tags.h"
#include "calib/error.h"
#include "io/virtual_rig/virtual_rig.h"
#include "tests/support/real_photos.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using Corners = std::array<Eigen::Vector2d, 4>;

Scenario Tagged(const std::string& name) {
  Scenario scenario = MakeScenario(name);
  scenario.tags = WheelTagOptions::Parse("36h11:12:24mm");
  return scenario;
}

// By a reader that is not ours.
std::map<int, Corners> FoundByOpenCv(const GrayImage& image) {
  cv::Mat grey(image.height(), image.width(), CV_8UC1);
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) {
      grey.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(image.grey(y, x));
    }
  }
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> corners;
  const auto parameters = cv::aruco::DetectorParameters::create();
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_CONTOUR;
  cv::aruco::detectMarkers(grey, cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11),
                           corners, ids, parameters);
  std::map<int, Corners> found;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    for (std::size_t k = 0; k < 4; ++k) {
      const cv::Point2f& p = corners[i][(5 - k) % 4];  // its tags stand on their heads
      found[ids[i]][k] = {p.x, p.y};
    }
  }
  return found;
}

// Of corners that were found: how far from the truth, and whose they are.
struct Distances {
  std::vector<double> px;
  std::set<int> ids;
};

void HoldAgainstTheTruth(const VirtualRig& rig, int frame, const std::map<int, Corners>& found,
                         Distances* out) {
  const auto truth = rig.Truth(frame);
  for (const auto& [id, corners] : found) {
    ASSERT_LT(id, 12);
    const auto material = WheelTagCorners(rig.surface().Domain(), *rig.scenario().tags, id);
    out->ids.insert(id);
    for (std::size_t k = 0; k < 4; ++k) {
      out->px.push_back((truth->OfMaterial(material[k]).left_px - corners[k]).norm());
    }
  }
}

double Rms(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v * v;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

// The tags move with the material, wherever that is pressed, and are read upright, not mirrored.
TEST(TagAlbedo, IsReadWhereTheMaterialIsByOpenCvAndByAprilTag) {
  for (const char* name : {"tyre-lifted", "tyre-flat"}) {
    const VirtualRig rig(Tagged(name));
    Distances opencv, apriltag;
    for (const int frame : {1, 4}) {
      const GrayImage left = rig.TakeImage(frame, Side::kLeft);
      HoldAgainstTheTruth(rig, frame, FoundByOpenCv(left), &opencv);
      std::map<int, Corners> tags;
      for (const DetectedTag& tag : DetectTags(left, "tag36h11")) tags[tag.id] = tag.corners;
      HoldAgainstTheTruth(rig, frame, tags, &apriltag);
    }
    ASSERT_GE(apriltag.px.size(), 8U) << name;
    ASSERT_GE(opencv.px.size(), 8U) << name;
    EXPECT_EQ(opencv.ids, apriltag.ids) << name;
    EXPECT_LT(Rms(opencv.px), 1.2) << name;
    EXPECT_LT(Rms(apriltag.px), 0.25) << name;
    RecordProperty(std::string(name) + "-apriltag-rms-px", std::to_string(Rms(apriltag.px)));
  }
}

TEST(TagAlbedo, LeavesWhatIsNotUnderATagAsItWas) {
  const VirtualRig rig(Tagged("tyre-lifted"));
  const MaterialDomain domain = rig.surface().Domain();
  const auto speckle = MakeSpeckle(domain, rig.scenario().speckle);
  const auto tagged =
      MakeTaggedAlbedo(MakeSpeckle(domain, rig.scenario().speckle), domain, *rig.scenario().tags);
  const auto corners = WheelTagCorners(domain, *rig.scenario().tags, 3);
  const double turn = domain.period_u, nan = std::nan("");
  const Eigen::Vector2d middle = (corners[0] + corners[2]) / 2;
  const std::vector<Eigen::Vector2d> places = {
      corners[0] + Eigen::Vector2d(1, 1),         // its black border
      corners[0] + Eigen::Vector2d(-1, 1),        // its margin
      corners[0] + Eigen::Vector2d(-3.5, 1),      // beyond
      {middle.x(), -middle.y()},                  // on the other side
      corners[0] + Eigen::Vector2d(1 - turn, 1),  // a turn ago
      {nan, nan}};
  std::vector<float> before(places.size()), after(places.size());
  speckle->Evaluate(places, before);
  tagged->Evaluate(places, after);
  EXPECT_FLOAT_EQ(after[0], 0.05F);
  EXPECT_FLOAT_EQ(after[1], 0.9F);
  EXPECT_EQ(after[2], before[2]);
  EXPECT_EQ(after[3], before[3]);
  EXPECT_FLOAT_EQ(after[4], 0.05F);
  EXPECT_EQ(after[5], before[5]);
}

// docs/virtual_rig.md says that no rig in a tyre sees the rim.
TEST(TagAlbedo, TheBeadIsOutOfEveryView) {
  for (const RigKind kind : {RigKind::kWide640, RigKind::kWide1280}) {
    const VirtualRig rig(MakeScenario("tyre-flat", kind));
    const auto truth = rig.Truth(0);
    const double half = std::get<TyreOptions>(rig.scenario().surface).section.half_length_mm;
    double least_deg = 180;
    for (int i = -20; i <= 20; ++i) {
      for (const double v : {-half, half}) {
        const TruePoint point = truth->OfMaterial({384 * 0.05 * i, v});
        const Eigen::Vector3d seen = truth->ground_from_rig().Inverse() * point.position_mm;
        least_deg = std::min(least_deg,
                             std::atan2(seen.head<2>().norm(), seen.z()) * 180 / std::numbers::pi);
      }
    }
    EXPECT_GT(least_deg, 58) << "a lens that can be rendered could see it";
    RecordProperty("least_angle_off_the_axis_deg", std::to_string(least_deg));
  }
}

TEST(TagAlbedo, SaysWhatIsWrong) {
  const auto refusal = [](const char* word, const char* name = "tyre-flat") -> std::string {
    try {
      Scenario scenario = MakeScenario(name);
      scenario.tags = WheelTagOptions::Parse(word);
      const VirtualRig rig(scenario);
    } catch (const UsageError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(refusal("tag36h11:4:20"), "");
  EXPECT_THAT(refusal("36h11:4"), HasSubstr("36h11:12:24mm"));
  EXPECT_THAT(refusal("36h11:4:20cm"), HasSubstr("36h11:12:24mm"));
  EXPECT_THAT(refusal("36h12:4:20mm"), HasSubstr("no family"));
  EXPECT_THAT(refusal("25h9:36:20mm"), HasSubstr("35 tags"));
  EXPECT_THAT(refusal("36h11:100:24mm"), HasSubstr("do not fit"));
  EXPECT_THAT(refusal("36h11:4:0.1mm"), HasSubstr("soft edges"));
  EXPECT_THAT(refusal("36h11:2:290mm"), HasSubstr("bead"));
  EXPECT_THAT(refusal("36h11:4:24mm", "still"), HasSubstr("not on a specimen"));
}

}  // namespace
}  // namespace plumbline
