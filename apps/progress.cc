#include "apps/progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace plumbline {
namespace {

constexpr std::chrono::duration<double> kBarInterval(0.1);
constexpr std::chrono::duration<double> kLineInterval(5);
constexpr int kBarWidth = 30;

}  // namespace

ProgressStyle ProgressStyleOfStderr() {
  return isatty(STDERR_FILENO) != 0 ? ProgressStyle::kBar : ProgressStyle::kLines;
}

std::string DurationText(std::chrono::duration<double> duration) {
  const auto seconds = static_cast<std::int64_t>(std::llround(std::max(0.0, duration.count())));
  if (seconds < 60) return fmt::format("{} s", seconds);
  if (seconds < 3600) return fmt::format("{} min {} s", seconds / 60, seconds % 60);
  return fmt::format("{} h {} min", seconds / 3600, seconds / 60 % 60);
}

std::string ProgressText(const std::string& label, std::int64_t done, std::int64_t total,
                         std::chrono::duration<double> elapsed, int width,
                         const std::string& detail) {
  const std::string aside = detail.empty() ? "" : ", " + detail;
  if (total <= 0) {
    return fmt::format("{}  {} done in {}{}", label, done, DurationText(elapsed), aside);
  }
  const double share = std::clamp(static_cast<double>(done) / static_cast<double>(total), 0.0, 1.0);
  std::string text = label + "  ";
  if (width > 0) {
    const auto filled = static_cast<std::size_t>(std::lround(share * width));
    text +=
        fmt::format("[{:#<{}}{:.<{}}]  ", "", filled, "", static_cast<std::size_t>(width) - filled);
  }
  text += fmt::format("{}/{}  {:.0f} %", done, total, 100 * share);
  if (done > 0 && done < total && elapsed.count() > 0) {
    text += fmt::format(", {:.2g}/s", static_cast<double>(done) / elapsed.count());
  }
  text += aside;
  if (done >= total) {
    text += fmt::format(", took {}", DurationText(elapsed));
  } else if (done > 0) {
    text += fmt::format(", about {} left", DurationText(elapsed * ((1 - share) / share)));
  }
  return text;
}

Progress::Progress(std::string label, std::int64_t total, ProgressStyle style)
    : label_(std::move(label)), total_(total), style_(style) {
  if (style_ == ProgressStyle::kBar) Show(false);
}

Progress::~Progress() { Show(true); }

void Progress::Advance(std::int64_t count) {
  const std::lock_guard lock(mutex_);
  done_ += count;
  const auto interval = style_ == ProgressStyle::kBar ? kBarInterval : kLineInterval;
  if (Clock::now() - shown_ >= interval && done_ != total_) Show(false);
}

void Progress::SetDetail(std::string detail) {
  const std::lock_guard lock(mutex_);
  detail_ = std::move(detail);
}

void Progress::Note(const std::string& line) {
  if (style_ == ProgressStyle::kNone) return;
  const std::lock_guard lock(mutex_);
  if (style_ == ProgressStyle::kBar) fmt::print(stderr, "\r\033[K");
  fmt::print(stderr, "{}\n", line);
  if (style_ == ProgressStyle::kBar) Show(false);
}

void Progress::Show(bool last) {
  if (style_ == ProgressStyle::kNone) return;
  shown_ = Clock::now();
  const std::chrono::duration<double> elapsed = shown_ - begin_;
  if (style_ == ProgressStyle::kBar) {
    fmt::print(stderr, "\r\033[K{}{}",
               ProgressText(label_, done_, total_, elapsed, kBarWidth, detail_), last ? "\n" : "");
  } else {
    fmt::print(stderr, "{}\n", ProgressText(label_, done_, total_, elapsed, 0, detail_));
  }
  std::fflush(stderr);
}

}  // namespace plumbline
