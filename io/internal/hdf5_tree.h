#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "io/internal/hdf5.h"

// Whole trees of groups and datasets: what is in a file, and whether two files say the same.
namespace plumbline::internal::hdf5 {

struct Object {
  std::string path;  // "/" is the root; one with several links is there under each
  bool is_dataset = false;
  haddr_t address = 0;
};

// Groups come before what they hold. Throws Error, as all here.
std::vector<Object> ObjectsOf(hid_t file);

std::vector<std::string> AttributeNames(hid_t object);

// A dataset or an attribute as it is stored, texts of any length apart.
struct Values {
  Id type;
  Shape shape;
  std::vector<std::uint8_t> bytes;
  std::vector<std::string> texts;

  friend bool operator==(const Values& a, const Values& b);
};

// Throws Error where they hold references or compounds, which mean nothing in another file.
Values ValuesOf(const Id& dataset);
Values AttributeOf(hid_t object, const std::string& name);

void Write(const Id& dataset, const Values& values);
void WriteAttribute(hid_t object, const std::string& name, const Values& values);

// Attributes that HDF5's axes are made of; they hold references.
bool IsOfAxes(const std::string& attribute);

// Where two files differ, in words ("the attribute step of /grid", "/grid/pixel"); nothing: they
// say the same. compared(path, attribute): what counts; attribute is empty for the object itself,
// and what is below an object that does not count does not either.
std::optional<std::string> FirstDifference(
    hid_t a, hid_t b,
    const std::function<bool(const std::string& path, const std::string& attribute)>& compared);

}  // namespace plumbline::internal::hdf5
