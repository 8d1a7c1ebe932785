// Names of artifacts: everything that decides the bytes is in the name, and nothing else.

#include "coordinator/artifacts/artifact_id.h"

#include <gtest/gtest.h>

#include <functional>
#include <map>

#include "coordinator/artifacts/scene_lineage.h"
#include "coordinator/blobs/sha256.h"

namespace gleaner::coordinator {
namespace {

const std::string scene_a(64, 'a'), scene_b(64, 'b');

StageSpec sample() {
  StageSpec stage;
  stage.name = "photons";
  stage.kind = "emit";
  stage.items = 1000;
  stage.tile = 16;
  stage.parameters = Bytes(8, std::byte{3});
  stage.inputs = {{"lights", std::string(64, '1'), Extent::whole}, {"seeds", std::string(64, '2'), Extent::own_items}};
  stage.output = {.record_bytes = 32, .counted = true, .most_records = 4};
  return stage;
}

TEST(ArtifactName, IsASha256) { EXPECT_TRUE(is_sha256_hex(artifact_id(scene_a, sample()))); }

TEST(ArtifactName, DiffersWhereverTheBytesMayDiffer) {
  const std::map<std::string, std::function<void(StageSpec&)>> changes = {
      {"kind", [](StageSpec& s) { s.kind = "emit2"; }},
      {"items", [](StageSpec& s) { s.items = 1001; }},
      {"tile", [](StageSpec& s) { s.tile = 32; }},
      {"stride", [](StageSpec& s) { s.output.record_bytes = 36; }},
      {"counted", [](StageSpec& s) { s.output.counted = false; }},
      {"most records", [](StageSpec& s) { s.output.most_records = 5; }},
      {"parameters", [](StageSpec& s) { s.parameters[7] = std::byte{4}; }},
      {"more parameters", [](StageSpec& s) { s.parameters.push_back(std::byte{0}); }},
      {"an input's name", [](StageSpec& s) { s.inputs[0].name = "light"; }},
      {"an input", [](StageSpec& s) { s.inputs[0].artifact = std::string(64, '3'); }},
      {"an input's extent", [](StageSpec& s) { s.inputs[1].extent = Extent::whole; }},
      {"one input less", [](StageSpec& s) { s.inputs.pop_back(); }},
      {"inputs exchanged", [](StageSpec& s) { std::swap(s.inputs[0].artifact, s.inputs[1].artifact); }},
      // Without lengths before the fields this would be the first name again.
      {"a digit moved",
       [](StageSpec& s) { s.inputs[0].name = "lights1", s.inputs[0].artifact = std::string(63, '1'); }},
  };
  std::map<ArtifactId, std::string> names = {{artifact_id(scene_a, sample()), "nothing"},
                                             {artifact_id(scene_b, sample()), "scene"}};
  EXPECT_EQ(names.size(), 2u);
  for (const auto& [what, change] : changes) {
    StageSpec stage = sample();
    change(stage);
    const auto [at, fresh] = names.emplace(artifact_id(scene_a, stage), what);
    EXPECT_TRUE(fresh) << what << " gives the name of " << at->second;
  }
}

TEST(ArtifactName, IsTheSameWhereTheBytesAreTheSame) {
  StageSpec stage = sample();
  stage.name = "frame 2: photons";
  stage.priority = 3;
  stage.solo = true;
  stage.output.placement = Placement::retain;
  stage.output.reusable = true;
  EXPECT_EQ(artifact_id(scene_a, stage), artifact_id(scene_a, sample()));
}

// Frames that show a base in states share what is made of the parts in which they do not differ.
TEST(ArtifactName, NamesThePartsOfTheSceneThatAStageReads) {
  scene::Scene base;
  base.lights.resize(2);
  base.lights[0].intensity[1] = 3;
  base.materials.resize(1);
  const auto named = [&](const scene::FrameState& state, unsigned parts) {
    StageSpec stage = sample();
    stage.scene_parts = parts;
    return artifact_id(lineage_of(scene_a, base, state), stage);
  };
  const scene::FrameState none;
  scene::FrameState moved, lit, painted, colored, glowing, dark;
  moved.matrices = {{1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0}};
  lit.light_indices = {0};
  lit.lights = {base.lights[0]};
  lit.lights[0].intensity[1] = 4;
  painted.material_indices = {0};
  painted.materials = base.materials;
  painted.materials[0].alpha = 0.5f;
  colored = glowing = painted;
  colored.materials[0] = glowing.materials[0] = base.materials[0];
  colored.materials[0].base_color[2] = 0.25f;
  glowing.materials[0].emission[0] = 2;
  for (unsigned parts = 0; parts <= kWholeScene; ++parts) {
    EXPECT_EQ(named(moved, parts) == named(none, parts), !(parts & kGeometry)) << parts;
    EXPECT_EQ(named(painted, parts) == named(none, parts), !(parts & kMaterials)) << parts;
    EXPECT_EQ(named(lit, parts) == named(none, parts), !(parts & kLights)) << parts;
    EXPECT_EQ(named(colored, parts) == named(none, parts), !(parts & kColors)) << parts;
    // It begins to shine.
    EXPECT_EQ(named(glowing, parts) == named(none, parts), !(parts & (kEmission | kLights))) << parts;
  }
  // A state that says of a material what the base does changes nothing.
  scene::FrameState same = painted;
  same.materials[0] = base.materials[0];
  EXPECT_EQ(named(same, kWholeScene), named(none, kWholeScene));
  // What is made of the base at rest serves every state.
  StageSpec resting = sample();
  resting.pose = Pose::rest;
  for (const scene::FrameState& state : {none, moved, lit, painted, glowing})
    EXPECT_EQ(artifact_id(lineage_of(scene_a, base, state), resting), artifact_id(scene_a, sample()));
  // What was made of an earlier state is what a frame of that state makes.
  StageSpec earlier = sample();
  earlier.pose = Pose::earlier;
  SceneLineage after_moving = lineage_of(scene_a, base, lit);
  after_moving.earlier_geometry = lineage_of(scene_a, base, moved).geometry;
  earlier.scene_parts = kGeometry | kMaterials;
  StageSpec at_once = earlier;
  at_once.pose = Pose::shown;
  EXPECT_EQ(artifact_id(after_moving, earlier), artifact_id(lineage_of(scene_a, base, moved), at_once));
  EXPECT_NE(artifact_id(after_moving, earlier), artifact_id(after_moving, at_once));
  // Which of the parts it is makes a difference.
  scene::FrameState weighed;
  weighed.morph_weights = {1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0};
  EXPECT_NE(named(moved, kGeometry), named(weighed, kGeometry));
  // Where another number of lights shines, other programs of kernels are built: their roundings may differ.
  dark = lit;
  dark.lights[0].intensity[1] = 0;
  EXPECT_NE(named(dark, kSurfaces), named(lit, kSurfaces));
  EXPECT_EQ(named(dark, kNoScene), named(lit, kNoScene));
}

TEST(ArtifactName, OfAPlansOwnDataIsThatOfItsBytes) {
  const Bytes bytes(3, std::byte{'x'});
  EXPECT_EQ(data_id(bytes),
            "cd2eb0837c9b4c962c22d2ff8b5441b7b45805887f051d39bf133b583baf6860");  // echo -n xxx | sha256sum
}

}  // namespace
}  // namespace gleaner::coordinator
