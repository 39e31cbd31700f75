#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"
#include "io/internal/bytes.h"

// How a series holds values of points, whatever these are: which datasets there are, how they are
// cut into chunks, and how a frame's chunks lie in the journal. The tables of what the kinds of
// series hold are in series_layout.h (stereo) and planar_layout.h.
namespace plumbline::internal {

// The axis of a point field's components: a dataset of names in the field's group.
struct ComponentAxis {
  std::string_view name;  // empty: the field has one component and no such axis
  std::span<const std::string_view> labels;

  std::size_t count() const { return labels.empty() ? 1 : labels.size(); }
};
inline constexpr ComponentAxis kOneNumber{"", {}};

// What of a point a field holds.
enum class PointPart : std::uint8_t {
  kValue,
  kRandom,
  kCalibration,
  kCombined,
  kPrincipal,
  kPrincipalRandom,
  kPrincipalCalibration,
  kPrincipalCombined,
  kPrincipalAngle,
  kPrincipalAngleRandom,
  kPrincipalAngleCalibration,
  kPrincipalAngleCombined,
  kMaxShear,
  kMaxShearRandom,
  kMaxShearCalibration,
  kMaxShearCombined,
  kVonMises,
  kVonMisesRandom,
  kVonMisesCalibration,
  kVonMisesCombined,
  kCovariance,
  kCorrelation,
  kEpipolar,
  kGradient,
  kGradientRandom,
  kGradientCovariance,
  kIterations,
  kStatus,
  // Of the match in the right image, and how much of a match's variance the reference image has.
  kRightValue,
  kRightGradient,
  kRightCovariance,
  kShare,
  kRightShare,
  // Of a strain gauge that each point has for itself.
  kModel,
  kWindow,
};

enum class PointType : std::uint8_t { kFloat, kDouble, kByte, kStatus };
std::size_t BytesOf(PointType type);

// A group that holds a vector a point, with its sigmas.
struct PointGroupFacts {
  std::string_view path;
  std::string_view signal;  // the dataset of the vectors
  std::string_view what;    // they are
  std::uint32_t needs;      // bits of the contents, all of them; 0: every series holds it
  bool in_surface_frame;    // their components are along the axes of Surface::frame
  // It has a status of its own, and its vectors are numbers exactly where that is ok. Else it goes
  // by the status of the group before it, and its vectors may be missing where that is ok.
  bool has_status;
  // Its vectors are where they are, whatever any status says.
  bool free = false;
  // A frame without a surface may hold them too.
  bool in_any_frame = false;
};

// A dataset that holds one value or vector a point.
struct PointField {
  std::uint8_t group;  // place in the layout's groups
  PointPart part;
  std::string_view path;
  const ComponentAxis* axis;
  std::string_view units;
  std::string_view long_name;
  std::uint32_t needs = 0;  // as above
  PointType type = PointType::kFloat;
  std::string_view also = {};    // a second link to the dataset; empty: none
  std::int64_t since = 1;        // version of the format
  std::string_view before = {};  // its path in version 1; empty: the same
  bool optional = false;         // a frame may have none, though it has the group's vectors

  std::string Path() const { return std::string(path); }
  // Where a file of that version has it; empty: it does not.
  std::string PathIn(std::int64_t version) const {
    if (version < since) return "";
    return std::string(version < 2 && !before.empty() ? before : path);
  }
};

// All that a kind of series holds of points, in the order of the file.
struct PointLayout {
  std::string_view what;  // of a frame they make up
  std::span<const PointGroupFacts> groups;
  std::span<const PointField> fields;

  // Throws std::logic_error if there is none.
  const PointField& FieldOf(std::uint8_t group, PointPart part) const;
};

// needs: bits of the contents, all of them; 0: every series holds it.
inline bool Holds(std::uint32_t content_bits, std::uint32_t needs) {
  return (content_bits & needs) == needs;
}

// Size of the grid, how it is cut (a chunk holds `band_rows` rows of one frame), and what is held.
// The journal begins with one.
struct SeriesShape {
  std::int32_t rows = 0;
  std::int32_t columns = 0;
  std::int32_t band_rows = 1;
  std::uint32_t content_bits = 0;  // by the place in the table of optional contents

  ImageSize grid() const { return {columns, rows}; }
  int bands() const { return (rows + band_rows - 1) / band_rows; }
  std::size_t ChunkBytes(const PointField& field) const;

  // Chunks of `field` are of about 1 MiB at most, what HDF5's default cache holds. Throws
  // std::invalid_argument where the grid is empty.
  static SeriesShape For(ImageSize grid, std::uint32_t content_bits, const PointField& field);
};

// The values of one frame's points.
class PointSource {
 public:
  virtual ~PointSource() = default;

  // The size of the image that the field's values come from; empty: the frame has none.
  virtual ImageSize SizeOf(const PointField& field) const = 0;

  // Those of points first to last - 1, in row order, as the field's type lies in memory. Called by
  // many threads at once.
  virtual void Gather(const PointField& field, std::size_t first, std::size_t last,
                      std::uint8_t* to) const = 0;
};

// Places in layout.fields of what a frame holds; without a surface, of the groups that may be in
// any frame. Throws std::invalid_argument where that is not of the grid's size.
std::vector<std::size_t> FieldsOf(const PointLayout& layout, const SeriesShape& shape,
                                  const PointSource& source, bool has_surface = true);

// A compressed HDF5 chunk (shuffle, deflate level 1), ready to be copied into the file.
struct PointChunk {
  std::size_t field = 0;  // place in PointLayout::fields
  int band = 0;
  std::span<const std::uint8_t> bytes;
};

// One frame as the journal keeps it.
template <typename Frame>
struct FrameRecord {
  Frame frame;  // holds no images
  bool has_points = false;
  std::vector<PointChunk> chunks;
};

// Compresses these fields with all threads; the bytes do not depend on their number.
void PutChunks(ByteWriter& out, const PointLayout& layout, const SeriesShape& shape,
               const std::vector<std::size_t>& fields, const PointSource& source);

// They point into what `in` reads. Throws std::runtime_error on what PutChunks() did not write.
std::vector<PointChunk> GetChunks(ByteReader& in, const PointLayout& layout,
                                  const SeriesShape& shape);

}  // namespace plumbline::internal
