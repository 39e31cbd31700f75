#include "io/virtual_rig/board_albedo.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "io/virtual_rig/internal/board_ink.h"

namespace plumbline {
namespace {

using internal::EdgeRamp;
using internal::NearestInt;
using internal::Shade;
using Kind = BoardSpec::Kind;

// From a disc to the nearest others.
double DiscDistance(const BoardSpec& spec) {
  return spec.pitch_mm * (spec.kind == Kind::kAsymmetricCircles ? std::numbers::sqrt2 : 1);
}

// A corner disc must have twice the area of the others also where perspective makes it smaller.
constexpr double kBigDisc = 1.8;

struct Box {
  Eigen::Vector2d low, high;
};

// The patterns: the ink at a place of the sheet.

// Black and white squares around columns x rows inner corners, the first corner at the origin; the
// square between the first four is black.
struct CheckerInk {
  double pitch;
  int columns, rows;
  EdgeRamp ramp;

  struct Along {
    double wave;    // +1 and -1 in turn
    double inside;  // of the outermost edges
    double same_mm;
  };
  Along Look(double x, int count) const {
    const int line = std::clamp(NearestInt(x / pitch), 0, count - 1);
    const double from_line = x - line * pitch;
    const double from_end = std::min(x + pitch, count * pitch - x);
    const double side = 2 * ramp(from_line) - 1;
    return {line % 2 == 0 ? side : -side, ramp(from_end),
            std::min(ramp.Clear(from_line), ramp.Clear(from_end))};
  }

  Shade operator()(const Eigen::Vector2d& p) const {
    const Along x = Look(p.x(), columns), y = Look(p.y(), rows);
    return {(0.5 + 0.5 * x.wave * y.wave) * x.inside * y.inside, std::min(x.same_mm, y.same_mm)};
  }
};

struct DiscInk {
  double pitch;
  int columns, rows;
  bool staggered;
  double radius, hole;
  std::array<int, 3> rings;
  int big;  // id, or -1
  EdgeRamp ramp;

  // From a place to where another disc is looked at; the outermost ones are for all beyond too.
  static double ToNext(double from_centre, double half) {
    const double d = std::abs(from_centre);
    return d <= half ? half - d : half + d;
  }

  // No disc is wider than a pitch, so only the one of the nearest row and column can cover a place.
  Shade operator()(const Eigen::Vector2d& p) const {
    const int r = std::clamp(NearestInt(p.y() / pitch), 0, rows - 1);
    const int shift = staggered ? r % 2 : 0, stretch = staggered ? 2 : 1;
    const int c = std::clamp(NearestInt((p.x() / pitch - shift) / stretch), 0, columns - 1);
    const Eigen::Vector2d from = p - Eigen::Vector2d((stretch * c + shift) * pitch, r * pitch);
    const double distance = from.norm();
    const int id = r * columns + c;
    const double within = (id == big ? kBigDisc * radius : radius) - distance;
    Shade ink{ramp(within), std::min({ramp.Clear(within), ToNext(from.x(), stretch * pitch / 2),
                                      ToNext(from.y(), pitch / 2)})};
    if (id != big && (id == rings[0] || id == rings[1] || id == rings[2])) {
      ink.share *= ramp(distance - hole);
      ink.same_mm = std::min(ink.same_mm, ramp.Clear(distance - hole));
    }
    return ink;
  }
};

struct CharucoInk {
  CheckerInk checker;
  internal::MarkerBits bits;
  std::vector<int> marker_of_square;
  double module_mm, gap_mm;  // from a square's edge to its marker's

  Shade operator()(const Eigen::Vector2d& p) const {
    const Shade ink = checker(p);
    // The first square lies before the first inner corner.
    const int squares = checker.columns + 1;
    const int c = internal::FloorToInt(p.x() / checker.pitch) + 1;
    const int r = internal::FloorToInt(p.y() / checker.pitch) + 1;
    if (c < 0 || r < 0 || c >= squares || r > checker.rows) return ink;
    const int marker = marker_of_square[static_cast<std::size_t>(r * squares + c)];
    if (marker < 0) return ink;
    const double x = p.x() - (c - 1) * checker.pitch - gap_mm;
    const double y = p.y() - (r - 1) * checker.pitch - gap_mm;
    const Shade white = internal::MarkerWhite(bits, marker, module_mm, checker.ramp, x, y);
    return {std::max(ink.share, 1 - white.share), std::min(ink.same_mm, white.same_mm)};
  }
};

struct AprilGridInk {
  double side, gap;
  int columns, rows;
  internal::MarkerBits bits;
  double module_mm;
  EdgeRamp ramp;

  struct Along {
    int tag;       // the nearest
    double place;  // from its edge
    double on_tag, in_gap;
    double same_mm;
  };
  Along Look(double x, int count) const {
    const double step = side + gap;
    const int tag = std::clamp(NearestInt((x - side / 2) / step), 0, count - 1);
    const double place = x - tag * step;
    const double from_edge = std::min(place, side - place);
    const double from_end = std::min(x + gap, count * step - x);
    const double on_tag = ramp(from_edge);
    double same_mm = std::min(ramp.Clear(from_edge), ramp.Clear(from_end));
    if (from_edge > 0) same_mm = std::min(same_mm, ramp.ClearOfRow(place, module_mm));
    return {tag, place, on_tag, ramp(from_end) - on_tag, same_mm};
  }
  // Where all of the tag's border is behind.
  bool WithinBorder(double place) const {
    return place > 1.5 * module_mm && place < side - 1.5 * module_mm;
  }

  Shade operator()(const Eigen::Vector2d& p) const {
    const Along x = Look(p.x(), columns), y = Look(p.y(), rows);
    const double same_mm = std::min(x.same_mm, y.same_mm);
    if (WithinBorder(x.place) && WithinBorder(y.place)) {
      const int tag = (rows - 1 - y.tag) * columns + x.tag;  // numbered upwards
      const Shade white = internal::MarkerWhite(bits, tag, module_mm, ramp, x.place, y.place);
      return {1 - white.share, same_mm};
    }
    return {x.on_tag * y.on_tag + x.in_gap * y.in_gap, same_mm};
  }
};

// A sheet with a pattern on a background.
template <typename Ink>
class Sheet : public Albedo {
 public:
  Sheet(Ink ink, const Box& box, const BoardPrint& print)
      : ink_(std::move(ink)),
        box_(box),
        ramp_(print.edge_mm),
        reach_(print.edge_mm / 2),
        paper_(print.white_on_black ? print.black : print.white),
        ink_less_paper_(print.white_on_black ? print.white - print.black
                                             : print.black - print.white),
        background_(print.background) {}

  void Evaluate(std::span<const Eigen::Vector2d> material_mm,
                std::span<float> albedo) const override {
    if (material_mm.size() != albedo.size()) {
      throw std::invalid_argument("Albedo::Evaluate: spans of different sizes");
    }
    // A row of samples is much finer than the pattern: most stand where the last ones did, on one
    // patch of one shade.
    Eigen::Vector2d patch(0, 0);
    double patch_radius2 = -1;
    float shade = 0;
    for (std::size_t i = 0; i < albedo.size(); ++i) {
      // So put that NaN is on no patch.
      if (!((material_mm[i] - patch).squaredNorm() < patch_radius2)) {
        const Shade at = At(material_mm[i]);
        shade = static_cast<float>(at.share);
        patch = material_mm[i];
        patch_radius2 = at.same_mm > 0 ? at.same_mm * at.same_mm : -1;
      }
      albedo[i] = shade;
    }
  }

 private:
  Shade At(const Eigen::Vector2d& p) const {
    const double inside = std::min(
        {p.x() - box_.low.x(), box_.high.x() - p.x(), p.y() - box_.low.y(), box_.high.y() - p.y()});
    const double same_mm = ramp_.Clear(inside);
    // So put that NaN is outside.
    if (!(inside > -reach_) || !p.allFinite()) return {background_, same_mm};
    const Shade ink = ink_(p);
    const double sheet = paper_ + ink_less_paper_ * ink.share;
    if (inside < reach_) return {background_ + (sheet - background_) * ramp_(inside), 0};
    return {sheet, std::min(same_mm, ink.same_mm)};
  }

  Ink ink_;
  Box box_;
  EdgeRamp ramp_;
  double reach_;
  double paper_, ink_less_paper_, background_;
};

Box PatternBox(const BoardSpec& spec, const BoardPrint& print) {
  const double p = spec.pitch_mm;
  const Eigen::Vector2d counts(spec.columns, spec.rows);
  switch (spec.kind) {
    case Kind::kChessboard:
      return {{-p, -p}, counts * p};
    case Kind::kCharuco:
      return {{-p, -p}, (counts - Eigen::Vector2d(1, 1)) * p};
    case Kind::kAprilGrid: {
      const double gap = p * spec.spacing_ratio;
      return {{-gap, -gap}, counts * (p + gap)};
    }
    default: {
      Box box{{1e300, 1e300}, {-1e300, -1e300}};
      for (int id = 0; id < spec.PointCount(); ++id) {
        const Eigen::Vector2d centre = spec.NominalPoint(id).head<2>();
        const Eigen::Vector2d radius =
            Eigen::Vector2d::Constant(PrintedDiscRadius(spec, print, id));
        box.low = box.low.cwiseMin(centre - radius);
        box.high = box.high.cwiseMax(centre + radius);
      }
      return box;
    }
  }
}

Box SheetBox(const BoardSpec& spec, const BoardPrint& print) {
  const double square =
      spec.kind == Kind::kAprilGrid ? spec.pitch_mm * spec.spacing_ratio : spec.pitch_mm;
  const Eigen::Vector2d margin = Eigen::Vector2d::Constant(print.margin_mm.value_or(square));
  const Box pattern = PatternBox(spec, print);
  return {pattern.low - margin, pattern.high + margin};
}

BoardRectangle Corners(const Box& box) {
  return {box.low, {box.high.x(), box.low.y()}, box.high, {box.low.x(), box.high.y()}};
}

// The shortest distance between two edges of the pattern.
double FinestFeature(const BoardSpec& spec, const BoardPrint& print) {
  const double p = spec.pitch_mm;
  switch (spec.kind) {
    case Kind::kChessboard:
      return p;
    case Kind::kCharuco:
      return std::min(spec.marker_mm / internal::ModulesPerSide(spec), (p - spec.marker_mm) / 2);
    case Kind::kAprilGrid:
      return std::min(p / internal::ModulesPerSide(spec), p * spec.spacing_ratio);
    case Kind::kDonutDots:
      return p * print.disc_share * std::min(1 - print.hole_share, 2 * print.hole_share);
    default:
      return 2 * DiscDistance(spec) * print.disc_share;
  }
}

void CheckDiscs(const BoardSpec& spec, const BoardPrint& print) {
  if (!spec.HasDiscs()) {
    if (print.white_on_black) {
      throw UsageError(fmt::format("{} cannot be white on black: only discs can", spec.Word()));
    }
    return;
  }
  const double largest = print.disc_share * (print.big_corner_disc ? kBigDisc : 1);
  if (!(print.disc_share > 0) || !(largest + print.edge_mm / spec.pitch_mm < 0.5)) {
    throw UsageError(fmt::format(
        "a disc radius of {} pitches on {} is not above 0, or the discs touch{}", print.disc_share,
        spec.Word(), print.big_corner_disc ? "; the big corner disc needs less than 0.27" : ""));
  }
  if (!(print.hole_share > 0) || !(print.hole_share < 1)) {
    throw UsageError(
        fmt::format("a ring's hole of {} disc radii is not between 0 and 1", print.hole_share));
  }
}

}  // namespace

void BoardPrint::Check(const BoardSpec& spec) const {
  for (const double level : {black, white, background}) {
    if (!(level >= 0) || !(level <= 1)) {
      throw UsageError(fmt::format("a board's albedo of {} is not between 0 and 1", level));
    }
  }
  if (!(black < white)) {
    throw UsageError(
        fmt::format("a board's black of {} is not below its white of {}", black, white));
  }
  if (margin_mm && (!(*margin_mm >= 0) || !std::isfinite(*margin_mm))) {
    throw UsageError(fmt::format("a board's margin of {} mm is negative", *margin_mm));
  }
  if (big_corner_disc && spec.kind != Kind::kCircles) {
    throw UsageError(fmt::format("{} has no big corner disc: only circles boards do", spec.Word()));
  }
  CheckDiscs(spec, *this);
  const double finest = FinestFeature(spec, *this);
  if (!(edge_mm > 0) || !(edge_mm < finest)) {
    throw UsageError(fmt::format(
        "an edge width of {} mm on {} must be above 0 and below its finest feature of {:.3g} mm",
        edge_mm, spec.Word(), finest));
  }
}

BoardRectangle PatternOutline(const BoardSpec& spec, const BoardPrint& print) {
  return Corners(PatternBox(spec, print));
}

BoardRectangle BoardOutline(const BoardSpec& spec, const BoardPrint& print) {
  return Corners(SheetBox(spec, print));
}

double PrintedDiscRadius(const BoardSpec& spec, const BoardPrint& print, int id) {
  if (!spec.HasDiscs()) return 0;
  const bool big = print.big_corner_disc && id == (spec.rows - 1) * spec.columns;
  return DiscDistance(spec) * print.disc_share * (big ? kBigDisc : 1);
}

std::unique_ptr<const Albedo> MakeBoardAlbedo(const BoardSpec& spec, const BoardPrint& print) {
  print.Check(spec);
  const EdgeRamp ramp(print.edge_mm);
  const double p = spec.pitch_mm;
  const auto sheet = [&](auto ink) -> std::unique_ptr<const Albedo> {
    return std::make_unique<Sheet<decltype(ink)>>(std::move(ink), SheetBox(spec, print), print);
  };
  switch (spec.kind) {
    case Kind::kChessboard:
      return sheet(CheckerInk{p, spec.columns, spec.rows, ramp});
    case Kind::kCharuco:
      return sheet(CharucoInk{{p, spec.columns - 1, spec.rows - 1, ramp},
                              internal::ArucoBits(spec),
                              internal::MarkerOfSquare(spec),
                              spec.marker_mm / internal::ModulesPerSide(spec),
                              (p - spec.marker_mm) / 2});
    case Kind::kAprilGrid:
      return sheet(AprilGridInk{p, p * spec.spacing_ratio, spec.columns, spec.rows,
                                internal::KalibrTagBits(spec), p / internal::ModulesPerSide(spec),
                                ramp});
    default: {
      const double radius = DiscDistance(spec) * print.disc_share;
      const bool staggered = spec.kind == Kind::kAsymmetricCircles;
      DiscInk ink{
          p,  spec.columns, spec.rows, staggered, radius, radius * print.hole_share, {-1, -1, -1},
          -1, ramp};
      if (spec.kind == Kind::kDonutDots) {
        const DonutMarkers markers = MarkersOf(spec);
        ink.rings = {markers.origin, markers.along_x, markers.along_y};
      }
      if (print.big_corner_disc) ink.big = (spec.rows - 1) * spec.columns;
      return sheet(ink);
    }
  }
}

}  // namespace plumbline
