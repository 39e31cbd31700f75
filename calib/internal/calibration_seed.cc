#include "calib/internal/calibration_seed.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "calib/error.h"
#include "calib/median.h"

namespace plumbline::internal {
namespace {

constexpr int kMinPoints = 8;
constexpr int kMinPairs = 4;
constexpr double kMinOrientationSpread = 8 * M_PI / 180;

// What one camera alone says.
struct CameraSeed {
  Eigen::Vector4d fxycxy;
  double k1 = 0;
  std::vector<std::optional<Rigid3>> camera_from_board;  // a pair
  std::vector<std::string> problems;                     // a pair
};

Rigid3 ToRigid3(const cv::Mat& r, const cv::Mat& t) {
  return Rigid3::FromRotationVector({r.at<double>(0), r.at<double>(1), r.at<double>(2)},
                                    {t.at<double>(0), t.at<double>(1), t.at<double>(2)});
}

// Why too few photographs can be used, in the words of the detector where it has a common
// complaint.
[[noreturn]] void RefuseTooFew(const char* side, std::size_t usable,
                               const std::vector<std::string>& problems) {
  std::map<std::string, int> count;
  for (const std::string& p : problems) {
    if (!p.empty()) ++count[p];
  }
  const auto most = std::max_element(
      count.begin(), count.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  const std::string why = most == count.end() ? "" : fmt::format(" (most often: {})", most->first);
  throw InputError(
      fmt::format("the board was found in only {} of {} {} photographs{}; at least {} are needed: "
                  "check the board word, or add photographs",
                  usable, problems.size(), side, why, kMinPairs));
}

CameraSeed SeedCamera(const BoardSpec& board, ImageSize size,
                      const std::vector<const BoardDetection*>& photographs, const char* side) {
  CameraSeed out;
  out.camera_from_board.resize(photographs.size());
  out.problems.resize(photographs.size());
  std::vector<std::size_t> use;
  std::vector<std::vector<cv::Point3f>> object(photographs.size());
  std::vector<std::vector<cv::Point2f>> image(photographs.size());
  for (std::size_t i = 0; i < photographs.size(); ++i) {
    const BoardDetection& d = *photographs[i];
    if (static_cast<int>(d.ids.size()) < kMinPoints) {
      out.problems[i] = !d.problem.empty()
                            ? d.problem
                            : fmt::format("only {} points of the board were found", d.ids.size());
      continue;
    }
    for (std::size_t k = 0; k < d.ids.size(); ++k) {
      const Eigen::Vector3f p = board.NominalPoint(d.ids[k]).cast<float>();
      object[i].emplace_back(p.x(), p.y(), p.z());
      image[i].emplace_back(static_cast<float>(d.pixels[k].x()),
                            static_cast<float>(d.pixels[k].y()));
    }
    use.push_back(i);
  }
  // A photograph of another camera, or with a misread board, spoils the first solve: solve, drop
  // what fits badly, solve again.
  for (int round = 0; round < 3; ++round) {
    if (use.size() < kMinPairs) RefuseTooFew(side, use.size(), out.problems);
    std::vector<std::vector<cv::Point3f>> object_used;
    std::vector<std::vector<cv::Point2f>> image_used;
    for (std::size_t i : use) {
      object_used.push_back(object[i]);
      image_used.push_back(image[i]);
    }
    cv::Mat K = cv::Mat::eye(3, 3, CV_64F), D = cv::Mat::zeros(5, 1, CV_64F), deviations,
            extrinsic_deviations, errors;
    std::vector<cv::Mat> rotations, translations;
    cv::calibrateCamera(
        object_used, image_used, cv::Size(size.width, size.height), K, D, rotations, translations,
        deviations, extrinsic_deviations, errors,
        cv::CALIB_FIX_PRINCIPAL_POINT | cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K2 |
            cv::CALIB_FIX_K3 | cv::CALIB_FIX_ASPECT_RATIO,
        cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 60, 1e-9));
    out.fxycxy << K.at<double>(0, 0), K.at<double>(1, 1), K.at<double>(0, 2), K.at<double>(1, 2);
    out.k1 = D.at<double>(0);
    if (!out.fxycxy.allFinite() || out.fxycxy[0] <= 0) {
      throw InputError(
          fmt::format("the {} photographs do not determine a focal length; add photographs with "
                      "the board tilted by 20 to 40 degrees",
                      side));
    }
    std::vector<double> rms;
    for (int k = 0; k < errors.rows; ++k) rms.push_back(errors.at<double>(k));
    const double limit = std::max(5 * Median(rms), 2.0);
    std::vector<std::size_t> kept;
    out.camera_from_board.assign(photographs.size(), std::nullopt);
    for (std::size_t k = 0; k < use.size(); ++k) {
      if (rms[k] <= limit) {
        out.camera_from_board[use[k]] = ToRigid3(rotations[k], translations[k]);
        kept.push_back(use[k]);
      } else {
        out.problems[use[k]] = fmt::format(
            "does not fit the camera of the other photographs ({:.1f} px rms): another camera or "
            "lens setting, or the board misread",
            rms[k]);
      }
    }
    const bool settled = kept.size() == use.size();
    use = std::move(kept);
    if (settled) break;
  }
  return out;
}

// How far apart two rigid motions are: the distance between what they do to points at the working
// distance, mm.
double Disagreement(const Rigid3& a, const Rigid3& b, double working_distance_mm) {
  const Rigid3 difference = a * b.Inverse();
  return difference.translation_mm.norm() +
         working_distance_mm * difference.RotationVector().norm();
}

Eigen::VectorXd FirstIntrinsics(const LensModel& model, const CameraSeed& seed) {
  Eigen::VectorXd p = Eigen::VectorXd::Zero(model.ParameterCount());
  p.head<4>() = seed.fxycxy;
  if (!model.IsSplined()) p[4] = seed.k1;
  return p;
}

void AddObservations(BoardProblem& problem, int pair, int camera, const BoardDetection& detection) {
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    BoardObservation o;
    o.pair = pair;
    o.camera = camera;
    o.id = detection.ids[k];
    o.pixel = detection.pixels[k];
    o.sigma_px = detection.sigma_px[k];
    problem.observations.push_back(o);
  }
}

std::string OfBothSides(const std::string& left, const std::string& right) {
  if (left == right) return left;
  if (left.empty()) return "right: " + right;
  if (right.empty()) return "left: " + left;
  return "left: " + left + "; right: " + right;
}

// The pose of the right camera against the left that agrees best with all pairs; pairs that
// contradict it are named.
Rigid3 RelativePose(const CameraSeed& left, const CameraSeed& right,
                    std::vector<std::string>& pair_problems) {
  std::vector<std::size_t> both;
  std::vector<Rigid3> right_from_left;
  std::vector<double> distances;
  for (std::size_t i = 0; i < left.camera_from_board.size(); ++i) {
    if (!left.camera_from_board[i] || !right.camera_from_board[i]) continue;
    both.push_back(i);
    right_from_left.push_back(*right.camera_from_board[i] * left.camera_from_board[i]->Inverse());
    distances.push_back(left.camera_from_board[i]->translation_mm.norm());
  }
  if (both.size() < kMinPairs) {
    throw InputError(
        fmt::format("both cameras see the board in only {} pairs, and at least {} are needed; add "
                    "pairs in which the board is in view of both",
                    both.size(), kMinPairs));
  }
  const double distance = Median(distances);
  std::size_t best = 0;
  double best_score = std::numeric_limits<double>::infinity();
  std::vector<double> to_best;
  for (std::size_t i = 0; i < both.size(); ++i) {
    std::vector<double> d;
    for (std::size_t j = 0; j < both.size(); ++j)
      d.push_back(Disagreement(right_from_left[j], right_from_left[i], distance));
    const double score = Median(d);
    if (score < best_score) {
      best_score = score;
      best = i;
      to_best = d;
    }
  }
  const Rigid3& reference = right_from_left[best];
  // A first solve has errors of its own, larger for long lenses: a tenth of the working distance is
  // no contradiction yet.
  const double limit = std::max(8 * best_score, 0.1 * distance);
  if (best_score > 0.25 * distance) {
    throw InputError(fmt::format(
        "the pose of the right camera against the left differs from pair to pair by about {:.0f} "
        "mm at the board; the photographs are not taken at the same moments, or "
        "left and right are paired wrongly",
        best_score));
  }
  for (std::size_t k = 0; k < both.size(); ++k) {
    if (to_best[k] <= limit) continue;
    const bool swapped = Disagreement(right_from_left[k].Inverse(), reference, distance) <= limit;
    pair_problems[both[k]] =
        swapped ? "left and right are swapped in this pair"
                : fmt::format(
                      "the two photographs contradict the other pairs by {:.0f} mm at the board: "
                      "not taken at the same moment, or paired wrongly",
                      to_best[k]);
  }
  return reference;
}

}  // namespace

double OrientationSpread(const BoardProblem& problem) {
  double spread = 0;
  for (const Rigid3& a : problem.left_from_board) {
    for (const Rigid3& b : problem.left_from_board) {
      spread = std::max(spread,
                        std::acos(std::clamp(a.rotation.col(2).dot(b.rotation.col(2)), -1.0, 1.0)));
    }
  }
  return spread;
}

CalibrationSeed SeedCalibration(const BoardSpec& board, const LensModel& model, ImageSize left_size,
                                ImageSize right_size, const std::vector<CalibrationPair>& pairs) {
  std::vector<const BoardDetection*> left_photographs, right_photographs;
  for (const CalibrationPair& p : pairs) {
    left_photographs.push_back(&p.left);
    right_photographs.push_back(&p.right);
  }
  const CameraSeed left = SeedCamera(board, left_size, left_photographs, "left");
  const CameraSeed right = SeedCamera(board, right_size, right_photographs, "right");
  std::vector<std::string> problems(pairs.size());
  const Rigid3 right_from_left = RelativePose(left, right, problems);

  CalibrationSeed seed{
      BoardProblem{StereoRig{Camera(model, left_size, FirstIntrinsics(model, left)),
                             Camera(model, right_size, FirstIntrinsics(model, right)),
                             right_from_left,
                             {},
                             board.Word()},
                   {},
                   {},
                   {},
                   {}},
      std::move(problems)};
  BoardProblem& problem = seed.problem;
  for (int id = 0; id < board.PointCount(); ++id)
    problem.nominal_mm.push_back(board.NominalPoint(id));
  problem.target_mm = problem.nominal_mm;
  std::vector<double> radii;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const bool has_left = left.camera_from_board[i].has_value();
    const bool has_right = right.camera_from_board[i].has_value();
    std::string& trouble = seed.pair_problems[i];
    const bool contradictory = !trouble.empty();
    if (!contradictory) trouble = OfBothSides(left.problems[i], right.problems[i]);
    problem.left_from_board.push_back(has_left ? *left.camera_from_board[i]
                                      : has_right
                                          ? right_from_left.Inverse() * *right.camera_from_board[i]
                                          : Rigid3{});
    if (contradictory) continue;
    if (has_left) AddObservations(problem, static_cast<int>(i), 0, pairs[i].left);
    if (has_right) AddObservations(problem, static_cast<int>(i), 1, pairs[i].right);
    for (const BoardDetection* d : {&pairs[i].left, &pairs[i].right}) {
      if (d->found() && d->disc_radius_mm > 0) radii.push_back(d->disc_radius_mm);
    }
  }
  if (board.HasDiscs() && !radii.empty()) problem.disc_radius_mm = Median(radii);
  const double spread = OrientationSpread(problem);
  if (spread < kMinOrientationSpread) {
    throw InputError(fmt::format(
        "all boards stand parallel (within {:.1f} degrees), which leaves the focal length open; "
        "add photographs with the board tilted by 20 to 40 degrees in both directions",
        spread * 180 / M_PI));
  }
  return seed;
}

}  // namespace plumbline::internal
