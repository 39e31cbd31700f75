#include "io/virtual_rig/board_surface.h"

#include <fmt/format.h>

#include <Eigen/QR>
#include <cmath>
#include <numbers>
#include <random>
#include <utility>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

// amplitude * sin(wave . s + phase), s = (q - middle) / half the board's longer side.
struct Wave {
  Eigen::Vector2d amplitude_mm, wave;
  double phase_rad;
};

std::vector<Eigen::Vector2d> NominalPoints(const BoardSpec& spec) {
  std::vector<Eigen::Vector2d> points;
  for (int id = 0; id < spec.PointCount(); ++id) points.push_back(spec.NominalPoint(id).head<2>());
  return points;
}

}  // namespace

void BoardFlaws::Check(const BoardSpec& spec) const {
  for (const auto& [size, what] :
       {std::pair{bend_mm, "bend"}, std::pair{misprint_mm, "misprint"}}) {
    if (!(size >= 0) || !(size <= spec.pitch_mm)) {
      throw UsageError(fmt::format("a {} of {} mm on {} is not between 0 and its pitch", what, size,
                                   spec.Word()));
    }
  }
  if (!(std::abs(scale_error) <= 0.1)) {
    throw UsageError(fmt::format("a board's scale error of {} is not within 0.1", scale_error));
  }
}

struct BoardSurface::Shape {
  struct Place {
    Eigen::Vector3d position_mm;
    Eigen::Matrix<double, 3, 2> tangents;
  };

  Shape(const BoardSpec& board, const BoardPrint& print, const BoardFlaws& flaws);

  Place At(const Eigen::Vector2d& q) const {
    Place out;
    out.position_mm << q + offset_mm + linear * (q - middle), 0;
    out.tangents.topRows<2>() = Eigen::Matrix2d::Identity() + linear;
    const Eigen::Vector2d s = (q - middle) / half_mm;
    for (const Wave& w : waves) {
      const double angle = w.wave.dot(s) + w.phase_rad;
      out.position_mm.head<2>() += w.amplitude_mm * std::sin(angle);
      out.tangents.topRows<2>() +=
          w.amplitude_mm * (std::cos(angle) / half_mm) * w.wave.transpose();
    }
    // Height c0 + c . s + s' C s.
    const Eigen::Vector2d C_s = bend_quadratic * s;
    out.position_mm.z() = bend_constant + bend_linear.dot(s) + s.dot(C_s);
    out.tangents.row(2) = ((bend_linear + 2 * C_s) / half_mm).transpose();
    return out;
  }

  BoardSpec spec;
  MaterialDomain domain;
  Eigen::Vector2d middle;  // of the points
  double half_mm = 1;
  // Shift in the plane.
  Eigen::Vector2d offset_mm = Eigen::Vector2d::Zero();
  Eigen::Matrix2d linear = Eigen::Matrix2d::Zero();
  std::vector<Wave> waves;
  // Depth, mm.
  double bend_constant = 0;
  Eigen::Vector2d bend_linear = Eigen::Vector2d::Zero();
  Eigen::Matrix2d bend_quadratic = Eigen::Matrix2d::Zero();

 private:
  void DrawMisprint(const std::vector<Eigen::Vector2d>& points, double rms_mm,
                    std::mt19937_64& random);
  void DrawBend(const std::vector<Eigen::Vector2d>& points, double depth_mm,
                std::mt19937_64& random);
};

BoardSurface::Shape::Shape(const BoardSpec& board, const BoardPrint& print, const BoardFlaws& flaws)
    : spec(board) {
  const BoardRectangle sheet = BoardOutline(spec, print);
  domain.u_min = sheet[0].x();
  domain.v_min = sheet[0].y();
  domain.u_max = sheet[2].x();
  domain.v_max = sheet[2].y();
  const auto points = NominalPoints(spec);
  middle.setZero();
  for (const auto& p : points) middle += p / static_cast<double>(points.size());
  half_mm = 0;
  for (const auto& p : points) half_mm = std::max(half_mm, (p - middle).cwiseAbs().maxCoeff());
  // Streams of their own, so that one flaw does not change the shape of the other.
  std::seed_seq misprint_seed{flaws.seed, flaws.seed >> 32, std::uint64_t{1}};
  std::seed_seq bend_seed{flaws.seed, flaws.seed >> 32, std::uint64_t{2}};
  std::mt19937_64 misprint_random(misprint_seed), bend_random(bend_seed);
  if (flaws.misprint_mm > 0) DrawMisprint(points, flaws.misprint_mm, misprint_random);
  if (flaws.bend_mm > 0) DrawBend(points, flaws.bend_mm, bend_random);
  linear += flaws.scale_error * Eigen::Matrix2d::Identity();
}

void BoardSurface::Shape::DrawMisprint(const std::vector<Eigen::Vector2d>& points, double rms_mm,
                                       std::mt19937_64& random) {
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> uniform(-std::numbers::pi, std::numbers::pi);
  const double stretch = normal(random), shear = normal(random);
  linear << stretch, shear, shear, -stretch;
  linear /= half_mm;
  for (int k = 0; k < 3; ++k) {
    // Between half a wave and one and a half over the board.
    const double wave = std::numbers::pi * (0.5 + k / 2.0), direction = uniform(random);
    const Eigen::Vector2d amplitude(normal(random), normal(random));
    waves.push_back({0.7 * amplitude,
                     wave * Eigen::Vector2d(std::cos(direction), std::sin(direction)),
                     uniform(random)});
  }
  // The similarity that fits the shifts best goes: shift = t + [a -b; b a] (q - middle).
  const auto n = static_cast<Eigen::Index>(points.size());
  Eigen::MatrixXd J(2 * n, 4);
  Eigen::VectorXd shifts(2 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector2d& q = points[static_cast<std::size_t>(i)];
    const Eigen::Vector2d r = q - middle;
    J.middleRows<2>(2 * i) << 1, 0, r.x(), -r.y(), 0, 1, r.y(), r.x();
    shifts.segment<2>(2 * i) = At(q).position_mm.head<2>() - q;
  }
  const Eigen::Vector4d similarity = J.colPivHouseholderQr().solve(shifts);
  offset_mm -= similarity.head<2>();
  linear -=
      (Eigen::Matrix2d() << similarity[2], -similarity[3], similarity[3], similarity[2]).finished();
  const double rms = (shifts - J * similarity).norm() / std::sqrt(static_cast<double>(n));
  offset_mm *= rms_mm / rms;
  linear *= rms_mm / rms;
  for (Wave& w : waves) w.amplitude_mm *= rms_mm / rms;
}

void BoardSurface::Shape::DrawBend(const std::vector<Eigen::Vector2d>& points, double depth_mm,
                                   std::mt19937_64& random) {
  std::normal_distribution<double> normal(0, 1);
  const double across = normal(random), down = normal(random), twist = normal(random);
  bend_quadratic << across, twist / 2, twist / 2, down;
  // The best plane goes, so that the pose stays that of the board as a whole.
  const auto n = static_cast<Eigen::Index>(points.size());
  Eigen::MatrixXd J(n, 3);
  Eigen::VectorXd depths(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector2d& q = points[static_cast<std::size_t>(i)];
    J.row(i) << 1, (q - middle).transpose() / half_mm;
    depths[i] = At(q).position_mm.z();
  }
  const Eigen::Vector3d plane = J.colPivHouseholderQr().solve(depths);
  const Eigen::VectorXd left = depths - J * plane;
  const double scale = depth_mm / (left.maxCoeff() - left.minCoeff());
  bend_constant = -scale * plane[0];
  bend_linear = -scale * plane.tail<2>();
  bend_quadratic *= scale;
}

class BoardSurface::Instant : public SurfaceInstant {
 public:
  Instant(std::shared_ptr<const Shape> shape, const Rigid3& world_from_board)
      : shape_(std::move(shape)), world_from_board_(world_from_board) {}

  SurfacePoint At(const Eigen::Vector2d& material_mm) const override {
    const Shape::Place place = shape_->At(material_mm);
    return {world_from_board_ * place.position_mm, world_from_board_.rotation * place.tangents};
  }
  Eigen::Vector3d Velocity(const Eigen::Vector2d&) const override {
    return Eigen::Vector3d::Zero();
  }
  MaterialDomain Window() const override { return shape_->domain; }

 private:
  std::shared_ptr<const Shape> shape_;
  Rigid3 world_from_board_;
};

BoardSurface::BoardSurface(const BoardSpec& spec, const BoardPrint& print, const BoardFlaws& flaws,
                           const Rigid3& world_from_board)
    : world_from_board_(world_from_board) {
  print.Check(spec);
  flaws.Check(spec);
  shape_ = std::make_shared<const Shape>(spec, print, flaws);
}

BoardSurface BoardSurface::MovedTo(const Rigid3& world_from_board) const {
  BoardSurface moved = *this;
  moved.world_from_board_ = world_from_board;
  return moved;
}

Eigen::Vector3d BoardSurface::PointAsMade(int id) const {
  return shape_->At(shape_->spec.NominalPoint(id).head<2>()).position_mm;
}

MaterialDomain BoardSurface::Domain() const { return shape_->domain; }

std::unique_ptr<const SurfaceInstant> BoardSurface::At(double) const {
  return std::make_unique<Instant>(shape_, world_from_board_);
}

std::unique_ptr<const SurfaceInstant> BoardSurface::Reference(double time_s) const {
  return At(time_s);
}

}  // namespace plumbline
