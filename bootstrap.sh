#!/usr/bin/env bash
# Everything from a fresh Debian 12: packages, build, demo, tests. Run without arguments for the list.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

# The one list of packages that the build, the tests and the program need.
packages=(
  build-essential cmake ninja-build pkg-config git ca-certificates ccache
  libeigen3-dev libmrcal-dev libceres-dev libsuitesparse-dev libopencv-dev libopencv-contrib-dev libapriltag-dev libpcl-dev
  libhdf5-dev libflann-dev libtbb-dev libcli11-dev libtomlplusplus-dev libspdlog-dev libfmt-dev libpugixml-dev libzip-dev
  libhwy-dev libfftw3-dev
  libpng-dev libjpeg-dev libtiff-dev libdeflate-dev libcsv-dev nlohmann-json3-dev libssl-dev
  libgtest-dev libgmock-dev libbenchmark-dev
  python3 python3-numpy python3-h5py python3-mrcal mrcal python3-opencv python3-vtk9
  clang-format clang-tidy
)
build=${PLUMBLINE_BUILD:-build}

usage() {
  cat <<'TEXT'
usage: ./bootstrap.sh COMMAND

  demo      install the packages, build, run the whole story, and say where its results are
  test      the same, then run all tests; ends with one line 'N passed, N failed'
  build     install the packages and build
  bench     build and run the benchmarks
  prove     build and run the long Monte-Carlo proofs of the error bars
  sanitize  build with ASan and UBSan and run the tests
  lint      clang-tidy on the source files that differ from the last commit (all with 'lint all')

Build folder: build, or $PLUMBLINE_BUILD. Needs root or sudo to install packages.
TEXT
}

install_packages() {
  local missing=()
  for package in "${packages[@]}"; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
  done
  if [ ${#missing[@]} -eq 0 ]; then return; fi
  local as_root=()
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || { echo "packages are missing (${missing[*]}) and this is neither root nor is there sudo" >&2; exit 4; }
    as_root=(sudo)
  fi
  echo "installing ${#missing[@]} packages"
  "${as_root[@]}" apt-get update -qq
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

configure_and_build() {  # build folder, CMake arguments...
  local folder=$1
  shift
  export CCACHE_DEPEND=1  # the compiler's own list of headers: a file that is not in the cache is preprocessed once, not twice
  cmake -S . -B "$folder" -G Ninja -DCMAKE_CXX_COMPILER_LAUNCHER=ccache "$@" >/dev/null
  cmake --build "$folder"
}

demo() { "$build/plumbline" demo -o "$build/demo"; }

run_tests() {  # build folder, ctest arguments...
  local folder=$1
  shift
  local report=$folder/tests.xml status=0
  ctest --test-dir "$folder" -j2 --output-on-failure --output-junit tests.xml "$@" || status=$?
  local total failed skipped
  total=$(grep -om1 'tests="[0-9]*"' "$report" | tr -dc 0-9)
  failed=$(grep -om1 'failures="[0-9]*"' "$report" | tr -dc 0-9)
  skipped=$(grep -om1 'skipped="[0-9]*"' "$report" | tr -dc 0-9)
  local line="$((total - failed - skipped)) passed, $failed failed"
  if [ "$skipped" -gt 0 ]; then line+=", $skipped skipped"; fi
  echo "$line"
  return "$status"
}

case ${1:-} in
  build)
    install_packages
    configure_and_build "$build" -DPLUMBLINE_TESTS=OFF
    ;;
  demo)
    install_packages
    configure_and_build "$build" -DPLUMBLINE_TESTS=OFF
    demo
    ;;
  test)
    install_packages
    configure_and_build "$build" -DPLUMBLINE_TESTS=ON
    demo
    run_tests "$build"
    ;;
  bench)
    install_packages
    configure_and_build "$build" -DPLUMBLINE_TESTS=ON -DPLUMBLINE_BENCH=ON
    "$build/tests/bench/plumbline_bench" "${@:2}"
    ;;
  prove)
    install_packages
    configure_and_build "$build" -DPLUMBLINE_TESTS=ON
    PLUMBLINE_PROVE=1 run_tests "$build" -R Prove "${@:2}"
    ;;
  sanitize)
    install_packages
    configure_and_build "$build-sanitize" -DPLUMBLINE_TESTS=ON -DPLUMBLINE_SANITIZE=address,undefined \
      -DCMAKE_CXX_FLAGS_RELEASE="-O1 -DNDEBUG"
    # A garbled HDF5 file makes libhdf5 ask for absurd amounts of memory: it must get none, as without the sanitizer.
    ASAN_OPTIONS=allocator_may_return_null=1 LSAN_OPTIONS=suppressions=$PWD/tests/support/leaks.supp \
      UBSAN_OPTIONS=print_stacktrace=1 run_tests "$build-sanitize" "${@:2}"
    ;;
  lint)
    install_packages
    configure_and_build "$build" -DPLUMBLINE_TESTS=ON
    if [ "${2:-}" = all ]; then files=$(git ls-files '*.cc'); else files=$(git diff --name-only HEAD -- '*.cc'); fi
    if [ -z "$files" ]; then echo "no source file differs from the last commit"; exit 0; fi
    echo "$files" | xargs -P "$(nproc)" -n 1 clang-tidy -p "$build" --quiet --warnings-as-errors='*'
    ;;
  *)
    usage
    exit 2
    ;;
esac
