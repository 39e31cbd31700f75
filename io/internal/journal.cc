#include "io/internal/journal.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <libdeflate.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstring>

#include "calib/error.h"
#include "io/internal/durable_file.h"

namespace plumbline::internal {
namespace {

constexpr std::uint32_t kMagic = 0x4a424c50;  // "PLBJ"

struct Head {
  std::uint32_t magic = kMagic;
  std::uint32_t payload_crc = 0;
  std::uint64_t index = 0;
  std::uint64_t payload_size = 0;
  std::uint32_t head_crc = 0;  // of everything above
  std::uint32_t reserved = 0;
};
static_assert(sizeof(Head) == 32);

std::uint32_t Crc(std::span<const std::uint8_t> bytes) {
  return libdeflate_crc32(0, bytes.data(), bytes.size());
}

std::uint32_t HeadCrc(const Head& head) {
  return Crc({reinterpret_cast<const std::uint8_t*>(&head), offsetof(Head, head_crc)});
}

// 0, or the system's error number.
int WriteAll(int fd, const void* from, std::size_t count) {
  const auto* bytes = static_cast<const char*>(from);
  while (count > 0) {
    const ssize_t n = write(fd, bytes, count);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return errno;
    bytes += n;
    count -= static_cast<std::size_t>(n);
  }
  return 0;
}

// Throws InputError where that fails or another process has it locked.
int OpenLocked(const std::filesystem::path& file, int flags, bool lock) {
  const int fd = open(file.c_str(), flags | O_CLOEXEC);
  if (fd < 0) {
    throw InputError(fmt::format("cannot open {}: {}", file.string(), std::strerror(errno)));
  }
  if (lock && flock(fd, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    close(fd);
    throw InputError(
        fmt::format("{} is being written by a run that is still going on; wait for "
                    "its end, or stop it first",
                    file.string()));
  }
  return fd;
}

}  // namespace

JournalWriter::JournalWriter(const std::filesystem::path& file) : file_(file) {
  fd_ = open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (fd_ < 0) ThrowSystemError("cannot create", file, errno);
  flock(fd_, LOCK_EX | LOCK_NB);
}

JournalWriter::JournalWriter(
    const std::filesystem::path& file,
    const std::function<void(std::span<const std::uint8_t> payload)>& visit)
    : file_(file) {
  fd_ = OpenLocked(file, O_RDWR, true);
  try {
    JournalReader reader(file, false);
    while (const auto payload = reader.Next()) visit(*payload);
    index_ = reader.index();
    size_ = reader.position();
    if (ftruncate(fd_, size_) != 0 || lseek(fd_, size_, SEEK_SET) < 0 || fsync(fd_) != 0) {
      ThrowSystemError("cannot go on with", file, errno);
    }
  } catch (...) {
    close(fd_);
    throw;
  }
}

JournalWriter::~JournalWriter() { close(fd_); }

void JournalWriter::Append(std::span<const std::uint8_t> payload) {
  Head head;
  head.index = index_;
  head.payload_size = payload.size();
  head.payload_crc = Crc(payload);
  head.head_crc = HeadCrc(head);
  int error_number = WriteAll(fd_, &head, sizeof head);
  if (error_number == 0) error_number = WriteAll(fd_, payload.data(), payload.size());
  if (error_number == 0 && fdatasync(fd_) != 0) error_number = errno;
  if (error_number != 0) {
    // Half a record must not stay before the next one. If even this fails, a reader stops here.
    if (ftruncate(fd_, size_) == 0) lseek(fd_, size_, SEEK_SET);
    ThrowSystemError("cannot write to", file_, error_number);
  }
  ++index_;
  size_ += static_cast<std::int64_t>(sizeof head + payload.size());
}

JournalReader::JournalReader(const std::filesystem::path& file, bool lock) : file_(file) {
  fd_ = OpenLocked(file, O_RDONLY, lock);
  struct stat facts {};
  fstat(fd_, &facts);
  size_ = facts.st_size;
}

JournalReader::JournalReader(const std::filesystem::path& file, const JournalPlace& begin)
    : JournalReader(file, false) {
  lseek(fd_, begin.offset, SEEK_SET);
  index_ = begin.index;
  position_ = begin.offset;
}

JournalReader::~JournalReader() { close(fd_); }

bool JournalReader::ReadExactly(void* to, std::size_t count) {
  auto* bytes = static_cast<char*>(to);
  while (count > 0) {
    const ssize_t n = read(fd_, bytes, count);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    bytes += n;
    count -= static_cast<std::size_t>(n);
  }
  return true;
}

std::optional<std::vector<std::uint8_t>> JournalReader::Next() {
  Head head;
  at_end_ = !ReadExactly(&head, sizeof head);
  if (at_end_ || head.magic != kMagic || head.head_crc != HeadCrc(head) || head.index != index_) {
    return std::nullopt;
  }
  at_end_ = head.payload_size > static_cast<std::uint64_t>(size_ - position_) - sizeof head;
  if (at_end_) return std::nullopt;
  std::vector<std::uint8_t> payload(head.payload_size);
  if (!ReadExactly(payload.data(), payload.size()) || Crc(payload) != head.payload_crc) {
    return std::nullopt;
  }
  ++index_;
  position_ += static_cast<std::int64_t>(sizeof head + payload.size());
  return payload;
}

}  // namespace plumbline::internal
