#include "apps/internal/noise_report.h"

#include <fmt/format.h>

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <span>

#include "apps/internal/planar_report.h"

namespace plumbline::internal {
namespace {

std::string Percent(double share) { return fmt::format("{:.1f} %", 100 * share); }

std::string DescribeModel(const PhotonTransfer& found) {
  const NoiseModel& model = found.model;
  const double top = std::ldexp(1.0, found.bits) - 1;
  const double middle = 0.5 * (found.lowest_grey + found.highest_grey);
  const auto sigma = [&](double grey) { return std::sqrt(model.Variance(grey)); };
  std::string text = fmt::format(
      "Noise (one standard deviation) in grey levels of 0 to {:.0f}: {:.2f} at level {:.0f}, "
      "{:.2f} "
      "at {:.0f}, {:.2f} at {:.0f}.\n",
      top, sigma(found.lowest_grey), found.lowest_grey, sigma(middle), middle,
      sigma(found.highest_grey), found.highest_grey);
  if (found.constant) {
    return text + fmt::format("Variance: {:.4g} +- {:.2g} grey levels squared, at any level.\n",
                              model.offset_grey2, found.sigma_offset_grey2());
  }
  text += fmt::format(
      "Variance = ({:.4g} +- {:.2g}) + ({:.4g} +- {:.2g}) x grey level; rounding is not in it.\n",
      model.offset_grey2, found.sigma_offset_grey2(), model.slope_grey, found.sigma_slope_grey());
  const double darkest = std::sqrt(model.Variance(0) + kRoundingVarianceGrey2);
  text += fmt::format(
      "If these are raw levels: {:.3g} grey levels an electron, so that white is about {:.2g} "
      "electrons;\n  dynamic range {:.0f} dB, signal to noise at white {:.0f}.\n",
      model.slope_grey, top / model.slope_grey, 20 * std::log10(top / darkest), top / sigma(top));
  return text;
}

struct Quantity {
  const char* key;
  const char* title;
  std::span<const FloorComponent> components;
  std::vector<const char*> names;
  const char* unit;
  double per_unit;  // from the file's unit to that of the text
};

std::vector<Quantity> QuantitiesOf(const NoiseFloor& floor) {
  std::vector<Quantity> all = {
      {"left_px", "left image", floor.left_px, {"x", "y"}, "px", 1},
      {"right_px", "right image", floor.right_px, {"x", "y"}, "px", 1},
      {"displacement_mm", "displacement", floor.displacement_mm, {"x", "y", "z"}, "um", 1000}};
  if (floor.strain) {
    all.push_back({"strain", "strain", *floor.strain, {"xx", "yy", "xy"}, "microstrain", 1e6});
  }
  return all;
}

std::string NameOf(const Quantity& quantity, std::size_t i) {
  return fmt::format("{} {}", quantity.title, quantity.names[i]);
}

nlohmann::json JsonOfQuantity(const Quantity& quantity) {
  const auto each = [&](const std::function<double(const FloorComponent&)>& value) {
    nlohmann::json out = nlohmann::json::array();
    for (const FloorComponent& c : quantity.components) out.push_back(FiniteJson(value(c)));
    return out;
  };
  return {{"noise", each(&FloorComponent::noise)},
          {"predicted", each(&FloorComponent::predicted)},
          {"ratio", each(&FloorComponent::ratio)},
          {"sigma_ratio", each(&FloorComponent::sigma_ratio)},
          {"common", each(&FloorComponent::common)},
          {"bias", each(&FloorComponent::bias)},
          {"predicted_bias", each(&FloorComponent::predicted_bias)}};
}

}  // namespace

std::string TextOf(const PhotonTransfer& found) {
  std::string text =
      fmt::format("{} still frames of {}x{} px, {} bits; {} of the pixels used", found.frames,
                  found.size.width, found.size.height, found.bits, Percent(found.used_share));
  if (found.black_share + found.white_share > 5e-4) {
    text += fmt::format(" ({} black, {} saturated)", Percent(found.black_share),
                        Percent(found.white_share));
  }
  return text + ".\n" + DescribeModel(found) +
         fmt::format(
             "Between frames the brightness changed by up to {}, and the picture moved by up to "
             "{:.2f} px; both are taken out.\n",
             Percent(found.flicker), found.motion_px);
}

nlohmann::json JsonOf(const PhotonTransfer& found) {
  nlohmann::json curve = nlohmann::json::array();
  for (const PhotonTransferPoint& p : found.curve) {
    curve.push_back({{"grey", p.grey},
                     {"variance_grey2", p.variance_grey2},
                     {"sigma_grey2", p.sigma_grey2},
                     {"pixels", p.pixels}});
  }
  return {{"bits", found.bits},
          {"width", found.size.width},
          {"height", found.size.height},
          {"frames", found.frames},
          {"pairs", found.pairs},
          {"moved_pairs", found.moved_pairs},
          {"offset_grey2", found.model.offset_grey2},
          {"slope_grey", found.model.slope_grey},
          {"sigma_offset_grey2", found.sigma_offset_grey2()},
          {"sigma_slope_grey", found.sigma_slope_grey()},
          {"constant", found.constant},
          {"chi2_per_dof", found.chi2_per_dof},
          {"misfit", found.misfit},
          {"lowest_grey", found.lowest_grey},
          {"highest_grey", found.highest_grey},
          {"used_share", found.used_share},
          {"black_share", found.black_share},
          {"white_share", found.white_share},
          {"flicker", found.flicker},
          {"motion_px", found.motion_px},
          {"neighbour_correlation", found.neighbour_correlation},
          {"curve", curve}};
}

std::string TextOf(const NoiseFloor& floor) {
  std::string text = fmt::format(
      "Noise floor of {} static pairs ({} differences a point), {} points every {} px, subset {} "
      "px{}:\n"
      "  {:<16}{:>9}{:>11}  {:<15}{:>10}{:>9}{:>11}\n",
      floor.frames, floor.frames - 1, floor.points, floor.step_px, floor.subset_px,
      floor.strain ? fmt::format("; {} gauges of {} px", floor.strain_points, floor.vsg_px) : "",
      "one sigma", "noise", "predicted", "ratio", "together", "bias", "predicted");
  for (const Quantity& quantity : QuantitiesOf(floor)) {
    for (std::size_t i = 0; i < quantity.components.size(); ++i) {
      const FloorComponent& c = quantity.components[i];
      const double f = quantity.per_unit;
      text += fmt::format("  {:<16}{:>9.3g}{:>11.3g}  {:<15}{:>10.2g}{:>9.2g}{:>11.2g} {}\n",
                          NameOf(quantity, i), f * c.noise, f * c.predicted,
                          fmt::format("{:.2f} +- {:.2f}", c.ratio(), c.sigma_ratio * c.ratio()),
                          f * c.common, f * c.bias, f * c.predicted_bias, quantity.unit);
    }
  }
  return text +
         fmt::format(
             "  noise: of the difference between two pairs; together: what all points did since "
             "the first pair\n"
             "  (not in the noise of displacements); bias: of the later pairs' mean, point by "
             "point. "
             "x, y, z of the {} frame.\n",
             floor.frame);
}

std::vector<std::string> NotesOf(const NoiseFloor& floor) {
  constexpr double kTolerance = 0.15, kSigmas = 2;
  std::vector<std::string> off;
  for (const Quantity& quantity : QuantitiesOf(floor)) {
    for (std::size_t i = 0; i < quantity.components.size(); ++i) {
      const FloorComponent& c = quantity.components[i];
      if (std::abs(c.ratio() - 1) > kTolerance + kSigmas * c.sigma_ratio) {
        off.push_back(fmt::format("{} {:.2f}", NameOf(quantity, i), c.ratio()));
      }
    }
  }
  std::vector<std::string> notes;
  if (!off.empty()) {
    notes.push_back(
        fmt::format("the noise departs from what the sigmas predict by more than {:.0f} % "
                    "(observed over predicted: {}): "
                    "something moved or shimmered (warm air, a flickering lamp), or the images are "
                    "filtered or compressed",
                    100 * kTolerance, fmt::join(off, ", ")));
  }
  constexpr int kFew = 5;
  if (floor.frames < kFew) {
    notes.push_back(fmt::format(
        "{} pairs tell the noise of all points together, but hardly that of one: take ten or more "
        "for maps",
        floor.frames));
  }
  return notes;
}

nlohmann::json JsonOf(const NoiseFloor& floor) {
  nlohmann::json json = {{"frames", floor.frames},   {"points", floor.points},
                         {"step_px", floor.step_px}, {"subset_px", floor.subset_px},
                         {"frame", floor.frame},     {"strain_points", floor.strain_points}};
  if (floor.strain) {
    json["vsg_px"] = floor.vsg_px;
    json["strain_measure"] = floor.strain_measure;
  }
  for (const Quantity& quantity : QuantitiesOf(floor)) {
    json[quantity.key] = JsonOfQuantity(quantity);
  }
  return json;
}

}  // namespace plumbline::internal
