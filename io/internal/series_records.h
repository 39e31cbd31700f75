#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "io/internal/series_layout.h"

namespace plumbline::internal {

// One number, vector or matrix a frame, in a group such as /ground.
struct RecordField {
  std::string name, units, long_name;
  // Of its dimensions (none: a number): an axis of the group, or digits for a plain index of that
  // length.
  std::vector<std::string> axes;
  std::vector<Eigen::Index> shape;  // as long as `axes`
  bool needed = false;              // has to be a number where the record was found
  std::function<Eigen::MatrixXd(const SeriesFrame&)> get;
  // Puts back what get() gave. Empty: it follows from other fields.
  std::function<void(const Eigen::MatrixXd&, SeriesFrame*)> set;

  Eigen::Index rows() const { return shape.empty() ? 1 : shape[0]; }
  Eigen::Index columns() const { return shape.size() < 2 ? 1 : shape[1]; }
};

// An axis whose entries have names.
struct RecordAxis {
  std::string name, long_name;
  std::vector<std::string> labels;
};

// A group with one record a frame, which was found or not. Everything that touches these groups -
// journal, packing, reading, validating - goes by this description.
struct RecordGroup {
  std::string path;
  std::string what;    // was found
  std::string signal;  // of NXdata; empty: the group's point fields name theirs
  ContentFlag needs = nullptr;
  std::vector<RecordAxis> axes;
  std::vector<RecordField> fields;
  std::function<bool(const SeriesFrame&)> found;
  std::function<std::string(const SeriesFrame&)> problem;
  std::function<void(bool found, std::string problem, SeriesFrame*)> set_found;
  bool in_surface_frame = false;  // its vectors are along the axes of Surface::frame
  bool may_lack = false;          // one that was found may say what of it was not
};

// /ground, /wheel, /patch (without its contour), the numbers of /slip, /rigid_motion, /rig_watch,
// /rig_rotation, /deformation, /wheel_channel, /placement, those of /survey.
const std::vector<RecordGroup>& RecordGroups();

}  // namespace plumbline::internal
