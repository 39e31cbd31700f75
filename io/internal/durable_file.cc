#include "io/internal/durable_file.h"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>
#include <openssl/evp.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <memory>

#include "calib/error.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

fs::path TemporaryName(const fs::path& file) {
  return file.string() + fmt::format(".tmp{}", getpid());
}

void ThrowSystemError(const std::string& doing, const fs::path& file, int error_number) {
  throw EnvironmentError(
      fmt::format("{} {}: {}", doing, file.string(), std::strerror(error_number)));
}

void SyncPath(const fs::path& path) {
  const int fd = open(path.empty() ? "." : path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) ThrowSystemError("cannot open", path, errno);
  const int result = fsync(fd);
  const int error_number = errno;
  close(fd);
  // Some file systems do not sync folders; that is not the user's trouble.
  if (result != 0 && error_number != EINVAL) ThrowSystemError("cannot write", path, error_number);
}

void WriteDurably(const fs::path& file, const std::function<void(const fs::path&)>& write) {
  const fs::path temporary = TemporaryName(file);
  std::error_code failed;
  try {
    write(temporary);
    SyncPath(temporary);
  } catch (...) {
    fs::remove(temporary, failed);
    throw;
  }
  fs::rename(temporary, file, failed);
  if (failed) {
    const int error_number = failed.value();
    fs::remove(temporary, failed);
    ThrowSystemError("cannot write", file, error_number);
  }
  SyncPath(file.parent_path());
}

void WriteBytes(const fs::path& file, std::span<const char> bytes) {
  const fs::path temporary = TemporaryName(file);
  errno = 0;
  std::ofstream out(temporary, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  std::error_code failed;
  if (out) fs::rename(temporary, file, failed);
  if (out && !failed) return;
  const int error_number = failed ? failed.value() : errno;
  fs::remove(temporary, failed);
  ThrowSystemError("cannot write", file, error_number);
}

std::string Sha256(const fs::path& file, const std::function<bool()>& stop) {
  std::ifstream in(file, std::ios::binary);
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(),
                                                                        EVP_MD_CTX_free);
  if (!in || !context || EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr) != 1) return "";
  std::vector<char> block(1 << 20);
  while (in) {
    if (stop && stop()) return "";
    in.read(block.data(), static_cast<std::streamsize>(block.size()));
    EVP_DigestUpdate(context.get(), block.data(), static_cast<std::size_t>(in.gcount()));
  }
  if (in.bad()) return "";
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned length = 0;
  EVP_DigestFinal_ex(context.get(), digest, &length);
  std::string text;
  for (unsigned i = 0; i < length; ++i) text += fmt::format("{:02x}", digest[i]);
  return text;
}

namespace {

std::string JsonText(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20) {
      out += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    } else {
      out += c;
    }
  }
  return out + '"';
}

}  // namespace

std::string DescribeInputs(const std::vector<fs::path>& inputs, const std::function<bool()>& stop) {
  std::vector<std::string> entries(inputs.size());
  tbb::parallel_for(std::size_t{0}, inputs.size(), [&](std::size_t i) {
    std::error_code failed;
    const auto size = fs::file_size(inputs[i], failed);
    entries[i] =
        fmt::format("{{\"path\": {}, \"size\": {}, \"sha256\": \"{}\"}}",
                    JsonText(inputs[i].string()), failed ? 0 : size, Sha256(inputs[i], stop));
  });
  std::string json = "[";
  for (std::size_t i = 0; i < entries.size(); ++i) json += (i > 0 ? ",\n " : "") + entries[i];
  return json + "]";
}

std::string TimestampNow() {
  const auto now = std::chrono::system_clock::now();
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}",
                     fmt::gmtime(std::chrono::system_clock::to_time_t(now)));
}

}  // namespace plumbline::internal
