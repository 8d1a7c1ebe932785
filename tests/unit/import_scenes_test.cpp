// The real scenes that stand beside the project, where they do.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/blob.h"

namespace gleaner::scene {
namespace {

std::string scenes_folder() {
  const char* set = std::getenv("GLEANER_SHARED");
  return std::string(set ? set : GLEANER_SHARED_DIR) + "/scenes/";
}

struct RealScene {
  const char* path;
  std::size_t triangles, cameras, lights, textures;
  std::vector<std::string> needs;
  std::uint32_t width, height;  // of the first camera
};

std::vector<std::string> needs_named(const Scene& scene) {
  std::vector<std::string> names;
  const std::uint32_t bits = needs_of(scene).bits();
  for (std::size_t i = 0; i < need_names().size(); ++i)
    if (bits >> i & 1) names.push_back(need_names()[i]);
  return names;
}

class RealScenes : public testing::TestWithParam<RealScene> {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(scenes_folder() + GetParam().path))
      GTEST_SKIP() << "NOT TESTED: " << scenes_folder() << GetParam().path << " is not there (set GLEANER_SHARED)";
  }
};

// Triangle counts are those of the scenes' own README.
TEST_P(RealScenes, AreReadWhole) {
  const RealScene& expected = GetParam();
  const Scene s = import_scene(scenes_folder() + expected.path);
  EXPECT_EQ(s.triangle_count(), expected.triangles);
  EXPECT_EQ(s.cameras.size(), expected.cameras);
  EXPECT_EQ(s.lights.size(), expected.lights);
  EXPECT_EQ(s.textures.size(), expected.textures);
  EXPECT_EQ(needs_named(s), expected.needs);
  EXPECT_EQ(s.cameras.at(0).width, expected.width);
  EXPECT_EQ(s.cameras.at(0).height, expected.height);
  EXPECT_THAT(s.warnings, testing::IsEmpty());
  const Bytes bytes = serialize(s);
  EXPECT_TRUE(serialize(parse_scene(bytes, "blob")) == bytes);
}

using Needs = std::vector<std::string>;

INSTANTIATE_TEST_SUITE_P(
    Import, RealScenes,
    testing::Values(
        RealScene{"cornell-box/cornell-box.gltf", 36, 1, 0, 0, Needs{"emissive_triangles"}, 1024, 1024},
        RealScene{"cornell-mcguire/CornellBox-Original.gltf", 36, 1, 0, 0, Needs{"emissive_triangles"}, 512, 512},
        RealScene{"cornell-mcguire/CornellBox-Mirror.gltf", 32, 1, 0, 0,
                  Needs{"specular", "metallic", "emissive_triangles"}, 512, 512},
        RealScene{"cornell-mcguire/CornellBox-Sphere.gltf", 2188, 1, 0, 0,
                  Needs{"specular", "metallic", "transmissive", "smooth_normals", "emissive_triangles", "refractive"},
                  512, 512},
        RealScene{"cornell-mcguire/CornellBox-Water.gltf", 7088, 1, 0, 0,
                  Needs{"specular", "metallic", "transmissive", "smooth_normals", "emissive_triangles", "refractive",
                        "media"},
                  512, 512},
        RealScene{"cornell-mcguire/CornellBox-Glossy.gltf", 1112, 1, 0, 0,
                  Needs{"glossy", "smooth_normals", "emissive_triangles"}, 512, 512},
        RealScene{"sponza-dabrovic/sponza-dabrovic.gltf", 70413, 2, 0, 10,
                  Needs{"textures", "smooth_normals", "emissive_triangles"}, 768, 575},
        RealScene{"modern-hall/modern-hall.gltf", 28885, 1, 0, 3,
                  Needs{"specular", "glossy", "metallic", "transmissive", "textures", "smooth_normals",
                        "emissive_triangles", "refractive"},
                  1024, 1024},
        RealScene{"breakfast-room/breakfast-room.gltf", 269538, 1, 1, 3,
                  Needs{"glossy", "metallic", "textures", "smooth_normals", "punctual_lights"}, 1280, 720},
        RealScene{"white-room/white-room.gltf", 413353, 1, 0, 13,
                  Needs{"specular", "glossy", "metallic", "transmissive", "rough_transmissive", "alpha", "textures",
                        "smooth_normals", "emissive_triangles", "panes", "refractive", "media"},
                  1280, 720},
        RealScene{"water-caustic/water-caustic.gltf", 103487, 1, 0, 0,
                  Needs{"specular", "transmissive", "smooth_normals", "emissive_triangles", "refractive"}, 1000, 563}),
    [](const auto& instance) {
      std::string name = std::filesystem::path(instance.param.path).stem().string();
      std::replace_if(
          name.begin(), name.end(), [](unsigned char c) { return !std::isalnum(c); }, '_');
      return name;
    });

// The OBJ files are the originals of the glTF files: the same rooms, the same lamps.
TEST(RealObj, SaysWhatItsGltfSays) {
  for (const std::string name : {"Original", "Sphere", "Water", "Glossy"}) {
    const std::string folder = scenes_folder() + "cornell-mcguire/";
    if (!std::filesystem::exists(folder))
      GTEST_SKIP() << "NOT TESTED: " << folder << " is not there (set GLEANER_SHARED)";
    const Scene gltf = import_scene(folder + "CornellBox-" + name + ".gltf");
    const Scene obj = import_scene(folder + "obj/CornellBox-" + name + ".obj");
    EXPECT_EQ(obj.triangle_count(), gltf.triangle_count()) << name;
    const Bounds a = bounds_of(gltf), b = bounds_of(obj);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(a.lower[c], b.lower[c], 1e-6) << name;
      EXPECT_NEAR(a.upper[c], b.upper[c], 1e-6) << name;
    }
    // Area times emission, a normal's worth: what leaves the front, and which way.
    const auto flux = [](const Scene& s) {
      std::array<double, 3> sum{};
      for (std::size_t t = 0; t < s.triangle_count(); ++t) {
        const Material& m = s.materials[s.triangle_material[t]];
        double e[2][3];
        for (int k = 0; k < 2; ++k)
          for (int c = 0; c < 3; ++c)
            e[k][c] = s.positions[3 * s.indices[3 * t + k + 1] + c] - s.positions[3 * s.indices[3 * t] + c];
        for (int c = 0; c < 3; ++c)
          sum[c] += m.emission[0] * (e[0][(c + 1) % 3] * e[1][(c + 2) % 3] - e[0][(c + 2) % 3] * e[1][(c + 1) % 3]) / 2;
      }
      return sum;
    };
    const auto left = flux(gltf), right = flux(obj);
    EXPECT_LT(left[1], -0.1) << name;  // the ceiling's lamp shines down
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(left[c], right[c], 1e-4) << name;
    const SceneNeeds needs = needs_of(obj);
    EXPECT_EQ(needs.transmissive, needs_of(gltf).transmissive) << name;
    EXPECT_EQ(needs.specular, needs_of(gltf).specular) << name;
  }
}

TEST(RealEnvironment, IsRead) {
  const std::string path = scenes_folder() + "breakfast-room/env.hdr";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "NOT TESTED: " << path << " is not there (set GLEANER_SHARED)";
  const Environment environment = import_environment(path);
  EXPECT_EQ(environment.width, 2 * environment.height);
  EXPECT_EQ(environment.radiance.size(), 3u * environment.width * environment.height);
}

}  // namespace
}  // namespace gleaner::scene
