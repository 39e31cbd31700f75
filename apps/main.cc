#include <malloc.h>

#include <string>
#include <vector>

#include "apps/command_line.h"

int main(int argc, char** argv) {
  // Images are made and dropped with every frame. Memory that the process keeps need not be mapped,
  // zeroed and unmapped again each time.
  constexpr int kKept = 32 << 20;  // bytes: the most that glibc takes
  mallopt(M_MMAP_THRESHOLD, kKept);
  mallopt(M_TRIM_THRESHOLD, 8 * kKept);
  return plumbline::RunCommandLine(std::vector<std::string>(argv + 1, argv + argc));
}
