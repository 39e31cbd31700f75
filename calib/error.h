#pragma once

#include <stdexcept>
#include <string>

namespace plumbline {

// What the command line turns into an exit code. Each message is one sentence: what is wrong,
// where, what to do.

// The call itself is wrong: an unknown option, a value out of its range. Exit code 2.
class UsageError : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The input cannot be used: a damaged image, a board that is not there, a rig file of another
// camera. Exit code 3.
class InputError : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The world failed: disk full, folder not writable, camera gone. Exit code 4.
class EnvironmentError : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

}  // namespace plumbline
