#pragma once

#include <cstdint>

#include "match/correlate_field.h"

namespace plumbline::internal {

// What a frame's field was composed from.
struct ComposedField {
  CorrelatedField total;  // from the reference image of the sequence
  // From the updated reference, at its pixels (also to start from); but for the covariance of the
  // displacement, which is that at the points, offset_px from these pixels (empty: at them).
  PlanarField leg;
  Image<Eigen::Vector2f> offset_px;
};

// A frame of a sequence that others are correlated with, at the places where it shows the points
// of a field. See PlanarSequence for the method.
class UpdatedReference {
 public:
  // `base`: the fields of this image; in its first leg both are the same. mask: of the sequence's
  // reference image; may be empty.
  UpdatedReference(const GrayImage& image, const ComposedField& base,
                   const Image<std::uint8_t>& mask, const FieldOptions& options);

  // As FieldCorrelator::Correlate(); the prior's displacements count from this image.
  ComposedField Correlate(const GrayImage& deformed, const FieldStart& start) const;

  std::int64_t lost() const { return lost_; }  // points that base has no value for

 private:
  ComposedField From(const GrayImage& image, const CorrelationImage& deformed,
                     const std::vector<std::pair<std::int64_t, SubsetWarp>>& starts,
                     const FieldStart& start, bool from_seeds) const;
  std::vector<std::pair<std::int64_t, SubsetWarp>> StartsOf(
      const std::vector<CorrelationSeed>& seeds) const;
  // What the noise of this image does to a leg's displacement and gradient in the mean: it takes
  // from the gain that is solved for, and where the grey levels and their gradients go together in
  // the subset, the shape function makes up for it. e = -H^-1 q n s^2 / S, q = sum grad f (f - m),
  // S = sum (f - m)^2. Far below a leg's sigma; but the same in all legs, so that it would add up.
  struct NoiseBias {
    Eigen::Vector2d displacement_px{0, 0};
    Eigen::Vector4d gradient{0, 0, 0, 0};  // row by row
  };
  NoiseBias BiasOf(std::int64_t point, const PlanarField& leg) const;
  void Compose(std::int64_t point, const SubsetWarp& warp, ComposedField& result) const;

  FieldOptions options_;
  GrayImage raw_;
  PlanarField base_;
  PlanarField base_leg_;
  Image<Eigen::Vector2f> base_offset_px_;
  Image<Eigen::Vector2i> pixels_;
  Image<std::uint8_t> mask_;
  CorrelationImage reference_;
  SubsetCorrelator correlator_;
  std::int64_t lost_ = 0;
  double noise_of_weights_ = 0;  // see Compose()
  double lost_a_px_ = 0;         // of the correlation of two legs' answers, by their offset squared
};

}  // namespace plumbline::internal
