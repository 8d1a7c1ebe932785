// glTF 2.0 to flat arrays in the scene's space. Transforms are composed in double precision.

#include "scene/import/formats.h"
#include "scene/import/gltf/animation.h"
#include "scene/import/gltf/cameras.h"
#include "scene/import/gltf/document.h"
#include "scene/import/gltf/lights.h"
#include "scene/import/gltf/materials.h"
#include "scene/import/gltf/meshes.h"
#include "scene/import/gltf/nodes.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using gltf::Document;
using gltf::Element;

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

Scene read_gltf(const std::string& path, const ImportOptions& options, Warnings& warnings) {
  Document document(path, warnings);
  Scene scene;
  const gltf::Animations animations(document, options.animation, warnings);
  scene.animations = animations.list();
  animations.pose(options.seconds, document);
  const auto variant = chosen_variant(document, options.variant, scene);
  gltf::Materials materials(document, scene, warnings);
  materials.read(options.most_texels);
  gltf::Nodes nodes(document, warnings);
  gltf::Meshes meshes(document, scene, materials, nodes, warnings, variant, options.instances);
  scene.origin = origin_for(meshes.place());
  add_cameras(document, nodes, scene, warnings);
  gltf::Lights(document, options.light_units, scene, warnings).add(nodes);
  meshes.add();
  return scene;
}

}  // namespace gleaner::scene
