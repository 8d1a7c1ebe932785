#include "scene/library/library.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "scene/library/recipes.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

const std::vector<Recipe>& recipes() {
  static const std::vector<Recipe> all = [] {
    std::vector<Recipe> result;
    for (const auto& some : {cornell_recipes(), furnace_recipes(), form_factor_recipes(), light_recipes(),
                             material_recipes(), hall_recipes(), room_recipes(), stress_recipes(), moving_recipes()})
      result.insert(result.end(), some.begin(), some.end());
    return result;
  }();
  return all;
}

// The shortest decimal without an exponent that reads back to the same number.
std::string decimal(double value) {
  char text[32];
  const auto end = std::to_chars(text, text + sizeof text, value, std::chars_format::fixed).ptr;
  return {text, end};
}

std::string range_of(const Parameter& p) {
  return (p.whole ? "a whole number from " : "a number from ") + decimal(p.lowest) + " to " + decimal(p.highest);
}

double parse(const std::string& scene, const Parameter& p, const std::string& text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const bool read = error == std::errc{} && end == text.data() + text.size();
  if (read && value >= p.lowest && value <= p.highest && (!p.whole || value == std::floor(value))) return value;
  throw Error::usage("scene " + scene + ": " + p.name + " must be " + range_of(p) + ", found '" + text + "'");
}

template <class Range>
std::string names_of(const Range& range) {
  std::string text;
  for (const auto& item : range) text += (text.empty() ? "" : ", ") + item.name;
  return text;
}

}  // namespace

const std::vector<LibraryEntry>& library() {
  static const std::vector<LibraryEntry> entries = [] {
    std::vector<LibraryEntry> result;
    for (const Recipe& recipe : recipes()) {
      LibraryEntry entry{recipe.name, recipe.description, {}, {}};
      for (const Parameter& p : recipe.parameters) {
        entry.parameters[p.name] = decimal(p.value);
        entry.ranges[p.name] = range_of(p);
      }
      result.push_back(std::move(entry));
    }
    return result;
  }();
  return entries;
}

Scene make_scene(const std::string& name, const std::map<std::string, std::string>& parameters) {
  return make_animated_scene(name, parameters).scene;
}

AnimatedScene make_animated_scene(const std::string& name, const std::map<std::string, std::string>& parameters) {
  const auto recipe = std::find_if(recipes().begin(), recipes().end(), [&](const Recipe& r) { return r.name == name; });
  if (recipe == recipes().end())
    throw Error::usage("no scene is named '" + name + "'; there are " + names_of(recipes()));
  std::map<std::string, double> values;
  for (const Parameter& p : recipe->parameters) values[p.name] = p.value;
  for (const auto& [key, text] : parameters) {
    const auto p = std::find_if(recipe->parameters.begin(), recipe->parameters.end(),
                                [&key = key](const Parameter& candidate) { return candidate.name == key; });
    if (p == recipe->parameters.end())
      throw Error::usage("scene " + name + " has no parameter '" + key + "'; it has " +
                         (recipe->parameters.empty() ? "none" : names_of(recipe->parameters)));
    values[key] = parse(name, *p, text);
  }
  const Values chosen(std::move(values));
  return recipe->animate ? recipe->animate(name, chosen) : AnimatedScene{recipe->make(name, chosen), {}};
}

}  // namespace gleaner::scene
