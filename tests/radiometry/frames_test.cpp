// A worker that shows a base in one state after another computes what a worker computes that was given that scene
// alone: whatever was shown before, and with whatever traces.

#include <cmath>
#include <vector>

#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "scene/model/frame_state.h"
#include "tests/radiometry/shot.h"
#include "worker/trace/tracer.h"

namespace gleaner::test {
namespace {

using scene::FrameState;
using scene::Vec;

// Gives a mesh vertices of its own, at the end, which `posed` names: they and its triangles are posed by one matrix.
// Meshes are to be given in their order.
scene::PosedMesh& add_posed(Scene& scene, const std::string& name) {
  const auto mesh = std::ranges::find(scene.meshes, name, &scene::Mesh::name);
  const std::size_t corners = 3 * std::size_t{mesh->triangle_count};
  scene::PosedMesh posed{};
  posed.first_triangle = mesh->first_triangle;
  posed.triangle_count = mesh->triangle_count;
  posed.first_vertex = static_cast<std::uint32_t>(scene.vertex_count());
  posed.vertex_count = static_cast<std::uint32_t>(corners);
  posed.first_rest = static_cast<std::uint32_t>(scene.rig.positions.size() / 3);
  posed.first_matrix = scene.rig.matrices;
  posed.matrix_count = 1;
  for (std::size_t i = 0; i < corners; ++i) {
    std::uint32_t& index = scene.indices[3 * std::size_t{mesh->first_triangle} + i];
    for (auto [from, to] : {std::pair{&scene.positions, &scene.rig.positions}, {&scene.normals, &scene.rig.normals}})
      for (std::size_t c = 0; c < 3; ++c) {
        const float value = (*from)[3 * std::size_t{index} + c];
        to->push_back(value);
        from->push_back(value);
      }
    index = posed.first_vertex + static_cast<std::uint32_t>(i);
  }
  scene.rig.matrices += 1;
  scene.rig.meshes.push_back(posed);
  return scene.rig.meshes.back();
}

// A morph target that waves a mesh, and one that scatters its vertices, so that no box of a refitted tree is of use.
void add_targets(Scene& scene, scene::PosedMesh& posed) {
  posed.target_count = 2;
  posed.first_target = 0;
  posed.first_weight = scene.rig.morph_weights;
  scene.rig.morph_weights += 2;
  for (int target = 0; target < 2; ++target) {
    scene.rig.targets.push_back({static_cast<gl_uint>(scene.rig.deltas.size()), GLEANER_NONE});
    for (std::size_t v = 0; v < posed.vertex_count; ++v) {
      const float* at = &scene.rig.positions[3 * (posed.first_rest + v)];
      const double x = at[0], z = at[2];
      for (int c = 0; c < 3; ++c) {
        const double wave = c == 1 ? 0.07 * std::sin(5 * x) * std::cos(4 * z) : 0;
        const double torn = 0.7 * std::sin(1000 * (x + 3 * z) + c);
        scene.rig.deltas.push_back(static_cast<float>(target == 0 ? wave : torn));
      }
    }
  }
}

// Makes a mesh an instance that a matrix of the state places, the state's last.
void make_rigid(Scene& scene, const std::string& name) {
  const auto mesh = std::ranges::find(scene.meshes, name, &scene::Mesh::name);
  mesh->instanced = true;
  scene.rig.instances.push_back({static_cast<gl_uint>(scene.instances.size()), scene.rig.matrices++});
  scene.instances.push_back(
      {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, static_cast<gl_uint>(mesh - scene.meshes.begin()), {}});
}

// A room with a cloth that waves or is torn, a block that moves, a lamp that does, and a toy that does as an instance.
std::shared_ptr<const Scene> moving_room() {
  scene::SceneBuilder b("room");
  const auto grey = b.material("grey", scene::lambert(scene::grey(0.6)));
  scene::Material glowing = scene::lambert(scene::grey(0.2));
  std::fill(glowing.emission, glowing.emission + 3, 12.0f);
  glowing.flags |= GLEANER_MATERIAL_DOUBLE_SIDED;
  const auto glow = b.material("glow", glowing);
  b.mesh("floor");
  b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, grey);
  b.quad({-2, 0, -2}, {2, 0, -2}, {2, 3, -2}, {-2, 3, -2}, grey);
  b.mesh("block");
  b.quad({-0.5, 0, 0.5}, {0.5, 0, 0.5}, {0.5, 1, 0}, {-0.5, 1, 0}, grey);
  b.mesh("lamp");
  b.quad({-0.3, 2.5, 0.3}, {0.3, 2.5, 0.3}, {0.3, 2.5, -0.3}, {-0.3, 2.5, -0.3}, glow);
  b.mesh("still lamp");
  b.quad({1.5, 2.5, 0.3}, {1.8, 2.5, 0.3}, {1.8, 2.5, -0.3}, {1.5, 2.5, -0.3}, glow);
  b.mesh("cloth");
  b.grid(24, 24,
         [](std::uint32_t i, std::uint32_t j) {
           return Vec{0.08 * i - 1, 1.4 + 0.04 * std::sin(i), 0.08 * j - 1};
         },
         grey, {.smooth = true});
  b.mesh("toy");
  b.grid(8, 8,
         [](std::uint32_t i, std::uint32_t j) {
           return Vec{1 + 0.05 * i, 0.3 + 0.1 * std::sin(0.8 * j), 0.9 + 0.05 * j};
         },
         grey, {.smooth = true});
  b.point_light({-1, 1.8, 1}, {2, 2, 3});
  b.camera("front", {0, 1.5, 5}, {0, 1.2, 0}, 45, 24, 20);
  Scene scene = b.finish();
  add_posed(scene, "block");
  add_posed(scene, "lamp");
  add_targets(scene, add_posed(scene, "cloth"));
  make_rigid(scene, "toy");
  mark_deforming(scene);
  validate(scene, "room");
  return std::make_shared<const Scene>(std::move(scene));
}

struct Pose {
  double block = 0, lamp = 0, wave = 0, torn = 0;
  float light = 0, red = 0;  // of the point light, 0: as it is; of the floor, alike
  double toy = 0;            // turned by that angle, and shrunk
};

FrameState state_of(const Scene& base, const Pose& pose) {
  const auto moved = [](double x) { return scene::Placement{1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 0}; };
  FrameState state;
  const double c = std::cos(pose.toy), s = std::sin(pose.toy), h = 1 - 0.3 * pose.toy;
  state.matrices = {moved(pose.block), moved(pose.lamp), moved(0), {c, 0, s, 0, 0, h, 0, 0.1, -s, 0, c, 0}};
  state.morph_weights = {pose.wave, pose.torn};
  if (pose.light > 0) {
    state.light_indices = {0};
    state.lights = base.lights;
    std::fill(state.lights[0].intensity, state.lights[0].intensity + 3, pose.light);
  }
  if (pose.red > 0) {
    state.material_indices = {0};
    state.materials = {base.materials[0]};
    state.materials[0].base_color[0] = pose.red;
  }
  return state;
}

const std::vector<Pose> kPoses = {{},
                                  {.block = 0.4, .wave = 1},
                                  {.lamp = -1.2, .wave = 1},
                                  {.lamp = -1.2, .wave = 1, .light = 9, .red = 0.1f},
                                  {.block = 0.4, .lamp = 0.5, .torn = 1},
                                  {.wave = -0.7},
                                  // On the other side of the lamp that stands.
                                  {.lamp = 2.9, .wave = -0.7},
                                  // From then on the toy alone moves, at last mirrored.
                                  {.lamp = 2.9, .wave = -0.7, .toy = 0.5},
                                  {.lamp = 2.9, .wave = -0.7, .toy = 5}};

class Frames : public ::testing::TestWithParam<worker::TraceKind> {
 protected:
  void SetUp() override {
    if (GetParam() == worker::TraceKind::embree && !worker::embree_available()) GTEST_SKIP() << "built without Embree";
    base_ = moving_room();
    shot_ = {.scene = base_, .width = 24, .height = 20, .samples = 16, .chunks = 1, .trace = GetParam()};
    shot_.camera = base_->cameras.front().camera;
  }

  std::unique_ptr<worker::Executor> worker_with_base(unsigned threads = 1) const {
    worker::DeviceChoice choice;
    choice.threads = static_cast<int>(threads);
    choice.trace = GetParam();
    auto on = std::make_unique<worker::Executor>(choice);
    on->load_base("base", base_, bvh_of(*on, *base_));
    return on;
  }
  static std::shared_ptr<const scene::Bvh> bvh_of(const worker::Executor& on, const Scene& scene) {
    return on.needs_bvh() ? std::make_shared<const scene::Bvh>(scene::build_bvh(scene)) : nullptr;
  }

  scene::Bytes records(worker::Executor& on, const std::string& scene) const {
    return on.run(task_of(parameters_of(shot_), scene), 0, std::uint64_t{shot_.width} * shot_.height).records;
  }
  scene::Bytes frame(worker::Executor& on, std::size_t pose) const {
    const std::string id = "base+" + std::to_string(pose);
    on.load_frame(id, "base", state_of(*base_, kPoses[pose]));
    return records(on, id);
  }
  scene::Bytes own(std::size_t pose) const {
    const auto on = worker_with_base();
    const auto scene = std::make_shared<const Scene>(posed(*base_, state_of(*base_, kPoses[pose]), "own"));
    on->load_scene("own", scene, bvh_of(*on, *scene));
    return records(*on, "own");
  }

  std::shared_ptr<const Scene> base_;
  Shot shot_;
};

INSTANTIATE_TEST_SUITE_P(Tracers, Frames, ::testing::Values(worker::TraceKind::embree, worker::TraceKind::opencl),
                         [](const auto& p) { return p.param == worker::TraceKind::opencl ? "OpenCL" : "Embree"; });

TEST_P(Frames, AreThoseOfTheirScenes) {
  const auto on = worker_with_base();
  std::vector<scene::Bytes> pictures;
  for (std::size_t pose = 0; pose < kPoses.size(); ++pose) {
    pictures.push_back(frame(*on, pose));
    EXPECT_EQ(pictures.back() == own(pose), true) << "pose " << pose;
    for (std::size_t other = 0; other < pose; ++other)
      EXPECT_NE(pictures.back() == pictures[other], true) << "poses " << pose << " and " << other;
  }
}

TEST_P(Frames, DoNotDependOnThoseBefore) {
  const auto on = worker_with_base(), backwards = worker_with_base(2);
  std::vector<scene::Bytes> pictures;
  for (std::size_t pose = 0; pose < kPoses.size(); ++pose) pictures.push_back(frame(*on, pose));
  for (std::size_t pose = kPoses.size(); pose-- > 0;)
    EXPECT_EQ(frame(*backwards, pose) == pictures[pose], true) << "backwards, pose " << pose;
  for (const std::size_t pose : {4u, 1u, 3u, 0u}) {
    EXPECT_EQ(frame(*worker_with_base(), pose) == pictures[pose], true) << "alone, pose " << pose;
    EXPECT_EQ(frame(*on, pose) == pictures[pose], true) << "again, pose " << pose;
  }
}

// Whatever was shown before, a base at rest is the scene as it came.
TEST_P(Frames, AtRestAreTheBase) {
  const auto on = worker_with_base(), plain = worker_with_base();
  plain->load_scene("plain", base_, bvh_of(*plain, *base_));
  const scene::Bytes expected = records(*plain, "plain");
  const auto at_rest = [&](const std::string& id) {
    on->load_frame(id, "base", std::nullopt);
    return records(*on, id);
  };
  EXPECT_EQ(at_rest("first") == expected, true);
  for (std::size_t pose = 0; pose < kPoses.size(); ++pose) {
    const scene::Bytes posed = frame(*on, pose);
    EXPECT_EQ(at_rest("rest " + std::to_string(pose)) == expected, true) << "after pose " << pose;
    EXPECT_EQ(frame(*on, pose) == posed, true) << "pose " << pose << " again";
  }
}

// What stands is not followed; what is followed is refitted, or rebuilt where it was torn.
TEST_P(Frames, FollowWhatMovesAlone) {
  const auto on = worker_with_base();
  std::vector<worker::MotionReport> reports;
  for (std::size_t pose = 0; pose < kPoses.size(); ++pose)
    reports.push_back(on->load_frame(std::to_string(pose), "base", state_of(*base_, kPoses[pose])));
  const auto meshes = [&](std::size_t pose) {
    std::vector<std::string> names;
    for (const auto& mesh : reports[pose].meshes)
      names.push_back(base_->meshes[mesh.mesh].name + (mesh.rebuilt ? " rebuilt" : ""));
    return names;
  };
  using Names = std::vector<std::string>;
  EXPECT_EQ(meshes(0), (Names{"block", "lamp", "cloth"}));
  EXPECT_EQ(meshes(1), (Names{"block", "cloth"}));
  EXPECT_EQ(meshes(2), (Names{"block", "lamp"}));
  EXPECT_EQ(meshes(3), Names{});
  EXPECT_EQ(meshes(4), (Names{"block", "lamp", "cloth rebuilt"}));
  EXPECT_EQ(meshes(5), (Names{"block", "lamp", "cloth"}));
  EXPECT_EQ(meshes(6), Names{"lamp"});
  EXPECT_EQ(meshes(7), Names{});
  EXPECT_GT(reports[7].top_level_seconds, 0);
  EXPECT_LT(reports[7].written_bytes, 1024u) << "an instance's row, and no triangles";
  EXPECT_GT(reports[7].written_bytes, 0u);
  EXPECT_GT(reports[0].load_seconds, 0);
  for (std::size_t pose = 1; pose < reports.size(); ++pose) EXPECT_EQ(reports[pose].load_seconds, 0) << pose;
  // A light and a colour: neither triangles nor textures.
  EXPECT_LT(reports[3].written_bytes, 16384u);
  EXPECT_GT(reports[3].written_bytes, 0u);
  EXPECT_EQ(on->load_frame("8", "base", state_of(*base_, kPoses[8])).top_level_seconds, 0) << "held";
}

// Frames that run side by side take turns on a worker: each gets a place of its own.
TEST_P(Frames, ThatTakeTurnsAreHeldTogether) {
  const auto on = worker_with_base();
  std::vector<scene::Bytes> first;
  for (const std::size_t pose : {1u, 2u}) first.push_back(frame(*on, pose));
  unsigned loads = 0;
  for (int round = 0; round < 4; ++round)
    for (const std::size_t pose : {1u, 2u}) {
      const std::string id = "base+" + std::to_string(pose);
      loads += !on->holds_scene(id);
      EXPECT_EQ(frame(*on, pose) == first[pose - 1], true) << round;
    }
  EXPECT_EQ(loads, 1u);
}

TEST_P(Frames, ThatDoNotFitLeaveNoTrace) {
  const auto on = worker_with_base();
  const scene::Bytes before = frame(*on, 1);
  FrameState bad = state_of(*base_, kPoses[2]);
  bad.matrices[1][3] = 1e30;
  EXPECT_THROW(on->load_frame("bad", "base", bad), Error);
  EXPECT_FALSE(on->holds_scene("bad"));
  for (const double scale : {0.0, 1e30}) {
    bad = state_of(*base_, kPoses[2]);
    bad.matrices[3][5] = scale;
    EXPECT_THROW(on->load_frame("bad", "base", bad), Error) << scale;
  }
  bad = state_of(*base_, kPoses[2]);
  bad.matrices.pop_back();
  EXPECT_THROW(on->load_frame("bad", "base", bad), Error);
  bad = state_of(*base_, kPoses[3]);
  bad.light_indices = {7};
  EXPECT_THROW(on->load_frame("bad", "base", bad), Error);
  EXPECT_THROW(on->load_frame("frame", "another base", state_of(*base_, kPoses[2])), Error);
  EXPECT_EQ(frame(*on, 1) == before, true);
}

}  // namespace
}  // namespace gleaner::test
