#include "cli/session_words.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include "cli/frame_options.h"
#include "coordinator/gateway/convert.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;

namespace {

std::optional<double> number(const std::string& word) {
  double value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc{} || end != word.data() + word.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

// A line's words from one on, all of them numbers.
class Numbers {
 public:
  Numbers(const std::vector<std::string>& words, std::size_t first, const std::string& line) : line_(line) {
    for (std::size_t k = first; k < words.size(); ++k) {
      const auto value = number(words[k]);
      if (!value) throw Error::usage("\"" + line + "\": expected a number, found \"" + words[k] + "\"");
      values_.push_back(*value);
    }
  }
  const std::vector<double>& expect(std::size_t least, std::size_t most) const {
    if (values_.size() < least || values_.size() > most)
      throw Error::usage("\"" + line_ + "\": expected " + std::to_string(least) +
                         (most > least ? " to " + std::to_string(most) : "") + " numbers, found " +
                         std::to_string(values_.size()));
    return values_;
  }
  const std::vector<double>& expect(std::size_t count) const { return expect(count, count); }

 private:
  std::string line_;
  std::vector<double> values_;
};

void set(pb::Vector3& to, const std::vector<double>& v, const std::array<double, 3>& origin = {}) {
  to.set_x(static_cast<float>(v[0] - origin[0]));
  to.set_y(static_cast<float>(v[1] - origin[1]));
  to.set_z(static_cast<float>(v[2] - origin[2]));
}

std::uint32_t index(const std::string& word, std::size_t count, const std::string& what) {
  const auto value = number(word);
  if (!value || *value < 0 || *value >= static_cast<double>(count) || *value != std::floor(*value))
    throw Error::bad_input(
        "session", what + " \"" + word + "\"",
        count ? "a number from 0 to " + std::to_string(count - 1) : "none: the scene has no " + what);
  return static_cast<std::uint32_t>(*value);
}

}  // namespace

const char* SessionWords::help() {
  return "Lines on standard input:\n"
         "  light N position X Y Z | light N direction X Y Z | light N intensity R G B\n"
         "  material NAME color R G B | material NAME emission R G B   (NAME or its number)\n"
         "  object NAME move X Y Z | object NAME matrix M11 ... M34    (of --movable NAME)\n"
         "  camera EX EY EZ TX TY TZ [FOV]\n"
         "  wait      until a picture shows all changes so far\n"
         "  settle    until the finest picture of them has come\n"
         "  quit      (or the end of the input, once all changes are shown)\n";
}

SessionWords::SessionWords(const scene::Scene& scene, const coordinator::FrameSettings& settings,
                           std::map<std::string, std::uint32_t> objects)
    : settings_(settings), objects_(std::move(objects)) {
  names_.origin = scene.origin;
  names_.lights = scene.lights;
  names_.materials = scene.materials;
  names_.material_names = scene.material_names;
}

std::uint32_t SessionWords::material(const std::string& word) const {
  const auto found = std::ranges::find(names_.material_names, word);
  if (found != names_.material_names.end()) return static_cast<std::uint32_t>(found - names_.material_names.begin());
  return index(word, names_.materials.size(), "material");
}

SessionWords::Meaning SessionWords::read(const std::string& line) const {
  std::vector<std::string> words;
  std::istringstream stream(line);
  for (std::string word; stream >> word;) words.push_back(word);
  if (words.empty() || words[0][0] == '#') return std::monostate{};
  const auto is = [&](std::size_t at, const char* word) { return at < words.size() && words[at] == word; };
  if (words.size() == 1 && is(0, "wait")) return SessionPause::shown;
  if (words.size() == 1 && is(0, "settle")) return SessionPause::settled;
  if (words.size() == 1 && is(0, "quit")) return SessionEnd{};
  pb::SessionChange change;
  if (is(0, "camera")) {
    Numbers(words, 1, line).expect(6, 7);
    std::string look_at = words[1];
    for (std::size_t k = 2; k < words.size(); ++k) look_at.append(",").append(words[k]);
    *change.mutable_camera() = gateway::to_proto(look_at_camera(look_at, names_, settings_));
    return change;
  }
  if (words.size() > 3 && is(0, "light")) {
    pb::LightChange& light = *change.add_lights();
    light.set_light(index(words[1], names_.lights.size(), "light"));
    const std::vector<double> values = Numbers(words, 3, line).expect(3);
    if (is(2, "position")) return set(*light.mutable_position(), values, names_.origin), change;
    if (is(2, "direction")) return set(*light.mutable_direction(), values), change;
    if (is(2, "intensity")) return set(*light.mutable_intensity(), values), change;
  }
  if (words.size() > 3 && is(0, "material")) {
    pb::MaterialChange& changed = *change.add_materials();
    changed.set_material(material(words[1]));
    const std::vector<double> values = Numbers(words, 3, line).expect(3);
    if (is(2, "color")) return set(*changed.mutable_base_color(), values), change;
    if (is(2, "emission")) return set(*changed.mutable_emission(), values), change;
  }
  if (words.size() > 3 && is(0, "object")) {
    const auto object = objects_.find(words[1]);
    if (object == objects_.end())
      throw Error::bad_input("session", "object \"" + words[1] + "\"", "one that --movable names");
    pb::ObjectChange& moved = *change.add_objects();
    moved.set_matrix(object->second);
    if (is(2, "move")) {
      const std::vector<double> by = Numbers(words, 3, line).expect(3);
      for (int k = 0; k < 12; ++k) moved.add_placement(k % 4 == 3 ? by[static_cast<std::size_t>(k / 4)] : k % 5 == 0);
      return change;
    }
    if (is(2, "matrix")) {
      for (const double value : Numbers(words, 3, line).expect(12)) moved.add_placement(value);
      return change;
    }
  }
  throw Error::usage("\"" + line + "\": expected words of a session\n" + help());
}

}  // namespace gleaner::cli
