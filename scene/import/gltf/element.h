#pragma once
// One value of a glTF document with the way to it: every access is checked, and every error names the element
// ("meshes[3].name").

#include <cstddef>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

namespace gleaner::scene::gltf {

inline constexpr double kAnyNumber = std::numeric_limits<float>::max();

// Names of a member of the element `name` ("": the document itself), and of an item of an array.
std::string member_name(const std::string& name, const std::string& key);
std::string item_name(const std::string& name, std::size_t index);

// Cheap enough to pass by value; refers to the document.
class Element {
 public:
  Element(const nlohmann::json& value, std::string name, const std::string& file)
      : value_(&value), name_(std::move(name)), file_(&file) {}

  const std::string& name() const { return name_; }
  const std::string& file() const { return *file_; }

  Element at(const char* key) const;                   // error where the object lacks it
  std::optional<Element> find(const char* key) const;  // nothing where the object lacks it
  std::optional<Element> extension(const char* name) const;
  std::size_t size() const;                     // of an array
  Element operator[](std::size_t index) const;  // of an array; index < size()

  double number(double lower = -std::numeric_limits<double>::max(),
                double upper = std::numeric_limits<double>::max()) const;  // finite, within [lower, upper]
  std::uint64_t count(std::uint64_t lower, std::uint64_t upper) const;     // a whole number within [lower, upper]
  std::size_t index(std::size_t limit) const;                              // a whole number below limit
  const std::string& text() const;
  bool boolean() const;
  bool is_object() const { return value_->is_object(); }
  bool is_number() const { return value_->is_number(); }
  std::vector<double> numbers(std::size_t count, double lower = -std::numeric_limits<double>::max(),
                              double upper = std::numeric_limits<double>::max()) const;

  // number(0, upper) of a field, or `otherwise` where there is none.
  double factor(const char* key, double otherwise, double upper = 1) const;
  // numbers(N, 0, upper) of a field into `to`, which stays as it is where there is none.
  template <std::size_t N>
  void colour(const char* key, float (&to)[N], double upper = 1) const {
    if (const std::optional<Element> value = find(key)) {
      const std::vector<double> numbers = value->numbers(N, 0, upper);
      for (std::size_t i = 0; i < N; ++i) to[i] = static_cast<float>(numbers[i]);
    }
  }

  [[noreturn]] void fail(const std::string& expected) const;  // found: this value
  [[noreturn]] void fail(const std::string& expected, const std::string& found) const;

  const nlohmann::json& json() const { return *value_; }

 private:
  const nlohmann::json* value_;
  std::string name_;
  const std::string* file_;
};

// The first name that is not empty among the elements', or `otherwise`.
std::string name_of(const Element& first, const Element& second, const std::string& otherwise);

}  // namespace gleaner::scene::gltf
