#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "io/image_source.h"

namespace plumbline::testing {

// Pairs that are there.
class HeldPairs : public ImageSource {
 public:
  explicit HeldPairs(std::vector<StereoFrame> pairs) : pairs_(std::move(pairs)) {}
  std::int64_t DeclaredCount() const override { return static_cast<std::int64_t>(pairs_.size()); }
  std::optional<StereoFrame> Next() override {
    if (next_ == pairs_.size()) return std::nullopt;
    return pairs_[next_++];
  }
  std::vector<std::string> Notes() const override { return {}; }
  std::vector<std::filesystem::path> Files() const override { return {}; }

 private:
  std::vector<StereoFrame> pairs_;
  std::size_t next_ = 0;
};

}  // namespace plumbline::testing
