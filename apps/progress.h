#pragma once

#include <chrono>
#include <cstdint>
#include <mutex>
#include <string>

namespace plumbline {

enum class ProgressStyle {
  kNone,
  kBar,   // one line on a terminal, drawn over and over
  kLines  // plain lines now and then, for logs
};

// The style that suits stderr: a bar on a terminal, lines elsewhere.
ProgressStyle ProgressStyleOfStderr();

// One line: "measure  12/44  27 %, 2.1/s, 97 % valid, about 40 s left". With `width` columns for a
// bar (0: none). `total` 0 or less: not known.
std::string ProgressText(const std::string& label, std::int64_t done, std::int64_t total,
                         std::chrono::duration<double> elapsed, int width,
                         const std::string& detail = "");

// "42 s", "3 min 20 s", "2 h 5 min".
std::string DurationText(std::chrono::duration<double> duration);

// Tells on stderr how far long work has come. Safe to call from several threads.
class Progress {
 public:
  Progress(std::string label, std::int64_t total, ProgressStyle style);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  void Advance(std::int64_t count = 1);

  // What is told beside the count: "97.2 % valid".
  void SetDetail(std::string detail);

  // A line of its own that stays, above the bar.
  void Note(const std::string& line);

 private:
  void Show(bool last);

  using Clock = std::chrono::steady_clock;
  const std::string label_;
  const std::int64_t total_;
  const ProgressStyle style_;
  const Clock::time_point begin_ = Clock::now();
  std::mutex mutex_;
  Clock::time_point shown_ = begin_;
  std::int64_t done_ = 0;
  std::string detail_;
};

}  // namespace plumbline
