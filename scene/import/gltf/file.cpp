// glTF 2.0 to flat arrays in the scene's space. Transforms are composed in double precision.

#include "scene/import/gltf/file.h"

#include "scene/import/gltf/cameras.h"
#include "scene/import/gltf/lights.h"
#include "scene/import/gltf/meshes.h"
#include "scene/import/gltf/nodes.h"
#include "scene/model/error.h"

namespace gleaner::scene::gltf {
namespace {

// The number of the material variant that is wanted; the scene learns which there are.
std::optional<std::size_t> chosen_variant(const Document& document, const std::string& wanted, Scene& scene) {
  const auto extension = document.root().extension("KHR_materials_variants");
  const auto variants = extension ? extension->find("variants") : std::nullopt;
  std::optional<std::size_t> chosen;
  std::string known;
  for (std::size_t i = 0; variants && i < variants->size(); ++i) {
    const std::string name = (*variants)[i].at("name").text();
    scene.variants.push_back(name);
    if (name == wanted && !chosen) chosen = i;
    known += (known.empty() ? "" : ", ") + name;
  }
  if (!wanted.empty() && !chosen)
    throw Error::bad_input(document.file(), "variant \"" + wanted + "\"",
                           known.empty() ? "no name: the file has no material variants" : "one of " + known);
  return chosen;
}

}  // namespace

File::File(const std::string& path, const ImportOptions& options, Warnings& warnings)
    : options_(options),
      warnings_(warnings),
      document_(path, warnings),
      animations_(document_, options.animation, warnings),
      light_units_(options.light_units) {}

Scene File::read(bool moving) {
  Scene scene;
  scene.animations = animations_.list();
  const auto variant = chosen_variant(document_, options_.variant, scene);
  materials_ = std::make_unique<Materials>(document_, scene, warnings_);
  materials_->read(options_.most_texels);
  Nodes nodes(document_, warnings_);
  rigging_ = std::make_unique<Rigging>(document_, animations_, moving, nodes, scene);
  Meshes meshes(document_, scene, *materials_, nodes, *rigging_, warnings_, variant, options_.instances);
  scene.origin = origin_for(meshes.place());
  add_cameras(document_, nodes, scene, warnings_);
  Lights lights(document_, options_.light_units, scene, warnings_);
  light_units_ = lights.units();
  lights.add(nodes);
  meshes.add();
  return scene;
}

Scene File::read_at(double seconds) {
  animations_.pose(seconds, document_);
  return read(false);
}

Scene File::read_base() { return read(true); }

bool File::read_changes(Nodes& nodes, const Scene& base, Scene& shown) {
  Warnings said_of_base;
  shown.origin = base.origin;
  add_cameras(document_, nodes, shown, said_of_base);
  Lights(document_, light_units_, shown, said_of_base).add(nodes);
  if (shown.lights.size() != base.lights.size()) return false;
  if (!animations_.animates("/materials")) {
    shown.materials = base.materials;
    shown.albedo_tables = base.albedo_tables;
    return true;
  }
  Materials materials(document_, shown, said_of_base);
  materials.read_without_images();
  if (!materials.lays_on_textures_as(*materials_)) return false;
  // What primitives without a material got.
  shown.materials.insert(shown.materials.end(), base.materials.begin() + std::ptrdiff_t(shown.materials.size()),
                         base.materials.end());
  finish_materials(shown);
  return true;
}

std::optional<ShownFrame> File::at(double seconds, const Scene& base) {
  if (animations_.needs_own_scenes() || rigging_->needs_own_scenes()) return std::nullopt;
  animations_.pose(seconds, document_);
  Warnings said_of_base;
  Nodes nodes(document_, said_of_base);
  Scene shown;
  if (!read_changes(nodes, base, shown)) return std::nullopt;
  ShownFrame frame{changes(base, shown), std::move(shown.cameras)};
  if (!rigging_->pose(nodes, base, frame.state)) return std::nullopt;
  return frame;
}

}  // namespace gleaner::scene::gltf
