#include "scene/import/gltf/mend.h"

#include <functional>
#include <set>
#include <string>

#include "scene/import/gltf/element.h"

namespace gleaner::scene::gltf {
namespace {

using nlohmann::json;

// The member of an object; null where `object` is none or lacks it.
json* member(json& object, const char* key) {
  if (!object.is_object()) return nullptr;
  const auto found = object.find(key);
  return found == object.end() ? nullptr : &*found;
}

// Calls `visit` for every item of an array of the document, with its name.
void for_each_item(json& document, const char* array, const std::function<void(json&, const std::string&)>& visit) {
  json* items = member(document, array);
  if (!items || !items->is_array()) return;
  for (std::size_t i = 0; i < items->size(); ++i) visit((*items)[i], item_name(array, i));
}

class Mender {
 public:
  Mender(json& document, Warnings& warnings) : document_(document), warnings_(warnings) {}

  void run() {
    drop_empty(document_, "");
    for_each_item(document_, "materials",
                  [&](json& material, const std::string& name) { round_factors(material, name); });
    for_each_item(document_, "cameras", [&](json& camera, const std::string& name) {
      if (json* lens = member(camera, "perspective"))
        drop_zero(*lens, name + ".perspective", "aspectRatio", "0 is taken as no aspect ratio");
    });
    drop_ranges();
    for_each_item(document_, "scenes", [&](json& scene, const std::string& name) { list_once(scene, name); });
  }

 private:
  // Goes down to `extras`, which are people's own.
  void drop_empty(json& value, const std::string& name) {
    if (value.is_array()) {
      if (!value.empty() && value.front().is_number()) return;
      for (std::size_t i = 0; i < value.size(); ++i) drop_empty(value[i], item_name(name, i));
      return;
    }
    if (!value.is_object()) return;
    for (auto it = value.begin(); it != value.end();) {
      const std::string child = member_name(name, it.key());
      if (it.key() == "extras") {
        ++it;
      } else if (it->is_null()) {
        warnings_.add(child, "null is taken as absent");
        it = value.erase(it);
      } else if (it.key() == "extensions" && it->is_array() && it->empty()) {
        warnings_.add(child, "an empty array is taken as absent");
        it = value.erase(it);
      } else {
        if (it->is_structured()) drop_empty(*it, child);
        ++it;
      }
    }
  }

  // Everything called "...Factor" under a material has the range 0 to 1 (core) or begins at 0 (extensions).
  void round_factors(json& value, const std::string& name) {
    if (!value.is_object()) return;
    for (const auto& [key, child] : value.items()) {
      if (key == "extras") continue;
      if (child.is_object()) round_factors(child, member_name(name, key));
      if (!key.ends_with("Factor")) continue;
      const bool is_array = child.is_array();
      for (std::size_t i = 0; i < (is_array ? child.size() : 1); ++i) {
        json& number = is_array ? child[i] : child;
        const std::string where = is_array ? item_name(member_name(name, key), i) : member_name(name, key);
        if (number.is_number_float()) round(number, where);
      }
    }
  }

  void round(json& number, const std::string& where) {
    constexpr double rounding = 1e-5;
    const double x = number.get<double>();
    if (x >= -rounding && x < 0) {
      number = 0.0;
      warnings_.add(where, "a little less than 0 is taken as 0");
    } else if (x > 1 && x <= 1 + rounding) {
      number = 1.0;
      warnings_.add(where, "a little more than 1 is taken as 1");
    }
  }

  void drop_zero(json& object, const std::string& name, const char* key, const char* warning) {
    const json* value = member(object, key);
    if (!value || !value->is_number() || *value != 0) return;
    object.erase(key);
    warnings_.add(member_name(name, key), warning);
  }

  void drop_ranges() {
    json* extensions = member(document_, "extensions");
    json* punctual = extensions ? member(*extensions, "KHR_lights_punctual") : nullptr;
    if (!punctual) return;
    for_each_item(*punctual, "lights", [&](json& light, const std::string& name) {
      drop_zero(light, "extensions.KHR_lights_punctual." + name, "range", "0 is taken as no range");
    });
  }

  void list_once(json& scene, const std::string& name) {
    json* roots = member(scene, "nodes");
    if (!roots || !roots->is_array()) return;
    json once = json::array();
    std::set<json> seen;
    for (const json& root : *roots) {
      const bool is_new = seen.insert(root).second;
      if (is_new) once.push_back(root);
      if (!is_new) warnings_.add(name + ".nodes", "a node that is listed twice is taken once");
    }
    *roots = std::move(once);
  }

  json& document_;
  Warnings& warnings_;
};

}  // namespace

void mend(json& document, Warnings& warnings) { Mender(document, warnings).run(); }

}  // namespace gleaner::scene::gltf
