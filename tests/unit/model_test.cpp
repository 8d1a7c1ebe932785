#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <random>

#include "model_scene.h"
#include "scene/model/albedo.h"
#include "scene/model/error.h"
#include "scene/model/names.h"
#include "scene/model/scene.h"

namespace gleaner::scene {
namespace {

using testing::HasSubstr;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

double at(const DirectionalAlbedo& a, int i, double f0) { return f0 * a.scale[i] + (1 - f0) * a.bias[i]; }

// The numbers of specular_albedo() of the tool that made the reference images, 4096 rays.
TEST(Albedo, IsThatOfTheReferenceTool) {
  struct Row {
    double roughness, f0;
    std::array<double, 5> e;  // at nodes 0, 1, 10, 64, 127
  };
  const Row rows[] = {
      {0.1, 0.04, {0.770722229, 0.764512169, 0.648590704, 0.068956313, 0.040000104}},
      {0.1, 0.6, {0.846947724, 0.834014986, 0.848327372, 0.611879304, 0.599999717}},
      {0.22360679774997896, 0.04, {0.524705786, 0.523252807, 0.4699243, 0.069756643, 0.039890574}},
      {0.22360679774997896, 0.6, {0.759476676, 0.750365933, 0.718081416, 0.608180856, 0.598328583}},
      {0.5, 0.04, {0.183446652, 0.181770663, 0.162055922, 0.054993541, 0.036651533}},
      {0.5, 0.6, {0.599501415, 0.59655233, 0.569772188, 0.522046372, 0.549321164}},
      {1.0, 0.04, {0.043122612, 0.042402812, 0.036620713, 0.018635481, 0.012333611}},
      {1.0, 0.6, {0.374569736, 0.37151613, 0.346113169, 0.245808177, 0.184486775}},
  };
  const int nodes[] = {0, 1, 10, 64, 127};
  for (const Row& row : rows) {
    const DirectionalAlbedo albedo = directional_albedo(row.roughness * row.roughness);
    for (int k = 0; k < 5; ++k)
      EXPECT_NEAR(at(albedo, nodes[k], row.f0), row.e[k], 1e-8)
          << "roughness " << row.roughness << ", f0 " << row.f0 << ", node " << nodes[k];
  }
}

// The definition itself: the integral of F D V cos over the hemisphere, by a grid in (h's slope) that D concentrates
// on.
TEST(Albedo, IsTheIntegralOfTheLobe) {
  for (const double alpha : {0.05, 0.25, 1.0}) {
    const DirectionalAlbedo albedo = directional_albedo(alpha);
    for (const int i : {3, 40, 100, 127}) {
      const double mu = (i + 0.5) / GLEANER_ALBEDO_NODES, sine = std::sqrt(1 - mu * mu), f0 = 0.04;
      const double a2 = alpha * alpha;
      double sum = 0;
      // Half vectors h are drawn from D cos(h): cos^2 = (1 - u) / (1 + (a2 - 1) u); the pdf of l is D cos(h) / (4 v.h).
      constexpr int n = 1000;
      for (int a = 0; a < n; ++a) {
        const double u = (a + 0.5) / n, ch = std::sqrt((1 - u) / (1 + (a2 - 1) * u)), sh = std::sqrt(1 - ch * ch);
        for (int b = 0; b < n; ++b) {
          const double phi = 2 * std::numbers::pi * (b + 0.5) / n;
          const double vh = sine * sh * std::cos(phi) + mu * ch, nl = 2 * vh * ch - mu;
          if (!(vh > 0 && nl > 0)) continue;
          const auto g = [&](double c) { return 2 * c / (c + std::sqrt(a2 + (1 - a2) * c * c)); };
          const double f = f0 + (1 - f0) * std::pow(1 - vh, 5);
          sum += f * g(mu) * g(nl) * vh / (mu * ch);  // F D G / (4 nl nv) nl over the pdf
        }
      }
      EXPECT_NEAR(at(albedo, i, f0), sum / n / n, 2e-3) << "alpha " << alpha << ", node " << i;
    }
  }
}

TEST(Albedo, MirrorIsSchlick) {
  const DirectionalAlbedo albedo = directional_albedo(0);
  for (int i = 0; i < GLEANER_ALBEDO_NODES; ++i) {
    const double mu = (i + 0.5) / GLEANER_ALBEDO_NODES;
    EXPECT_DOUBLE_EQ(at(albedo, i, 0.04), 0.04 + 0.96 * std::pow(1 - mu, 5));
  }
}

TEST(FinishMaterials, DerivesF0) {
  Scene s = square();
  s.materials[0].ior = 2;
  s.materials[0].specular_color[0] = 0.5f;
  s.materials[0].specular_color[2] = 1000;
  finish_materials(s);
  EXPECT_FLOAT_EQ(s.materials[0].f0[0], 0.5f / 9);
  EXPECT_FLOAT_EQ(s.materials[0].f0[1], 1.0f / 9);
  EXPECT_FLOAT_EQ(s.materials[0].f0[2], 1);
  s.materials[0].ior = 0;  // KHR_materials_ior: reflects everything
  s.materials[0].specular_color[0] = 1;
  finish_materials(s);
  EXPECT_FLOAT_EQ(s.materials[0].f0[0], 1);
}

TEST(FinishMaterials, TableHoldsWhatIsLeftAndItsMean) {
  Scene s = square();
  s.materials[0].specular = 0.5f;
  s.materials[0].roughness = 0.5f;
  finish_materials(s);
  ASSERT_EQ(s.materials[0].albedo_table, 0u);
  ASSERT_EQ(s.materials[0].albedo_rows, 1u);
  ASSERT_EQ(s.albedo_tables.size(), GLEANER_ALBEDO_NODES + 1u);
  EXPECT_NEAR(s.albedo_tables[64], 1 - 0.5 * 0.054993541, 1e-6);
  EXPECT_NEAR(s.albedo_tables[GLEANER_ALBEDO_NODES], 0.9737448279370458, 1e-6);
}

TEST(FinishMaterials, MakesOneTableForWhatIsAlike) {
  Scene s = square();
  s.materials.assign(9, plain_material());
  for (Material& m : s.materials) m.specular = 1, m.roughness = 0.4f;
  s.materials[1].base_color[0] = 0.1f;             // alike
  s.materials[2].roughness = 0.41f;                // another
  s.materials[3].specular = 0.9f;                  // another
  s.materials[4].ior = 1.6f;                       // another
  s.materials[5].metallic = 1;                     // none
  s.materials[6].specular = 0;                     // none
  s.materials[7].transmission = 1;                 // none
  s.materials[8].flags |= GLEANER_MATERIAL_UNLIT;  // none
  finish_materials(s);
  EXPECT_EQ(s.albedo_tables.size(), 4u * (GLEANER_ALBEDO_NODES + 1));
  EXPECT_EQ(s.materials[0].albedo_table, s.materials[1].albedo_table);
  for (int i : {2, 3, 4}) EXPECT_NE(s.materials[i].albedo_table, s.materials[0].albedo_table) << i;
  for (int i : {5, 6, 7, 8}) EXPECT_EQ(s.materials[i].albedo_table, GLEANER_NONE) << i;
  const std::vector<float> once = s.albedo_tables;
  finish_materials(s);
  EXPECT_EQ(s.albedo_tables, once);
}

TEST(FinishMaterials, TextureOfRoughnessTakesATableOfAllRoughnesses) {
  Scene s = square();
  s.materials[0].specular = 1;
  s.materials[0].metallic = 1;  // times the texture's blue: there may be a coated layer
  s.materials[0].metallic_roughness_texture = 0;
  finish_materials(s);
  ASSERT_EQ(s.materials[0].albedo_rows, GLEANER_ALBEDO_ROWS);
  ASSERT_EQ(s.albedo_tables.size(), std::size_t(GLEANER_ALBEDO_ROWS) * (GLEANER_ALBEDO_NODES + 1));
  const float* row = &s.albedo_tables[(GLEANER_ALBEDO_ROWS - 1) / 2 * (GLEANER_ALBEDO_NODES + 1)];
  EXPECT_NEAR(row[64], 1 - 0.054993541, 1e-6);  // roughness 0.5
  EXPECT_NEAR(s.albedo_tables[0], 1 - (0.04 + 0.96 * std::pow(1 - 0.5 / GLEANER_ALBEDO_NODES, 5)), 1e-6);  // a mirror
}

TEST(FinishMaterials, SolidsThatAbsorbAttenuate) {
  Scene s = square();
  s.materials.assign(3, plain_material());
  s.materials[0].attenuation[1] = s.materials[1].attenuation[1] = 2;
  s.materials[1].flags = s.materials[2].flags = GLEANER_MATERIAL_SOLID;
  s.materials[2].flags |= GLEANER_MATERIAL_ATTENUATES;  // stale
  finish_materials(s);
  EXPECT_FALSE(s.materials[0].flags & GLEANER_MATERIAL_ATTENUATES);
  EXPECT_TRUE(s.materials[1].flags & GLEANER_MATERIAL_ATTENUATES);
  EXPECT_FALSE(s.materials[2].flags & GLEANER_MATERIAL_ATTENUATES);
}

// --- needs ---------------------------------------------------------------------------------------------------------

std::vector<std::string> needs_named(const Scene& scene) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < need_names().size(); ++i)
    if (needs_of(scene).bits() >> i & 1) names.push_back(need_names()[i]);
  return names;
}

using Names = std::vector<std::string>;

TEST(Needs, LambertNeedsNothing) { EXPECT_EQ(needs_named(square()), Names{}); }

TEST(Needs, FollowTheMaterialsThatTrianglesUse) {
  struct Case {
    const char* what;
    std::function<void(Scene&, Material&)> change;
    Names needs;
  };
  const Case cases[] = {
      {"coat", [](Scene&, Material& m) { m.specular = 1; }, {"glossy"}},
      {"smooth coat", [](Scene&, Material& m) { m.specular = 1, m.roughness = 0; }, {"specular"}},
      {"roughness without a lobe", [](Scene&, Material& m) { m.roughness = 0; }, {}},
      {"mirror", [](Scene&, Material& m) { m.metallic = 1, m.roughness = 0; }, {"specular", "metallic"}},
      {"metal", [](Scene&, Material& m) { m.metallic = 1; }, {"glossy", "metallic"}},
      {"roughness by texture",
       [](Scene&, Material& m) { m.metallic = 1, m.roughness = 0, m.metallic_roughness_texture = 0; },
       {"glossy", "metallic", "textures", "material_textures"}},
      {"glass",
       [](Scene&, Material& m) { m.transmission = 1, m.roughness = 0, m.flags |= GLEANER_MATERIAL_SOLID; },
       {"specular", "transmissive", "refractive"}},
      {"pane", [](Scene&, Material& m) { m.transmission = 1, m.roughness = 0; }, {"specular", "transmissive", "panes"}},
      {"frosted glass",
       [](Scene&, Material& m) { m.transmission = 1, m.flags |= GLEANER_MATERIAL_SOLID; },
       {"glossy", "transmissive", "rough_transmissive"}},
      {"frosted pane",
       [](Scene&, Material& m) { m.transmission = 1; },
       {"glossy", "transmissive", "rough_transmissive"}},
      {"metal hides transmission",
       [](Scene&, Material& m) { m.transmission = 1, m.roughness = 0, m.metallic = 1; },
       {"specular", "metallic"}},
      {"coloured glass",
       [](Scene&, Material& m) {
         m.transmission = 1, m.roughness = 0, m.attenuation[0] = 1, m.flags |= GLEANER_MATERIAL_SOLID;
       },
       {"specular", "transmissive", "attenuation", "refractive", "media"}},
      {"half transparent",
       [](Scene&, Material& m) { m.alpha = 0.5f, m.flags |= GLEANER_MATERIAL_ALPHA_BLEND; },
       {"alpha"}},
      {"clear coat", [](Scene&, Material& m) { m.clearcoat = 1; }, {"clearcoat"}},
      {"sheen", [](Scene&, Material& m) { m.sheen_color[1] = 1; }, {"sheen"}},
      {"grain", [](Scene&, Material& m) { m.anisotropy = 0.5f, m.metallic = 1; }, {"glossy", "metallic", "anisotropy"}},
      {"film", [](Scene&, Material& m) { m.iridescence = 1, m.specular = 1; }, {"glossy", "iridescence"}},
      {"grain and film without a lobe", [](Scene&, Material& m) { m.anisotropy = m.iridescence = 1; }, {}},
      {"coat on nothing but glass",
       [](Scene&, Material& m) { m.transmission = 1, m.roughness = 0, m.clearcoat = 1; },
       {"specular", "transmissive", "panes"}},
      {"alpha that opaque ignores", [](Scene&, Material& m) { m.alpha = 0.5f; }, {}},
      {"blend with alpha 1", [](Scene&, Material& m) { m.flags |= GLEANER_MATERIAL_ALPHA_BLEND; }, {}},
      {"mask below alpha", [](Scene&, Material& m) { m.alpha = 0.6f, m.flags |= GLEANER_MATERIAL_ALPHA_MASK; }, {}},
      {"mask above alpha",
       [](Scene&, Material& m) { m.alpha = 0.4f, m.flags |= GLEANER_MATERIAL_ALPHA_MASK; },
       {"alpha"}},
      {"blend with a texture of alpha 0.5",
       [](Scene& s, Material& m) {
         m.flags |= GLEANER_MATERIAL_ALPHA_BLEND, m.base_color_texture = 0, s.texels = {0x80ffffff};
       },
       {"alpha", "textures"}},
      {"blend with an opaque texture",
       [](Scene& s, Material& m) {
         m.flags |= GLEANER_MATERIAL_ALPHA_BLEND, m.base_color_texture = 0, s.texels = {0xffffffff};
       },
       {"textures"}},
      {"unlit", [](Scene&, Material& m) { m.flags |= GLEANER_MATERIAL_UNLIT, m.specular = 1; }, {"unlit"}},
      {"base colour texture", [](Scene&, Material& m) { m.base_color_texture = 0; }, {"textures"}},
      {"normal map",
       [](Scene&, Material& m) { m.normal_texture = 0; },
       {"textures", "material_textures", "normal_maps"}},
      {"emission", [](Scene&, Material& m) { m.emission[2] = 1; }, {"emissive_triangles"}},
      {"light", [](Scene& s, Material&) { s.lights.resize(1); }, {"punctual_lights"}},
      {"environment",
       [](Scene& s, Material&) {
         s.environment = {1, 1, {1, 1, 1}};
       },
       {"environment"}},
      {"smooth normals", [](Scene& s, Material&) { s.normals[0] = 2e-4f; }, {"smooth_normals"}},
      {"normals that turn away", [](Scene& s, Material&) { s.normals[2] = -1; }, {"smooth_normals"}},
      {"flat but for rounding", [](Scene& s, Material&) { s.normals[0] = 5e-5f; }, {}},
      {"no normals", [](Scene& s, Material&) { s.normals.assign(12, 0.0f); }, {}},
  };
  for (const Case& c : cases) {
    Scene used = square();
    used.textures.resize(1);
    used.textures[0].width = used.textures[0].height = 1;
    used.textures[0].transform[0] = used.textures[0].transform[4] = 1;
    used.texels = {0xffffffff};
    used.uvs.resize(8);
    c.change(used, used.materials[0]);
    finish_materials(used);
    EXPECT_EQ(needs_named(used), c.needs) << c.what;
    // The same material, used by no triangle, needs nothing.
    Scene unused = square();
    Scene scratch = used;
    unused.materials.push_back(scratch.materials[0]);
    unused.textures = scratch.textures;
    unused.texels = scratch.texels;
    finish_materials(unused);
    EXPECT_EQ(needs_named(unused), Names{}) << c.what << ", unused";
  }
}

TEST(Needs, TrianglesWithoutAreaEmitNothing) {
  Scene s = square();
  s.materials.push_back(plain_material());
  s.materials[1].emission[0] = 1;
  s.indices = {0, 1, 2, 0, 2, 2};
  s.triangle_material = {0, 1};
  EXPECT_FALSE(needs_of(s).emissive_triangles);
  s.indices[5] = 3;
  EXPECT_TRUE(needs_of(s).emissive_triangles);
}

TEST(Needs, HaveOneNameABit) {
  SceneNeeds needs;
  EXPECT_EQ(needs.bits(), 0u);
  needs.specular = true;
  EXPECT_EQ(needs.bits(), 1u);
  EXPECT_EQ(need_names().front(), "specular");
  needs = {};
  needs.diffuse_transmission = true;
  EXPECT_EQ(needs.bits(), 1u << (need_names().size() - 1));
  EXPECT_EQ(need_names().back(), "diffuse_transmission");
  needs = {};
  needs.normal_maps = true;
  EXPECT_EQ(need_names()[std::countr_zero(needs.bits())], "normal_maps");
}

// --- validation ----------------------------------------------------------------------------------------------------

TEST(Validate, InstancesAreChecked) {
  const auto instanced = [] {
    Scene scene = square();
    scene.meshes[0].instanced = true;
    for (std::size_t m = 1; m < scene.meshes.size(); ++m) scene.meshes[m].instanced = true;
    for (std::uint32_t m = 0; m < scene.meshes.size(); ++m) {
      Instance instance{};
      instance.transform[0] = instance.transform[5] = instance.transform[10] = 1;
      instance.mesh = m;
      scene.instances.push_back(instance);
    }
    for (Material& m : scene.materials) std::fill(m.emission, m.emission + 3, 0.0f);
    return scene;
  };
  const auto why = [](const Scene& scene) -> std::string {
    try {
      validate(scene, "f");
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  EXPECT_EQ(why(instanced()), "accepted");
  Scene s = instanced();
  s.instances[0].mesh = 99;
  EXPECT_NE(why(s).find("instances[0].mesh"), std::string::npos) << why(s);
  s = instanced();
  s.instances[0].transform[5] = 0;
  EXPECT_NE(why(s).find("instances[0].transform"), std::string::npos) << why(s);
  s = instanced();
  s.instances[0].transform[3] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_NE(why(s).find("instances[0].transform"), std::string::npos) << why(s);
  s = instanced();
  s.meshes[0].deforming = true;
  EXPECT_NE(why(s).find("meshes[0]"), std::string::npos) << why(s);
  s = instanced();
  s.instances.clear();
  EXPECT_NE(why(s).find("meshes[0]"), std::string::npos) << why(s);
  s = instanced();
  s.materials[s.triangle_material[0]].emission[0] = 1;
  EXPECT_NE(why(s).find("meshes[0]"), std::string::npos) << why(s);
}

TEST(Validate, AcceptsWhatIsRight) {
  EXPECT_NO_THROW(validate(square(), "f"));
  EXPECT_NO_THROW(validate(rich_square(), "f"));
  Scene empty;
  EXPECT_NO_THROW(validate(empty, "f"));
}

TEST(Validate, NamesWhatIsWrong) {
  struct Case {
    std::function<void(Scene&)> break_it;
    std::string element;
  };
  const Case cases[] = {
      {[](Scene& s) { s.positions[4] = kNan; }, "positions[1]"},
      {[](Scene& s) { s.positions[4] = -kInfinity; }, "positions[1]"},
      {[](Scene& s) { s.positions[4] = 2e9f; }, "positions[1]"},
      {[](Scene& s) { s.positions.pop_back(); }, "positions"},
      {[](Scene& s) { s.normals.pop_back(); }, "normals"},
      {[](Scene& s) { s.normals[8] = 2; }, "normals[2]"},
      {[](Scene& s) { s.normals[8] = kNan; }, "normals[2]"},
      {[](Scene& s) { s.uvs.pop_back(); }, "uvs"},
      {[](Scene& s) { s.uvs[2] = kNan; }, "uvs[1]"},
      {[](Scene& s) { s.uvs.clear(); }, "uvs"},
      {[](Scene& s) { s.indices.pop_back(); }, "indices"},
      {[](Scene& s) { s.indices[5] = 4; }, "indices[5]"},
      {[](Scene& s) { s.triangle_material.pop_back(); }, "triangle_material"},
      {[](Scene& s) { s.triangle_material[1] = 2; }, "triangle_material[1]"},
      {[](Scene& s) { s.meshes.pop_back(); }, "meshes"},
      {[](Scene& s) { s.meshes[1].first_triangle = 0; }, "meshes[1]"},
      {[](Scene& s) { s.meshes[1].triangle_count = 0xffffffff; }, "meshes[1]"},
      {[](Scene& s) { s.materials[0].base_color[1] = -0.1f; }, "materials[0].base_color"},
      {[](Scene& s) { s.materials[0].base_color[1] = kNan; }, "materials[0].base_color"},
      {[](Scene& s) { s.materials[0].base_color[1] = 1.5f; }, "materials[0].base_color"},
      {[](Scene& s) { s.materials[1].emission[0] = -1; }, "materials[1].emission"},
      {[](Scene& s) { s.materials[1].emission[0] = kInfinity; }, "materials[1].emission"},
      {[](Scene& s) { s.materials[1].metallic = 2; }, "materials[1].metallic"},
      {[](Scene& s) { s.materials[1].roughness = -1; }, "materials[1].roughness"},
      {[](Scene& s) { s.materials[1].transmission = kNan; }, "materials[1].transmission"},
      {[](Scene& s) { s.materials[1].transmission = 1, s.materials[1].ior = 0.5f; }, "materials[1].ior"},
      {[](Scene& s) { s.materials[1].attenuation[0] = kInfinity; }, "materials[1].attenuation"},
      {[](Scene& s) { s.materials[1].flags = 1u << 20; }, "materials[1].flags"},
      {[](Scene& s) { s.materials[1].normal_texture = 1; }, "materials[1].normal_texture"},
      {[](Scene& s) { s.materials[1].albedo_table = 1; }, "materials[1].albedo_table"},
      {[](Scene& s) { s.materials[1].albedo_table = 0xfffffffe; }, "materials[1].albedo_table"},
      {[](Scene& s) { s.materials[1].albedo_rows = 7; }, "materials[1].albedo_rows"},
      {[](Scene& s) { s.albedo_tables[7] = 1.5f; }, "albedo_tables[7]"},
      {[](Scene& s) { s.textures[0].first_texel = 1; }, "textures[0]"},
      {[](Scene& s) { s.textures[0].width = 0xffffffff; }, "textures[0]"},
      {[](Scene& s) { s.textures[0].height = 0; }, "textures[0]"},
      {[](Scene& s) { s.textures[0].wrap_u = 3; }, "textures[0]"},
      {[](Scene& s) { s.textures[0].flags = 2; }, "textures[0].flags"},
      {[](Scene& s) { s.lights[0].type = 3; }, "lights[0].type"},
      {[](Scene& s) { s.lights[0].intensity[1] = -1; }, "lights[0].intensity"},
      {[](Scene& s) { s.lights[0].position[1] = kNan; }, "lights[0].position"},
      {[](Scene& s) { s.lights[1].direction[1] = 0; }, "lights[1].direction"},
      {[](Scene& s) { s.lights[1].cos_outer = 1, s.lights[1].cos_inner = 0; }, "lights[1]"},
      {[](Scene& s) { s.cameras[1].camera.origin[0] = kNan; }, "cameras[1].origin"},
      {[](Scene& s) { s.cameras[1].camera.up[0] = 2; }, "cameras[1].up"},
      {[](Scene& s) { s.cameras[1].camera.half_width = 0; }, "cameras[1]"},
      {[](Scene& s) { s.cameras[1].camera.type = 2; }, "cameras[1].type"},
      {[](Scene& s) { s.cameras[1].aspect = kNan; }, "cameras[1].aspect"},
      {[](Scene& s) { s.environment.radiance[4] = -1; }, "environment[1]"},
      {[](Scene& s) { s.environment.radiance.pop_back(); }, "environment"},
      {[](Scene& s) { s.environment.height = 0; }, "environment"},
      {[](Scene& s) { s.environment.width = 0xffffffff; }, "environment"},
  };
  for (const Case& c : cases) {
    Scene s = rich_square();
    c.break_it(s);
    try {
      validate(s, "file.glb");
      ADD_FAILURE() << c.element << " was accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      EXPECT_THAT(error.what(), HasSubstr("file.glb: " + c.element + ": expected ")) << c.element;
    }
  }
}

// --- cameras -------------------------------------------------------------------------------------------------------

double dot(const float* a, const float* b) { return double(a[0]) * b[0] + double(a[1]) * b[1] + double(a[2]) * b[2]; }

void expect_right_handed(const Camera& c) {
  for (const float* axis : {c.right, c.up, c.forward}) EXPECT_NEAR(dot(axis, axis), 1, 1e-6);
  EXPECT_NEAR(dot(c.right, c.up), 0, 1e-6);
  EXPECT_NEAR(dot(c.up, c.forward), 0, 1e-6);
  const float cross[3] = {c.right[1] * c.up[2] - c.right[2] * c.up[1], c.right[2] * c.up[0] - c.right[0] * c.up[2],
                          c.right[0] * c.up[1] - c.right[1] * c.up[0]};
  EXPECT_NEAR(dot(cross, c.forward), -1, 1e-6);  // right x up points backwards
}

TEST(LookAt, LooksAtItsTarget) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> coordinate(-10, 10);
  for (int i = 0; i < 100; ++i) {
    const std::array<float, 3> eye{coordinate(random), coordinate(random), coordinate(random)};
    const std::array<float, 3> target{coordinate(random), coordinate(random), coordinate(random)};
    const Camera c = look_at(eye, target, 0.8f).camera;
    expect_right_handed(c);
    float to[3];
    for (int k = 0; k < 3; ++k) to[k] = target[k] - eye[k];
    EXPECT_NEAR(dot(to, c.right), 0, 1e-4);
    EXPECT_NEAR(dot(to, c.up), 0, 1e-4);
    EXPECT_GT(dot(to, c.forward), 0);
    EXPECT_GE(c.up[1], 0);
    EXPECT_NEAR(c.half_height, std::tan(0.4), 1e-6);
  }
}

TEST(LookAt, LooksStraightUpAndDown) {
  for (const float y : {-1.0f, 1.0f}) expect_right_handed(look_at({0, 0, 0}, {0, y, 0}, 1).camera);
}

TEST(LookAt, RefusesWhatHasNoDirection) {
  EXPECT_THROW(look_at({1, 2, 3}, {1, 2, 3}, 1), Error);
  EXPECT_THROW(look_at({1, 2, kNan}, {1, 2, 3}, 1), Error);
  for (const float fov : {0.0f, 3.2f, -1.0f, kNan}) EXPECT_THROW(look_at({0, 0, 0}, {1, 2, 3}, fov), Error) << fov;
}

TEST(FramingCamera, SeesEveryCorner) {
  std::mt19937 random(2);
  std::uniform_real_distribution<float> coordinate(-1, 1), exponent(-6, 8);
  for (int i = 0; i < 200; ++i) {
    Scene s = square();
    const float scale = std::pow(10.0f, exponent(random));
    for (float& x : s.positions) x = scale * (3 + coordinate(random));
    const NamedCamera named = framing_camera(s);
    expect_right_handed(named.camera);
    for (std::size_t v = 0; v < s.vertex_count(); ++v) {
      float to[3];
      for (int k = 0; k < 3; ++k) to[k] = s.positions[3 * v + k] - named.camera.origin[k];
      const double depth = dot(to, named.camera.forward);
      ASSERT_GT(depth, 0) << scale;
      EXPECT_LE(std::abs(dot(to, named.camera.right)), depth * named.camera.half_width) << scale;
      EXPECT_LE(std::abs(dot(to, named.camera.up)), depth * named.camera.half_height) << scale;
    }
    s.cameras = {named};
    EXPECT_NO_THROW(validate(s, "f"));
  }
}

TEST(FramingCamera, StandsBeforeNothing) {
  Scene empty;
  expect_right_handed(framing_camera(empty).camera);
}

TEST(Names, BytesThatAreNoTextAreSpelledOut) {
  EXPECT_EQ(printable("caf\u00e9 \xe9 \xff"), "caf\u00e9 \\xe9 \\xff");
  EXPECT_EQ(printable(std::string_view("a\0b", 3)), "a\\x00b");
}

TEST(Names, CharactersThatATerminalObeysAreSpelledOut) {
  EXPECT_EQ(printable("\x1b[31mred\x7f"), "\\x1b[31mred\\x7f");
  EXPECT_EQ(printable("\u009b2J"), "\\xc2\\x9b2J");
  EXPECT_EQ(printable("gpj.\u202eexe"), "gpj.\\xe2\\x80\\xaeexe");  // turns the line around
  EXPECT_EQ(printable("one\u2028two"), "one\\xe2\\x80\\xa8two");
  EXPECT_EQ(printable("two\nlines\u00a0\u20ac"), "two\\x0alines\u00a0\u20ac");
  EXPECT_EQ(printable_lines("two\nlines\x1b\n"), "two\nlines\\x1b\n");
}

TEST(Names, LongOnesAreCutBetweenCharacters) {
  EXPECT_EQ(printable("abcd\u00e9", 5), "abcd");
  EXPECT_EQ(printable("abcd\u00e9", 6), "abcd\u00e9");
  EXPECT_EQ(printable("abc\n", 5), "abc");  // no half of "\x0a"
}

}  // namespace
}  // namespace gleaner::scene
