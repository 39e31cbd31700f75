#include "apps/interrupt.h"

#include <unistd.h>

#include <csignal>
#include <string_view>

namespace plumbline {
namespace {

volatile std::sig_atomic_t requested = 0;

void OnSignal(int signal) {
  requested = 1;
  std::signal(signal, SIG_DFL);  // the second time is meant
  constexpr std::string_view kMessage =
      "\nStopping after the frame in hand; press Ctrl-C again to stop at once.\n";
  static_cast<void>(!write(STDERR_FILENO, kMessage.data(), kMessage.size()));
}

}  // namespace

InterruptGuard::InterruptGuard() {
  requested = 0;
  std::signal(SIGINT, OnSignal);
  std::signal(SIGTERM, OnSignal);
}

InterruptGuard::~InterruptGuard() {
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

bool InterruptGuard::Requested() { return requested != 0; }

}  // namespace plumbline
