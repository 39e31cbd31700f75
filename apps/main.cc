#include <string>
#include <vector>

#include "apps/command_line.h"

int main(int argc, char** argv) {
  return plumbline::RunCommandLine(std::vector<std::string>(argv + 1, argv + argc));
}
