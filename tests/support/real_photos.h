#pragma once

#include <algorithm>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "calib/internal/opencv_image.h"
#include "tests/support/shared_data.h"

namespace plumbline::testing {

// The files of a folder with an ending, sorted by name.
inline std::vector<std::filesystem::path> PhotosIn(const std::filesystem::path& folder,
                                                   const std::string& extension) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() == extension) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

inline GrayImage ReadPhoto(const std::filesystem::path& file) {
  return internal::FromMat(cv::imread(file.string(), cv::IMREAD_GRAYSCALE | cv::IMREAD_ANYDEPTH),
                           16);
}

}  // namespace plumbline::testing
