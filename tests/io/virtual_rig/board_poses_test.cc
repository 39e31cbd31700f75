#include "io/virtual_rig/board_poses.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <set>

#include "calib/error.h"
#include "calib/image.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using Style = BoardPoseOptions::Style;

constexpr double kDegree = std::numbers::pi / 180;

// Two wide lenses side by side, as inside a tyre.
StereoRig WideRig() {
  Eigen::VectorXd lens(9);
  lens << 320, 320, 319.5, 239.5, -0.25, 0.06, 0, 0, 0;
  const Camera camera(LensModel::FromName("OPENCV5"), {640, 480}, lens);
  return {camera, camera, Rigid3::FromRotationVector({0, 0, 0}, {-40, 0, 0}), {}, ""};
}

// Two long lenses that converge by 14 degrees at 480 mm.
StereoRig LabRig() {
  Eigen::VectorXd lens(9);
  lens << 4000, 4000, 959.5, 599.5, -0.08, 0.1, 0, 0, 0;
  const Camera camera(LensModel::FromName("OPENCV5"), {1920, 1200}, lens);
  Rigid3 left_from_right = Rigid3::FromRotationVector({0, -14 * kDegree, 0}, {0, 0, 0});
  const double half = 7 * kDegree;
  left_from_right.translation_mm = 120 * Eigen::Vector3d(std::cos(half), 0, std::sin(half));
  return {camera, camera, left_from_right.Inverse(), {}, ""};
}

BoardPoseOptions WideOptions() {
  BoardPoseOptions options;
  options.min_distance_mm = 110;
  options.max_distance_mm = 220;
  return options;
}

BoardPoseOptions LabOptions() {
  BoardPoseOptions options;
  options.min_distance_mm = 440;
  options.max_distance_mm = 520;
  return options;
}

Rigid3 FromBoard(const StereoRig& rig, int camera, const Rigid3& left_from_board) {
  return camera == 0 ? left_from_board : rig.right_from_left * left_from_board;
}
const Camera& CameraOf(const StereoRig& rig, int camera) {
  return camera == 0 ? rig.left : rig.right;
}

Eigen::Vector3d Middle(const BoardSpec& spec) {
  const BoardRectangle pattern = PatternOutline(spec, {});
  const Eigen::Vector2d middle = (pattern[0] + pattern[2]) / 2;
  return {middle.x(), middle.y(), 0};
}

// Between the board's normal and the mean of the cameras' axes.
double Tilt(const StereoRig& rig, const Rigid3& pose) {
  const Eigen::Vector3d axis =
      (Eigen::Vector3d::UnitZ() + rig.right_from_left.Inverse().rotation.col(2)).normalized();
  return std::acos(std::clamp(axis.dot(pose.rotation.col(2)), -1.0, 1.0));
}

// Whether a camera sees all of the pattern, `margin` px inside its image.
bool Whole(const StereoRig& rig, int camera, const BoardSpec& spec, const Rigid3& pose,
           double margin_px) {
  const BoardRectangle pattern = PatternOutline(spec, {});
  const ImageSize size = CameraOf(rig, camera).size();
  for (std::size_t side = 0; side < 4; ++side) {
    for (double t = 0; t < 1; t += 0.05) {
      const Eigen::Vector2d p = (1 - t) * pattern[side] + t * pattern[(side + 1) % 4];
      const Eigen::Vector2d q =
          CameraOf(rig, camera)
              .Project(FromBoard(rig, camera, pose) * Eigen::Vector3d(p.x(), p.y(), 0));
      if (!(q.x() > margin_px && q.y() > margin_px && q.x() < size.width - 1 - margin_px &&
            q.y() < size.height - 1 - margin_px)) {
        return false;
      }
    }
  }
  return true;
}

// Where a camera shows a point of a board: centroid of the disc's image, or the point's own.
Eigen::Vector2d Shown(const Camera& camera, const Rigid3& camera_from_board, const BoardSpec& spec,
                      int id) {
  const Eigen::Vector3d point = spec.NominalPoint(id);
  const double radius = PrintedDiscRadius(spec, {}, id);
  const Eigen::Vector2d base = camera.Project(camera_from_board * point);
  if (radius == 0) return base;
  constexpr int kSides = 200;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero(), last;
  double area = 0;
  for (int k = 0; k <= kSides; ++k) {
    const double a = 2 * std::numbers::pi * k / kSides;
    const Eigen::Vector3d rim = point + radius * Eigen::Vector3d(std::cos(a), std::sin(a), 0);
    const Eigen::Vector2d p = camera.Project(camera_from_board * rim) - base;
    if (k > 0) {
      const double cross = last.x() * p.y() - p.x() * last.y();
      area += cross / 2;
      sum += (last + p) * cross / 6;
    }
    last = p;
  }
  return base + sum / area;
}

// Photographs without a renderer: rays of a grid of pixels, bilinear in between.
class Photographer {
 public:
  Photographer(const Camera& camera, int step_px) : size_(camera.size()), step_(step_px) {
    columns_ = size_.width / step_ + 2;
    rows_ = size_.height / step_ + 2;
    std::vector<Eigen::Vector2d> pixels;
    for (int r = 0; r < rows_; ++r) {
      for (int c = 0; c < columns_; ++c) pixels.push_back({c * step_ - 0.5, r * step_ - 0.5});
    }
    rays_.resize(pixels.size());
    camera.Unproject(pixels, rays_);
    for (Eigen::Vector3d& ray : rays_) ray /= ray.z();
  }

  // kSamples x kSamples per pixel, then a slight blur.
  GrayImage Take(const Albedo& albedo, const Rigid3& camera_from_board) const {
    constexpr int kSamples = 3;
    const Rigid3 board_from_camera = camera_from_board.Inverse();
    const Eigen::Vector3d o = board_from_camera.translation_mm;
    cv::Mat image(size_.height, size_.width, CV_32F);
    std::array<Eigen::Vector2d, kSamples * kSamples> places;
    std::array<float, kSamples * kSamples> values;
    for (int y = 0; y < size_.height; ++y) {
      for (int x = 0; x < size_.width; ++x) {
        for (int k = 0; k < kSamples * kSamples; ++k) {
          const Eigen::Vector3d d =
              board_from_camera.rotation *
              Ray(x + (k % kSamples + 0.5) / kSamples, y + (k / kSamples + 0.5) / kSamples);
          places[static_cast<std::size_t>(k)] = (o - d * (o.z() / d.z())).head<2>();
        }
        albedo.Evaluate(places, values);
        float sum = 0;
        for (const float v : values) sum += v;
        image.at<float>(y, x) = 220 * sum / (kSamples * kSamples);
      }
    }
    cv::GaussianBlur(image, image, {0, 0}, 0.5);
    GrayImage out{Image<std::uint16_t>(size_), 8};
    for (int y = 0; y < size_.height; ++y) {
      for (int x = 0; x < size_.width; ++x) {
        out.grey(y, x) = static_cast<std::uint16_t>(std::lround(image.at<float>(y, x)));
      }
    }
    return out;
  }

 private:
  // (x, y) from the image's top left corner.
  Eigen::Vector3d Ray(double x, double y) const {
    const int c = static_cast<int>(x) / step_, r = static_cast<int>(y) / step_;
    const double a = x / step_ - c, b = y / step_ - r;
    const auto at = [&](int i, int j) {
      return rays_[static_cast<std::size_t>((r + j) * columns_ + c + i)];
    };
    return (1 - b) * ((1 - a) * at(0, 0) + a * at(1, 0)) + b * ((1 - a) * at(0, 1) + a * at(1, 1));
  }

  ImageSize size_;
  int step_, columns_, rows_;
  std::vector<Eigen::Vector3d> rays_;
};

struct Case {
  const char* word;
  bool wide;
};
const Case kCases[] = {{"chessboard:9x6:10mm", true},
                       {"circles:9x7:10mm", true},
                       {"acircles:4x11:8mm", true},
                       {"donut-dots:14x10:7mm", true},
                       {"charuco:7x5:15mm:11mm:DICT_5X5_100", true},
                       {"aprilgrid:3x2:25mm:0.3:tag36h11", true},
                       {"chessboard:9x6:7mm", false},
                       {"circles:9x7:8mm", false},
                       {"donut-dots:14x10:5mm", false},
                       {"charuco:7x5:12mm:9mm:DICT_5X5_100", false},
                       {"aprilgrid:3x2:20mm:0.3:tag36h11", false}};

StereoRig RigOf(const Case& c) { return c.wide ? WideRig() : LabRig(); }
BoardPoseOptions OptionsOf(const Case& c) { return c.wide ? WideOptions() : LabOptions(); }

TEST(DrawBoardPoses, CarefulPosesAreTiltedAllRoundAtAllDistances) {
  for (const Case& c : kCases) {
    const StereoRig rig = RigOf(c);
    const BoardSpec spec = BoardSpec::Parse(c.word);
    const BoardPoseOptions options = OptionsOf(c);
    const auto poses = DrawBoardPoses(rig, spec, {}, options);
    ASSERT_EQ(poses.size(), 30U);
    EXPECT_LT(Tilt(rig, poses[0]), 1e-6) << c.word;
    std::array<int, 4> quadrants{};
    double nearest = 1e9, farthest = 0;
    for (std::size_t k = 0; k < poses.size(); ++k) {
      const double distance = (poses[k] * Middle(spec)).z();
      nearest = std::min(nearest, distance);
      farthest = std::max(farthest, distance);
      EXPECT_GE(distance, options.min_distance_mm - 1e-9);
      EXPECT_LE(distance, options.max_distance_mm + 1e-9);
      // Rows to the right, front to the cameras.
      EXPECT_GT(poses[k].rotation(0, 0), 0.5) << c.word << ' ' << k;
      EXPECT_GT(poses[k].rotation(2, 2), 0.5) << c.word << ' ' << k;
      if (k == 0) continue;
      EXPECT_GE(Tilt(rig, poses[k]), 20 * kDegree - 1e-9);
      EXPECT_LE(Tilt(rig, poses[k]), 40 * kDegree + 1e-9);
      const Eigen::Vector3d normal = poses[k].rotation.col(2);
      ++quadrants[static_cast<std::size_t>((normal.x() > 0) + 2 * (normal.y() > 0))];
    }
    EXPECT_GE(*std::min_element(quadrants.begin(), quadrants.end()), 3) << c.word;
    const double range = options.max_distance_mm - options.min_distance_mm;
    EXPECT_LT(nearest - options.min_distance_mm, 0.02 * range) << c.word;
    // The small rings of this board cannot be told further away with that lens.
    const bool rings_too_small = c.wide && spec.kind == BoardSpec::Kind::kDonutDots;
    EXPECT_LT(options.max_distance_mm - farthest, (rings_too_small ? 0.55 : 0.02) * range)
        << c.word;
  }
}

TEST(DrawBoardPoses, BoardsAreWholeWhereTheyMustBe) {
  for (const Case& c : kCases) {
    const StereoRig rig = RigOf(c);
    const BoardSpec spec = BoardSpec::Parse(c.word);
    int whole = 0, images = 0;
    for (const Rigid3& pose : DrawBoardPoses(rig, spec, {}, OptionsOf(c))) {
      for (const int camera : {0, 1}) {
        ++images;
        whole += Whole(rig, camera, spec, pose, 7.5);
        int points = 0;
        for (int id = 0; id < spec.PointCount(); ++id) {
          points +=
              CameraOf(rig, camera)
                  .Contains(CameraOf(rig, camera)
                                .Project(FromBoard(rig, camera, pose) * spec.NominalPoint(id)));
        }
        EXPECT_GE(points, 0.6 * spec.PointCount()) << c.word;
      }
    }
    const bool part = spec.kind == BoardSpec::Kind::kDonutDots ||
                      spec.kind == BoardSpec::Kind::kCharuco ||
                      spec.kind == BoardSpec::Kind::kAprilGrid;
    if (part) {
      EXPECT_GE(2 * whole, images) << c.word;
      EXPECT_LE(whole, images - 4) << c.word << ": nothing sticks out";
    } else {
      EXPECT_EQ(whole, images) << c.word;
    }
  }
}

TEST(DrawBoardPoses, CarefulPosesFillBothImages) {
  for (const Case& c : kCases) {
    const StereoRig rig = RigOf(c);
    const BoardSpec spec = BoardSpec::Parse(c.word);
    const auto poses = DrawBoardPoses(rig, spec, {}, OptionsOf(c));
    for (const int camera : {0, 1}) {
      const ImageSize size = CameraOf(rig, camera).size();
      std::set<std::pair<int, int>> parts;
      Eigen::Array2d low(1e9, 1e9), high(-1e9, -1e9);
      for (const Rigid3& pose : poses) {
        for (int id = 0; id < spec.PointCount(); ++id) {
          const Eigen::Vector2d q =
              CameraOf(rig, camera).Project(FromBoard(rig, camera, pose) * spec.NominalPoint(id));
          if (!CameraOf(rig, camera).Contains(q)) continue;
          parts.insert({static_cast<int>((q.x() + 0.5) * 8 / size.width),
                        static_cast<int>((q.y() + 0.5) * 6 / size.height)});
          low = low.min(q.array());
          high = high.max(q.array());
        }
      }
      EXPECT_GE(parts.size(), c.wide ? 39U : 45U) << c.word << ' ' << camera;
      EXPECT_LT(low.y(), 0.08 * size.height) << c.word;
      EXPECT_GT(high.y(), 0.92 * size.height) << c.word;
      // Side by side, what is near the left edge of the left image is not in the right one at all.
      const bool left_in_common = !c.wide || camera == 1, right_in_common = !c.wide || camera == 0;
      EXPECT_LT(low.x(), (left_in_common ? 0.08 : 0.2) * size.width) << c.word;
      EXPECT_GT(high.x(), (right_in_common ? 0.92 : 0.8) * size.width) << c.word;
    }
  }
}

TEST(DrawBoardPoses, CarelessPosesAreAlike) {
  for (const Case& c : kCases) {
    const StereoRig rig = RigOf(c);
    const BoardSpec spec = BoardSpec::Parse(c.word);
    BoardPoseOptions options = OptionsOf(c);
    options.style = Style::kCareless;
    const auto poses = DrawBoardPoses(rig, spec, {}, options);
    ASSERT_EQ(poses.size(), 30U);
    const Eigen::Vector3d first = poses[0] * Middle(spec);
    double largest = 0;
    for (const Rigid3& pose : poses) {
      EXPECT_LT(Tilt(rig, pose), 8 * kDegree);
      largest = std::max(largest, Tilt(rig, pose));
      const Eigen::Vector3d place = pose * Middle(spec);
      EXPECT_NEAR(place.z(), first.z(), 0.021 * first.z());
      EXPECT_LT((place - first).head<2>().norm(), 0.06 * first.z());
      EXPECT_TRUE(Whole(rig, 0, spec, pose, 7.5) && Whole(rig, 1, spec, pose, 7.5));
    }
    EXPECT_GT(largest, 3 * kDegree);
  }
}

TEST(DrawBoardPoses, SameSeedSamePoses) {
  const BoardSpec spec = BoardSpec::Parse("chessboard:9x6:10mm");
  BoardPoseOptions options = WideOptions();
  options.count = 8;
  const auto one = DrawBoardPoses(WideRig(), spec, {}, options);
  const auto again = DrawBoardPoses(WideRig(), spec, {}, options);
  options.seed = 2;
  const auto other = DrawBoardPoses(WideRig(), spec, {}, options);
  ASSERT_EQ(one.size(), 8U);
  for (std::size_t k = 1; k < one.size(); ++k) {
    EXPECT_EQ(one[k].Matrix(), again[k].Matrix());
    EXPECT_NE(one[k].Matrix(), other[k].Matrix());
  }
}

struct Photographed {
  int images = 0;
  int found = 0;        // with 60 % of their points or more
  double worst_px = 0;  // from the truth
};

// Takes every step-th pose, with the cameras from `first_camera` on, and detects the board.
Photographed Photograph(const Case& c, std::size_t first, std::size_t step, int first_camera) {
  const StereoRig rig = RigOf(c);
  const BoardSpec spec = BoardSpec::Parse(c.word);
  const auto albedo = MakeBoardAlbedo(spec, {});
  const auto poses = DrawBoardPoses(rig, spec, {}, OptionsOf(c));
  Photographed out;
  for (int camera = first_camera; camera < 2; ++camera) {
    const Photographer photographer(CameraOf(rig, camera), c.wide ? 1 : 4);
    for (std::size_t k = first; k < poses.size(); k += step) {
      const Rigid3 camera_from_board = FromBoard(rig, camera, poses[k]);
      const BoardDetection seen = DetectBoard(spec, photographer.Take(*albedo, camera_from_board));
      ++out.images;
      out.found += 10 * static_cast<int>(seen.ids.size()) >= 6 * spec.PointCount();
      for (std::size_t i = 0; i < seen.ids.size(); ++i) {
        const Eigen::Vector2d truth =
            Shown(CameraOf(rig, camera), camera_from_board, spec, seen.ids[i]);
        out.worst_px = std::max(out.worst_px, (seen.pixels[i] - truth).norm());
      }
    }
  }
  return out;
}

// Two of the poses in both wide cameras, one in the right one of the others.
TEST(DrawBoardPoses, BoardsSoHeldAreDetected) {
  for (const Case& c : kCases) {
    const Photographed seen = c.wide ? Photograph(c, 1, 19, 0) : Photograph(c, 16, 30, 1);
    EXPECT_EQ(seen.found, seen.images) << c.word;
    // Three samples a pixel across do not show the smallest markers truly.
    EXPECT_LT(seen.worst_px, 0.35) << c.word;
  }
}

TEST(DrawBoardPoses, ProveBoardsSoHeldAreDetected) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE";
  for (const Case& c : kCases) {
    const Photographed seen = Photograph(c, 0, 1, 0);
    std::printf("%s: %d of %d, worst %.3f px\n", c.word, seen.found, seen.images, seen.worst_px);
    EXPECT_GE(20 * seen.found, 19 * seen.images) << c.word;
    EXPECT_LT(seen.worst_px, 0.35) << c.word;
  }
}

std::string Refusal(const StereoRig& rig, const char* word, const BoardPoseOptions& options) {
  try {
    DrawBoardPoses(rig, BoardSpec::Parse(word), {}, options);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(DrawBoardPoses, SaysWhyABoardCannotBeHeld) {
  EXPECT_THAT(Refusal(LabRig(), "chessboard:9x6:40mm", LabOptions()),
              HasSubstr("too large for this rig: at no distance between 440 and 520 mm"));
  EXPECT_THAT(Refusal(WideRig(), "chessboard:9x6:2mm", WideOptions()),
              HasSubstr("its squares are at most 5."));
  EXPECT_THAT(Refusal(WideRig(), "charuco:5x7:8mm:4mm:DICT_6X6_250", WideOptions()),
              HasSubstr("hold it nearer"));
  EXPECT_THAT(Refusal(WideRig(), "chessboard:150x60:2mm", WideOptions()),
              HasSubstr("fewer and larger ones"));
  StereoRig apart = LabRig();
  apart.right_from_left.translation_mm.x() -= 2000;
  EXPECT_THAT(Refusal(apart, "chessboard:9x6:7mm", LabOptions()), HasSubstr("no field in common"));
  BoardPoseOptions one_distance = LabOptions();
  one_distance.min_distance_mm = one_distance.max_distance_mm = 300;
  EXPECT_THAT(Refusal(LabRig(), "chessboard:9x6:7mm", one_distance), ::testing::IsEmpty());
}

TEST(DrawBoardPoses, RefusesOptionsThatContradictThemselves) {
  for (const auto& set : {+[](BoardPoseOptions& o) { o.min_distance_mm = 0; },
                          +[](BoardPoseOptions& o) { o.max_distance_mm = 100; },
                          +[](BoardPoseOptions& o) { o.count = 0; },
                          +[](BoardPoseOptions& o) { o.max_tilt_rad = 0.1; },
                          +[](BoardPoseOptions& o) { o.edge_margin_px = -1; }}) {
    BoardPoseOptions options = WideOptions();
    set(options);
    EXPECT_THROW(DrawBoardPoses(WideRig(), BoardSpec::Parse("chessboard:9x6:10mm"), {}, options),
                 UsageError);
  }
}

}  // namespace
}  // namespace plumbline
