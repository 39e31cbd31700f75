#include "io/internal/table_file.h"

#include <cerrno>
#include <fstream>

#include "io/internal/durable_file.h"

namespace plumbline::internal {

void WriteTableFile(const std::filesystem::path& file,
                    const std::function<void(std::ostream&)>& write) {
  WriteDurably(file, [&](const std::filesystem::path& temporary) {
    std::ofstream out(temporary, std::ios::binary);
    if (out) write(out);
    out.close();
    if (!out) ThrowSystemError("cannot write", file, errno);
  });
}

}  // namespace plumbline::internal
