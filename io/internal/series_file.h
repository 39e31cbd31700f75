#pragma once

#include <fmt/format.h>

#include <cstring>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "calib/error.h"
#include "calib/image.h"
#include "calib/status.h"
#include "io/internal/hdf5.h"
#include "io/internal/series_datasets.h"
#include "io/series_frame.h"

namespace plumbline::internal {

// A frame of 16 384 by 16 384 points, three numbers each, is the largest that is read.
inline constexpr hsize_t kMaxFrameElements = hsize_t{3} << 28;
inline constexpr hsize_t kMaxFrames = 100'000'000;

// A series of either kind that is open for reading. Its members throw hdf5::Error on what is
// missing or wrong in the file: call them within Reading().
//
// Not thread-safe.
class SeriesFile {
 public:
  enum class Kind : std::uint8_t { kStereo, kPlanar };

  // Throws InputError naming the file where there is none, or one of another format or kind.
  SeriesFile(const std::filesystem::path& path, Kind kind);

  hid_t id() const { return file_.get(); }
  const SeriesFacts& facts() const { return facts_; }

  // Runs a reader; what is wrong becomes an InputError that says which file it was.
  template <typename Read>
  auto Reading(const Read& read) const {
    const auto refuse = [&](const char* reason) {
      return InputError(fmt::format("{} cannot be read as a series: {}", path_.string(), reason));
    };
    try {
      return read();
    } catch (const hdf5::Error& error) {
      throw refuse(error.what());
    } catch (const std::invalid_argument& error) {  // impossible camera parameters
      throw refuse(error.what());
    }
  }

  GridFacts ReadGrid() const;

  // A column of one-byte values.
  std::vector<std::uint8_t> ReadEnum(const std::string& name) const;

  // Throws hdf5::Error where they are not all of the length n.
  static void CheckLengths(const std::string& group, std::size_t n,
                           std::initializer_list<std::size_t> lengths);

  template <typename T>
  std::vector<T> Slab(const std::string& name, std::size_t i) const {
    return hdf5::ReadSlab<T>(hdf5::OpenDataset(id(), name), i, kMaxFrameElements);
  }

  // Frame i of a dataset of points; all of one that is of no frame.
  template <typename Element, typename Scalar>
  Image<Element> Points(const std::string& name, std::optional<std::size_t> i,
                        ImageSize size) const {
    return ToImage<Element>(size,
                            i ? Slab<Scalar>(name, *i)
                              : hdf5::ReadArray<Scalar>(id(), name, nullptr, kMaxFrameElements));
  }
  Image<std::uint8_t> Bytes(const std::string& name, std::optional<std::size_t> i,
                            ImageSize size) const;
  Image<Status> Statuses(const std::string& name, std::optional<std::size_t> i,
                         ImageSize size) const;

 private:
  template <typename Element, typename Scalar>
  static Image<Element> ToImage(ImageSize size, const std::vector<Scalar>& values) {
    Element zero{};
    if constexpr (std::is_class_v<Element>) zero.setZero();
    Image<Element> image(size, zero);
    if (values.size() * sizeof(Scalar) != image.pixel_count() * sizeof(Element)) {
      throw hdf5::Error("a dataset of points is not of the grid's size");
    }
    if (!values.empty()) {
      std::memcpy(static_cast<void*>(image.data()), values.data(), values.size() * sizeof(Scalar));
    }
    return image;
  }

  void Open(Kind kind);

  std::filesystem::path path_;
  hdf5::Id file_;
  SeriesFacts facts_;
};

}  // namespace plumbline::internal
