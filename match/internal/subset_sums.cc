#include "match/internal/subset_sums.h"

#include <algorithm>
#include <cstdint>

#include "match/internal/bspline.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "match/internal/subset_sums.cc"
#include <hwy/foreach_target.h>
// Highway's own header comes after the one that compiles this file once an instruction set.
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace plumbline::internal::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// At most kRun floats a vector, so that a run is a whole number of them.
using D = hn::CappedTag<float, PackedSubset::kRun>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;

inline double Total(V v) { return static_cast<double>(hn::GetLane(hn::SumOfLanes(D(), v))); }

// Sums v m_k over the subset, for all monomials up to a degree: first by powers of x along a row,
// then by powers of y.
template <int kDegree>
class MomentSums {
 public:
  MomentSums() {
    for (V& sum : along_row_) sum = hn::Zero(D());
    for (V& sum : sums_) sum = hn::Zero(D());
  }
  // Written out term by term: every sum stays in a register.
  HWY_INLINE void Add(V v, V x) {
    along_row_[0] = hn::Add(along_row_[0], v);
    if constexpr (kDegree >= 1) along_row_[1] = hn::MulAdd(v, x, along_row_[1]);
    if constexpr (kDegree >= 2) {
      const V xx = hn::Mul(x, x);
      along_row_[2] = hn::MulAdd(v, xx, along_row_[2]);
      if constexpr (kDegree >= 4) {
        const V vxx = hn::Mul(v, xx);
        along_row_[3] = hn::MulAdd(vxx, x, along_row_[3]);
        along_row_[4] = hn::MulAdd(vxx, xx, along_row_[4]);
      }
    }
  }
  // Monomials of degree n stand in the order x^n, x^(n-1) y, ...
  HWY_INLINE void EndRow(float row) {
    const D d;
    const V y = hn::Set(d, row);
    sums_[0] = hn::Add(sums_[0], along_row_[0]);
    if constexpr (kDegree >= 1) {
      sums_[1] = hn::Add(sums_[1], along_row_[1]);
      sums_[2] = hn::MulAdd(along_row_[0], y, sums_[2]);
    }
    if constexpr (kDegree >= 2) {
      const V yy = hn::Set(d, row * row);
      sums_[3] = hn::Add(sums_[3], along_row_[2]);
      sums_[4] = hn::MulAdd(along_row_[1], y, sums_[4]);
      sums_[5] = hn::MulAdd(along_row_[0], yy, sums_[5]);
      if constexpr (kDegree >= 4) {
        const V yyy = hn::Set(d, row * row * row);
        const V yyyy = hn::Set(d, row * row * row * row);
        sums_[6] = hn::Add(sums_[6], along_row_[3]);
        sums_[7] = hn::MulAdd(along_row_[2], y, sums_[7]);
        sums_[8] = hn::MulAdd(along_row_[1], yy, sums_[8]);
        sums_[9] = hn::MulAdd(along_row_[0], yyy, sums_[9]);
        sums_[10] = hn::Add(sums_[10], along_row_[4]);
        sums_[11] = hn::MulAdd(along_row_[3], y, sums_[11]);
        sums_[12] = hn::MulAdd(along_row_[2], yy, sums_[12]);
        sums_[13] = hn::MulAdd(along_row_[1], yyy, sums_[13]);
        sums_[14] = hn::MulAdd(along_row_[0], yyyy, sums_[14]);
      }
    }
    for (V& sum : along_row_) sum = hn::Zero(d);
  }
  void Store(double* to) const {
    for (int k = 0; k < kTerms; ++k) to[k] = Total(sums_[k]);
  }

 private:
  static_assert(kDegree <= 2 || kDegree == 4);
  static constexpr int kTerms = (kDegree + 1) * (kDegree + 2) / 2;
  V along_row_[kDegree + 1];
  V sums_[kTerms];
};

// Calls visit(place in the arrays, offsets along x) for each vector of a row.
template <typename Visit>
HWY_INLINE void ForEachVector(const PackedSubset::Row& row, const Visit& visit) {
  const D d;
  const V iota = hn::Iota(d, static_cast<float>(row.x));
  for (int i = 0; i < row.count; i += static_cast<int>(hn::Lanes(d))) {
    visit(row.at + static_cast<std::size_t>(i), hn::Add(iota, hn::Set(d, static_cast<float>(i))));
  }
}

template <int kOrder>
ReferenceSums ReferenceOfOrder(const PackedSubset& subset) {
  const D d;
  V f_sum = hn::Zero(d);
  V ff_sum = hn::Zero(d);
  MomentSums<kOrder> gradient_x, gradient_y, f_gradient_x, f_gradient_y;
  for (const PackedSubset::Row& row : subset.rows) {
    ForEachVector(row, [&](std::size_t at, V x) HWY_ATTR {
      const V f = hn::Load(d, subset.grey.data() + at);
      const V gx = hn::Load(d, subset.gradient_x.data() + at);
      const V gy = hn::Load(d, subset.gradient_y.data() + at);
      f_sum = hn::Add(f_sum, f);
      ff_sum = hn::MulAdd(f, f, ff_sum);
      gradient_x.Add(gx, x);
      gradient_y.Add(gy, x);
      f_gradient_x.Add(hn::Mul(f, gx), x);
      f_gradient_y.Add(hn::Mul(f, gy), x);
    });
    gradient_x.EndRow(row.y);
    gradient_y.EndRow(row.y);
    f_gradient_x.EndRow(row.y);
    f_gradient_y.EndRow(row.y);
  }
  ReferenceSums sums;
  sums.f = Total(f_sum);
  sums.ff = Total(ff_sum);
  gradient_x.Store(sums.gradient_x);
  gradient_y.Store(sums.gradient_y);
  f_gradient_x.Store(sums.f_gradient_x);
  f_gradient_y.Store(sums.f_gradient_y);
  return sums;
}

template <int kOrder>
ProductSums ProductsOfOrder(const PackedSubset& subset, const float* gradient_x,
                            const float* gradient_y) {
  const D d;
  MomentSums<2 * kOrder> xx, xy, yy;
  for (const PackedSubset::Row& row : subset.rows) {
    ForEachVector(row, [&](std::size_t at, V x) HWY_ATTR {
      const V gx = hn::Load(d, gradient_x + at);
      const V gy = hn::Load(d, gradient_y + at);
      xx.Add(hn::Mul(gx, gx), x);
      xy.Add(hn::Mul(gx, gy), x);
      yy.Add(hn::Mul(gy, gy), x);
    });
    xx.EndRow(row.y);
    xy.EndRow(row.y);
    yy.EndRow(row.y);
  }
  ProductSums sums;
  xx.Store(sums.xx);
  xy.Store(sums.xy);
  yy.Store(sums.yy);
  return sums;
}

// Weights of all taps along one axis; s = fraction - 1/2.
template <int kDegree>
HWY_INLINE void Weights(const SplineTapPolynomials& taps, V s, V* weights) {
  const D d;
  const V ss = hn::Mul(s, s);
  for (int k = 0; k <= kDegree / 2; ++k) {
    V even = hn::MulAdd(hn::Set(d, taps.even[1][k]), ss, hn::Set(d, taps.even[0][k]));
    V odd = hn::MulAdd(hn::Set(d, taps.odd[1][k]), ss, hn::Set(d, taps.odd[0][k]));
    if constexpr (kDegree == 5) {
      const V s4 = hn::Mul(ss, ss);
      even = hn::MulAdd(hn::Set(d, taps.even[2][k]), s4, even);
      odd = hn::MulAdd(hn::Set(d, taps.odd[2][k]), s4, odd);
    }
    weights[k] = hn::MulAdd(s, odd, even);
    weights[kDegree - k] = hn::NegMulAdd(s, odd, even);
  }
}

// Room for the weights of lanes that stray by so many columns or lines.
constexpr int kMostStray = 2;
template <int kDegree>
constexpr int kRoom = kDegree + 1 + kMostStray;

// Moves the weights of lanes on by as many taps as they are ahead (0 to `most`), zeros before them.
template <int kDegree>
HWY_INLINE void MoveOn(hn::Vec<DI> ahead, int most, V* weights) {
  const D d;
  const DI di;
  for (int k = 1; k <= most; ++k) {
    const hn::Mask<D> moved = hn::RebindMask(d, hn::Gt(ahead, hn::Set(di, k - 1)));
    weights[kDegree + k] = hn::IfThenElseZero(moved, weights[kDegree + k - 1]);
    for (int i = kDegree + k - 1; i > 0; --i) {
      weights[i] = hn::IfThenElse(moved, weights[i - 1], weights[i]);
    }
    weights[0] = hn::IfThenZeroElse(moved, weights[0]);
  }
}

// Sums coefficients times weights; `corner` is the first coefficient of the first lane.
template <int kTapsX>
HWY_INLINE V Interpolate(const float* HWY_RESTRICT corner, std::ptrdiff_t stride, int taps_y,
                         const V* along_x, const V* along_y) {
  const D d;
  V value = hn::Zero(d);
  for (int j = 0; j < taps_y; ++j) {
    V row = hn::Mul(along_x[0], hn::LoadU(d, corner));
    for (int i = 1; i < kTapsX; ++i) row = hn::MulAdd(along_x[i], hn::LoadU(d, corner + i), row);
    value = hn::MulAdd(along_y[j], row, value);
    corner += stride;
  }
  return value;
}

// Where the pixels of the first `count` lanes lie: column (less the lane) and line of the first
// coefficient that each takes. The other lanes' are anywhere.
struct Places {
  hn::Vec<DI> column, line;
  int count;
};

// Lanes that lie anywhere: one group of those side by side after the other.
template <int kDegree>
HWY_NOINLINE V InterpolateApart(const TargetPixels& target, const Places& places,
                                const std::int32_t* columns, const std::int32_t* lines,
                                const V* along_x, const V* along_y) {
  const D d;
  const DI di;
  V value = hn::Zero(d);
  hn::Mask<D> left = hn::FirstN(d, static_cast<std::size_t>(places.count));
  for (std::intptr_t lane = hn::FindFirstTrue(d, left); lane >= 0;
       lane = hn::FindFirstTrue(d, left)) {
    const hn::Mask<DI> together = hn::And(hn::Eq(places.column, hn::Set(di, columns[lane])),
                                          hn::Eq(places.line, hn::Set(di, lines[lane])));
    const hn::Mask<D> group = hn::And(hn::RebindMask(d, together), left);
    const float* corner = target.coefficients + lines[lane] * target.stride + columns[lane];
    value = hn::IfThenElse(
        group, Interpolate<kDegree + 1>(corner, target.stride, kDegree + 1, along_x, along_y),
        value);
    left = hn::AndNot(group, left);
  }
  return value;
}

// Lanes that lie nearly side by side, as under a stretch: all of them at once, with some more taps.
template <int kDegree>
HWY_NOINLINE V InterpolateStraying(const TargetPixels& target, const Places& places, V* along_x,
                                   V* along_y) {
  const D d;
  const DI di;
  HWY_ALIGN std::int32_t columns[PackedSubset::kRun];
  HWY_ALIGN std::int32_t lines[PackedSubset::kRun];
  hn::Store(places.column, di, columns);
  hn::Store(places.line, di, lines);
  const int last = places.count - 1;
  const int column = std::min(columns[0], columns[last]);
  const int line = std::min(lines[0], lines[last]);
  const int more_x = std::max(columns[0], columns[last]) - column;
  const int more_y = std::max(lines[0], lines[last]) - line;
  const hn::Vec<DI> columns_ahead = hn::Sub(places.column, hn::Set(di, column));
  const hn::Vec<DI> lines_ahead = hn::Sub(places.line, hn::Set(di, line));
  // Under a warp that bends, the outermost lanes need not be the first and the last.
  const hn::Vec<DI> zero = hn::Zero(di);
  const auto beyond = hn::Or(
      hn::Or(hn::Lt(columns_ahead, zero), hn::Lt(lines_ahead, zero)),
      hn::Or(hn::Gt(columns_ahead, hn::Set(di, more_x)), hn::Gt(lines_ahead, hn::Set(di, more_y))));
  if (more_x > kMostStray || more_y > kMostStray ||
      !hn::AllFalse(d, hn::And(hn::RebindMask(d, beyond),
                               hn::FirstN(d, static_cast<std::size_t>(places.count))))) {
    return InterpolateApart<kDegree>(target, places, columns, lines, along_x, along_y);
  }
  MoveOn<kDegree>(columns_ahead, more_x, along_x);
  MoveOn<kDegree>(lines_ahead, more_y, along_y);
  const float* corner = target.coefficients + line * target.stride + column;
  const int taps_y = kDegree + 1 + more_y;
  switch (more_x) {
    case 0:
      return Interpolate<kDegree + 1>(corner, target.stride, taps_y, along_x, along_y);
    case 1:
      return Interpolate<kDegree + 2>(corner, target.stride, taps_y, along_x, along_y);
    default:
      return Interpolate<kDegree + 3>(corner, target.stride, taps_y, along_x, along_y);
  }
}

// The spline at one pixel, the taps along x side by side: for what a row has beyond its whole
// vectors.
template <int kDegree>
class OnePixel {
 public:
  explicit OnePixel(const SplineTapPolynomials& taps) : taps_(taps) {}

  HWY_INLINE float Interpolate(const TargetPixels& target, float x, float y) const {
    const DTaps d;
    const float floor_x = hn::GetLane(hn::Floor(hn::Set(d, x)));
    const float floor_y = hn::GetLane(hn::Floor(hn::Set(d, y)));
    HWY_ALIGN float along_x[kPadded], along_y[kPadded];
    Weights(x - floor_x - 0.5F, along_x);
    Weights(y - floor_y - 0.5F, along_y);
    constexpr int kBefore = (kDegree - 1) / 2;
    const float* const corner = target.coefficients +
                                (static_cast<int>(floor_y) - kBefore) * target.stride +
                                (static_cast<int>(floor_x) - kBefore);
    auto sum = hn::Zero(d);
    for (int i = 0; i < kPadded; i += static_cast<int>(hn::Lanes(d))) {
      auto column = hn::Zero(d);
      for (int j = 0; j <= kDegree; ++j) {
        column = hn::MulAdd(hn::Set(d, along_y[j]), hn::LoadU(d, corner + j * target.stride + i),
                            column);
      }
      sum = hn::MulAdd(hn::Load(d, along_x + i), column, sum);
    }
    return hn::GetLane(hn::SumOfLanes(d, sum));
  }

 private:
  static constexpr int kPadded = 8;  // taps
  using DTaps = hn::CappedTag<float, kPadded>;

  HWY_INLINE void Weights(float s, float* weights) const {
    const DTaps d;
    const auto of_s = hn::Set(d, s);
    const auto ss = hn::Set(d, s * s);
    for (int i = 0; i < kPadded; i += static_cast<int>(hn::Lanes(d))) {
      auto even = hn::MulAdd(hn::Load(d, taps_.even[2] + i), ss, hn::Load(d, taps_.even[1] + i));
      auto odd = hn::MulAdd(hn::Load(d, taps_.odd[2] + i), ss, hn::Load(d, taps_.odd[1] + i));
      even = hn::MulAdd(even, ss, hn::Load(d, taps_.even[0] + i));
      odd = hn::MulAdd(odd, ss, hn::Load(d, taps_.odd[0] + i));
      hn::Store(hn::MulAdd(of_s, odd, even), d, weights + i);
    }
  }

  const SplineTapPolynomials& taps_;
};

// The rows' polynomials in x of the warped coordinate; its second order where it is bent.
template <bool kBent>
HWY_INLINE V Warped(const float* warp, float y, V x) {
  const D d;
  if constexpr (!kBent) {
    return hn::MulAdd(x, hn::Set(d, warp[1]), hn::Set(d, warp[0] + y * warp[2]));
  } else {
    const V linear = hn::MulAdd(x, hn::Set(d, warp[3]), hn::Set(d, warp[1] + y * warp[4]));
    return hn::MulAdd(x, linear, hn::Set(d, warp[0] + y * (warp[2] + y * warp[5])));
  }
}

// The spline where consecutive pixels of the reference go: the first `count` lanes.
template <int kDegree>
HWY_INLINE V SplineAt(const SplineTapPolynomials& taps, const TargetPixels& target, V x, V y,
                      int count) {
  const D d;
  const DI di;
  const V floor_x = hn::Floor(x);
  const V floor_y = hn::Floor(y);
  const V half_pixel = hn::Set(d, 0.5F);
  V along_x[kRoom<kDegree>];
  V along_y[kRoom<kDegree>];
  Weights<kDegree>(taps, hn::Sub(hn::Sub(x, floor_x), half_pixel), along_x);
  Weights<kDegree>(taps, hn::Sub(hn::Sub(y, floor_y), half_pixel), along_y);
  constexpr int kBefore = (kDegree - 1) / 2;
  // The same in all lanes whose pixels lie side by side.
  const Places places{hn::Sub(hn::ConvertTo(di, floor_x), hn::Iota(di, kBefore)),
                      hn::Sub(hn::ConvertTo(di, floor_y), hn::Set(di, kBefore)), count};
  const std::int32_t column = hn::GetLane(places.column);
  const std::int32_t line = hn::GetLane(places.line);
  const hn::Mask<D> apart = hn::RebindMask(d, hn::Or(hn::Ne(places.column, hn::Set(di, column)),
                                                     hn::Ne(places.line, hn::Set(di, line))));
  if (HWY_LIKELY(hn::AllFalse(d, hn::And(apart, hn::FirstN(d, static_cast<std::size_t>(count)))))) {
    return Interpolate<kDegree + 1>(target.coefficients + line * target.stride + column,
                                    target.stride, kDegree + 1, along_x, along_y);
  }
  return InterpolateStraying<kDegree>(target, places, along_x, along_y);
}

template <int kOrder, int kDegree, bool kBent>
TargetSums TargetOfOrder(const PackedSubset& subset, const TargetPixels& target) {
  static const SplineTapPolynomials kTaps = TapPolynomials(kDegree);
  const SplineTapPolynomials taps = kTaps;
  const OnePixel<kDegree> one_pixel(taps);
  const D d;
  const V offset = hn::Set(d, target.grey_offset);
  V g_sum = hn::Zero(d);
  V gg_sum = hn::Zero(d);
  V fg_sum = hn::Zero(d);
  MomentSums<kOrder> gradient_x, gradient_y;
  for (const PackedSubset::Row& row : subset.rows) {
    ForEachVector(row, [&](std::size_t at, V x) HWY_ATTR {
      const V to_x = Warped<kBent>(target.warp_x, row.y, x);
      const V to_y = Warped<kBent>(target.warp_y, row.y, x);
      const int left = row.count - static_cast<int>(at - row.at);
      V g;
      if (left == 1) {
        g = hn::Set(d, one_pixel.Interpolate(target, hn::GetLane(to_x), hn::GetLane(to_y)));
      } else {
        g = SplineAt<kDegree>(taps, target, to_x, to_y,
                              std::min(left, static_cast<int>(hn::Lanes(d))));
      }
      const V weight = hn::Load(d, subset.weight.data() + at);
      g = hn::Mul(hn::Sub(g, offset), weight);
      const V f = hn::Load(d, subset.grey.data() + at);
      g_sum = hn::Add(g_sum, g);
      gg_sum = hn::MulAdd(g, g, gg_sum);
      fg_sum = hn::MulAdd(f, g, fg_sum);
      gradient_x.Add(hn::Mul(g, hn::Load(d, subset.gradient_x.data() + at)), x);
      gradient_y.Add(hn::Mul(g, hn::Load(d, subset.gradient_y.data() + at)), x);
    });
    gradient_x.EndRow(row.y);
    gradient_y.EndRow(row.y);
  }
  TargetSums sums;
  sums.g = Total(g_sum);
  sums.gg = Total(gg_sum);
  sums.fg = Total(fg_sum);
  gradient_x.Store(sums.gradient_x);
  gradient_y.Store(sums.gradient_y);
  return sums;
}

void CopyHere(const PackedSubset& subset, const float* plane, std::ptrdiff_t stride, float offset,
              bool weighted, float* to) {
  const D d;
  const auto lanes = static_cast<int>(hn::Lanes(d));
  const V less = hn::Set(d, offset);
  for (const PackedSubset::Row& row : subset.rows) {
    const float* from = plane + static_cast<std::ptrdiff_t>(row.y) * stride + row.x;
    float* begin = to + row.at;
    int i = 0;
    for (; i + lanes <= row.count; i += lanes) {
      hn::Store(hn::Sub(hn::LoadU(d, from + i), less), d, begin + i);
    }
    for (; i < row.count; ++i) begin[i] = from[i] - offset;
    for (; i < row.runs * PackedSubset::kRun; ++i) begin[i] = 0;
    if (!weighted) continue;
    for (i = 0; i < row.runs * PackedSubset::kRun; i += lanes) {
      const V weight = hn::Load(d, subset.weight.data() + row.at + i);
      hn::Store(hn::Mul(hn::Load(d, begin + i), weight), d, begin + i);
    }
  }
}

ReferenceSums ReferenceHere(const PackedSubset& subset, int order) {
  return order == 0   ? ReferenceOfOrder<0>(subset)
         : order == 1 ? ReferenceOfOrder<1>(subset)
                      : ReferenceOfOrder<2>(subset);
}

ProductSums ProductsHere(const PackedSubset& subset, const float* x, const float* y, int order) {
  return order == 0   ? ProductsOfOrder<0>(subset, x, y)
         : order == 1 ? ProductsOfOrder<1>(subset, x, y)
                      : ProductsOfOrder<2>(subset, x, y);
}

template <int kDegree>
TargetSums TargetOfDegree(const PackedSubset& subset, const TargetPixels& target, int order) {
  if (target.bent && order < 2) {
    return order == 0 ? TargetOfOrder<0, kDegree, true>(subset, target)
                      : TargetOfOrder<1, kDegree, true>(subset, target);
  }
  return order == 0   ? TargetOfOrder<0, kDegree, false>(subset, target)
         : order == 1 ? TargetOfOrder<1, kDegree, false>(subset, target)
                      : TargetOfOrder<2, kDegree, true>(subset, target);
}

TargetSums TargetHere(const PackedSubset& subset, const TargetPixels& target, int order) {
  return target.degree == 3 ? TargetOfDegree<3>(subset, target, order)
                            : TargetOfDegree<5>(subset, target, order);
}

const char* NameHere() { return hwy::TargetName(HWY_TARGET); }

}  // namespace plumbline::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace plumbline::internal {

HWY_EXPORT(CopyHere);
HWY_EXPORT(ReferenceHere);
HWY_EXPORT(ProductsHere);
HWY_EXPORT(TargetHere);
HWY_EXPORT(NameHere);

void CopyPlane(const PackedSubset& subset, const float* plane, std::ptrdiff_t stride, float offset,
               bool weighted, float* to) {
  HWY_DYNAMIC_DISPATCH(CopyHere)(subset, plane, stride, offset, weighted, to);
}

ReferenceSums SumReference(const PackedSubset& subset, int order) {
  return HWY_DYNAMIC_DISPATCH(ReferenceHere)(subset, order);
}

ProductSums SumProducts(const PackedSubset& subset, const AlignedFloats& x, const AlignedFloats& y,
                        int order) {
  return HWY_DYNAMIC_DISPATCH(ProductsHere)(subset, x.data(), y.data(), order);
}

TargetSums SumTarget(const PackedSubset& subset, const TargetPixels& target, int order) {
  return HWY_DYNAMIC_DISPATCH(TargetHere)(subset, target, order);
}

const char* SumsInstructionSet() { return HWY_DYNAMIC_DISPATCH(NameHere)(); }

}  // namespace plumbline::internal
#endif
