#include "calib/internal/two_level_fit.h"

#include <gtest/gtest.h>

#include "calib/internal/disc_shape.h"
#include "calib/internal/saddle_shape.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline::internal {
namespace {

// The slope that a shape reports against finite differences, at points all over its edges.
template <class Shape>
void CheckSlopes(const typename Shape::Parameters& q) {
  int on_an_edge = 0;
  for (double y = -9; y <= 9; y += 0.7) {
    for (double x = -9; x <= 9; x += 0.7) {
      const Eigen::Vector2d p(x, y);
      typename Shape::Parameters slope;
      Shape::Share(q, p, slope);
      const auto share = [&](const Eigen::VectorXd& v) {
        typename Shape::Parameters unused;
        return Eigen::VectorXd::Constant(1, Shape::Share(typename Shape::Parameters(v), p, unused));
      };
      const Eigen::VectorXd numeric =
          plumbline::testing::NumericJacobian(share, q, 1e-5).transpose();
      on_an_edge += slope.norm() > 0.01 ? 1 : 0;
      // Beyond five blurs an edge is cut off: a step of 3e-7.
      EXPECT_LT((slope - numeric).norm(),
                1e-5 * std::max(1.0, numeric.norm()) + 1e-4 * numeric.norm())
          << p.transpose();
    }
  }
  EXPECT_GT(on_an_edge, 50);
}

TEST(DiscShape, SlopesMatchFiniteDifferences) {
  DiscShape<false>::Parameters q;
  q << 0.3, -0.2, 0.03, 0.006, 0.04, 0.9;
  CheckSlopes<DiscShape<false>>(q);
}

TEST(DiscShape, SlopesOfARingMatchFiniteDifferences) {
  DiscShape<true>::Parameters q;
  q << 0.3, -0.2, 0.02, 0.004, 0.025, 0.8, 0.25, -0.1, 0.45;
  CheckSlopes<DiscShape<true>>(q);
}

TEST(SaddleShape, SlopesMatchFiniteDifferences) {
  SaddleShape::Parameters q;
  q << 0.2, -0.4, 0.3, 1.7, 0.8;
  CheckSlopes<SaddleShape>(q);
}

}  // namespace
}  // namespace plumbline::internal
