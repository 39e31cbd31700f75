#pragma once

#include <cstdint>

#include "calib/image.h"
#include "match/correlate_field.h"
#include "match/internal/propagation.h"

namespace plumbline::internal {

// Both images of a match, as they came and as they are correlated.
struct MatchedImages {
  const GrayImage& raw_reference;
  const CorrelationImage& reference;
  const GrayImage& raw_deformed;
  const CorrelationImage& deformed;
  const Image<std::uint8_t>* mask = nullptr;  // of the reference
};

// Takes back (failed_verification, counted as not_found_back) each match that a second look at the
// raw images does not see, that its inner half contradicts where it correlates worse than most, or
// that is not found again from the deformed image.
void RejectNotFoundBack(const MatchedImages& images, const FieldOptions& options,
                        const Propagation& propagation, PlanarField& field, FieldCounts& counts);

// Takes back the points that contradict all others (counted as isolated), and background that
// stands still unless that is to be kept.
void RejectParts(bool keep_still_parts, PlanarField& field, FieldCounts& counts);

// Leaves a point without a value, for this reason.
void TakeBack(std::int64_t point, Status why, PlanarField& field);

// Counts points, attempted, ok and by_status anew.
void CountStatuses(const PlanarField& field, FieldCounts& counts);

}  // namespace plumbline::internal
