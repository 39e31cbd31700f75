#pragma once

#include <cstddef>

#include "calib/image.h"
#include "io/series_frame.h"
#include "match/planar_field.h"
#include "match/stereo_sequence.h"
#include "track/rolling_survey.h"

// What a file keeps of the survey of a rolling tyre, so that all can be told again without images.
namespace plumbline::internal {

// Where the points of a field are, without what was found there; and that nothing was.
PlanarField GridOf(const PlanarField& field);
StereoField NoneOf(const PlanarField& grid);

// `frame`: its place in `rolling`; grid: of the file's points, every n-th of which the survey has.
// Throws std::logic_error where it has others.
SurveyRecord SurveyRecordOf(const RollingWheel& rolling, std::size_t frame,
                            const PlanarField& grid);

// Of a frame of such a file (its index, time, problem, placement and survey), as
// RollingSurvey::AddMatched() takes it. like: a field of the file's points. Throws InputError where
// the record makes no sense.
RollingFrame RollingFrameOf(const SeriesFrame& stored, const PlanarField& like);

}  // namespace plumbline::internal
