#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <vector>

namespace plumbline::internal {

// Where a record begins.
struct JournalPlace {
  std::uint64_t index = 0;  // of the record
  std::int64_t offset = 0;  // in the file
};

// Records that are on the disk before Append() returns. Each is a head (magic, index, payload's
// size, payload's CRC-32, head's CRC-32) and a payload; whatever follows the last whole record is
// what a killed process was writing.
class JournalWriter {
 public:
  // Creates the file, which must not exist, and locks it for the life of the object. Throws
  // EnvironmentError.
  explicit JournalWriter(const std::filesystem::path& file);
  // Goes on behind the last whole record of a file, cutting off what follows it, and locks it.
  // visit: called with each record that is there. Throws InputError where the file cannot be opened
  // or another process is writing it, EnvironmentError.
  JournalWriter(const std::filesystem::path& file,
                const std::function<void(std::span<const std::uint8_t> payload)>& visit);
  ~JournalWriter();
  JournalWriter(const JournalWriter&) = delete;
  JournalWriter& operator=(const JournalWriter&) = delete;

  // Throws EnvironmentError; the file then ends with the previous record.
  void Append(std::span<const std::uint8_t> payload);

  JournalPlace end() const { return {index_, size_}; }

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
  // Begins at a place that JournalWriter::end() gave.
  JournalReader(const std::filesystem::path& file, const JournalPlace& begin);
  ~JournalReader();
  JournalReader(const JournalReader&) = delete;
  JournalReader& operator=(const JournalReader&) = delete;

  // The next whole record; nothing at the end or where the rest is no whole record.
  std::optional<std::vector<std::uint8_t>> Next();
  std::int64_t position() const { return position_; }  // end of the last whole record
  std::int64_t size() const { return size_; }
  std::uint64_t index() const { return index_; }  // of the next record
  // Whether Next() gave nothing because the file ends within a record, or at the end of one.
  bool at_end() const { return at_end_; }

 private:
  bool ReadExactly(void* to, std::size_t count);

  std::filesystem::path file_;
  int fd_ = -1;
  std::uint64_t index_ = 0;
  std::int64_t position_ = 0;
  std::int64_t size_ = 0;
  bool at_end_ = false;
};

}  // namespace plumbline::internal
