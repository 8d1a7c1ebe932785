#pragma once
// How a scene of the library is made: its parameters with their ranges, and the function that builds it.

#include <map>
#include <string>
#include <vector>

#include "scene/library/builder.h"
#include "scene/library/motion.h"

namespace gleaner::scene {

struct Parameter {
  std::string name;
  double value, lowest, highest;
  bool whole = false;  // whole numbers only
};

// The parameters of one scene, each within its range.
class Values {
 public:
  explicit Values(std::map<std::string, double> values) : values_(std::move(values)) {}
  double number(const std::string& name) const { return values_.at(name); }
  std::uint32_t count(const std::string& name) const { return static_cast<std::uint32_t>(values_.at(name)); }

 private:
  std::map<std::string, double> values_;
};

struct Recipe {
  std::string name;
  std::string description;
  std::vector<Parameter> parameters;
  Scene (*make)(const std::string& name, const Values& values);
  AnimatedScene (*animate)(const std::string& name, const Values& values) = nullptr;  // instead, of a scene that moves
};

std::vector<Recipe> cornell_recipes();
std::vector<Recipe> furnace_recipes();
std::vector<Recipe> form_factor_recipes();
std::vector<Recipe> light_recipes();
std::vector<Recipe> material_recipes();
std::vector<Recipe> hall_recipes();
std::vector<Recipe> room_recipes();
std::vector<Recipe> stress_recipes();
std::vector<Recipe> moving_recipes();

// Shared by the recipes of several files.
Scene hall(const std::string& name, const Values& values);
AnimatedScene walking_figure(const std::string& name, const Values& values);

}  // namespace gleaner::scene
