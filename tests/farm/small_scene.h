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
  scene::Material material{};
  material.base_color[0] = material.base_color[1] = material.base_color[2] = 0.5f;
  material.alpha = 1;
  material.ior = 1.5f;
  material.roughness = 1;
  material.specular_color[0] = material.specular_color[1] = material.specular_color[2] = 1;
  material.base_color_texture = material.metallic_roughness_texture = material.normal_texture = GLEANER_NONE;
  material.emission_texture = material.transmission_texture = material.specular_texture = GLEANER_NONE;
  material.specular_color_texture = material.albedo_table = GLEANER_NONE;
  scene.materials = {material};
  scene.material_names = {"grey"};
  scene::finish_materials(scene);
  return scene;
}

}  // namespace gleaner::test
