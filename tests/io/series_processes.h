#pragma once

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

// Tests of series that run a (disabled) test of this binary in a process of its own. That test
// finds the file it is to write in the environment variable PLUMBLINE_SERIES_CHILD, and how many
// frames in PLUMBLINE_SERIES_FRAMES.
namespace plumbline::testing {

// Starts it. Returns the process.
inline pid_t StartChild(const std::string& test, const std::filesystem::path& file, int frames) {
  const pid_t child = fork();
  if (child != 0) return child;
  setenv("PLUMBLINE_SERIES_CHILD", file.c_str(), 1);
  setenv("PLUMBLINE_SERIES_FRAMES", std::to_string(frames).c_str(), 1);
  if (std::freopen("/dev/null", "w", stdout) == nullptr) _exit(1);
  execl("/proc/self/exe", "series", "--gtest_also_run_disabled_tests",
        ("--gtest_filter=" + test).c_str(), nullptr);
  _exit(1);
}

// Kills a test that commits frames and adds a byte to `<file>.told` for each, after it has told
// three and then some time that depends on the round. Returns how many it had told.
inline std::int64_t KillWhileCommitting(const std::string& test, const std::filesystem::path& file,
                                        int round) {
  const pid_t child = StartChild(test, file, 100'000);
  const std::filesystem::path told = file.string() + ".told";
  std::error_code ignored;
  for (int k = 0; k < 4000; ++k) {
    if (std::filesystem::exists(told) && std::filesystem::file_size(told, ignored) >= 3) break;
    usleep(2000);
  }
  usleep(static_cast<useconds_t>(3000 + 1777 * round));
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  return static_cast<std::int64_t>(std::filesystem::file_size(told));
}

// The most memory that this process has had, since it was started: unlike ru_maxrss, without what
// its parent had.
inline long PeakKilobytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) return std::stol(line.substr(6));
  }
  return -1;
}

// What a test that writes so many frames, and its peak to `<file>.peak`, has told; -1: it failed.
inline long PeakOfARun(const std::string& test, const std::filesystem::path& file, int frames) {
  const pid_t child = StartChild(test, file, frames);
  int status = -1;
  waitpid(child, &status, 0);
  long peak = -1;
  std::ifstream(file.string() + ".peak") >> peak;
  return status == 0 ? peak : -1;
}

// Damages one byte of the last three quarters of a file.
template <typename Rng>
void DamageOneByte(const std::filesystem::path& file, Rng& rng) {
  const auto size = static_cast<std::int64_t>(std::filesystem::file_size(file));
  const std::int64_t at = size / 4 + static_cast<std::int64_t>(rng()) % (size - size / 4);
  std::fstream bytes(file, std::ios::in | std::ios::out | std::ios::binary);
  bytes.seekg(at);
  const char old = static_cast<char>(bytes.get());
  bytes.seekp(at);
  bytes.put(static_cast<char>(old ^ 0x55));
}

}  // namespace plumbline::testing
