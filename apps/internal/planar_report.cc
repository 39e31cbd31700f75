#include "apps/internal/planar_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

namespace plumbline::internal {
namespace {

double Percent(std::int64_t part, std::int64_t whole) {
  return whole > 0 ? 100.0 * static_cast<double>(part) / static_cast<double>(whole) : 0.0;
}

// What became of the points without a value, the most first.
std::string LossText(const FieldCounts& counts) {
  const auto of = [&](Status status) { return counts.by_status[static_cast<std::size_t>(status)]; };
  std::vector<std::pair<std::int64_t, std::string>> losses = {
      {of(Status::kOutsideImage), "leave the image"},
      {of(Status::kLowTexture), "have too little texture"},
      {of(Status::kLowCorrelation), "look different in the deformed image (low correlation)"},
      {of(Status::kNotConverged), "could not be reached or did not converge"},
      {counts.not_found_back, "were not found again from the deformed image"},
      {counts.isolated, "contradict all their neighbours"},
      {counts.still, "stand still beside what moves (background; --keep-still-parts keeps it)"}};
  std::stable_sort(losses.begin(), losses.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  std::string text;
  for (const auto& [count, words] : losses) {
    if (count > 0) text += fmt::format("{}{} {}", text.empty() ? "" : "; ", count, words);
  }
  return text;
}

nlohmann::json Json2(const Eigen::Vector2d& value) {
  return {FiniteJson(value.x()), FiniteJson(value.y())};
}

nlohmann::json Json3(const Eigen::Vector3d& value) {
  return {FiniteJson(value[0]), FiniteJson(value[1]), FiniteJson(value[2])};
}

}  // namespace

nlohmann::json FiniteJson(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

nlohmann::json StrainJson(const PlanarSummary& summary) {
  return {{"points", summary.strain_points},
          {"median", Json3(summary.median_strain)},
          {"median_sigma", Json3(summary.median_sigma_strain)}};
}

std::string GaugeText(const PlanarSeriesHeader& header) {
  return fmt::format("Strain ({}) over virtual gauges of {} px (VSG; {} by {} points).\n",
                     header.strain_measure, header.vsg_px, header.window_points,
                     header.window_points);
}

std::string StrainText(const PlanarSummary& summary, const PlanarSeriesHeader& header) {
  if (summary.strain_points == 0) {
    const int side = std::min(header.grid.width, header.grid.height);
    return fmt::format(
        "  No point has a strain: a window of {0} by {0} points has to be filled to 70 % (the grid "
        "is {1} by {2} points); take a smaller --strain-window{3}.\n",
        header.window_points, header.grid.width, header.grid.height,
        side >= 3 ? "" : " or a smaller --step");
  }
  const Eigen::Vector3d& e = summary.median_strain;
  const Eigen::Vector3d& s = summary.median_sigma_strain;
  return fmt::format(
      "  Strain, median of {} points: xx {:.6f} (sigma {:.1e}), yy {:.6f} ({:.1e}), xy {:.6f} "
      "({:.1e}).\n",
      summary.strain_points, e[0], s[0], e[1], s[1], e[2], s[2]);
}

PlanarReport::PlanarReport(std::filesystem::path output, std::int64_t declared_frames,
                           const PlanarSeriesHeader& header, ReferenceMode mode)
    : output_(std::move(output)), declared_frames_(declared_frames), header_(header), mode_(mode) {}

void PlanarReport::Add(const CorrelatedFrame& f) {
  rows_.push_back({f.frame.index, f.frame.reference_index, f.frame.id, f.frame.problem, f.counts,
                   f.summary, f.lost_at_updates, f.seconds});
}

std::int64_t PlanarReport::Bad() const {
  return std::count_if(rows_.begin(), rows_.end(),
                       [](const Row& row) { return !row.problem.empty(); });
}

std::int64_t PlanarReport::Found() const {
  return std::accumulate(rows_.begin(), rows_.end(), std::int64_t{0},
                         [](std::int64_t sum, const Row& row) { return sum + row.counts.ok; });
}

std::string PlanarReport::Complaint() const {
  if (rows_.empty() || Found() > 0) return "";
  const auto good =
      std::find_if(rows_.begin(), rows_.end(), [](const Row& row) { return row.problem.empty(); });
  if (good == rows_.end()) return "No image could be used. " + rows_.front().problem;
  const FieldCounts& n = good->counts;
  if (n.by_status[static_cast<std::size_t>(Status::kLowTexture)] * 2 > n.attempted) {
    return fmt::format(
        "No point was found: subsets of {} px show too little texture. Is the image blank, "
        "saturated or out of focus? Else take a larger --subset.",
        header_.subset_px);
  }
  return fmt::format(
      "No point was found: {}. Do both images show the same speckle, and is neither blank, "
      "saturated "
      "or blurred?",
      LossText(n));
}

double PlanarReport::PointsPerSecond() const {
  double points = 0;
  double seconds = 0;
  for (const Row& row : rows_) {
    points += static_cast<double>(row.counts.attempted);
    seconds += row.seconds;
  }
  return seconds > 0 ? points / seconds : 0;
}

std::string PlanarReport::FrameText(const Row& row) const {
  std::string text = fmt::format("Frame {} ({}): ", row.index, row.id);
  if (!row.problem.empty()) return text + "bad. " + row.problem + "\n";
  const FieldCounts& n = row.counts;
  text += fmt::format("{} of {} points found ({:.1f} %)", n.ok, n.attempted,
                      Percent(n.ok, n.attempted));
  if (row.reference_index >= 0) text += fmt::format(", from frame {}", row.reference_index);
  text += ".\n";
  const std::string losses = LossText(n);
  if (!losses.empty()) text += fmt::format("  Of the others: {}.\n", losses);
  if (row.lost_at_updates > 0) {
    text +=
        fmt::format("  Lost for good when the reference was updated: {}.\n", row.lost_at_updates);
  }
  if (n.ok == 0) return text;
  const PlanarSummary& s = row.summary;
  text += fmt::format(
      "  u {:.4f} to {:.4f} px (median {:.4f}), v {:.4f} to {:.4f} px ({:.4f}); sigma {:.4f} px, "
      "median.\n",
      s.least_px.x(), s.most_px.x(), s.median_px.x(), s.least_px.y(), s.most_px.y(),
      s.median_px.y(), s.median_sigma_px);
  if (header_.contents.strain) text += StrainText(s, header_);
  return text;
}

std::string PlanarReport::GoOnText() const {
  const std::int64_t next = rows_.empty() ? 0 : rows_.back().index + 1;
  if (mode_ == ReferenceMode::kFixed) {
    return fmt::format(
        "Stopped by Ctrl-C: the {} finished frames are kept; go on with --frames {}: and another "
        "output file.\n",
        frames(), next);
  }
  return fmt::format(
      "Stopped by Ctrl-C: the {} finished frames are kept. As the reference is updated on the way, "
      "the frames from {} on need those before: run all again into another output file.\n",
      frames(), next);
}

std::string PlanarReport::Text(const std::vector<std::string>& notes) const {
  constexpr std::size_t kMostFrames = 6;
  std::string text =
      fmt::format("{} by {} points every {} px, subset {} px, order {}.\n", header_.grid.width,
                  header_.grid.height, header_.step_px, header_.subset_px, header_.order);
  if (header_.contents.strain) text += GaugeText(header_);
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    // A long run is told by its first and last frames; the file has them all.
    if (rows_.size() > kMostFrames && i >= kMostFrames / 2 && i + kMostFrames / 2 < rows_.size()) {
      if (i == kMostFrames / 2) {
        text += fmt::format("... {} more frames ...\n", rows_.size() - kMostFrames);
      }
      continue;
    }
    text += FrameText(rows_[i]);
  }
  text += fmt::format("{} of {} frames correlated", frames() - Bad(),
                      std::max(declared_frames_, frames()));
  if (Bad() > 0) text += fmt::format(", {} marked as bad", Bad());
  text += fmt::format("; {:.0f} points a second.\n", PointsPerSecond());
  if (interrupted_) text += GoOnText();
  for (const std::string& note : notes) text += "Note: " + note + "\n";
  text += "Sigmas are one standard deviation, from the noise of the images alone.\n";
  text += fmt::format(
      "Wrote {}. Look at it with: plumbline info {}, or plumbline export {} --format csv\n",
      output_.string(), output_.filename().string(), output_.filename().string());
  return text;
}

nlohmann::json PlanarReport::FrameJson(const Row& row) const {
  const FieldCounts& n = row.counts;
  nlohmann::json frame = {{"index", row.index},     {"image", row.id},
                          {"problem", row.problem}, {"reference_index", row.reference_index},
                          {"points", n.points},     {"attempted_points", n.attempted},
                          {"ok_points", n.ok},      {"seconds", row.seconds}};
  if (!row.problem.empty()) return frame;
  nlohmann::json by_status = nlohmann::json::object();
  for (std::size_t i = 0; i < kStatusNames.size(); ++i) {
    if (n.by_status[i] > 0) by_status[std::string(kStatusNames[i])] = n.by_status[i];
  }
  frame["by_status"] = std::move(by_status);
  frame["failed_verification"] = {
      {"not_found_back", n.not_found_back}, {"isolated", n.isolated}, {"still", n.still}};
  frame["lost_at_updates"] = row.lost_at_updates;
  const PlanarSummary& s = row.summary;
  frame["displacement_px"] = {{"least", Json2(s.least_px)},
                              {"median", Json2(s.median_px)},
                              {"most", Json2(s.most_px)},
                              {"median_sigma", FiniteJson(s.median_sigma_px)}};
  frame["median_zncc"] = FiniteJson(s.median_zncc);
  if (header_.contents.strain) frame["strain"] = StrainJson(s);
  return frame;
}

nlohmann::json PlanarReport::Json(const std::vector<std::string>& notes) const {
  nlohmann::json json = {{"output", output_.string()},
                         {"frames_declared", declared_frames_},
                         {"frames_read", frames()},
                         {"frames_correlated", frames() - Bad()},
                         {"interrupted", interrupted_},
                         {"grid", {header_.grid.height, header_.grid.width}},
                         {"step_px", header_.step_px},
                         {"subset_px", header_.subset_px},
                         {"points_per_second", PointsPerSecond()},
                         {"notes", notes},
                         {"frames", nlohmann::json::array()}};
  if (header_.contents.strain) {
    json["strain_measure"] = header_.strain_measure;
    json["strain_window"] = header_.window_points;
    json["vsg_px"] = header_.vsg_px;
  }
  for (const Row& row : rows_) json["frames"].push_back(FrameJson(row));
  return json;
}

CommandReport PlanarReport::Make(const std::vector<std::string>& notes) const {
  CommandReport report;
  report.text = Text(notes);
  report.json = Json(notes);
  if (Found() == 0) report.exit_code = 3;
  if (interrupted_) report.exit_code = 130;
  return report;
}

}  // namespace plumbline::internal
