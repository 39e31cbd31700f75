#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace plumbline {

// Width (columns) and height (rows) in pixels.
struct ImageSize {
  int width = 0;
  int height = 0;
  friend bool operator==(const ImageSize&, const ImageSize&) = default;
};

// A dense image, row-major, no padding. Pixel (0, 0) is the top-left one and its centre has the
// coordinates (0, 0); x is the column and grows to the right, y is the row and grows downwards.
template <typename T>
class Image {
 public:
  Image() = default;
  explicit Image(ImageSize size, T value = T{})
      : size_(size),
        data_(static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height), value) {
  }

  int width() const { return size_.width; }
  int height() const { return size_.height; }
  ImageSize size() const { return size_; }
  bool empty() const { return data_.empty(); }

  T& operator()(int row, int column) { return data_[Index(row, column)]; }
  const T& operator()(int row, int column) const { return data_[Index(row, column)]; }

  T* row(int r) { return data_.data() + Index(r, 0); }
  const T* row(int r) const { return data_.data() + Index(r, 0); }
  T* data() { return data_.data(); }
  const T* data() const { return data_.data(); }
  std::size_t pixel_count() const { return data_.size(); }

  std::vector<T>& values() { return data_; }
  const std::vector<T>& values() const { return data_; }

 private:
  std::size_t Index(int row, int column) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(size_.width) +
           static_cast<std::size_t>(column);
  }

  ImageSize size_;
  std::vector<T> data_;
};

// A monochrome photograph of 8 to 16 significant bits; grey levels run from 0 to 2^bits - 1.
struct GrayImage {
  Image<std::uint16_t> grey;
  int bits = 8;

  ImageSize size() const { return grey.size(); }
  int width() const { return grey.width(); }
  int height() const { return grey.height(); }
  int max_level() const { return (1 << bits) - 1; }
};

}  // namespace plumbline
