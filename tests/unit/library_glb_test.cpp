#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "scene/import/import.h"
#include "scene/library/library.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

// A folder of its own, gone with the test.
class Folder {
 public:
  Folder() {
    std::string name = testing::TempDir() + "gleaner-glb-XXXXXX";
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = name;
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  std::size_t files() const {
    return static_cast<std::size_t>(
        std::distance(std::filesystem::directory_iterator(path_), std::filesystem::directory_iterator()));
  }

 private:
  std::filesystem::path path_;
};

void expect_same_material(const Material& a, const Material& b, const Scene& sa, const Scene& sb,
                          const std::string& name) {
  SCOPED_TRACE(name);
  for (int k = 0; k < 3; ++k) {
    EXPECT_EQ(a.base_color[k], b.base_color[k]);
    EXPECT_EQ(a.emission[k], b.emission[k]);
    EXPECT_EQ(a.specular_color[k], b.specular_color[k]);
    EXPECT_EQ(a.f0[k], b.f0[k]);
    EXPECT_NEAR(a.attenuation[k], b.attenuation[k], 1e-5f * a.attenuation[k]);  // through exp and log
  }
  EXPECT_EQ(a.alpha, b.alpha);
  EXPECT_EQ(a.alpha_cutoff, b.alpha_cutoff);
  EXPECT_EQ(a.specular, b.specular);
  EXPECT_EQ(a.ior, b.ior);
  EXPECT_EQ(a.metallic, b.metallic);
  EXPECT_EQ(a.roughness, b.roughness);
  EXPECT_EQ(a.transmission, b.transmission);
  EXPECT_EQ(a.normal_scale, b.normal_scale);
  EXPECT_EQ(a.flags, b.flags);
  const auto same_texture = [&](std::uint32_t i, std::uint32_t j, const char* slot) {
    SCOPED_TRACE(slot);
    ASSERT_EQ(i == GLEANER_NONE, j == GLEANER_NONE);
    if (i == GLEANER_NONE) return;
    const Texture &s = sa.textures[i], &t = sb.textures[j];
    ASSERT_EQ(s.width, t.width);
    ASSERT_EQ(s.height, t.height);
    EXPECT_EQ(s.wrap_u, t.wrap_u);
    EXPECT_EQ(s.wrap_v, t.wrap_v);
    EXPECT_EQ(s.flags, t.flags);
    EXPECT_TRUE(std::equal(sa.texels.begin() + s.first_texel, sa.texels.begin() + s.first_texel + s.width * s.height,
                           sb.texels.begin() + t.first_texel));
  };
  same_texture(a.base_color_texture, b.base_color_texture, "base colour");
  same_texture(a.metallic_roughness_texture, b.metallic_roughness_texture, "metallic-roughness");
  same_texture(a.normal_texture, b.normal_texture, "normal");
  same_texture(a.emission_texture, b.emission_texture, "emission");
  same_texture(a.transmission_texture, b.transmission_texture, "transmission");
  same_texture(a.specular_texture, b.specular_texture, "specular");
  same_texture(a.specular_color_texture, b.specular_color_texture, "specular colour");
  EXPECT_EQ(a.clearcoat, b.clearcoat);
  EXPECT_EQ(a.anisotropy, b.anisotropy);
  EXPECT_EQ(a.iridescence, b.iridescence);
  if (a.clearcoat > 0) {
    EXPECT_EQ(a.clearcoat_roughness, b.clearcoat_roughness);
  }
  if (a.anisotropy > 0) {
    EXPECT_EQ(a.anisotropy_rotation, b.anisotropy_rotation);
  }
  if (a.iridescence > 0) {
    EXPECT_EQ(a.iridescence_maximum, b.iridescence_maximum);
  }
  for (int k = 0; k < 3; ++k) EXPECT_EQ(a.sheen_color[k], b.sheen_color[k]);
}

// Where a scene's point lies in the file's coordinates: what lies far from the origin is read about its own centre.
float in_file(const Scene& s, float coordinate, std::size_t axis) {
  return static_cast<float>(s.origin[axis] + coordinate);
}

bool has_texture(const Material& m) {
  return m.base_color_texture != GLEANER_NONE || m.metallic_roughness_texture != GLEANER_NONE ||
         m.normal_texture != GLEANER_NONE || m.emission_texture != GLEANER_NONE ||
         m.transmission_texture != GLEANER_NONE || m.specular_texture != GLEANER_NONE ||
         m.specular_color_texture != GLEANER_NONE;
}

// Texture coordinates, of triangles that read a texture: the importer leaves the others out.
void expect_same_uvs(const Scene& a, const Scene& b) {
  for (std::size_t t = 0; t < a.triangle_count(); ++t) {
    if (!has_texture(a.materials[a.triangle_material[t]])) continue;
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t c = 0; c < 2; ++c)
        ASSERT_EQ(a.uvs.at(2 * a.indices[3 * t + k] + c), b.uvs.at(2 * b.indices[3 * t + k] + c)) << "triangle " << t;
  }
}

void expect_same(const Scene& a, const Scene& b) {
  ASSERT_EQ(a.positions.size(), b.positions.size());
  for (std::size_t i = 0; i < a.positions.size(); ++i)
    ASSERT_EQ(in_file(a, a.positions[i], i % 3), in_file(b, b.positions[i], i % 3)) << "coordinate " << i;
  ASSERT_EQ(a.normals.size(), b.normals.size());
  for (std::size_t i = 0; i < a.normals.size(); ++i) {
    ASSERT_NEAR(a.normals[i], b.normals[i], 1.2e-7) << "component " << i;  // the importer normalises what it reads
    ASSERT_EQ(a.normals[i] == 0, b.normals[i] == 0) << "component " << i;
  }
  EXPECT_EQ(a.indices, b.indices);
  ASSERT_EQ(a.triangle_material, b.triangle_material);
  ASSERT_EQ(a.meshes.size(), b.meshes.size());
  for (std::size_t i = 0; i < a.meshes.size(); ++i) {
    EXPECT_EQ(a.meshes[i].name, b.meshes[i].name);
    EXPECT_EQ(a.meshes[i].first_triangle, b.meshes[i].first_triangle);
    EXPECT_EQ(a.meshes[i].triangle_count, b.meshes[i].triangle_count);
  }
  EXPECT_EQ(a.material_names, b.material_names);
  ASSERT_EQ(a.materials.size(), b.materials.size());
  for (std::size_t i = 0; i < a.materials.size(); ++i)
    expect_same_material(a.materials[i], b.materials[i], a, b, a.material_names[i]);
  expect_same_uvs(a, b);
  EXPECT_EQ(a.albedo_tables, b.albedo_tables);
  ASSERT_EQ(a.lights.size(), b.lights.size());
  for (std::size_t i = 0; i < a.lights.size(); ++i) {
    const Light &l = a.lights[i], &m = b.lights[i];
    EXPECT_EQ(l.type, m.type);
    for (int k = 0; k < 3; ++k) {
      if (l.type != GLEANER_LIGHT_DIRECTIONAL) {
        EXPECT_EQ(in_file(a, l.position[k], k), in_file(b, m.position[k], k));
      }
      if (l.type != GLEANER_LIGHT_POINT) {
        EXPECT_NEAR(l.direction[k], m.direction[k], 2e-7);
      }
      EXPECT_EQ(l.intensity[k], m.intensity[k]);
    }
    EXPECT_EQ(l.range, m.range);
    if (l.type == GLEANER_LIGHT_SPOT) {
      EXPECT_NEAR(l.cos_inner, m.cos_inner, 2e-7);
      EXPECT_NEAR(l.cos_outer, m.cos_outer, 2e-7);
    }
  }
  ASSERT_EQ(a.cameras.size(), b.cameras.size());
  for (std::size_t i = 0; i < a.cameras.size(); ++i) {
    const NamedCamera &c = a.cameras[i], &d = b.cameras[i];
    EXPECT_EQ(c.name, d.name);
    EXPECT_EQ(c.width, d.width);
    EXPECT_EQ(c.height, d.height);
    EXPECT_FLOAT_EQ(c.aspect, d.aspect);
    EXPECT_EQ(c.camera.type, d.camera.type);
    EXPECT_FLOAT_EQ(c.camera.half_width, d.camera.half_width);
    EXPECT_FLOAT_EQ(c.camera.half_height, d.camera.half_height);
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(in_file(a, c.camera.origin[k], k), in_file(b, d.camera.origin[k], k));
      EXPECT_NEAR(c.camera.right[k], d.camera.right[k], 2e-7);
      EXPECT_NEAR(c.camera.up[k], d.camera.up[k], 2e-7);
      EXPECT_NEAR(c.camera.forward[k], d.camera.forward[k], 2e-7);
    }
  }
}

class EveryGlb : public testing::TestWithParam<std::string> {};

TEST_P(EveryGlb, ReadsBackTheSame) {
  const Folder folder;
  const Scene scene = make_scene(GetParam());
  const std::string path = folder / (GetParam() + ".glb");
  write_glb(scene, path);
  const Scene read = import_scene(path);
  EXPECT_EQ(read.name, scene.name);
  // The scene "far" lies where single precision is 1.6 cm.
  EXPECT_THAT(read.warnings, testing::Each(testing::HasSubstr("far from the origin")));
  EXPECT_EQ(read.warnings.empty(), GetParam() != "far");
  expect_same(scene, read);
  if (scene.environment.empty()) {
    EXPECT_EQ(folder.files(), 1u) << "something was left behind";
  } else {
    EXPECT_EQ(folder.files(), 2u);
    const Environment environment = import_environment(environment_path(path));
    EXPECT_EQ(environment.width, scene.environment.width);
    EXPECT_EQ(environment.height, scene.environment.height);
    EXPECT_EQ(environment.radiance, scene.environment.radiance);
  }
}

std::vector<std::string> names() {
  std::vector<std::string> result;
  for (const LibraryEntry& entry : library()) result.push_back(entry.name);
  return result;
}

INSTANTIATE_TEST_SUITE_P(Library, EveryGlb, testing::ValuesIn(names()), [](const auto& scene_name) {
  std::string name = scene_name.param;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
});

Scene one_triangle() {
  Scene scene;
  scene.name = "small";
  scene.positions = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  scene.normals.resize(9);
  scene.indices = {0, 1, 2};
  scene.triangle_material = {0};
  scene.meshes = {{"triangle", 0, 1}};
  return scene;
}

Material plain() {
  Material m = make_scene("cornell-box").materials[0];
  m.albedo_table = GLEANER_NONE;
  return m;
}

// What no scene of the library has: every field of a material that glTF can say.
TEST(Glb, KeepsEveryFieldOfAMaterial) {
  Scene scene = one_triangle();
  scene.uvs = {0, 0, 1, 0, 0, 1};
  for (std::uint32_t i = 0; i < 8; ++i) {
    Texture t = plain_texture();
    t.first_texel = static_cast<std::uint32_t>(scene.texels.size());
    t.width = 2 + i;
    t.height = 3;
    t.wrap_u = i % 3;
    t.wrap_v = (i + 1) % 3;
    for (std::uint32_t k = 0; k < t.width * t.height; ++k) scene.texels.push_back(0x9e3779b9u * (k + 100 * i + 1));
    scene.textures.push_back(t);
  }
  Material full = plain();
  full.base_color[0] = 0.1f;
  full.alpha = 0.3f;
  full.emission[0] = 1234.567f;
  full.emission[1] = 1e-20f;
  full.emission[2] = 0.333f;
  full.alpha_cutoff = 0.7f;
  full.specular = 0.4f;
  full.specular_color[1] = 0.6f;
  full.specular_color[2] = 3.5f;
  full.ior = 1.31f;
  full.metallic = 0.2f;
  full.roughness = 0.7f;
  full.transmission = 0.9f;
  full.normal_scale = -1.5f;
  full.attenuation[0] = 0.5f;
  full.attenuation[1] = 7;
  full.attenuation[2] = 0;
  full.flags = GLEANER_MATERIAL_SOLID | GLEANER_MATERIAL_ALPHA_MASK;
  full.base_color_texture = 0;
  full.metallic_roughness_texture = 1;
  full.normal_texture = 2;
  full.emission_texture = 3;
  full.specular_texture = 4;
  full.specular_color_texture = 5;
  full.transmission_texture = 6;
  for (std::uint32_t srgb : {0, 3, 5, 7}) scene.textures[srgb].flags = GLEANER_TEXTURE_SRGB;
  Material blend = plain();
  blend.alpha = 0.25f;
  blend.flags = GLEANER_MATERIAL_ALPHA_BLEND;
  Material unlit = plain();
  unlit.flags = GLEANER_MATERIAL_UNLIT;
  unlit.base_color_texture = 7;
  Material thin = plain();
  thin.transmission = 1;
  thin.roughness = 0;
  scene.materials = {full, blend, unlit, thin};
  scene.material_names = {"full", "blend", "unlit", "thin"};
  Light light{};
  light.type = GLEANER_LIGHT_SPOT;
  light.position[0] = 5;
  light.direction[2] = 1;  // where a basis around -z divides by zero unless it minds the sign
  light.range = 12.5f;
  light.intensity[0] = 0.001f;
  light.intensity[1] = 777.7f;
  light.cos_inner = 0.9f;
  light.cos_outer = 0.3f;
  scene.lights = {light};
  light.direction[2] = -1;
  scene.lights.push_back(light);
  finish_materials(scene);
  validate(scene, "full");

  const Folder folder;
  write_glb(scene, folder / "small.glb");
  const Scene read = import_scene(folder / "small.glb");
  // This one has no camera; the importer gives it one.
  scene.cameras = read.cameras;
  expect_same(scene, read);
  EXPECT_EQ(read.textures.size(), 8u);
}

// Vertices out of order, shared between materials, with and without normals: the triangles are the same.
TEST(Glb, KeepsTrianglesThatShareVertices) {
  Scene scene = one_triangle();
  scene.positions.insert(scene.positions.end(), {0, 0, 1, 5, 5, 5, 1, 1, 0});
  scene.normals.assign(18, 0);
  scene.normals[9 + 2] = 1;
  scene.indices = {2, 0, 1, 5, 1, 2, 0, 3, 1, 2, 1, 0};
  scene.triangle_material = {0, 1, 1, 0};
  scene.meshes = {{"three", 0, 3}, {"one", 3, 1}};
  scene.materials = {plain(), plain()};
  scene.material_names = {"a", "b"};
  finish_materials(scene);
  validate(scene, "shared");
  const Folder folder;
  write_glb(scene, folder / "small.glb");
  const Scene read = import_scene(folder / "small.glb");
  ASSERT_EQ(read.indices.size(), scene.indices.size());
  EXPECT_EQ(read.triangle_material, scene.triangle_material);
  for (std::size_t i = 0; i < scene.indices.size(); ++i)
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(read.positions[3 * std::size_t{read.indices[i]} + k],
                scene.positions[3 * std::size_t{scene.indices[i]} + k]);
      EXPECT_EQ(read.normals[3 * std::size_t{read.indices[i]} + k],
                scene.normals[3 * std::size_t{scene.indices[i]} + k]);
    }
}

TEST(Glb, ReplacesWholeFilesOrNothing) {
  const Folder folder;
  const std::string path = folder / "scene.glb";
  std::ofstream(path) << "what was there";
  write_glb(make_scene("cornell-box"), path);
  EXPECT_EQ(import_scene(path).triangle_count(), 36u);
  EXPECT_EQ(folder.files(), 1u);

  std::filesystem::create_directory(folder / "folder.glb");
  std::ofstream(folder / "folder.glb/inside") << "so that it cannot be replaced";
  try {
    write_glb(make_scene("cornell-box"), folder / "folder.glb");
    FAIL() << "a folder was replaced by a file";
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::failed);
    EXPECT_THAT(e.what(), testing::HasSubstr("folder.glb"));
  }
  EXPECT_EQ(folder.files(), 2u) << "a temporary file was left behind";
  try {
    write_glb(make_scene("white-furnace"), folder / "nowhere/scene.glb");
    FAIL() << "a file in a folder that does not exist";
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::failed);
    EXPECT_THAT(e.what(), testing::HasSubstr("nowhere"));
  }
}

}  // namespace
}  // namespace gleaner::scene
