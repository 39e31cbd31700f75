#pragma once

#include <filesystem>
#include <memory>

#include "calib/image.h"

namespace plumbline {

// Writes a grey PNG of 8 or 16 bits a sample; of more than 8 significant bits the number is stated
// (sBIT), so that ReadImage() gives the same image back. Written to a temporary name and renamed.
// Throws EnvironmentError naming the file.
void WritePng(const std::filesystem::path& file, const GrayImage& image);

// A lossless grey video: FFV1 in a Matroska (.mkv) or AVI (.avi) file, 8 bits.
class VideoWriter {
 public:
  // Throws UsageError on a rate that videos cannot have: for asking before there is a file.
  static void CheckRate(double frames_per_second);

  // Throws UsageError on another ending or as CheckRate(), EnvironmentError when the file cannot be
  // made.
  VideoWriter(const std::filesystem::path& file, ImageSize size, double frames_per_second);
  ~VideoWriter();

  // Throws std::invalid_argument when the image has another size, UsageError when it has more than
  // 8 bits.
  void Add(const GrayImage& image);

  // Finishes the file. Throws EnvironmentError when it does not hold what was added.
  void Close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
