#include "io/version.h"

#include "plumbline_build_version.h"

namespace plumbline {

std::string SoftwareVersion() {
  const std::string commit = PLUMBLINE_COMMIT;
  return std::string("plumbline ") + PLUMBLINE_VERSION +
         (commit.empty() ? "" : " (commit " + commit + ")");
}

}  // namespace plumbline
