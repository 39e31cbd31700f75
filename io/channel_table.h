#pragma once

#include <filesystem>
#include <vector>

#include "io/series_writer.h"

namespace plumbline {

// Signals that a logger wrote beside the cameras, out of a text table: on the logger's own clock,
// all values as they are.
//
// Columns are parted by commas, semicolons or tabs, whichever the first line has most of; quotes as
// in RFC 4180; blank lines and lines that begin with # are passed over. With semicolons or tabs a
// decimal comma is read too. The first line names the columns: "force_x [N]", "force_x (N)" or
// "force_x_N", the last with units of the list in channel_table.cc. A second line without any
// number is of units. The time is the column "time", "t" or "timestamp" (in s, or in the ms, us or
// ns that its heading names), else the first. Empty cells, "nan" and "-" are dropouts (NaN).
//
// Throws InputError, naming file, line and column, for what is no number, for times that are
// missing or go back, for a table without a channel or without rows, and for names that are there
// twice.
std::vector<Channel> ReadChannelTable(const std::filesystem::path& file);

}  // namespace plumbline
