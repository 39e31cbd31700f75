#include "track/internal/frame_turns.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace plumbline::internal {
namespace {

constexpr double kSigma_rad = 2e-5;
const PlaceLattice kLattice{-0.4, -80, 0.02, 8, {41, 21}};

struct Drawn {
  std::mt19937 rng;
  std::normal_distribution<double> normal{0, 1};
  explicit Drawn(unsigned seed) : rng(seed) {}

  // 1500 points all over the lattice.
  template <typename Angle>
  AngleField Field(const Angle& angle, double sigma = kSigma_rad) {
    std::uniform_real_distribution<double> place(-0.4, 0.4), y(-80, 80);
    std::vector<PlacedAngle> points;
    for (int i = 0; i < 1500; ++i) {
      PlacedAngle p{place(rng), y(rng), 0, sigma};
      p.angle_rad = angle(p.place_rad, p.y_mm) + sigma * normal(rng);
      points.push_back(p);
    }
    return FieldOf(points, kLattice);
  }
};

TEST(FrameTurns, FieldsFollowPlanesAndEndWherePointsEnd) {
  Drawn drawn(1);
  const auto plane = [](double place, double y) { return 0.01 * place + 2e-5 * y; };
  std::uniform_real_distribution<double> place(-0.2, 0.4), y(-80, 80);
  std::vector<PlacedAngle> points;
  for (int i = 0; i < 3000; ++i) {
    const double a = place(drawn.rng), b = y(drawn.rng);
    points.push_back({a, b, plane(a, b), kSigma_rad});
  }
  const AngleField field = FieldOf(points, kLattice);
  int known = 0;
  for (int r = 0; r < kLattice.size.height; ++r) {
    for (int c = 0; c < kLattice.size.width; ++c) {
      const double at = -0.4 + 0.02 * c;
      if (at < -0.215) {
        EXPECT_TRUE(std::isnan(field.angle_rad(r, c)));
      } else if (std::isfinite(field.angle_rad(r, c))) {
        ++known;
        EXPECT_NEAR(field.angle_rad(r, c), plane(at, -80 + 8 * r), 1e-12);
        EXPECT_GT(field.sigma_rad(r, c), 0);
        EXPECT_LT(field.sigma_rad(r, c), kSigma_rad);
      }
    }
  }
  EXPECT_GT(known, 28 * 18);
}

TEST(FrameTurns, TheSigmaOfATurnIsThatOfDraws) {
  double off = 0, claimed = 0;
  constexpr int kDraws = 150;
  for (int draw = 0; draw < kDraws; ++draw) {
    Drawn drawn(10 + static_cast<unsigned>(draw));
    const AngleField a = drawn.Field([](double, double) { return 0.0; });
    const AngleField b = drawn.Field([](double, double) { return 0.003; });
    const FrameTurn turn = TurnsBetween(a, b).at(0);
    off += std::pow(turn.turn_rad - 0.003, 2) / kDraws;
    claimed += turn.sigma_rad * turn.sigma_rad / kDraws;
    EXPECT_GT(turn.support, 600);
    EXPECT_LT(turn.spread_rad, 2e-6);
  }
  EXPECT_NEAR(off / claimed, 1, 0.25);
}

TEST(FrameTurns, PlacesThatMoveOtherwiseAreLeftOutAndCountedAsSpread) {
  Drawn drawn(3);
  const AngleField a = drawn.Field([](double, double) { return 0.0; });
  // Two thirds of the surface are drawn on by something, each place by as much as it lies there.
  const AngleField b =
      drawn.Field([](double place, double) { return 0.003 + 0.01 * std::max(0.0, place + 0.13); });
  const FrameTurn turn = TurnsBetween(a, b).at(0);
  EXPECT_NEAR(turn.turn_rad, 0.003, 2e-6);
  EXPECT_GT(turn.spread_rad, 5e-4);
  EXPECT_LT(turn.support, SupportOf(a, b, 0.003) + 1);
  EXPECT_LT(SupportOf(a, b, 0), 1);
}

TEST(FrameTurns, AreThoseOfASpeedThatChangesLittle) {
  // In the middle most of what is seen goes another way at once; the others say how the wheel
  // turns.
  Drawn drawn(4);
  std::vector<AngleField> fields;
  std::vector<double> model, times;
  for (int f = 0; f < 8; ++f) {
    fields.push_back(
        drawn.Field([&](double place, double) { return f >= 4 && place > -0.1 ? -0.01 : 0.0; }));
    model.push_back(0.07 * f);
    times.push_back(f < 6 ? f : f + 1);  // one was lost
  }
  model[6] += 0.07;
  model[7] += 0.07;
  EXPECT_NEAR(TurnsBetween(fields[3], fields[4]).at(0).turn_rad, -0.01, 1e-5);
  const std::vector<FrameTurn> turns = SteadyTurns(fields, model, times);
  ASSERT_EQ(turns.size(), 7U);
  for (const FrameTurn& turn : turns) EXPECT_NEAR(turn.turn_rad, 0, 1e-5);
  EXPECT_GT(turns[3].spread_rad, 0.004);
}

TEST(FrameTurns, AreNoneWhereNothingIsSeenTwice) {
  Drawn drawn(5);
  const AngleField a = drawn.Field([](double, double) { return 0.0; });
  const AngleField nothing = FieldOf({}, kLattice);
  EXPECT_TRUE(TurnsBetween(a, nothing).empty());
  const double model[] = {0, 0.1}, times[] = {0, 1};
  const AngleField fields[] = {a, nothing};
  const std::vector<FrameTurn> turns = SteadyTurns(fields, model, times);
  ASSERT_EQ(turns.size(), 1U);
  EXPECT_EQ(turns[0].support, 0);
  EXPECT_EQ(turns[0].turn_rad, 0);
  EXPECT_TRUE(SteadyTurns({}, {}, {}).empty());
}

}  // namespace
}  // namespace plumbline::internal
