#include "fit/internal/ransac_plane.h"

#include <pcl/console/print.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/sample_consensus/ransac.h>
#include <pcl/sample_consensus/sac_model_plane.h>

#include <memory>

namespace plumbline::internal {
namespace {

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

// PCL seeds its generator with a constant or with the clock; the generator is open to subclasses.
class SeededPlaneModel : public pcl::SampleConsensusModelPlane<pcl::PointXYZ> {
 public:
  SeededPlaneModel(const Cloud::ConstPtr& cloud, std::uint64_t seed)
      : pcl::SampleConsensusModelPlane<pcl::PointXYZ>(cloud) {
    rng_alg_.seed(static_cast<std::uint32_t>(seed ^ (seed >> 32)));
  }
};

}  // namespace

std::optional<PlaneCandidate> RansacPlane(std::span<const Eigen::Vector3d> points, double threshold,
                                          std::uint64_t seed) {
  if (points.size() < 3) return std::nullopt;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& point : points) mean += point;
  mean /= static_cast<double>(points.size());

  const auto cloud = std::make_shared<Cloud>();
  cloud->reserve(points.size());
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3f q = (point - mean).cast<float>();
    cloud->push_back(pcl::PointXYZ(q.x(), q.y(), q.z()));
  }
  // PCL prints to stderr when a sample is degenerate; that is our caller's to report.
  pcl::console::setVerbosityLevel(pcl::console::L_ALWAYS);
  const auto model = std::make_shared<SeededPlaneModel>(cloud, seed);
  pcl::RandomSampleConsensus<pcl::PointXYZ> ransac(model, threshold);
  ransac.setProbability(0.9999);
  ransac.setMaxIterations(2000);
  if (!ransac.computeModel()) return std::nullopt;
  Eigen::VectorXf c;
  ransac.getModelCoefficients(c);
  const Eigen::Vector3d normal = c.head<3>().cast<double>();
  const double norm = normal.norm();
  if (!(norm > 0)) return std::nullopt;
  return PlaneCandidate{normal / norm, -static_cast<double>(c[3]) / norm + normal.dot(mean) / norm};
}

}  // namespace plumbline::internal
