#pragma once

#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/internal/hdf5.h"

namespace plumbline::internal {

// Arrays of a file that is written in one go, each with its units and the scales of its dimensions.
class ArrayWriter {
 public:
  explicit ArrayWriter(hid_t file) : file_(file) {}

  // An axis of its own.
  template <typename T>
  void Scale(const std::string& path, const std::string& units, const std::string& long_name,
             const std::vector<T>& values) {
    const hdf5::Id dataset =
        hdf5::WriteArray<T>(file_, {path, units, long_name, {values.size()}, {}}, values);
    hdf5::MakeScale(dataset, path.substr(path.rfind('/') + 1));
  }

  // scales: one a dimension; "": the plain index.
  template <typename T>
  void Array(const std::string& path, const std::string& units, const std::string& long_name,
             const hdf5::Shape& shape, std::span<const T> values,
             std::vector<std::string> scales = {}, const hdf5::Shape& chunk = {}) {
    const hdf5::Id dataset =
        hdf5::WriteArray<T>(file_, {path, units, long_name, shape, chunk}, values);
    scales.resize(shape.size());
    for (std::size_t d = 0; d < shape.size(); ++d) {
      if (scales[d].empty()) scales[d] = hdf5::IndexScale(file_, shape[d]);
    }
    hdf5::AttachScales(file_, dataset, scales);
  }
  void Doubles(const std::string& path, const std::string& units, const std::string& long_name,
               const hdf5::Shape& shape, const std::vector<double>& values,
               const std::vector<std::string>& scales = {}) {
    Array<double>(path, units, long_name, shape, values, scales);
  }
  void Number(const std::string& path, const std::string& units, const std::string& long_name,
              double value) {
    Doubles(path, units, long_name, {}, {value});
  }

 private:
  hid_t file_;
};

// Throws hdf5::Error where the array has another size.
inline std::vector<double> ReadDoubles(hid_t file, const std::string& path,
                                       const hdf5::Shape& shape) {
  hdf5::Shape found;
  auto values = hdf5::ReadArray<double>(file, path, &found);
  if (found != shape) throw hdf5::Error(path + " does not have the size that it should");
  return values;
}

}  // namespace plumbline::internal
