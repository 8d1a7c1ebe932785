#pragma once

#include <vector>

#include "scene/model/blob.h"
#include "scene/model/scene.h"

namespace gleaner::test {

// One triangle: enough of a scene for a blob that parses.
inline scene::Scene small_scene() {
  scene::Scene scene;
  scene.name = "triangle";
  scene.positions = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  scene.normals = std::vector<float>(9, 0.0f);
  scene.indices = {0, 1, 2};
  scene.triangle_material = {0};
  scene.meshes = {{"triangle", 0, 1}};
  scene::Material material = scene::blank_material();
  material.base_color[0] = material.base_color[1] = material.base_color[2] = 0.5f;
  scene.materials = {material};
  scene.material_names = {"grey"};
  scene::finish_materials(scene);
  return scene;
}

}  // namespace gleaner::test
