#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/status.h"
#include "io/series_shard.h"
#include "match/noise_model.h"
#include "match/planar_field.h"

// What `plumbline correlate` finds, as a series holds it: one camera, everything in pixels.
namespace plumbline {

// Which optional datasets a planar series holds; fixed for the whole run.
struct PlanarContents {
  bool gradient_covariance =
      false;  // /displacement/gradient_covariance: all of it, not only sigmas
  bool strain = false;

  friend bool operator==(const PlanarContents&, const PlanarContents&) = default;
};

// The names of those that it holds, in the order above.
std::vector<std::string> Names(const PlanarContents& contents);

// The strain at the points of a grid, as /strain of a planar series holds it, along the image's
// axes. All of one size (rows, columns), or empty. NaN where status is not kOk; that is the
// strain's own: a point without displacement may have a strain from its neighbours, and one with a
// displacement none (at an edge the gauge is not full).
struct PlanarStrainRecord {
  Image<Eigen::Vector3f> strain;  // xx, yy, xy: xy the tensor's shear component
  // From independent noise. Upper triangle, row by row: xx xx, xx yy, xx xy, yy yy, yy xy, xy xy.
  Image<Eigen::Matrix<float, 6, 1>> covariance;
  Image<Status> status;
};

// Sigmas of the principal strains and of their direction (PrincipalOf() in io/series_frame.h), to
// first order in the errors: they hold where the principal strains differ by more than a few
// sigmas. NaN where both are equal. `covariance` as in PlanarStrainRecord.
struct PrincipalStrainSigma {
  Eigen::Vector2f strain;
  float angle_rad;
};
PrincipalStrainSigma SigmaOfPrincipal(const Eigen::Vector3f& strain,
                                      const Eigen::Matrix<float, 6, 1>& covariance);

struct PlanarSeriesFrame {
  std::int64_t index = 0;
  double time_s = 0;
  std::string id;       // of the deformed image
  std::string problem;  // empty, or why this frame has no field
  int dropped_before = 0;
  // The image that this one was correlated with: a frame's index, or -1 for the reference image of
  // the run. Displacements count from what the header says, whatever this is.
  std::int64_t reference_index = -1;
  PlanarField field;          // empty images where there is a problem
  PlanarStrainRecord strain;  // written where the series' contents name it
};

// What is known of the camera.
struct PlanarCamera {
  ImageSize image_size;
  int bits = 8;  // significant bits of a grey level
  NoiseModel noise;
  std::string noise_source;  // where it came from, for people: "static frames", "estimated"...
};

struct PlanarSeriesHeader {
  // The grid of the PlanarFields.
  ImageSize grid;
  Eigen::Vector2i first_px{0, 0};
  int step_px = 1;
  int subset_px = 0;
  int order = 1;  // of the shape function
  // How it was correlated.
  std::string subset_shape = "square";  // or "circle"
  std::string interpolation = "quintic";
  // What both images were filtered by: "low-pass", "gaussian" (of this sigma) or "none".
  std::string prefilter = "none";
  double prefilter_sigma_px = 0;  // of the Gaussian; 0 where there is none
  // What displacements count from, attribute `reference` of /displacement: "image" (the reference
  // image of the run), "frame N" (PlanarSeriesFrame::index) or "previous"; and that image's name.
  std::string reference = "image";
  std::string reference_id;
  // Of /strain: "green_lagrange", "small", "hencky" or "almansi"; the size of the virtual strain
  // gauge, (window - 1) * step + subset, and of its window in points.
  std::string strain_measure = "green_lagrange";
  int vsg_px = 0;
  int window_points = 0;
  PlanarCamera camera;
  std::string recipe_toml;  // full, defaults filled in
  std::vector<std::filesystem::path> inputs;
  PlanarContents contents = {};
  std::optional<SeriesShard> shard = {};  // nothing: the run is whole
};

}  // namespace plumbline
