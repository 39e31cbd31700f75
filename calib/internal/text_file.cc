#include "calib/internal/text_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

#include "calib/error.h"

namespace plumbline::internal {

std::string ReadTextFile(const std::filesystem::path& path, std::size_t max_bytes) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) {
    throw EnvironmentError("cannot read '" + path.string() + "': there is no such file");
  }
  if (std::filesystem::file_size(path, error) > max_bytes) {
    throw InputError("'" + path.string() + "' is too large to be a calibration file");
  }
  std::ifstream in(path, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  if (!in) throw EnvironmentError("cannot read '" + path.string() + "': " + std::strerror(errno));
  return std::move(text).str();
}

void WriteTextFile(const std::filesystem::path& path, std::string_view text) {
  const std::string temporary = path.string() + ".tmp" + std::to_string(::getpid());
  const auto fail = [&] {
    const std::string reason = std::strerror(errno);
    ::unlink(temporary.c_str());
    throw EnvironmentError("cannot write '" + path.string() + "': " + reason);
  };
  const int file = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (file < 0) fail();
  bool ok = true;
  while (ok && !text.empty()) {
    const ssize_t n = ::write(file, text.data(), text.size());
    ok = n >= 0 || errno == EINTR;
    if (n > 0) text.remove_prefix(static_cast<std::size_t>(n));
  }
  ok = ok && ::fsync(file) == 0;
  const int saved_errno = errno;
  if (::close(file) != 0 && ok) fail();
  errno = saved_errno;
  if (!ok || ::rename(temporary.c_str(), path.c_str()) != 0) fail();
}

}  // namespace plumbline::internal
