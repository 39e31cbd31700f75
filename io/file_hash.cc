#include "io/file_hash.h"

#include "io/internal/durable_file.h"

namespace plumbline {

std::string FileSha256(const std::filesystem::path& file) { return internal::Sha256(file); }

}  // namespace plumbline
