#include "apps/calibrate_session.h"

#include <fmt/format.h>
#include <tbb/info.h>
#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <memory>

#include "apps/interrupt.h"
#include "calib/error.h"

namespace plumbline {
namespace {

void RefuseOtherSize(ImageSize& wanted, const GrayImage& image, const std::string& name,
                     std::string& problem) {
  if (wanted.width == 0) wanted = image.size();
  if (image.size() == wanted) return;
  problem = fmt::format(
      "{} is {}x{} px and the first photograph of its camera {}x{} px: it is from another camera "
      "or was cropped.",
      name, image.width(), image.height(), wanted.width, wanted.height);
}

struct Job {
  std::size_t index = 0;
  StereoFrame frame;
};

}  // namespace

DetectedPairs DetectPairs(const BoardSpec& board, ImageSource& source, ProgressStyle style) {
  DetectedPairs detected;
  Progress progress("finding the board", source.DeclaredCount(), style);
  const auto read = [&](tbb::flow_control& control) -> std::shared_ptr<Job> {
    std::optional<StereoFrame> frame;
    if (!InterruptGuard::Requested()) frame = source.Next();
    detected.interrupted = InterruptGuard::Requested();
    if (!frame) {
      control.stop();
      return nullptr;
    }
    auto job = std::make_shared<Job>();
    job->index = detected.pairs.size();
    job->frame = std::move(*frame);
    CalibrationPair pair;
    pair.left_name = job->frame.left_id;
    pair.right_name = job->frame.right_id;
    std::string problem = job->frame.problem;
    if (problem.empty()) {
      RefuseOtherSize(detected.left_size, job->frame.left, pair.left_name, problem);
      RefuseOtherSize(detected.right_size, job->frame.right, pair.right_name, problem);
    }
    job->frame.problem = problem;
    pair.left.problem = problem;
    pair.right.problem = problem;
    detected.pairs.push_back(std::move(pair));
    return job;
  };
  const auto detect = [&](const std::shared_ptr<Job>& job) {
    std::pair<std::size_t, CalibrationPair> result;
    result.first = job->index;
    if (job->frame.problem.empty()) {
      result.second.left = DetectBoard(board, job->frame.left);
      result.second.right = DetectBoard(board, job->frame.right);
    } else {
      result.second.left.problem = job->frame.problem;
      result.second.right.problem = job->frame.problem;
    }
    progress.Advance();
    return result;
  };
  // Results are put in place by the serial last stage; the first one may be growing the list, so
  // they are collected apart.
  std::vector<std::pair<std::size_t, CalibrationPair>> results;
  const auto tokens = static_cast<std::size_t>(2 * std::max(1, tbb::info::default_concurrency()));
  tbb::parallel_pipeline(
      tokens,
      tbb::make_filter<void, std::shared_ptr<Job>>(tbb::filter_mode::serial_in_order, read) &
          tbb::make_filter<std::shared_ptr<Job>, std::pair<std::size_t, CalibrationPair>>(
              tbb::filter_mode::parallel, detect) &
          tbb::make_filter<std::pair<std::size_t, CalibrationPair>, void>(
              tbb::filter_mode::serial_in_order,
              [&](std::pair<std::size_t, CalibrationPair> result) {
                results.push_back(std::move(result));
              }));
  for (auto& [index, result] : results) {
    detected.pairs[index].left = std::move(result.left);
    detected.pairs[index].right = std::move(result.right);
  }
  detected.notes = source.Notes();
  if (!detected.interrupted && detected.left_size.width == 0) {
    throw InputError(detected.pairs.empty()
                         ? std::string("There are no photographs to calibrate from.")
                         : "None of the photographs can be used; the first: " +
                               detected.pairs.front().left.problem);
  }
  return detected;
}

}  // namespace plumbline
