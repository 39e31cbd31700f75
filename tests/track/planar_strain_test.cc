#include "track/planar_strain.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/LU>
#include <cmath>
#include <functional>
#include <limits>

#include "calib/error.h"
#include "tests/support/subset_noise.h"

namespace plumbline {
namespace {

using testing::NormalDeviates;

// A field without noise whose points claim a sigma of 0.01 px; the offset of `at` is in px.
PlanarField FieldOf(ImageSize size, int step_px,
                    const std::function<Eigen::Vector2d(double x, double y)>& at) {
  PlanarField field;
  field.first_px = {20, 30};
  field.step_px = step_px;
  field.subset_px = 21;
  field.order = 1;
  field.displacement_px = Image<Eigen::Vector2d>(size, Eigen::Vector2d::Zero());
  field.gradient = Image<Eigen::Matrix2f>(size, Eigen::Matrix2f::Zero());
  field.cov_displacement_px2 =
      Image<Eigen::Vector3f>(size, Eigen::Vector3f(1e-4F, 0.2e-4F, 1.5e-4F));
  field.cov_gradient = Image<Eigen::Matrix<float, 10, 1>>(
      size, Eigen::Matrix<float, 10, 1>(Eigen::Matrix<float, 10, 1>::Constant(1e-8F)));
  field.status = Image<Status>(size, Status::kOk);
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) {
      const Eigen::Vector2d at_px = field.PixelOf(r, c);
      field.displacement_px(r, c) = at(at_px.x(), at_px.y());
    }
  }
  return field;
}

void Remove(PlanarField& field, int row, int column, Status why = Status::kLowCorrelation) {
  field.displacement_px(row, column).setConstant(std::numeric_limits<double>::quiet_NaN());
  field.cov_displacement_px2(row, column).setConstant(std::numeric_limits<float>::quiet_NaN());
  field.status(row, column) = why;
}

NeighbourCorrelation Overlap(const PlanarField& field) {
  return NeighbourCorrelation::OfOverlap(field.size(), field.step_px, field.subset_px, field.order);
}

PlanarStrainOptions Window(int points, int order = 1) {
  PlanarStrainOptions options;
  options.window_points = points;
  options.order = order;
  return options;
}

int CountOk(const PlanarStrain& strain) {
  int count = 0;
  for (const Status status : strain.status.values()) count += status == Status::kOk ? 1 : 0;
  return count;
}

TEST(PlanarStrain, IsExactForStretchShearAndRotation) {
  Eigen::Matrix2d G;
  G << 0.1, 0.03, -0.02, -0.05;
  const double angle = M_PI / 6;
  Eigen::Matrix2d turn;
  turn << std::cos(angle) - 1, -std::sin(angle), std::sin(angle), std::cos(angle) - 1;
  for (const Eigen::Matrix2d& gradient : {G, turn}) {
    const PlanarField field = FieldOf({20, 17}, 4, [&](double x, double y) {
      return Eigen::Vector2d(3 + gradient(0, 0) * x + gradient(0, 1) * y,
                             -7 + gradient(1, 0) * x + gradient(1, 1) * y);
    });
    for (const StrainMeasure measure : {StrainMeasure::kGreenLagrange, StrainMeasure::kSmall,
                                        StrainMeasure::kHencky, StrainMeasure::kAlmansi}) {
      for (const int order : {1, 2, 3}) {
        PlanarStrainOptions options = Window(7, order);
        options.measure = measure;
        const PlanarStrain strain = ComputePlanarStrain(field, Overlap(field), options);
        EXPECT_EQ(strain.vsg_px, 6 * 4 + 21);
        const GradientStrain expected = StrainOf(gradient, measure);
        for (int r = 2; r < 15; ++r) {
          for (int c = 2; c < 18; ++c) {
            ASSERT_EQ(strain.status(r, c), Status::kOk) << r << ' ' << c;
            EXPECT_LT((strain.strain(r, c).cast<double>() - expected.strain).cwiseAbs().maxCoeff(),
                      1e-7);
            EXPECT_NEAR(strain.rotation_rad(r, c), expected.rotation_rad, 1e-7);
          }
        }
      }
    }
  }
}

TEST(PlanarStrain, OfOrderTwoFollowsAQuadraticFieldThroughHolesAndOrderOneDoesNot) {
  PlanarField field = FieldOf({21, 21}, 5, [](double x, double y) {
    return Eigen::Vector2d(1e-4 * x * x + 3e-5 * x * y, 2e-4 * y * y - 1e-5 * x * x);
  });
  for (const auto& [r, c] : {std::pair{9, 9}, {10, 12}, {11, 12}, {8, 13}, {12, 7}})
    Remove(field, r, c);
  PlanarStrainOptions options = Window(9, 2);
  options.measure = StrainMeasure::kSmall;
  const PlanarStrain exact = ComputePlanarStrain(field, Overlap(field), options);
  options.order = 1;
  const PlanarStrain linear = ComputePlanarStrain(field, Overlap(field), options);
  const Eigen::Vector2d at = field.PixelOf(10, 10);
  const Eigen::Vector3f expected(static_cast<float>(2e-4 * at.x() + 3e-5 * at.y()),
                                 static_cast<float>(4e-4 * at.y()),
                                 static_cast<float>(0.5 * (3e-5 * at.x() - 2e-5 * at.x())));
  EXPECT_EQ(exact.points(10, 10), 81 - 5);
  EXPECT_LT((exact.strain(10, 10) - expected).cwiseAbs().maxCoeff(), 1e-7F);
  EXPECT_GT((linear.strain(10, 10) - expected).cwiseAbs().maxCoeff(), 1e-5F);
}

TEST(PlanarStrain, OfOrderThreeFollowsACubicFieldAndOrderTwoDoesNot) {
  PlanarField field = FieldOf({21, 21}, 5, [](double x, double y) {
    return Eigen::Vector2d(2e-6 * x * x * x - 3e-6 * x * y * y,
                           1e-6 * x * x * y + 4e-6 * y * y * y);
  });
  for (const auto& [r, c] : {std::pair{9, 9}, {10, 12}, {8, 13}}) Remove(field, r, c);
  PlanarStrainOptions options = Window(9, 3);
  options.measure = StrainMeasure::kSmall;
  const PlanarStrain exact = ComputePlanarStrain(field, Overlap(field), options);
  options.order = 2;
  const PlanarStrain quadratic = ComputePlanarStrain(field, Overlap(field), options);
  const Eigen::Vector2d at = field.PixelOf(10, 10);
  const double x = at.x(), y = at.y();
  const Eigen::Vector3d expected(6e-6 * x * x - 3e-6 * y * y, 1e-6 * x * x + 12e-6 * y * y,
                                 0.5 * (-6e-6 * x * y + 2e-6 * x * y));
  EXPECT_LT((exact.strain(10, 10).cast<double>() - expected).cwiseAbs().maxCoeff(), 1e-7);
  EXPECT_GT((quadratic.strain(10, 10).cast<double>() - expected).cwiseAbs().maxCoeff(), 1e-4);
}

// The covariance of strain written down pair by pair, for weights w.
Eigen::Matrix3d DenseCovariance(const PlanarField& field, const NeighbourCorrelation& correlation,
                                const PlanarStrainOptions& options, int row, int column) {
  const int half = options.window_points / 2, order = options.order;
  const int terms = (order + 1) * (order + 2) / 2;
  struct Point {
    int row, column;
    double weight;
    Eigen::VectorXd P;
  };
  std::vector<Point> points;
  Eigen::MatrixXd M = Eigen::MatrixXd::Zero(terms, terms);
  for (int r = std::max(0, row - half); r <= std::min(field.size().height - 1, row + half); ++r) {
    for (int c = std::max(0, column - half); c <= std::min(field.size().width - 1, column + half);
         ++c) {
      if (field.status(r, c) != Status::kOk) continue;
      const double x = field.step_px * (c - column), y = field.step_px * (r - row);
      Eigen::VectorXd P(10);
      P << 1, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y;
      const Eigen::Vector3f& cov = field.cov_displacement_px2(r, c);
      const double weight =
          options.weights == GaugeWeights::kEqual ? 1 : 1 / static_cast<double>(cov[0] + cov[2]);
      points.push_back({r, c, weight, P.head(terms)});
      M += weight * points.back().P * points.back().P.transpose();
    }
  }
  const Eigen::MatrixXd inverse = M.inverse();
  Eigen::Matrix4d cov = Eigen::Matrix4d::Zero();
  Eigen::Vector4d gradient = Eigen::Vector4d::Zero();
  for (const Point& p : points) {
    const Eigen::Vector2d a = p.weight * (inverse * p.P).segment<2>(1);
    const Eigen::Vector3f& cp = field.cov_displacement_px2(p.row, p.column);
    const Eigen::Vector2d& d = field.displacement_px(p.row, p.column);
    gradient += (Eigen::Vector4d() << a * d[0], a * d[1]).finished();
    for (const Point& q : points) {
      const Eigen::Vector2d b = q.weight * (inverse * q.P).segment<2>(1);
      const Eigen::Vector3f& cq = field.cov_displacement_px2(q.row, q.column);
      Eigen::Matrix2d pq;
      if (&p == &q) {
        pq << cp[0], cp[1], cp[1], cp[2];
      } else {
        const Eigen::Matrix2d R =
            correlation.Between(p.row, p.column, q.row - p.row, q.column - p.column).cast<double>();
        pq = Eigen::Vector2d(std::sqrt(cp[0]), std::sqrt(cp[2])).asDiagonal() * R *
             Eigen::Vector2d(std::sqrt(cq[0]), std::sqrt(cq[2])).asDiagonal();
      }
      for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j) cov.block<2, 2>(2 * i, 2 * j) += pq(i, j) * a * b.transpose();
      }
    }
  }
  Eigen::Matrix2d G;
  G << gradient[0], gradient[1], gradient[2], gradient[3];
  const auto J = StrainOf(G, options.measure).d_strain;
  return J * cov * J.transpose();
}

TEST(PlanarStrain, CovarianceIsTheSumOverAllPairs) {
  PlanarField field = FieldOf({70, 40}, 4, [](double x, double y) {
    return Eigen::Vector2d(0.05 * x + 0.02 * y, -0.3 * x + 0.1 * y);
  });
  NormalDeviates draw(3);
  for (Eigen::Vector3f& cov : field.cov_displacement_px2.values()) {
    const auto u = static_cast<float>(1e-4 * (0.5 + draw.Uniform()));
    const auto v = static_cast<float>(1e-4 * (0.5 + draw.Uniform()));
    cov = {u, 0.3F * std::sqrt(u * v), v};
  }
  for (const auto& [r, c] : {std::pair{20, 33}, {21, 34}, {18, 60}, {33, 66}}) Remove(field, r, c);
  const testing::SpeckleTexture speckle({330, 220}, 4);
  const SubsetGrid subsets{field.size(), field.first_px, field.step_px, field.subset_px, 1, false};
  const NeighbourCorrelation correlation =
      NeighbourCorrelation::OfTexture(subsets, speckle.Texture());
  for (const int order : {1, 2, 3}) {
    for (const GaugeWeights weights : {GaugeWeights::kEqual, GaugeWeights::kInverseVariance}) {
      PlanarStrainOptions options = Window(7, order);
      options.weights = weights;
      options.min_share = 0.6;
      const PlanarStrain strain = ComputePlanarStrain(field, correlation, options);
      for (const auto& [r, c] :
           {std::pair{20, 30}, {1, 20}, {31, 63}, {32, 64}, {37, 67}, {10, 5}}) {
        ASSERT_EQ(strain.status(r, c), Status::kOk) << r << ' ' << c;
        const Eigen::Matrix3d expected = DenseCovariance(field, correlation, options, r, c);
        EXPECT_LT((CovarianceOf(strain.cov_strain(r, c)) - expected).norm(), 1e-5 * expected.norm())
            << r << ' ' << c << '\n'
            << CovarianceOf(strain.cov_strain(r, c)) << '\n'
            << expected;
      }
    }
  }
}

TEST(PlanarStrain, OfOnePointIsTheSubsetsOwn) {
  PlanarField field = FieldOf({4, 3}, 5, [](double, double) { return Eigen::Vector2d(1, 2); });
  Eigen::Matrix2f G;
  G << 0.1F, 0.02F, -0.05F, 0.03F;
  Eigen::Matrix<float, 10, 1> cov;
  cov << 4, 1, 0.5F, 0, 3, 0.2F, 0.1F, 5, 1, 2;
  field.gradient = Image<Eigen::Matrix2f>(field.size(), G);
  field.cov_gradient = Image<Eigen::Matrix<float, 10, 1>>(field.size(), cov * 1e-6F);
  Remove(field, 1, 1, Status::kMasked);
  const PlanarStrain strain = ComputePlanarStrain(field, Overlap(field), Window(1));
  Eigen::Matrix4d full;
  full << 4, 1, 0.5, 0, 1, 3, 0.2, 0.1, 0.5, 0.2, 5, 1, 0, 0.1, 1, 2;
  const GradientStrain expected = StrainOf(G.cast<double>(), StrainMeasure::kGreenLagrange);
  EXPECT_EQ(strain.vsg_px, 21);
  EXPECT_EQ(strain.points(0, 0), 1);
  EXPECT_LT((strain.strain(0, 0).cast<double>() - expected.strain).norm(), 1e-7);
  const Eigen::Matrix3d expected_cov =
      1e-6 * expected.d_strain * full * expected.d_strain.transpose();
  EXPECT_LT((CovarianceOf(strain.cov_strain(0, 0)) - expected_cov).norm(),
            1e-6 * expected_cov.norm());
  EXPECT_EQ(strain.status(1, 1), Status::kMasked);
  EXPECT_TRUE(strain.strain(1, 1).array().isNaN().all());
  field.order = 0;
  EXPECT_THROW((void)ComputePlanarStrain(field, Overlap(field), Window(1)), UsageError);
}

TEST(PlanarStrain, DoesNotExtrapolateAtEdgesAndHoles) {
  PlanarField field =
      FieldOf({40, 40}, 5, [](double x, double) { return Eigen::Vector2d(0.01 * x, 0); });
  for (int r = 18; r < 22; ++r) {
    for (int c = 0; c < 9; ++c) Remove(field, r, c);
  }
  Remove(field, 30, 30, Status::kMasked);
  PlanarStrainOptions options = Window(9);
  const PlanarStrain strain = ComputePlanarStrain(field, Overlap(field), options);
  // One column from the edge 6 of 9 columns are there, two from it 7.
  for (int c = 0; c < 2; ++c) {
    EXPECT_EQ(strain.status(10, c), Status::kExtrapolated);
    EXPECT_TRUE(strain.strain(10, c).array().isNaN().all());
    EXPECT_TRUE(strain.cov_strain(10, c).array().isNaN().all());
    EXPECT_TRUE(std::isnan(strain.von_mises(10, c)));
  }
  EXPECT_EQ(strain.status(10, 2), Status::kOk);
  EXPECT_EQ(strain.points(10, 2), 63);
  EXPECT_EQ(strain.points(10, 20), 81);
  // A point that has no displacement gets no strain from its neighbours.
  EXPECT_EQ(strain.status(30, 30), Status::kMasked);
  EXPECT_TRUE(strain.strain(30, 30).array().isNaN().all());
  EXPECT_EQ(strain.status(30, 31), Status::kOk);
  EXPECT_EQ(strain.status(19, 4), Status::kLowCorrelation);
  EXPECT_EQ(strain.status(17, 4), Status::kExtrapolated);
  // Few points suffice if asked for, but not all on one side.
  options.min_share = 0.1;
  const PlanarStrain lenient = ComputePlanarStrain(field, Overlap(field), options);
  EXPECT_EQ(lenient.status(10, 1), Status::kOk);
  EXPECT_EQ(lenient.status(10, 0), Status::kExtrapolated);
  options.min_quarter_share = 0;
  const PlanarStrain sided = ComputePlanarStrain(field, Overlap(field), options);
  EXPECT_EQ(sided.status(10, 0), Status::kOk);
  EXPECT_GT(sided.cov_strain(10, 0)[0], 2 * sided.cov_strain(10, 20)[0]);
}

TEST(PlanarStrain, OfFieldsSmallerThanTheGaugeIsNone) {
  for (const ImageSize size : {ImageSize{1, 1}, ImageSize{5, 5}, ImageSize{40, 2}}) {
    const PlanarField field =
        FieldOf(size, 5, [](double x, double) { return Eigen::Vector2d(0.01 * x, 0); });
    const PlanarStrain strain = ComputePlanarStrain(field, Overlap(field), Window(15));
    EXPECT_EQ(strain.size(), size);
    EXPECT_EQ(CountOk(strain), 0);
    for (const Status status : strain.status.values()) EXPECT_EQ(status, Status::kExtrapolated);
  }
}

TEST(PlanarStrain, NeedsPointsThatFixThePolynomial) {
  PlanarField field =
      FieldOf({9, 9}, 5, [](double x, double) { return Eigen::Vector2d(0.01 * x, 0); });
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 9; ++c) {
      if (c != 4) Remove(field, r, c);
    }
  }
  PlanarStrainOptions options = Window(9);
  options.min_share = 0.01;
  options.min_quarter_share = 0;
  EXPECT_EQ(ComputePlanarStrain(field, Overlap(field), options).status(4, 4),
            Status::kExtrapolated);
}

TEST(PlanarStrain, MarksWhatIsNoDeformation) {
  PlanarField field =
      FieldOf({9, 9}, 5, [](double x, double) { return Eigen::Vector2d(-1.5 * x, 0); });
  field.cov_displacement_px2(4, 5)[1] = std::numeric_limits<float>::quiet_NaN();
  const PlanarStrain strain = ComputePlanarStrain(field, Overlap(field), Window(5));
  EXPECT_EQ(strain.status(4, 4), Status::kFailedVerification);
  EXPECT_EQ(strain.status(4, 5), Status::kFailedVerification);
  EXPECT_EQ(strain.points(4, 4), 24);
  EXPECT_TRUE(strain.strain(4, 4).array().isNaN().all());
}

TEST(PlanarStrain, RefusesWhatItCannotUse) {
  PlanarField field =
      FieldOf({9, 9}, 5, [](double x, double) { return Eigen::Vector2d(0.01 * x, 0); });
  const NeighbourCorrelation overlap = Overlap(field);
  for (const int points : {0, 4, -1})
    EXPECT_THROW((void)ComputePlanarStrain(field, overlap, Window(points)), UsageError);
  EXPECT_THROW((void)ComputePlanarStrain(field, overlap, Window(5, 4)), UsageError);
  EXPECT_THROW((void)ComputePlanarStrain(field, overlap, Window(3, 3)), UsageError);
  PlanarStrainOptions options;
  options.min_share = 0;
  EXPECT_THROW((void)ComputePlanarStrain(field, overlap, options), UsageError);
  field.cov_displacement_px2 = {};
  EXPECT_THROW((void)ComputePlanarStrain(field, overlap), InputError);
  EXPECT_THROW((void)ComputePlanarStrain(PlanarField{}, overlap), InputError);
}

// Errors of displacements as subsets of a speckle image make them from white noise of its pixels.
struct NoisyFields {
  testing::SpeckleTexture speckle;
  SubsetGrid subsets;
  std::vector<testing::SubsetAnswer> answers;
  PlanarField quiet;  // with the covariances of noise of 1 grey level
  NormalDeviates draw{99};

  NoisyFields(ImageSize grid, int step_px, int subset_px, int order)
      : speckle({(grid.width - 1) * step_px + subset_px + 2,
                 (grid.height - 1) * step_px + subset_px + 2},
                21) {
    subsets = {grid, {subset_px / 2 + 1, subset_px / 2 + 1}, step_px, subset_px, order, false};
    for (int r = 0; r < grid.height; ++r) {
      for (int c = 0; c < grid.width; ++c) answers.emplace_back(subsets, speckle.Texture(), r, c);
    }
    SetCovariances();
  }

  NeighbourCorrelation Correlation() const {
    return NeighbourCorrelation::OfTexture(subsets, speckle.Texture());
  }

  const testing::SubsetAnswer& Answer(int row, int column) const {
    return answers[static_cast<std::size_t>(row * subsets.grid.width + column)];
  }

  void SetCovariances() {
    quiet = FieldOf(subsets.grid, subsets.step_px,
                    [](double, double) { return Eigen::Vector2d(0, 0); });
    quiet.first_px = subsets.first_px;
    quiet.subset_px = subsets.subset_px;
    quiet.order = subsets.order;
    for (int r = 0; r < subsets.grid.height; ++r) {
      for (int c = 0; c < subsets.grid.width; ++c) {
        Eigen::Matrix2d cov = Eigen::Matrix2d::Zero();
        Eigen::Matrix4d cov_gradient = Eigen::Matrix4d::Zero();
        for (const auto& k : Answer(r, c).pixels) {
          cov += k.weight * k.weight.transpose();
          cov_gradient += k.gradient_weight * k.gradient_weight.transpose();
        }
        quiet.cov_displacement_px2(r, c) =
            Eigen::Vector3d(cov(0, 0), cov(0, 1), cov(1, 1)).cast<float>();
        int next = 0;
        for (int i = 0; i < 4; ++i) {
          for (int j = i; j < 4; ++j)
            quiet.cov_gradient(r, c)[next++] = static_cast<float>(cov_gradient(i, j));
        }
      }
    }
  }

  // One draw of noise of 1 grey level on top of a uniform gradient.
  PlanarField Field(const Eigen::Matrix2d& gradient) {
    PlanarField field = quiet;
    Image<float> noise(speckle.grey.size());
    for (float& n : noise.values()) n = static_cast<float>(draw());
    for (int r = 0; r < subsets.grid.height; ++r) {
      for (int c = 0; c < subsets.grid.width; ++c) {
        field.displacement_px(r, c) = gradient * field.PixelOf(r, c) + Answer(r, c).Error(noise);
        const Eigen::Vector4d error = Answer(r, c).GradientError(noise);
        field.gradient(r, c) =
            (gradient + (Eigen::Matrix2d() << error[0], error[1], error[2], error[3]).finished())
                .cast<float>();
      }
    }
    return field;
  }
};

// Normalised errors squared, and how often 95 % intervals hold the truth.
struct Consistency {
  double nees = 0, inside = 0, intervals = 0, points = 0;
  void Interval(double error, double sigma) {
    inside += std::abs(error) < 1.959964 * sigma ? 1 : 0;
    intervals += 1;
  }
  void Add(const PlanarStrain& strain, const GradientStrain& truth) {
    const StrainInvariants invariants = InvariantsOf(truth.strain);
    for (int r = 0; r < strain.size().height; ++r) {
      for (int c = 0; c < strain.size().width; ++c) {
        if (strain.status(r, c) != Status::kOk) continue;
        const Eigen::Vector3d error = strain.strain(r, c).cast<double>() - truth.strain;
        const Eigen::Matrix3d cov = CovarianceOf(strain.cov_strain(r, c));
        nees += error.dot(cov.inverse() * error);
        points += 1;
        for (int i = 0; i < 3; ++i) Interval(error[i], std::sqrt(cov(i, i)));
        for (int i = 0; i < 2; ++i)
          Interval(strain.principal(r, c)[i] - invariants.principal[i],
                   strain.sigma_principal(r, c)[i]);
        Interval(strain.angle_rad(r, c) - invariants.angle_rad, strain.sigma_angle_rad(r, c));
        Interval(strain.rotation_rad(r, c) - truth.rotation_rad, strain.sigma_rotation_rad(r, c));
        Interval(strain.von_mises(r, c) - invariants.von_mises, strain.sigma_von_mises(r, c));
        Interval(strain.max_shear(r, c) - invariants.max_shear, strain.sigma_max_shear(r, c));
      }
    }
  }
};

struct NoiseCase {
  ImageSize grid;
  int step_px, subset_px, subset_order, window_points, gauge_order, draws;
};

class SigmaOfStrain : public ::testing::TestWithParam<NoiseCase> {};

TEST_P(SigmaOfStrain, HoldsForOverlappingSubsetsAndGauges) {
  const NoiseCase& c = GetParam();
  NoisyFields fields(c.grid, c.step_px, c.subset_px, c.subset_order);
  const NeighbourCorrelation correlation = fields.Correlation();
  Eigen::Matrix2d G;
  G << 0.12, 0.03, -0.05, -0.04;
  const GradientStrain truth = StrainOf(G, StrainMeasure::kGreenLagrange);
  Consistency consistency;
  for (int draw = 0; draw < c.draws; ++draw) {
    const PlanarField field = fields.Field(G);
    consistency.Add(ComputePlanarStrain(field, correlation, Window(c.window_points, c.gauge_order)),
                    truth);
  }
  ASSERT_GT(consistency.points, 0);
  const double nees = consistency.nees / consistency.points;
  const double coverage = consistency.inside / consistency.intervals;
  RecordProperty("nees", std::to_string(nees));
  RecordProperty("coverage", std::to_string(coverage));
  EXPECT_NEAR(nees, 3, 0.3);
  EXPECT_GT(coverage, 0.93);
  EXPECT_LT(coverage, 0.97);
}

INSTANTIATE_TEST_SUITE_P(Gauges, SigmaOfStrain,
                         ::testing::Values(NoiseCase{{18, 18}, 6, 21, 1, 7, 1, 200},
                                           NoiseCase{{18, 18}, 6, 21, 1, 1, 1, 60},
                                           NoiseCase{{18, 18}, 6, 21, 2, 5, 2, 200},
                                           NoiseCase{{26, 26}, 2, 21, 1, 15, 1, 70},
                                           NoiseCase{{24, 24}, 3, 21, 2, 9, 1, 100}));

TEST(SigmaOfStrain, IsFarTooSmallWithoutTheOverlap) {
  // What the tests above would say of independent points.
  NoisyFields fields({18, 18}, 4, 21, 1);
  const NeighbourCorrelation none = NeighbourCorrelation::OfOverlap({18, 18}, 100, 21, 1);
  Consistency consistency;
  for (int draw = 0; draw < 30; ++draw) {
    const PlanarField field = fields.Field(Eigen::Vector2d(0.1, 0).asDiagonal());
    consistency.Add(ComputePlanarStrain(field, none, Window(7)),
                    StrainOf(Eigen::Vector2d(0.1, 0).asDiagonal(), StrainMeasure::kGreenLagrange));
  }
  EXPECT_GT(consistency.nees / consistency.points, 10);
}

TEST(PlanarStrain, IsTheSameForAnyNumberOfThreads) {
  PlanarField field = FieldOf({150, 70}, 5, [](double x, double y) {
    return Eigen::Vector2d(0.01 * x, 0.02 * y * std::sin(0.02 * x));
  });
  for (int i = 0; i < 50; ++i) Remove(field, (7 * i) % 70, (31 * i) % 150);
  const auto compute = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return ComputePlanarStrain(field, Overlap(field), Window(9));
  };
  const PlanarStrain one = compute(1), four = compute(4);
  EXPECT_EQ(one.status.values(), four.status.values());
  for (int r = 0; r < 70; ++r) {
    for (int c = 0; c < 150; ++c) {
      if (one.status(r, c) != Status::kOk) continue;
      EXPECT_EQ(one.strain(r, c), four.strain(r, c));
      EXPECT_EQ(one.cov_strain(r, c), four.cov_strain(r, c));
    }
  }
}

}  // namespace
}  // namespace plumbline
