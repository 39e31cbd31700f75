// Triangulates the point that a small rig sees, with nothing but the installed package.

#include <plumbline/calib/triangulate.h>

#include <cstdio>

int main() {
  Eigen::VectorXd p(9);
  p << 1000, 1000, 320, 240, 0, 0, 0, 0, 0;
  const plumbline::Camera camera(plumbline::LensModel::FromName("OPENCV5"), {640, 480}, p);
  const plumbline::StereoRig rig{
      camera, camera, {Eigen::Matrix3d::Identity(), {-100, 0, 0}}, {}, ""};
  plumbline::StereoObservation observation;
  observation.left = {320, 240};
  observation.right = {120, 240};
  const auto point = plumbline::Triangulate(rig, observation);
  std::printf("%.6f %.6f %.6f mm\n", point.point_in_rig.x(), point.point_in_rig.y(),
              point.point_in_rig.z());
  return point.status == plumbline::Status::kOk ? 0 : 1;
}
