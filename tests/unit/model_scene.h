#pragma once
// A scene of two triangles with one of everything that a blob carries, for tests to bend.

#include <algorithm>

#include "scene/model/scene.h"

namespace gleaner::scene {

inline Material plain_material() {
  Material m = blank_material();
  std::fill(m.base_color, m.base_color + 3, 0.5f);
  return m;
}

// A unit square in the plane z = 0 that faces +z; flat normals; its two triangles are the meshes "left" and "right".
inline Scene square() {
  Scene s;
  s.name = "square";
  s.positions = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
  s.normals = {0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1};
  s.indices = {0, 1, 2, 0, 2, 3};
  s.triangle_material = {0, 0};
  s.meshes = {{"left", 0, 1}, {"right", 1, 1}};
  s.materials = {plain_material()};
  s.material_names = {"plain"};
  return s;
}

// square() with texture, lights, cameras, glossy material and environment.
inline Scene rich_square() {
  Scene s = square();
  s.uvs = {0, 0, 1, 0, 1, 1, 0, 1};
  s.second_uvs = {0, 0, .5f, 0, .5f, .5f, 0, .5f};
  s.colors = {65535, 0, 0, 65535, 0, 65535, 0, 65535, 0, 0, 65535, 65535, 1, 2, 3, 4};
  s.textures = {{0, 2, 1, GLEANER_WRAP_CLAMP, GLEANER_WRAP_MIRROR, GLEANER_TEXTURE_SRGB, 1, {2, 0, 1, 0, 2, 1}, {}}};
  s.texels = {0xff0000ff, 0x80ffffff};
  s.materials.push_back(plain_material());
  s.material_names.push_back("glossy \xc3\xa9");
  s.materials[1].specular = 1;
  s.materials[1].roughness = 0.3f;
  s.materials[1].base_color_texture = 0;
  s.materials[1].emission[1] = 2;
  s.triangle_material[1] = 1;
  s.lights.resize(2);
  s.lights[0].type = GLEANER_LIGHT_POINT;
  s.lights[0].intensity[0] = 3;
  s.lights[1].type = GLEANER_LIGHT_SPOT;
  s.lights[1].direction[1] = -1;
  s.lights[1].cos_inner = 1;
  s.lights[1].cos_outer = 0.5f;
  s.cameras = {framing_camera(s), look_at({1, 2, 3}, {0, 0, 0}, 0.7f)};
  s.cameras[1].width = 640;
  s.cameras[1].height = 360;
  s.cameras[1].aspect = 640.0f / 360;
  s.environment = {2, 1, {0, 1, 2, 3, 4, 5}};
  finish_materials(s);
  return s;
}

}  // namespace gleaner::scene
