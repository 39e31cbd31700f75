#include "match/internal/motion_memory.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "calib/median.h"

namespace plumbline::internal {
namespace {

// For so many frames a lost point is looked for where it was seen last.
constexpr std::uint8_t kRememberFrames = 10;

}  // namespace

// By the median over the points of how far a subset's pixels would have been off.
bool MotionMemory::LastMotionWouldHaveHelped(const PlanarField& field) const {
  if (!last_ || !before_last_) return false;
  std::vector<double> moved_on, stayed;
  const double radius2 = 0.25 * field.subset_px * field.subset_px;
  const auto shift2 = [&](const Eigen::Vector2d& by, const Eigen::Matrix2f& gradient) {
    return by.squaredNorm() + radius2 / 3 * static_cast<double>(gradient.squaredNorm());
  };
  for (std::size_t i = 0; i < field.status.pixel_count(); ++i) {
    if (field.status.data()[i] != Status::kOk || last_->status.data()[i] != Status::kOk ||
        before_last_->status.data()[i] != Status::kOk) {
      continue;
    }
    const Eigen::Vector2d motion =
        last_->displacement_px.data()[i] - before_last_->displacement_px.data()[i];
    const Eigen::Matrix2f turn = last_->gradient.data()[i] - before_last_->gradient.data()[i];
    const Eigen::Vector2d by = field.displacement_px.data()[i] - last_->displacement_px.data()[i];
    const Eigen::Matrix2f gradient = field.gradient.data()[i] - last_->gradient.data()[i];
    stayed.push_back(shift2(by, gradient));
    moved_on.push_back(shift2(by - motion, gradient - turn));
  }
  return !stayed.empty() && Median(std::move(moved_on)) < Median(std::move(stayed));
}

void MotionMemory::Take(const PlanarField& field) {
  const std::size_t count = field.status.pixel_count();
  if (!expected_) {
    const auto& all = field.status.values();
    if (std::find(all.begin(), all.end(), Status::kOk) == all.end()) return;
    expected_ = field;
    age_ = Image<std::uint8_t>(field.size(), 0);
  }
  const bool go_on = LastMotionWouldHaveHelped(field);
  for (std::size_t i = 0; i < count; ++i) {
    if (field.status.data()[i] == Status::kOk) {
      expected_->displacement_px.data()[i] = field.displacement_px.data()[i];
      expected_->gradient.data()[i] = field.gradient.data()[i];
      expected_->status.data()[i] = Status::kOk;
      age_.data()[i] = 0;
      if (go_on && last_->status.data()[i] == Status::kOk) {
        expected_->displacement_px.data()[i] +=
            field.displacement_px.data()[i] - last_->displacement_px.data()[i];
        expected_->gradient.data()[i] += field.gradient.data()[i] - last_->gradient.data()[i];
      }
    } else if (age_.data()[i] >= kRememberFrames) {
      expected_->status.data()[i] = field.status.data()[i];
    } else {
      // Where it was seen, not beyond.
      if (age_.data()[i] == 0 && last_ && last_->status.data()[i] == Status::kOk) {
        expected_->displacement_px.data()[i] = last_->displacement_px.data()[i];
        expected_->gradient.data()[i] = last_->gradient.data()[i];
      }
      ++age_.data()[i];
    }
  }
  before_last_ = std::exchange(last_, Motion{field.displacement_px, field.gradient, field.status});
}

void MotionMemory::Replace(PlanarField expected) {
  age_ = Image<std::uint8_t>(expected.size(), 0);
  expected_ = std::move(expected);
  last_.reset();
  before_last_.reset();
}

void MotionMemory::Forget() {
  expected_.reset();
  last_.reset();
  before_last_.reset();
}

}  // namespace plumbline::internal
