#include "io/virtual_rig/tag_albedo.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

#include "calib/detect_tags.h"
#include "calib/error.h"
#include "io/virtual_rig/internal/board_ink.h"

namespace plumbline {
namespace {

constexpr int kMargin = 1;  // modules of white around a tag

// Where the tags lie, and how large their modules are.
struct Layout {
  Layout(const MaterialDomain& domain, const WheelTagOptions& options)
      : begin(domain.u_min),
        step((domain.u_max - domain.u_min) / options.count),
        count(options.count),
        lateral(options.lateral_mm) {}

  Eigen::Vector2d Centre(int id) const {
    return {begin + (id + 0.5) * step, id % 2 == 0 ? lateral : -lateral};
  }

  double begin, step;
  int count;
  double lateral;
};

double ModuleOf(const WheelTagOptions& options) {
  return options.size_mm / internal::TagBits(options.family, 0, 1).size;
}

class TaggedAlbedo : public Albedo {
 public:
  TaggedAlbedo(std::unique_ptr<const Albedo> under, const MaterialDomain& domain,
               const WheelTagOptions& options)
      : under_(std::move(under)),
        layout_(domain, options),
        options_(options),
        bits_(internal::TagBits(options.family, options.count, 1)),
        module_mm_(ModuleOf(options)),
        ramp_(options.edge_mm) {}

  void Evaluate(std::span<const Eigen::Vector2d> material_mm,
                std::span<float> albedo) const override {
    under_->Evaluate(material_mm, albedo);
    const double half = options_.size_mm / 2, paper = half + kMargin * module_mm_;
    for (std::size_t i = 0; i < albedo.size(); ++i) {
      const Eigen::Vector2d& m = material_mm[i];
      // So put that NaN is on no tag.
      if (!(std::abs(std::abs(m.y()) - layout_.lateral) < paper + options_.edge_mm)) continue;
      const int nearest = internal::FloorToInt((m.x() - layout_.begin) / layout_.step);
      const int id = ((nearest % layout_.count) + layout_.count) % layout_.count;
      const double across = m.y() - layout_.Centre(id).y();
      const double along = m.x() - (layout_.begin + (nearest + 0.5) * layout_.step);
      const double cover = ramp_(paper - std::abs(along)) * ramp_(paper - std::abs(across));
      if (!(cover > 0)) continue;
      const double white =
          internal::MarkerWhite(bits_, id, module_mm_, ramp_, along + half, half - across).share;
      const double tag = options_.black + (options_.white - options_.black) * white;
      albedo[i] = static_cast<float>(albedo[i] + cover * (tag - static_cast<double>(albedo[i])));
    }
  }

 private:
  std::unique_ptr<const Albedo> under_;
  Layout layout_;
  WheelTagOptions options_;
  internal::MarkerBits bits_;
  double module_mm_;
  internal::EdgeRamp ramp_;
};

template <typename Number>
bool ReadAll(std::string_view text, Number& number) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  return error == std::errc() && end == text.data() + text.size();
}

}  // namespace

WheelTagOptions WheelTagOptions::Parse(std::string_view word) {
  WheelTagOptions options;
  const std::size_t first = word.find(':'), last = word.rfind(':');
  std::string_view size = last == std::string_view::npos ? "" : word.substr(last + 1);
  if (size.ends_with("mm")) size.remove_suffix(2);
  if (first == last || !ReadAll(word.substr(first + 1, last - first - 1), options.count) ||
      !ReadAll(size, options.size_mm)) {
    throw UsageError(
        fmt::format("tags '{}' are no family, count and size; right ones are 36h11:12:24mm", word));
  }
  options.family = TagFamilyOf(word.substr(0, first));
  return options;
}

void WheelTagOptions::Check(const MaterialDomain& domain) const {
  const int most = internal::TagsOfFamily(family);
  if (count < 1 || count > most) {
    throw UsageError(fmt::format("There are {} tags in the family {}: paint 1 to as many.", most,
                                 family.substr(3)));
  }
  if (!(size_mm > 0) || !(lateral_mm >= 0) || !(edge_mm > 0) || !(edge_mm < ModuleOf(*this))) {
    throw UsageError("A tag's size must be positive and its modules wider than its soft edges.");
  }
  const double whole = size_mm + 2 * (kMargin * ModuleOf(*this) + edge_mm);
  const double step = (domain.u_max - domain.u_min) / count;
  if (!(whole < step)) {
    throw UsageError(fmt::format(
        "{} tags of {:g} mm with their margins do not fit around the tyre: they may be {:.0f} mm "
        "wide.",
        count, size_mm, step));
  }
  if (!(lateral_mm + whole / 2 < std::min(domain.v_max, -domain.v_min))) {
    throw UsageError(fmt::format("Tags of {:g} mm, {:g} mm off the middle, reach beyond the bead.",
                                 size_mm, lateral_mm));
  }
}

std::array<Eigen::Vector2d, 4> WheelTagCorners(const MaterialDomain& domain,
                                               const WheelTagOptions& options, int id) {
  if (id < 0 || id >= options.count) throw std::out_of_range("WheelTagCorners: no such tag");
  const Eigen::Vector2d centre = Layout(domain, options).Centre(id);
  const double h = options.size_mm / 2;
  return {centre + Eigen::Vector2d(-h, -h), centre + Eigen::Vector2d(h, -h),
          centre + Eigen::Vector2d(h, h), centre + Eigen::Vector2d(-h, h)};
}

std::unique_ptr<const Albedo> MakeTaggedAlbedo(std::unique_ptr<const Albedo> under,
                                               const MaterialDomain& domain,
                                               const WheelTagOptions& options) {
  options.Check(domain);
  return std::make_unique<TaggedAlbedo>(std::move(under), domain, options);
}

}  // namespace plumbline
