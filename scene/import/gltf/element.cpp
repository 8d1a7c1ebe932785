#include "scene/import/gltf/element.h"

#include <cmath>
#include <cstdio>

#include "scene/model/error.h"

namespace gleaner::scene::gltf {
namespace {

using nlohmann::json;

std::string describe(const json& value) {
  switch (value.type()) {
    case json::value_t::object:
      return "an object";
    case json::value_t::array:
      return "an array of " + std::to_string(value.size());
    case json::value_t::string: {
      const std::string& text = value.get_ref<const std::string&>();
      return "\"" + text.substr(0, 80) + (text.size() > 80 ? "...\"" : "\"");
    }
    default:
      return value.dump();
  }
}

// A whole number that JSON may write as 5, 5.0 or 5e0. Nothing where it is none, or negative.
std::optional<std::uint64_t> whole_number(const json& value) {
  if (value.is_number_unsigned()) return value.get<std::uint64_t>();
  if (!value.is_number_float()) return std::nullopt;
  const double real = value.get<double>();
  if (!(real >= 0 && real <= 9007199254740992.0 && real == std::floor(real))) return std::nullopt;
  return static_cast<std::uint64_t>(real);
}

}  // namespace

std::string member_name(const std::string& name, const std::string& key) {
  return name.empty() ? key : name + "." + key;
}

std::string item_name(const std::string& name, std::size_t index) { return name + "[" + std::to_string(index) + "]"; }

void Element::fail(const std::string& expected) const { fail(expected, describe(*value_)); }

void Element::fail(const std::string& expected, const std::string& found) const {
  throw Error::bad_input(*file_, name_, expected, found);
}

std::optional<Element> Element::find(const char* key) const {
  if (!value_->is_object()) fail("an object");
  const auto place = value_->find(key);
  if (place == value_->end()) return std::nullopt;
  return Element(*place, member_name(name_, key), *file_);
}

std::optional<Element> Element::extension(const char* name) const {
  const std::optional<Element> all = find("extensions");
  return all ? all->find(name) : std::nullopt;
}

Element Element::at(const char* key) const {
  if (std::optional<Element> element = find(key)) return *element;
  throw Error::bad_input(*file_, member_name(name_, key), "a value", "none");
}

std::size_t Element::size() const {
  if (!value_->is_array()) fail("an array");
  return value_->size();
}

Element Element::operator[](std::size_t index) const { return {value_->at(index), item_name(name_, index), *file_}; }

double Element::number(double lower, double upper) const {
  if (!value_->is_number()) fail("a number");
  const double value = value_->get<double>();
  if (value >= lower && value <= upper) return value;
  const auto shown = [](double x) {
    char text[32];
    std::snprintf(text, sizeof text, "%g", x);
    return std::string(text);
  };
  const bool is_open = upper >= kAnyNumber;  // what a float can hold is no limit to speak of
  if (lower <= -upper && is_open) fail("a finite number");
  fail(is_open ? "a finite number of at least " + shown(lower)
               : "a number from " + shown(lower) + " to " + shown(upper));
}

std::uint64_t Element::count(std::uint64_t lower, std::uint64_t upper) const {
  const std::optional<std::uint64_t> value = whole_number(*value_);
  if (!value || *value < lower || *value > upper)
    fail("a whole number from " + std::to_string(lower) + " to " + std::to_string(upper));
  return *value;
}

std::size_t Element::index(std::size_t limit) const {
  if (limit == 0) fail("no index: there is nothing to name");
  const std::optional<std::uint64_t> value = whole_number(*value_);
  if (!value || *value >= limit) fail("an index below " + std::to_string(limit));
  return *value;
}

const std::string& Element::text() const {
  if (!value_->is_string()) fail("a string");
  return value_->get_ref<const std::string&>();
}

bool Element::boolean() const {
  if (!value_->is_boolean()) fail("true or false");
  return value_->get<bool>();
}

std::vector<double> Element::numbers(std::size_t count, double lower, double upper) const {
  if (!value_->is_array() || value_->size() != count) fail("an array of " + std::to_string(count) + " numbers");
  std::vector<double> values;
  for (std::size_t i = 0; i < count; ++i) values.push_back((*this)[i].number(lower, upper));
  return values;
}

double Element::factor(const char* key, double otherwise, double upper) const {
  const std::optional<Element> value = find(key);
  return value ? value->number(0, upper) : otherwise;
}

std::string name_of(const Element& first, const Element& second, const std::string& otherwise) {
  for (const Element& element : {first, second})
    if (const auto name = element.find("name"); name && name->json().is_string() && !name->text().empty())
      return name->text();
  return otherwise;
}

}  // namespace gleaner::scene::gltf
