#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <vector>

namespace plumbline::internal {

// Records that are on the disk before Append() returns. Each is a head (magic, index, payload's
// size, payload's CRC-32, head's CRC-32) and a payload; whatever follows the last whole record is
// what a killed process was writing.
class JournalWriter {
 public:
  // Creates the file, which must not exist, and locks it for the life of the object. Throws
  // EnvironmentError.
  explicit JournalWriter(const std::filesystem::path& file);
  ~JournalWriter();
  JournalWriter(const JournalWriter&) = delete;
  JournalWriter& operator=(const JournalWriter&) = delete;

  // Throws EnvironmentError; the file then ends with the previous record.
  void Append(std::span<const std::uint8_t> payload);

 private:
  std::filesystem::path file_;
  int fd_ = -1;
  std::uint64_t index_ = 0;
  std::int64_t size_ = 0;
};

class JournalReader {
 public:
  // Throws InputError where the file cannot be opened or another process is writing it.
  JournalReader(const std::filesystem::path& file, bool lock);
  ~JournalReader();
  JournalReader(const JournalReader&) = delete;
  JournalReader& operator=(const JournalReader&) = delete;

  // The next whole record; nothing at the end or where the rest is no whole record.
  std::optional<std::vector<std::uint8_t>> Next();
  void Rewind();
  std::int64_t position() const { return position_; }  // end of the last whole record
  std::int64_t size() const { return size_; }

 private:
  bool ReadExactly(void* to, std::size_t count);

  std::filesystem::path file_;
  int fd_ = -1;
  std::uint64_t index_ = 0;
  std::int64_t position_ = 0;
  std::int64_t size_ = 0;
};

}  // namespace plumbline::internal
