#pragma once

#include <cstddef>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// The sums over a subset that correlation is made of. Each has two implementations: one for the
// instruction sets of the machine (subset_sums.cc, chosen when the program runs), and a plain one
// that says what is meant (subset_sums_scalar.cc).

// Monomials of the offset (x, y) from the subset's centre, in this order:
//   1, x, y, x^2, xy, y^2, x^3, x^2 y, x y^2, y^3, x^4, x^3 y, x^2 y^2, x y^3, y^4.
// A shape function of order n has the first 1, 3 or 6; products of two of them the first 1, 6, 15.
constexpr int kShapeTerms[3] = {1, 3, 6};
constexpr int kProductTerms[3] = {1, 6, 15};

// Floats at an address that any vector unit likes; the size can only grow.
class AlignedFloats {
 public:
  AlignedFloats() = default;
  AlignedFloats(const AlignedFloats&) = delete;  // a copy's data would lie elsewhere
  AlignedFloats& operator=(const AlignedFloats&) = delete;
  float* Resize(std::size_t size);  // contents are lost
  float* data() { return data_; }
  const float* data() const { return data_; }

 private:
  std::vector<float> storage_;
  float* data_ = nullptr;
};

// The pixels of one subset of the reference image, taken out of the planes and laid side by side:
// runs of kRun values along a row, filled up with zeros. What is not in the subset (circle, mask)
// weighs 0 and has zero grey level and gradients.
struct PackedSubset {
  static constexpr int kRun = 16;
  struct Row {
    float y;         // offset of the row from the centre
    int x;           // offset of its first value
    int count;       // of values, before the zeros
    int runs;        // kRun values each
    std::size_t at;  // of its first value in the arrays
  };
  std::vector<Row> rows;
  AlignedFloats weight;  // 1 or 0
  AlignedFloats grey;    // less the offset that was given
  AlignedFloats gradient_x;
  AlignedFloats gradient_y;
  AlignedFloats noise_x;  // other gradients, whose products are wanted alone
  AlignedFloats noise_y;
  // Rows and weights are those of a whole outline without mask, and serve the next such subset too.
  int whole_radius = -1;
  bool whole_circle = false;
};

// Which pixels belong to a subset: row by row, the offsets [begin[i], end[i]) of row i - radius.
struct SubsetOutline {
  int radius = 0;
  bool circle = false;
  std::vector<int> begin, end;

  static SubsetOutline Square(int radius);
  static SubsetOutline Circle(int radius);
};

// The planes of the reference image. Mask: 0 for pixels that do not count; may be null. Noise
// gradients may be null.
struct ReferencePlanes {
  const Image<float>* grey = nullptr;
  const Image<float>* gradient_x = nullptr;
  const Image<float>* gradient_y = nullptr;
  const Image<float>* noise_x = nullptr;
  const Image<float>* noise_y = nullptr;
  const Image<unsigned char>* mask = nullptr;
  int edge = 0;  // pixels at the border that do not count either
};

// Takes the subset around the pixel (column, row) out of the planes, cut where the image (less its
// edge) ends. Returns how many pixels count.
int Pack(const ReferencePlanes& planes, const SubsetOutline& outline, int column, int row,
         float grey_offset, PackedSubset& subset);

// f: grey level; m_k: monomials.
struct ReferenceSums {
  double f = 0, ff = 0;
  double gradient_x[6] = {}, gradient_y[6] = {};      // sum of gradient m_k
  double f_gradient_x[6] = {}, f_gradient_y[6] = {};  // sum of f gradient m_k
};

// Sums of the products of two gradients times m_k.
struct ProductSums {
  double xx[15] = {}, xy[15] = {}, yy[15] = {};
};

// The deformed image under a warp.
struct TargetPixels {
  const float* coefficients = nullptr;  // of the spline, at the pixel that the warp counts from
  std::ptrdiff_t stride = 0;
  int degree = 5;
  float grey_offset = 0;
  // Offset (x, y) in the reference -> offset from that pixel: sum_k warp_x[k] m_k(x, y). Sums of
  // order 0 and 1 use the affine part alone unless the warp is bent.
  float warp_x[6] = {}, warp_y[6] = {};
  bool bent = false;  // its second order is not zero
};

// g: grey level of the deformed image less the offset.
struct TargetSums {
  double g = 0, gg = 0, fg = 0;
  double gradient_x[6] = {}, gradient_y[6] = {};  // sum of g gradient m_k
};

ReferenceSums SumReference(const PackedSubset& subset, int order);
ProductSums SumProducts(const PackedSubset& subset, const AlignedFloats& x, const AlignedFloats& y,
                        int order);
// Every warped offset that counts must lie within the image that the coefficients are of, with a
// margin of at least 18 values and the taps around it.
TargetSums SumTarget(const PackedSubset& subset, const TargetPixels& target, int order);

ReferenceSums SumReferenceScalar(const PackedSubset& subset, int order);
ProductSums SumProductsScalar(const PackedSubset& subset, const AlignedFloats& x,
                              const AlignedFloats& y, int order);
TargetSums SumTargetScalar(const PackedSubset& subset, const TargetPixels& target, int order);

// The rows' values of a plane less an offset, each times the value's weight where some do not
// count, and zeros behind them. `plane`: at the centre of the subset.
void CopyPlane(const PackedSubset& subset, const float* plane, std::ptrdiff_t stride, float offset,
               bool weighted, float* to);

// The instruction set that the sums run on here, for reports ("AVX3", "AVX2", ...).
const char* SumsInstructionSet();

}  // namespace plumbline::internal
