#include "scene/library/builder.h"
#include "scene/model/order.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gleaner::scene {
namespace {

void set(float* to, Vec from) {
  to[0] = static_cast<float>(from.x);
  to[1] = static_cast<float>(from.y);
  to[2] = static_cast<float>(from.z);
}

void set(float* to, Rgb from) { set(to, Vec{from.r, from.g, from.b}); }

void append(std::vector<float>& to, Vec v) {
  to.push_back(static_cast<float>(v.x));
  to.push_back(static_cast<float>(v.y));
  to.push_back(static_cast<float>(v.z));
}

// glTF's defaults, but metallic 0.
Material plain(Rgb base_color, double roughness) {
  Material m = blank_material();
  set(m.base_color, base_color);
  m.specular = 1;
  m.roughness = static_cast<float>(roughness);
  return m;
}

// A grain follows the texture coordinates too.
bool reads_uvs(const Material& m) {
  const std::vector<gl_uint Material::*>& slots = texture_slots();
  return m.anisotropy > 0 ||
         std::any_of(slots.begin(), slots.end(), [&](const auto slot) { return m.*slot != GLEANER_NONE; });
}

}  // namespace

Vec normalize(Vec a) {
  const double length = std::sqrt(dot(a, a));
  return length > 0 ? (1 / length) * a : Vec{};
}

Vec rotate_y(Vec a, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * a.x + s * a.z, a.y, c * a.z - s * a.x};
}

double hash_unit(std::uint64_t item, std::uint32_t dimension) {
  return unit_hash((item + 1) * 0x9e3779b97f4a7c15ull + dimension * 0xd1b54a32d192ed03ull);
}

Material lambert(Rgb base_color) {
  Material m = plain(base_color, 1);
  m.specular = 0;
  return m;
}

Material dielectric(Rgb base_color, double roughness, double ior) {
  Material m = plain(base_color, roughness);
  m.ior = static_cast<float>(ior);
  return m;
}

Material metal(Rgb base_color, double roughness) {
  Material m = plain(base_color, roughness);
  m.metallic = 1;
  return m;
}

Material solid_glass(double ior, double roughness) {
  Material m = dielectric(grey(1), roughness, ior);
  m.transmission = 1;
  m.flags = GLEANER_MATERIAL_SOLID;
  return m;
}

Material emitter(Rgb radiance) {
  Material m = lambert(grey(0));
  set(m.emission, radiance);
  return m;
}

std::uint32_t SceneBuilder::material(const std::string& name, const Material& material) {
  scene_.materials.push_back(material);
  scene_.material_names.push_back(name);
  return static_cast<std::uint32_t>(scene_.materials.size() - 1);
}

std::uint32_t SceneBuilder::texture(std::uint32_t width, std::uint32_t height, bool srgb,
                                    const std::function<Texel(std::uint32_t, std::uint32_t)>& texel) {
  Texture record = plain_texture();
  record.first_texel = static_cast<std::uint32_t>(scene_.texels.size());
  record.width = width;
  record.height = height;
  record.wrap_u = record.wrap_v = GLEANER_WRAP_REPEAT;
  record.flags = srgb ? GLEANER_TEXTURE_SRGB : 0;
  for (std::uint32_t y = 0; y < height; ++y)
    for (std::uint32_t x = 0; x < width; ++x) {
      const Texel t = texel(x, y);
      scene_.texels.push_back(static_cast<std::uint32_t>(t.r) | static_cast<std::uint32_t>(t.g) << 8 |
                              static_cast<std::uint32_t>(t.b) << 16 | static_cast<std::uint32_t>(t.a) << 24);
    }
  scene_.textures.push_back(record);
  return static_cast<std::uint32_t>(scene_.textures.size() - 1);
}

void SceneBuilder::mesh(const std::string& name) {
  scene_.meshes.push_back({name, static_cast<std::uint32_t>(scene_.triangle_count()), 0});
}

void SceneBuilder::instanced_mesh(const std::string& name) {
  mesh(name);
  scene_.meshes.back().instanced = true;
}

void SceneBuilder::instance(Vec x, Vec y, Vec z, Vec origin) {
  const auto mesh =
      std::find_if(scene_.meshes.rbegin(), scene_.meshes.rend(), [](const Mesh& m) { return m.instanced; });
  Instance instance{};
  instance.mesh = static_cast<gl_uint>(scene_.meshes.rend() - mesh - 1);
  const Vec columns[4] = {x, y, z, origin};
  for (int c = 0; c < 4; ++c) {
    instance.transform[c] = static_cast<float>(columns[c].x);
    instance.transform[4 + c] = static_cast<float>(columns[c].y);
    instance.transform[8 + c] = static_cast<float>(columns[c].z);
  }
  scene_.instances.push_back(instance);
}

std::uint32_t SceneBuilder::vertex(Vec position, Vec normal, double u, double v) {
  append(scene_.positions, position);
  append(scene_.normals, normal);
  scene_.uvs.push_back(static_cast<float>(u));
  scene_.uvs.push_back(static_cast<float>(v));
  return static_cast<std::uint32_t>(scene_.vertex_count() - 1);
}

void SceneBuilder::triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t material) {
  scene_.indices.insert(scene_.indices.end(), {a, b, c});
  scene_.triangle_material.push_back(material);
  ++scene_.meshes.back().triangle_count;
}

void SceneBuilder::quad(Vec a, Vec b, Vec c, Vec d, std::uint32_t material) {
  const std::uint32_t i = vertex(a, {}, 0, 1), j = vertex(b, {}, 1, 1), k = vertex(c, {}, 1, 0), l = vertex(d);
  triangle(i, j, k, material);
  triangle(i, k, l, material);
}

void SceneBuilder::box(Vec centre, Vec half, double yaw, std::uint32_t material, bool inward) {
  const auto corner = [&](int x, int y, int z) { return centre + rotate_y({x * half.x, y * half.y, z * half.z}, yaw); };
  const auto face = [&](Vec a, Vec b, Vec c, Vec d) {
    if (inward)
      quad(b, a, d, c, material);
    else
      quad(a, b, c, d, material);
  };
  face(corner(-1, -1, 1), corner(1, -1, 1), corner(1, 1, 1), corner(-1, 1, 1));      // +z
  face(corner(1, -1, -1), corner(-1, -1, -1), corner(-1, 1, -1), corner(1, 1, -1));  // -z
  face(corner(1, -1, 1), corner(1, -1, -1), corner(1, 1, -1), corner(1, 1, 1));      // +x
  face(corner(-1, -1, -1), corner(-1, -1, 1), corner(-1, 1, 1), corner(-1, 1, -1));  // -x
  face(corner(-1, 1, 1), corner(1, 1, 1), corner(1, 1, -1), corner(-1, 1, -1));      // +y
  face(corner(-1, -1, -1), corner(1, -1, -1), corner(1, -1, 1), corner(-1, -1, 1));  // -y
}

void SceneBuilder::grid(std::uint32_t nu, std::uint32_t nv,
                        const std::function<Vec(std::uint32_t, std::uint32_t)>& position, std::uint32_t material,
                        GridOptions options) {
  const std::uint32_t columns = options.closed_u ? nu : nu + 1, rows = options.closed_v ? nv : nv + 1;
  std::vector<Vec> positions(std::size_t{columns} * rows);
  for (std::uint32_t j = 0; j < rows; ++j)
    for (std::uint32_t i = 0; i < columns; ++i) positions[std::size_t{j} * columns + i] = position(i, j);
  const auto at = [&](std::uint32_t i, std::uint32_t j) { return std::size_t{j % rows} * columns + i % columns; };
  std::vector<Vec> normals(positions.size());
  if (options.smooth) {
    for (std::uint32_t j = 0; j < nv; ++j)
      for (std::uint32_t i = 0; i < nu; ++i) {
        const std::size_t corner[4] = {at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)};
        const Vec area =
            cross(positions[corner[2]] - positions[corner[0]], positions[corner[3]] - positions[corner[1]]);
        for (std::size_t c : corner) normals[c] = normals[c] + area;
      }
    for (Vec& n : normals) n = normalize(n);
  }
  const auto first = static_cast<std::uint32_t>(scene_.vertex_count());
  for (std::uint32_t j = 0; j < rows; ++j)
    for (std::uint32_t i = 0; i < columns; ++i)
      vertex(positions[at(i, j)], normals[at(i, j)], static_cast<double>(i) / nu, 1 - static_cast<double>(j) / nv);
  const auto index = [&](std::uint32_t i, std::uint32_t j) { return first + static_cast<std::uint32_t>(at(i, j)); };
  for (std::uint32_t j = 0; j < nv; ++j)
    for (std::uint32_t i = 0; i < nu; ++i) {
      triangle(index(i, j), index(i + 1, j), index(i + 1, j + 1), material);
      triangle(index(i, j), index(i + 1, j + 1), index(i, j + 1), material);
    }
}

void SceneBuilder::sphere(Vec centre, double radius, std::uint32_t segments, std::uint32_t material, bool inward) {
  const std::uint32_t rings = segments / 2;
  const auto add = [&](Vec direction) { return vertex(centre + radius * direction, inward ? Vec{} : direction); };
  const auto face = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (inward)
      triangle(a, c, b, material);
    else
      triangle(a, b, c, material);
  };
  const std::uint32_t top = add({0, 1, 0});
  for (std::uint32_t ring = 1; ring < rings; ++ring)
    for (std::uint32_t i = 0; i < segments; ++i) {
      const double theta = pi * ring / rings, phi = 2 * pi * i / segments;
      add({std::sin(theta) * std::sin(phi), std::cos(theta), std::sin(theta) * std::cos(phi)});
    }
  const std::uint32_t bottom = add({0, -1, 0});
  const auto at = [&](std::uint32_t ring, std::uint32_t i) { return top + 1 + (ring - 1) * segments + i % segments; };
  for (std::uint32_t i = 0; i < segments; ++i) face(top, at(1, i), at(1, i + 1));
  for (std::uint32_t ring = 1; ring + 1 < rings; ++ring)
    for (std::uint32_t i = 0; i < segments; ++i) {
      face(at(ring, i), at(ring + 1, i), at(ring + 1, i + 1));
      face(at(ring, i), at(ring + 1, i + 1), at(ring, i + 1));
    }
  for (std::uint32_t i = 0; i < segments; ++i) face(at(rings - 1, i), bottom, at(rings - 1, i + 1));
}

void SceneBuilder::torus(Vec centre, double ring_radius, double tube_radius, std::uint32_t segments,
                         std::uint32_t material) {
  const std::uint32_t around = segments, tube = segments / 2;
  grid(around, tube,
       [&](std::uint32_t i, std::uint32_t j) {
         const double phi = 2 * pi * i / around, theta = 2 * pi * j / tube;
         const double r = ring_radius + tube_radius * std::cos(theta);
         return centre + Vec{r * std::sin(phi), tube_radius * std::sin(theta), r * std::cos(phi)};
       },
       material, {.closed_u = true, .closed_v = true});
}

void SceneBuilder::camera(const std::string& name, Vec eye, Vec target, double yfov_degrees, std::uint32_t width,
                          std::uint32_t height) {
  const auto rounded = [](Vec v) {
    return std::array<float, 3>{static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
  };
  NamedCamera named = look_at(rounded(eye), rounded(target), static_cast<float>(radians(yfov_degrees)));
  named.name = name;
  named.width = width;
  named.height = height;
  named.aspect = static_cast<float>(static_cast<double>(width) / height);
  named.camera.half_width = named.camera.half_height * named.aspect;
  scene_.cameras.push_back(named);
}

void SceneBuilder::orthographic_camera(const std::string& name, Vec origin, Vec forward, Vec up, double half_width,
                                       double half_height, std::uint32_t width, std::uint32_t height) {
  NamedCamera named;
  named.name = name;
  named.width = width;
  named.height = height;
  named.aspect = static_cast<float>(half_width / half_height);
  named.camera.type = GLEANER_CAMERA_ORTHOGRAPHIC;
  set(named.camera.origin, origin);
  set(named.camera.forward, forward);
  set(named.camera.up, up);
  set(named.camera.right, cross(forward, up));
  named.camera.half_width = static_cast<float>(half_width);
  named.camera.half_height = static_cast<float>(half_height);
  scene_.cameras.push_back(named);
}

void SceneBuilder::point_light(Vec position, Rgb intensity) {
  Light light{};
  light.type = GLEANER_LIGHT_POINT;
  set(light.position, position);
  set(light.direction, Vec{0, 0, -1});
  set(light.intensity, intensity);
  light.cos_inner = 1;
  light.cos_outer = -1;
  scene_.lights.push_back(light);
}

void SceneBuilder::spot_light(Vec position, Vec direction, Rgb intensity, double inner, double outer) {
  Light light{};
  light.type = GLEANER_LIGHT_SPOT;
  set(light.position, position);
  set(light.direction, normalize(direction));
  set(light.intensity, intensity);
  light.cos_inner = static_cast<float>(std::cos(inner));
  light.cos_outer = static_cast<float>(std::cos(outer));
  scene_.lights.push_back(light);
}

void SceneBuilder::directional_light(Vec direction, Rgb irradiance) {
  Light light{};
  light.type = GLEANER_LIGHT_DIRECTIONAL;
  set(light.direction, normalize(direction));
  set(light.intensity, irradiance);
  light.cos_inner = 1;
  light.cos_outer = -1;
  scene_.lights.push_back(light);
}

void SceneBuilder::environment(std::uint32_t width, const std::function<Rgb(Vec)>& radiance) {
  constexpr int points = 8;
  Environment& map = scene_.environment;
  map.width = width;
  map.height = width / 2;
  for (std::uint32_t y = 0; y < map.height; ++y)
    for (std::uint32_t x = 0; x < map.width; ++x) {
      Rgb sum;
      for (int j = 0; j < points; ++j)
        for (int i = 0; i < points; ++i) {
          const double p = 2 * pi * (x + (i + 0.5) / points) / map.width,
                       t = pi * (y + (j + 0.5) / points) / map.height;
          const Rgb value = radiance({std::sin(t) * std::sin(p), std::cos(t), -std::sin(t) * std::cos(p)});
          sum = {sum.r + value.r, sum.g + value.g, sum.b + value.b};
        }
      append(map.radiance, 1.0 / (points * points) * Vec{sum.r, sum.g, sum.b});
    }
}

Scene SceneBuilder::finish() {
  if (std::none_of(scene_.materials.begin(), scene_.materials.end(), reads_uvs)) scene_.uvs.clear();
  finish_materials(scene_);
  validate(scene_, scene_.name);
  return std::exchange(scene_, {});
}

}  // namespace gleaner::scene
