#pragma once

namespace plumbline {

// Ctrl-C (SIGINT) and SIGTERM as a wish, not as an end: the work in hand is finished and the file
// closed. A second Ctrl-C ends the program at once. Once for the whole program.
class InterruptGuard {
 public:
  InterruptGuard();
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;

  // Whether the user has asked to stop since the guard was made.
  static bool Requested();
};

}  // namespace plumbline
