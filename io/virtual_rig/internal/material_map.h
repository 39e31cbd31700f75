#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <vector>

#include "io/virtual_rig/surface_view.h"

namespace plumbline::internal {

// What a camera sees at a place of the image during one exposure, known everywhere: the material
// point at the shutter's opening and closing, and the light there.
//
// Cells of 8 px hold 4x4 exact nodes (SurfaceView::Look) and are interpolated by bicubic Lagrange
// polynomials. Each cell is checked against exact looks at three places and halved until they agree
// to 1e-4 px, down to a pixel; what is still rough then (occluding edges) is looked at exactly,
// place by place.
class MaterialMap {
 public:
  // u, v at the opening, u, v at the closing, light.
  static constexpr int kChannels = 5;
  using Sample = Eigen::Array<double, kChannels, 1>;

  // Light at a seen point and its pixel, relative.
  using Light = std::function<double(const SeenPoint&, const Eigen::Vector2d& pixel)>;

  // `margin_px`: how far beyond the image's edge places are asked for. `closing` may be `opening`.
  // Built with all threads; the same for any number of them.
  MaterialMap(const SurfaceView& opening, const SurfaceView& closing, const Light& light,
              int margin_px);

  // The places x0, x0 + dx ... (count of them) of image row y; NaN in u where there is no surface.
  void EvaluateRow(double y, double x0, double dx, std::span<Sample> row) const;

  // How far the material moves under a pixel during the exposure, at most (px).
  double LargestMotion_px() const;

  // Share of the image that is interpolated, for tests.
  double InterpolatedShare() const;

 private:
  enum class Kind : std::uint8_t { kEmpty, kSmooth, kSplit, kExact };
  struct Cell {
    Kind kind = Kind::kEmpty;
    int first = 0;  // of its four children, or of its nodes
  };
  using Nodes = std::array<Sample, 16>;  // row by row, at thirds of the cell

  // A cell and all below it; merged into the map when the row of cells is finished.
  struct Branch {
    std::vector<Cell> cells;
    std::vector<Nodes> nodes;
    double motion_px = 0;  // largest between opening and closing
  };

  Sample Look(const Eigen::Vector2d& pixel) const;
  // `nodes` of the cell are known; those of the cells below it are found here.
  Cell Build(const Eigen::Vector2d& corner, double size, const Nodes& nodes, Branch& branch) const;
  // Whether the polynomials agree with exact looks between the nodes.
  bool Interpolates(const Nodes& nodes, const Eigen::Vector2d& corner, double size,
                    const Sample& centre) const;
  Cell Split(const Eigen::Vector2d& corner, double size, const Nodes& nodes, const Sample& centre,
             Branch& branch) const;
  void EvaluateRun(const Branch& branch, const Cell& cell, const Eigen::Vector2d& corner,
                   double size, double y, double x0, double dx, std::span<Sample> run) const;

  const SurfaceView& opening_;
  const SurfaceView& closing_;
  const Light& light_;
  bool moves_;
  Eigen::Vector2d corner_;
  int columns_, rows_;
  std::vector<std::vector<Cell>> roots_;  // a row of cells each
  std::vector<Branch> branches_;          // what is below them
};

}  // namespace plumbline::internal
