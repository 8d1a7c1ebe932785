// Animations of glTF files: what a time looks like, against values worked out by hand, and what is refused.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/library/bake.h"
#include "scene/model/error.h"
#include "scene/model/frame_state.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using testing::ElementsAre;
using testing::FloatNear;
using testing::HasSubstr;

using Floats = std::vector<float>;

constexpr float kHalfFloat = static_cast<float>(kHalf);

// A triangle (0 0 0, 1 0 0, 0 1 0) whose node is animated.
class Animation : public testing::Test {
 protected:
  void animate(const std::string& path, const Floats& times, const Floats& values, const std::string& type,
               const std::string& interpolation = "LINEAR", const std::string& name = "") {
    const std::size_t input = file_.add(times, 5126, "SCALAR"), output = file_.add(values, 5126, type);
    json animation = {{"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", path}}}}}},
                      {"samplers", {{{"input", input}, {"output", output}, {"interpolation", interpolation}}}}};
    if (!name.empty()) animation["name"] = name;
    file_.json["animations"].push_back(animation);
  }
  void animate_pointer(const std::string& pointer, const Floats& times, const Floats& values, const std::string& type) {
    animate("pointer", times, values, type);
    json& target = file_.json["animations"].back()["channels"][0]["target"];
    target.erase("node");
    target["extensions"]["KHR_animation_pointer"]["pointer"] = pointer;
  }
  Scene at(double seconds, const std::string& animation = "all") {
    ImportOptions options;
    options.seconds = seconds;
    options.animation = animation;
    return import_scene(folder_.write("scene.glb", file_.glb()), options);
  }
  // Where the second corner, (1, 0, 0) at rest, is.
  Floats corner(double seconds, const std::string& animation = "all") {
    const Scene scene = baked(at(seconds, animation));
    return {scene.positions.begin() + 3, scene.positions.begin() + 6};
  }
  // What is said of a file that is refused.
  std::string refusal(const std::string& animation = "all") {
    try {
      at(0, animation);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      return error.what();
    }
    return "";
  }

  Folder folder_;
  GltfFile file_ = triangle_file();
};

auto near(const Floats& values) { return testing::Pointwise(FloatNear(1e-6f), values); }

TEST_F(Animation, MovesInLines) {
  animate("translation", {1, 3}, {0, 0, 0, 2, 4, -6}, "VEC3");
  EXPECT_THAT(corner(2), near({2, 2, -3}));
  EXPECT_THAT(corner(1.5), near({1.5f, 1, -1.5f}));
  EXPECT_THAT(corner(0), near({1, 0, 0})) << "before the first key";
  EXPECT_THAT(corner(9), near({3, 4, -6})) << "the last pose holds";
  EXPECT_THAT(corner(-5), near({1, 0, 0}));
}

TEST_F(Animation, Steps) {
  animate("translation", {0, 1}, {0, 0, 0, 5, 0, 0}, "VEC3", "STEP");
  EXPECT_THAT(corner(0.999), near({1, 0, 0}));
  EXPECT_THAT(corner(1), near({6, 0, 0}));
}

// Half of a quarter turn about z, and the shorter way round where the quaternions' signs differ.
TEST_F(Animation, TurnsAlongTheShorterArc) {
  const float half = std::sqrt(0.5f);
  for (const float sign : {1.0f, -1.0f}) {
    file_ = triangle_file();
    animate("rotation", {0, 1}, {0, 0, 0, 1, 0, 0, sign * kHalfFloat, sign * kHalfFloat}, "VEC4");
    EXPECT_THAT(corner(0.5), near({half, half, 0})) << sign;
    EXPECT_THAT(corner(1.0 / 3), near({std::cos(0.52359878f), std::sin(0.52359878f), 0})) << sign;
  }
}

// From 1 to 3 in 2 s with slopes of 0.5 and -1 a second: at the middle the mean of the ends and an eighth of the span
// times the slopes' difference.
TEST_F(Animation, FollowsCubicSplines) {
  animate("scale", {0, 2}, {0, 0, 0, 1, 1, 1, 0.5f, 0, 0, -1, 0, 0, 3, 1, 1, 0, 0, 0}, "VEC3", "CUBICSPLINE");
  EXPECT_THAT(corner(1), near({2 + 2 * 1.5f / 8, 0, 0}));
  EXPECT_THAT(corner(2), near({3, 0, 0}));
}

TEST_F(Animation, BlendsMorphTargets) {
  const std::size_t up = file_.add(Floats{0, 0, 0, 0, 0, 1, 0, 0, 0}, 5126, "VEC3");
  const std::size_t right = file_.add(Floats{0, 0, 0, 4, 0, 0, 0, 0, 0}, 5126, "VEC3");
  file_.primitive()["targets"] = {{{"POSITION", up}}, {{"POSITION", right}}};
  animate("weights", {0, 1}, {0, 1, 1, 0}, "SCALAR");
  EXPECT_THAT(corner(0), near({5, 0, 0}));
  EXPECT_THAT(corner(0.25), near({4, 0, 0.25f}));
}

TEST_F(Animation, FollowsPointers) {
  file_.json["materials"] = {{{"emissiveFactor", {1, 1, 1}}, {"pbrMetallicRoughness", json::object()}}};
  file_.primitive()["material"] = 0;
  animate_pointer("/materials/0/emissiveFactor", {0, 1}, {0, 0, 0, 1, 0.5f, 0}, "VEC3");
  // The file leaves it to its default.
  animate_pointer("/materials/0/pbrMetallicRoughness/roughnessFactor", {0, 1}, {0, 1}, "SCALAR");
  const Material material = at(0.5).materials.at(0);
  EXPECT_FLOAT_EQ(material.emission[0], 0.5f);
  EXPECT_FLOAT_EQ(material.emission[1], 0.25f);
  EXPECT_FLOAT_EQ(material.roughness, 0.5f);
}

// The corner at ten times against the same computed here, in double precision, by other formulas: a turn about an axis
// by its angle, then a parent's move. As an instance, and vertex by vertex.
TEST_F(Animation, BaseAndStateStandWhereTheyShould) {
  animate("rotation", {0, 1}, {0, 0, 0, 1, 0, 0, kHalfFloat, kHalfFloat}, "VEC4");
  animate("translation", {0, 2}, {1, 0, 0, 1, 8, 0}, "VEC3");
  for (const bool instances : {true, false}) {
    ImportOptions options;
    options.instances = instances;
    MovingScene file(folder_.write("scene.glb", file_.glb()), options);
    ASSERT_TRUE(file.moves());
    const Bytes blob = serialize(file.base());
    const Scene base = parse_scene(blob, "base");
    ASSERT_EQ(base.rig.instances.size(), instances ? 1u : 0u);
    ASSERT_EQ(base.rig.meshes.size(), instances ? 0u : 1u);
    for (int k = 0; k < 10; ++k) {
      const double seconds = 0.25 * k, angle = std::min(seconds, 1.0) * std::acos(-1.0) / 2;
      const auto frame = file.at(seconds);
      ASSERT_TRUE(frame);
      const Bytes bytes = serialize(frame->state);
      EXPECT_LT(bytes.size(), 65536u);
      const Scene shown = posed(base, parse_frame_state(bytes, "state"), "frame"), placed = baked(shown);
      EXPECT_NEAR(placed.positions[3], 1 + std::cos(angle), 1e-5) << seconds;
      EXPECT_NEAR(placed.positions[4], std::sin(angle) + 4 * std::min(seconds, 2.0), 1e-5 * 9) << seconds;
      options.seconds = seconds;
      const Scene own = import_scene(folder_.write("scene.glb", file_.glb()), options);
      EXPECT_EQ(shown.positions, own.positions) << "a scene of its own";
      EXPECT_EQ(shown.normals, own.normals);
      EXPECT_TRUE(same_bytes(shown.instances, own.instances));
      EXPECT_EQ(serialize(file.at(seconds)->state), bytes) << "whatever was asked for before";
    }
  }
}

TEST_F(Animation, StatesThatDoNotFitAreRefused) {
  animate("translation", {0, 1}, {0, 0, 0, 1, 0, 0}, "VEC3");
  MovingScene file(folder_.write("scene.glb", file_.glb()));
  const Scene& base = file.base();
  const FrameState good = file.at(0.5)->state;
  ASSERT_EQ(good.matrices.size(), 1u);
  const auto refused = [&](const std::function<void(FrameState&)>& damage) -> std::string {
    FrameState state = good;
    damage(state);
    try {
      posed(base, parse_frame_state(serialize(state), "state"), "state");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(refused([](FrameState&) {}), "");
  EXPECT_THAT(refused([](FrameState& s) { s.matrices.clear(); }), HasSubstr("matrices: expected 1"));
  EXPECT_THAT(refused([](FrameState& s) { s.matrices[0][3] = NAN; }), HasSubstr("matrices[0]: expected a finite"));
  EXPECT_THAT(refused([](FrameState& s) { s.matrices[0][3] = 1e20; }), HasSubstr("instances[0].transform"));
  EXPECT_THAT(refused([](FrameState& s) { s.matrices[0][0] = 0; }), HasSubstr("instances[0].transform"));
  EXPECT_THAT(refused([](FrameState& s) { s.morph_weights = {1}; }), HasSubstr("morph_weights: expected 0"));
  EXPECT_THAT(refused([](FrameState& s) {
                s.light_indices = {0};
                s.lights.resize(1);
              }),
              HasSubstr("light_indices[0]"));
  EXPECT_THAT(refused([](FrameState& s) { s.material_indices = {0}; }), HasSubstr("material_indices"));
  Bytes cut = serialize(good);
  cut.resize(cut.size() - 1);
  EXPECT_THROW(parse_frame_state(cut, "state"), Error);
}

// What only lights do needs no rig, and what stands still has the blob that it always had.
TEST_F(Animation, StatesAreSmall) {
  animate("translation", {0, 1}, {0, 0, 0, 1, 0, 0}, "VEC3");
  const std::string still = folder_.write("still.glb", triangle_file().glb());
  MovingScene file(still);
  EXPECT_FALSE(file.moves());
  EXPECT_TRUE(file.base().rig.empty());
  EXPECT_TRUE(file.at(1)->state.empty());
}

TEST_F(Animation, AreListedAndChosen) {
  animate("translation", {0, 2.5f}, {0, 0, 0, 10, 0, 0}, "VEC3", "LINEAR", "walk");
  animate("scale", {0, 1}, {1, 1, 1, 3, 1, 1}, "VEC3");
  const Scene scene = at(0);
  ASSERT_EQ(scene.animations.size(), 2u);
  EXPECT_EQ(scene.animations[0].name, "walk");
  EXPECT_EQ(scene.animations[0].seconds, 2.5);
  EXPECT_EQ(scene.animations[1].seconds, 1);
  EXPECT_THAT(corner(1), near({4 + 3, 0, 0}));
  EXPECT_THAT(corner(1, "walk"), near({4 + 1, 0, 0}));
  EXPECT_THAT(corner(1, "1"), near({3, 0, 0}));
  EXPECT_THAT(refusal("run"), HasSubstr("walk"));
}

TEST_F(Animation, ConflictsAreSaid) {
  animate("translation", {0, 1}, {0, 0, 0, 1, 0, 0}, "VEC3");
  animate("translation", {0, 1}, {0, 0, 0, 0, 5, 0}, "VEC3");
  EXPECT_THAT(corner(1), near({1, 5, 0}));
  EXPECT_THAT(at(1).warnings, testing::Contains(HasSubstr("animations[1].channels[0]")));
}

TEST_F(Animation, MalformedOnesAreRefusedByName) {
  const auto refused = [&](const std::function<void()>& make) {
    file_ = triangle_file();
    make();
    return refusal();
  };
  const Floats two = {0, 0, 0, 1, 1, 1};
  EXPECT_THAT(refused([&] {
                animate("translation", {1, 1}, two, "VEC3");
              }),
              HasSubstr("animations[0].samplers[0].input"));
  EXPECT_THAT(refused([&] { animate("translation", {1, 0}, two, "VEC3"); }), HasSubstr("times from 0 on that rise"));
  EXPECT_THAT(refused([&] { animate("translation", {-1, 0}, two, "VEC3"); }), HasSubstr("times from 0 on that rise"));
  EXPECT_THAT(refused([&] { animate("translation", {0, NAN}, two, "VEC3"); }), HasSubstr("finite"));
  EXPECT_THAT(refused([&] {
                animate("translation", {0, 1}, {0, 0, 0, 1, NAN, 1}, "VEC3");
              }),
              HasSubstr("animations[0].samplers[0].output"));
  EXPECT_THAT(refused([&] {
                animate("rotation", {0, 1}, {0, 0, 0, 1, 0, 0, 0, 0}, "VEC4");
              }),
              HasSubstr("animations[0].samplers[0].output"));
  EXPECT_THAT(refused([&] { animate("translation", {0, 1, 2}, two, "VEC3"); }), HasSubstr("3 values"));
  EXPECT_THAT(refused([&] { animate("translation", {0, 1}, two, "VEC3", "CUBICSPLINE"); }), HasSubstr("output"));
  EXPECT_THAT(refused([&] { animate("translation", {0, 1}, two, "VEC3", "SPLINE"); }), HasSubstr("CUBICSPLINE"));
  EXPECT_THAT(refused([&] { animate("colour", {0, 1}, two, "VEC3"); }), HasSubstr("target.path"));
  EXPECT_THAT(refused([&] {
                animate("translation", {0, 1}, two, "VEC3");
                file_.json["animations"][0]["channels"][0]["target"]["node"] = 7;
              }),
              HasSubstr("animations[0].channels[0].target.node"));
  EXPECT_THAT(refused([&] {
                animate("translation", {0, 1}, two, "VEC3");
                file_.json["nodes"][0]["matrix"] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
              }),
              HasSubstr("nodes[0].matrix"));
  EXPECT_THAT(refused([&] {
                animate_pointer("/materials/9/emissiveFactor", {0, 1}, two, "VEC3");
              }),
              HasSubstr("pointer"));
}

}  // namespace
}  // namespace gleaner::scene
