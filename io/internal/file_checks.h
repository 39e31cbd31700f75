#pragma once

#include <string>
#include <vector>

#include "io/internal/hdf5.h"

// What may be wrong with a results file that opens, by docs/file_format.md: one sentence a finding,
// and no exception for a fault of the file.
namespace plumbline::internal {

// Groups, attributes and datasets that have to be there, and their shapes, which have to agree with
// each other (frames, rows, columns, parameters, modes).
std::vector<std::string> CheckLayout(hid_t file, bool is_series);

// Of every dataset: units, long_name, and an axis of the right length on every dimension.
std::vector<std::string> CheckDatasets(hid_t file);

// Of every frame of a series: values are numbers where the status says so, and NaN elsewhere; a
// displacement, strain or velocity may be NaN too, and then all that goes by it. Nothing is
// infinite. Sigmas from the calibration may be missing at single points, and everywhere where the
// rig has no calibration modes. The times of channels do not go back. Datasets that are not there,
// or not of the size of /surface/status, are passed over: CheckLayout() names them.
std::vector<std::string> CheckValues(hid_t file);

}  // namespace plumbline::internal
