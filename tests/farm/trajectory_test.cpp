// Frames of a camera trajectory on a farm with real devices: what the first one made serves the others, and no picture
// depends on that.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "cli/embedded.h"
#include "coordinator/plan/trajectory.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/frame_state.h"
#include "tests/farm/fake_frame.h"

namespace gleaner::test {
namespace {

using coordinator::JobRequest;
using nlohmann::json;
using testing::Contains;
using testing::Not;
using testing::StartsWith;

JobRequest request_of(const scene::Scene& scene) {
  JobRequest request;
  request.scene_name = "box";
  request.scenes.emplace_back().summary = coordinator::summarize(scene);
  request.settings.method = "vpl";
  request.settings.width = request.settings.height = 48;
  request.settings.spp = 4;
  request.settings.set = {{"vpl.count", "500"}, {"vpl.clusters", "100"}, {"vpl.point_clusters", "60"}};
  request.settings.camera = scene.cameras.front().camera;
  request.settings.camera.half_width = request.settings.camera.half_height;
  return request;
}

// The frames' reports, of a farm that has rendered nothing before.
std::vector<json> render(const std::vector<scene::Scene>& scenes, JobRequest request, unsigned workers = 1) {
  TemporaryFolder folder;
  cli::EmbeddedSettings settings;
  settings.workers = workers;
  settings.paths = [&](const std::string&, std::uint32_t frame) {
    return coordinator::FramePaths{{}, {}, folder.path() / (std::to_string(frame) + ".json")};
  };
  cli::EmbeddedFarm embedded(settings);
  request.scenes.clear();
  for (const scene::Scene& scene : scenes) {
    coordinator::FrameScene& blobs = request.scenes.emplace_back();
    blobs.summary = coordinator::summarize(scene);
    blobs.scene_blob = embedded.blobs().put(scene::serialize(scene));
    if (embedded.needs_bvh()) blobs.bvh_blob = embedded.blobs().put(scene::serialize(scene::build_bvh(scene)));
  }
  const std::string job = embedded.farm().submit(request);
  while (!ended(embedded.farm().status(job)->state)) embedded.farm().wait(job, ~std::uint64_t{0}, 0.1);
  EXPECT_EQ(embedded.farm().status(job)->state, coordinator::JobState::done) << embedded.farm().status(job)->message;
  std::vector<json> reports;
  for (std::uint32_t frame = request.first_frame; frame <= request.last_frame; ++frame) {
    std::ifstream file(folder.path() / (std::to_string(frame) + ".json"));
    reports.push_back(json::parse(file));
  }
  return reports;
}

std::vector<json> render(const scene::Scene& scene, JobRequest request) {
  return render(std::vector{scene}, std::move(request));
}

std::string pixels_of(const scene::Scene& scene, JobRequest request, unsigned workers) {
  return render(std::vector{scene}, std::move(request), workers).at(0)["pixels_sha256"];
}

std::vector<std::string> names(const json& entries, const char* key) {
  std::vector<std::string> all;
  for (const auto& entry : entries) all.push_back(entry[key]);
  return all;
}

TEST(FarmTrajectory, LaterFramesReuseAllButShading) {
  const scene::Scene scene = scene::make_scene("cornell-box", {});
  JobRequest request = request_of(scene);
  request.last_frame = 3;
  for (int frame = 0; frame < 3; ++frame) {
    request.cameras.push_back(request.settings.camera);
    request.cameras.back().origin[0] += 0.1f * static_cast<float>(frame);
  }
  const std::vector<json> frames = render(scene, request);
  const std::vector<std::string> shared = {"vpl.trace.0",       "vpl.resample.0",   "vpl.cluster.0", "vpl.order.0",
                                           "vpl.points.0",      "vpl.points.1",     "vpl.points.2",  "vpl.merge_points",
                                           "vpl.point_cluster", "vpl.visibility.0", "vpl.skipped.0"};
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto run = names(frames[k]["stages"], "name"), left_out = names(frames[k]["skips"], "what");
    for (const std::string& stage : shared) {
      EXPECT_EQ(std::ranges::count(run, stage), k == 0 ? 1 : 0) << stage << ", frame " << k + 1;
      EXPECT_EQ(std::ranges::count(left_out, "stage " + stage), k == 0 ? 0 : 1) << stage << ", frame " << k + 1;
    }
    EXPECT_THAT(run, Contains("vpl.shade.0"));
  }
  EXPECT_NE(frames[1]["pixels_sha256"], frames[0]["pixels_sha256"]);

  // The second frame for itself, of a farm that has seen neither of the others.
  JobRequest alone = request_of(scene);
  alone.settings.camera = request.cameras[1];
  alone.settings.trajectory = coordinator::trajectory_of(request.cameras);
  const json second = render(scene, alone).at(0);
  for (const std::string& stage : shared) EXPECT_THAT(names(second["stages"], "name"), Contains(stage));
  EXPECT_EQ(second["pixels_sha256"], frames[1]["pixels_sha256"]);
  // Not because the trajectory is nothing to the picture.
  alone.settings.trajectory.clear();
  EXPECT_NE(render(scene, alone).at(0)["pixels_sha256"], frames[1]["pixels_sha256"]);
}

TEST(FarmTrajectory, FramesOfOneCameraHaveNone) {
  const scene::Scene scene = scene::make_scene("cornell-box", {});
  JobRequest request = request_of(scene);
  request.last_frame = 2;
  request.cameras.assign(2, request.settings.camera);
  const std::vector<json> frames = render(scene, request);
  EXPECT_THAT(names(frames[0]["stages"], "name"), Contains("vpl.points"));
  EXPECT_THAT(names(frames[0]["stages"], "name"), Not(Contains(StartsWith("vpl.points."))));
  EXPECT_EQ(frames[1]["pixels_sha256"], frames[0]["pixels_sha256"]);
}

JobRequest splat_request(const scene::Scene& scene) {
  JobRequest request = request_of(scene);
  request.settings.method = "splat";
  request.settings.spp = 2;
  request.settings.set = {{"splat.accuracy", "0.4"}, {"splat.gather_rays", "64"}};
  return request;
}

// Records of the trajectory's cameras are made once; a frame adds the few that only it needs, and its bits depend
// neither on that nor on the number of workers.
TEST(FarmTrajectory, LaterFramesKeepCacheRecords) {
  const scene::Scene scene = scene::make_scene("cornell-box", {});
  JobRequest request = splat_request(scene);
  request.last_frame = 4;
  for (int frame = 0; frame < 4; ++frame) {
    request.cameras.push_back(request.settings.camera);
    request.cameras.back().origin[0] += 0.1f * static_cast<float>(frame);
  }
  const std::vector<json> frames = render(scene, request);
  std::uint64_t of_all = 0;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto run = names(frames[k]["stages"], "name"), left_out = names(frames[k]["skips"], "what");
    for (const char* stage :
         {"splat.extend.0", "splat.extend.1", "splat.extend.2", "splat.extend.3", "splat.gather.0"}) {
      EXPECT_EQ(std::ranges::count(run, stage), k == 0 ? 1 : 0) << stage << ", frame " << k + 1;
      EXPECT_EQ(std::ranges::count(left_out, std::string("stage ") + stage), k == 0 ? 0 : 1)
          << stage << ", frame " << k + 1;
    }
    const json& splat = frames[k]["parameters"]["splat"];
    EXPECT_EQ(splat["cameras"], 4);
    const std::uint64_t added = splat["new_records"], begun = splat["records"].get<std::uint64_t>() - added;
    if (k == 0) of_all = begun;
    EXPECT_EQ(begun, of_all) << "frame " << k + 1;
    EXPECT_LT(added, begun / 5) << "frame " << k + 1;
  }
  EXPECT_NE(frames[1]["pixels_sha256"], frames[0]["pixels_sha256"]);
  JobRequest alone = splat_request(scene);
  alone.settings.camera = request.cameras[2];
  alone.settings.trajectory = coordinator::trajectory_of(request.cameras);
  for (const unsigned workers : {1u, 3u})
    EXPECT_EQ(pixels_of(scene, alone, workers), frames[2]["pixels_sha256"]) << workers << " workers";
  alone.settings.trajectory.clear();
  EXPECT_NE(pixels_of(scene, alone, 1), frames[2]["pixels_sha256"]);
}

// Sample points of the trajectory's cameras, and what is gathered there, are made once.
TEST(FarmTrajectory, LaterFramesKeepShadingClusters) {
  const scene::Scene scene = scene::make_scene("cornell-box", {});
  JobRequest request = request_of(scene);
  request.settings.method = "photon";
  request.settings.set = {{"photon.count", "5000"}, {"photon.clusters", "100"}, {"photon.gather_rays", "64"}};
  JobRequest alone = request;
  request.last_frame = 3;
  for (int frame = 0; frame < 3; ++frame) {
    request.cameras.push_back(request.settings.camera);
    request.cameras.back().origin[0] += 0.1f * static_cast<float>(frame);
  }
  const std::vector<json> frames = render(scene, request);
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto run = names(frames[k]["stages"], "name"), left_out = names(frames[k]["skips"], "what");
    for (const char* stage : {"photon.map.global", "photon.extend.0", "photon.extend.1", "photon.extend.2",
                              "photon.extend_gather.0", "photon.extend_refine.2.0"}) {
      EXPECT_EQ(std::ranges::count(run, stage), k == 0 ? 1 : 0) << stage << ", frame " << k + 1;
      EXPECT_EQ(std::ranges::count(left_out, std::string("stage ") + stage), k == 0 ? 0 : 1)
          << stage << ", frame " << k + 1;
    }
    const json& photon = frames[k]["parameters"]["photon"];
    EXPECT_EQ(photon["cameras"], 3);
    EXPECT_EQ(photon["kept"], frames[0]["parameters"]["photon"]["kept"]);
    EXPECT_LT(photon["places"].get<int>() - photon["kept"].get<int>(), 40) << "frame " << k + 1;
  }
  EXPECT_NE(frames[1]["pixels_sha256"], frames[0]["pixels_sha256"]);
  alone.settings.camera = request.cameras[1];
  alone.settings.trajectory = coordinator::trajectory_of(request.cameras);
  for (const unsigned workers : {1u, 3u})
    EXPECT_EQ(pixels_of(scene, alone, workers), frames[1]["pixels_sha256"]) << workers << " workers";
  alone.settings.trajectory.clear();
  EXPECT_NE(pixels_of(scene, alone, 1), frames[1]["pixels_sha256"]);
}

// With a few new records each, pictures begin coarse and become finer; a picture is named by those before it.
TEST(FarmTrajectory, PicturesOfASessionMakeTheCacheFiner) {
  const scene::Scene scene = scene::make_scene("cornell-box", {});
  JobRequest request = splat_request(scene);
  request.settings.set["splat.accuracy"] = "0.2";
  request.settings.set["splat.new_records"] = "50";
  double before = 100, first = 0;
  std::uint64_t records = 0;
  std::string last;
  for (std::size_t look = 1; look <= 6; ++look) {
    request.settings.looks.assign(look, request.settings.camera);
    const json picture = render(scene, request).at(0);
    const json& splat = picture["parameters"]["splat"];
    std::printf("  look %zu: %llu records, %llu of them beyond its cameras', accuracy %.3f\n", look,
                static_cast<unsigned long long>(splat["records"].get<std::uint64_t>()),
                static_cast<unsigned long long>(splat["new_records"].get<std::uint64_t>()),
                splat["accuracy"].get<double>());
    EXPECT_LE(splat["records"].get<std::uint64_t>(), 50 * (look + 1));
    // None stands still.
    EXPECT_GT(splat["records"].get<std::uint64_t>(), records + 25);
    records = splat["records"];
    EXPECT_LE(splat["accuracy"].get<double>(), before);
    before = splat["accuracy"];
    if (look == 1) first = before;
    last = picture["pixels_sha256"];
  }
  EXPECT_LT(before, 0.6 * first);
  EXPECT_EQ(pixels_of(scene, request, 2), last);
}

// Frame N of a sequence whose scene moves is the picture of that scene alone; frames that are alike are rendered once.
TEST(FarmMovingScenes, FramesAreThoseOfTheirScenes) {
  std::vector<scene::Scene> scenes(3, scene::make_scene("cornell-box", {}));
  for (std::size_t i = 0; i < scenes[2].positions.size(); i += 3) scenes[2].positions[i] += 0.05f;
  for (const char* method : {"path", "vpl"}) {
    JobRequest request = request_of(scenes.front());
    request.settings.method = method;
    if (std::string(method) == "path") request.settings.set = {};
    JobRequest alone = request;
    request.last_frame = 3;
    const std::vector<json> frames = render(scenes, request);
    ASSERT_EQ(frames.size(), 3u);
    EXPECT_EQ(frames[0]["pixels_sha256"], frames[1]["pixels_sha256"]) << method;
    EXPECT_NE(frames[0]["pixels_sha256"], frames[2]["pixels_sha256"]) << method;
    EXPECT_EQ(render(scenes[2], alone).at(0)["pixels_sha256"], frames[2]["pixels_sha256"]) << method;
  }
}

// The box with a mesh that moves: the scene's last triangles, placed by a matrix.
scene::Scene moving_box() {
  scene::Scene base = scene::make_scene("cornell-box", {});
  const scene::Mesh& mesh = base.meshes.back();
  const std::size_t corners = 3 * std::size_t{mesh.triangle_count};
  scene::PosedMesh posed{};
  posed.first_triangle = mesh.first_triangle;
  posed.triangle_count = mesh.triangle_count;
  // Vertices of its own, at the end.
  posed.first_vertex = static_cast<std::uint32_t>(base.vertex_count());
  posed.vertex_count = static_cast<std::uint32_t>(corners);
  posed.matrix_count = 1;
  for (std::size_t i = 0; i < corners; ++i) {
    std::uint32_t& index = base.indices[3 * std::size_t{mesh.first_triangle} + i];
    for (std::size_t c = 0; c < 3; ++c) {
      base.rig.positions.push_back(base.positions[3 * std::size_t{index} + c]);
      base.rig.normals.push_back(base.normals[3 * std::size_t{index} + c]);
    }
    index = posed.first_vertex + static_cast<std::uint32_t>(i);
  }
  base.positions.insert(base.positions.end(), base.rig.positions.begin(), base.rig.positions.end());
  base.normals.insert(base.normals.end(), base.rig.normals.begin(), base.rig.normals.end());
  if (!base.uvs.empty()) base.uvs.resize(2 * base.vertex_count());
  if (!base.second_uvs.empty()) base.second_uvs.resize(2 * base.vertex_count());
  if (!base.colors.empty()) base.colors.resize(4 * base.vertex_count(), 65535);
  base.rig.meshes = {posed};
  base.rig.matrices = 1;
  mark_deforming(base);
  return base;
}

// The same, whose mesh moves as an instance.
scene::Scene rigid_box() {
  scene::Scene base = scene::make_scene("cornell-box", {});
  base.meshes.back().instanced = true;
  base.instances = {{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, static_cast<gl_uint>(base.meshes.size() - 1), {}}};
  base.rig.instances = {{0, 0}};
  base.rig.matrices = 1;
  return base;
}

scene::FrameState moved_by(double x) {
  scene::FrameState state;
  state.matrices = {{1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 0}};
  return state;
}

// The frames' reports, of a farm that has rendered nothing before; of no states: those of the base's own scene.
std::vector<json> reports(const scene::Scene& base, const std::vector<scene::FrameState>& states, JobRequest request,
                          unsigned workers) {
  TemporaryFolder folder;
  cli::EmbeddedSettings settings;
  settings.workers = workers;
  settings.paths = [&](const std::string&, std::uint32_t frame) {
    return coordinator::FramePaths{{}, {}, folder.path() / (std::to_string(frame) + ".json")};
  };
  cli::EmbeddedFarm embedded(settings);
  coordinator::FrameScene shown;
  shown.summary = coordinator::summarize(base);
  shown.scene_blob = embedded.blobs().put(scene::serialize(base));
  if (embedded.needs_bvh()) shown.bvh_blob = embedded.blobs().put(scene::serialize(scene::build_bvh(base)));
  request.scenes = {shown};
  if (!states.empty()) request.scenes.assign(states.size(), shown);
  for (std::size_t i = 0; i < states.size(); ++i)
    request.scenes[i].state_blob = embedded.blobs().put(scene::serialize(states[i]));
  request.last_frame = static_cast<std::uint32_t>(request.scenes.size());
  const std::string job = embedded.farm().submit(request);
  while (!ended(embedded.farm().status(job)->state)) embedded.farm().wait(job, ~std::uint64_t{0}, 0.1);
  EXPECT_EQ(embedded.farm().status(job)->state, coordinator::JobState::done) << embedded.farm().status(job)->message;
  std::vector<json> all;
  for (std::uint32_t frame = 1; frame <= request.last_frame; ++frame) {
    std::ifstream file(folder.path() / (std::to_string(frame) + ".json"));
    all.push_back(json::parse(file));
  }
  return all;
}

std::vector<std::string> pixels(const scene::Scene& base, const std::vector<scene::FrameState>& states,
                                const JobRequest& request, unsigned workers) {
  return names(reports(base, states, request, workers), "pixels_sha256");
}

// A base in a state is the picture of that scene alone, whatever frames came before and however many workers there are.
void compare_states_with_their_scenes(const scene::Scene& base) {
  for (const char* method : {"path", "vpl", "ao"}) {
    JobRequest request = request_of(base);
    request.settings.method = method;
    if (std::string(method) != "vpl") request.settings.set = {};
    const std::vector<scene::FrameState> states = {moved_by(0), moved_by(0.1), moved_by(0.2)};
    const std::vector<std::string> frames = pixels(base, states, request, 1);
    EXPECT_NE(frames[0], frames[2]) << method;
    EXPECT_EQ(pixels(scene::posed(base, states[2], "own"), {}, request, 1)[0], frames[2]) << method;
    EXPECT_EQ(pixels(base, {states[2]}, request, 1)[0], frames[2]) << method << ", rendered alone";
    EXPECT_EQ(pixels(base, {states[2], states[0], states[1]}, request, 2)[0], frames[2]) << method;
    EXPECT_EQ(pixels(base, states, request, 3), frames) << method;
  }
}

TEST(FarmMovingScenes, StatesOfABaseAreThoseOfTheirScenes) { compare_states_with_their_scenes(moving_box()); }

TEST(FarmMovingScenes, StatesOfInstancesAreThoseOfTheirScenes) { compare_states_with_their_scenes(rigid_box()); }

// What is seen of what stays while lights change, and is used again; no picture depends on that.
TEST(FarmMovingScenes, SurfacesServeEveryLight) {
  scene::Scene base = moving_box();
  base.lights = scene::make_scene("furnace-point").lights;
  for (int k = 0; k < 3; ++k) base.lights[0].position[k] = base.cameras.front().camera.origin[k];
  const auto lit = [&](float intensity, float x, double moved) {
    scene::FrameState state = moved_by(moved);
    state.light_indices = {0};
    state.lights = base.lights;
    std::fill(state.lights[0].intensity, state.lights[0].intensity + 3, intensity);
    state.lights[0].position[0] += x;
    return state;
  };
  const std::vector<scene::FrameState> states = {lit(1, 0, 0), lit(2, 0, 0), lit(2, 0.1f, 0), lit(0, 0.1f, 0),
                                                 lit(1, 0, 0.1)};
  const JobRequest request = request_of(base);
  const std::vector<json> frames = reports(base, states, request, 1);
  ASSERT_EQ(frames.size(), states.size());
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto run = names(frames[k]["stages"], "name"), left_out = names(frames[k]["skips"], "what");
    // A frame in which another number of lights shines runs kernels of its own; in the last one an object has moved.
    const bool again = k == 1 || k == 2;
    for (const char* stage : {"vpl.points", "vpl.point_cluster"}) {
      EXPECT_EQ(std::ranges::count(run, stage), again ? 0 : 1) << stage << ", frame " << k + 1;
      EXPECT_EQ(std::ranges::count(left_out, std::string("stage ") + stage), again ? 1 : 0)
          << stage << ", frame " << k + 1;
    }
    for (const char* stage : {"vpl.trace.0", "vpl.shade.0"}) EXPECT_THAT(run, Contains(stage)) << "frame " << k + 1;
    if (!again) continue;
    EXPECT_EQ(pixels(base, {states[k]}, request, 2)[0], frames[k]["pixels_sha256"]) << "frame " << k + 1 << " alone";
    EXPECT_EQ(pixels(scene::posed(base, states[k], "own"), {}, request, 1)[0], frames[k]["pixels_sha256"])
        << "frame " << k + 1 << ", a scene of its own";
  }
}

// Where records are needed follows from shapes alone: another light shines on the same places, and all are gathered
// anew.
TEST(FarmMovingScenes, CachePlacesServeEveryLight) {
  scene::Scene base = moving_box();
  base.lights = scene::make_scene("furnace-point").lights;
  for (int k = 0; k < 3; ++k) base.lights[0].position[k] = base.cameras.front().camera.origin[k];
  const auto lit = [&](float x, double moved) {
    scene::FrameState state = moved_by(moved);
    state.light_indices = {0};
    state.lights = base.lights;
    state.lights[0].position[0] += x;
    return state;
  };
  const std::vector<scene::FrameState> states = {lit(0, 0), lit(0.1f, 0), lit(0.1f, 0.1)};
  const JobRequest request = splat_request(base);
  const std::vector<json> frames = reports(base, states, request, 1);
  ASSERT_EQ(frames.size(), states.size());
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto run = names(frames[k]["stages"], "name");
    EXPECT_EQ(std::ranges::count(run, "splat.select"), k == 1 ? 0 : 1) << "frame " << k + 1;
    EXPECT_EQ(std::ranges::count(run, "splat.gather"), 1) << "frame " << k + 1;
    EXPECT_EQ(pixels(base, {states[k]}, request, 2)[0], frames[k]["pixels_sha256"]) << "frame " << k + 1 << " alone";
  }
}

// Of a frame's stages of `links`: those that ran, and those whose records were there.
struct LinksStages {
  std::set<std::string> run, reused;
};
LinksStages links_stages(const json& report) {
  LinksStages stages;
  for (const std::string& name : names(report["stages"], "name"))
    if (name.starts_with("links.")) stages.run.insert(name);
  for (const std::string& what : names(report["skips"], "what"))
    if (what.starts_with("stage links.")) stages.reused.insert(what.substr(6));
  return stages;
}

// What moves is divided as it is at rest: vertices stay what they are, and only the first frame looks for where
// irradiance bends.
TEST(FarmMovingScenes, LinksDivideWhatMovesOnce) {
  const scene::Scene base = moving_box();
  JobRequest request = request_of(base);
  request.settings.method = "links";
  for (const char* refine : {"1", "0"}) {
    request.settings.set = {
        {"links.vertices", "700"}, {"links.directions", "64"}, {"links.bounces", "2"}, {"links.refine", refine}};
    const std::vector<scene::FrameState> states = {moved_by(0.1), moved_by(0.2), moved_by(0.15)};
    const std::vector<json> frames = reports(base, states, request, 1);
    ASSERT_EQ(frames.size(), states.size());
    std::set<std::string> at_rest = {"links.rest_mesh"};
    if (*refine == '1') at_rest.insert({"links.coarse_mesh", "links.coarse_probe"});
    for (std::size_t k = 0; k < frames.size(); ++k) {
      const LinksStages stages = links_stages(frames[k]);
      EXPECT_EQ(stages.reused, k > 0 ? at_rest : std::set<std::string>{}) << "frame " << k + 1;
      EXPECT_TRUE(stages.run.contains("links.mesh") && stages.run.contains("links.make")) << "frame " << k + 1;
      EXPECT_EQ(frames[k]["parameters"]["links"]["vertices"], frames[0]["parameters"]["links"]["vertices"]);
      EXPECT_GT(frames[k]["parameters"]["links"]["triangles_divided"], 10);
      EXPECT_EQ(pixels(base, {states[k]}, request, 2)[0], frames[k]["pixels_sha256"]) << "frame " << k + 1 << " alone";
    }
    EXPECT_NE(frames[0]["pixels_sha256"], frames[1]["pixels_sha256"]);
    EXPECT_EQ(pixels(base, states, request, 3), names(frames, "pixels_sha256"));
  }
}

// Links follow from shapes alone: while lights, what glows, colours or the camera change, light flows over them anew.
TEST(FarmMovingScenes, LinksServeEveryLight) {
  scene::Scene base = scene::make_scene("cornell-box", {});
  base.lights = scene::make_scene("furnace-point").lights;
  for (int k = 0; k < 3; ++k) base.lights[0].position[k] = base.cameras.front().camera.origin[k];
  const auto lamp = static_cast<std::uint32_t>(
      std::ranges::find_if(base.materials, [](const scene::Material& m) { return m.emission[0] > 0; }) -
      base.materials.begin());
  ASSERT_LT(lamp, base.materials.size());
  const std::uint32_t wall = lamp == 0 ? 1 : 0;
  const auto state = [&](float x, float glow, float color) {
    scene::FrameState shown;
    shown.light_indices = {0};
    shown.lights = base.lights;
    shown.lights[0].position[0] += x;
    shown.material_indices = {std::min(lamp, wall), std::max(lamp, wall)};
    for (const std::uint32_t index : shown.material_indices) shown.materials.push_back(base.materials[index]);
    for (float& e : shown.materials[lamp < wall ? 0 : 1].emission) e *= glow;
    for (float& c : shown.materials[lamp < wall ? 1 : 0].base_color) c *= color;
    return shown;
  };
  // The light moves, the lamp glows less, both at once, a wall is painted, the lamp goes out.
  const std::vector<scene::FrameState> states = {state(0, 1, 1),     state(0.2f, 1, 1),     state(0.2f, 0.5f, 1),
                                                 state(0, 0.25f, 1), state(0, 0.25f, 0.5f), state(0, 0, 0.5f)};
  JobRequest request = request_of(base);
  request.settings.method = "links";
  request.settings.set = {{"links.vertices", "400"}, {"links.directions", "64"}, {"links.bounces", "2"}};
  const std::vector<json> frames = reports(base, states, request, 1);
  ASSERT_EQ(frames.size(), states.size());
  const std::set<std::string> light = {"links.light", "links.gather.1", "links.gather.2", "links.smooth",
                                       "links.shade"};
  const std::set<std::string> links = {"links.coarse_mesh", "links.coarse_probe", "links.mesh", "links.probe",
                                       "links.make"};
  for (std::size_t k = 1; k < frames.size(); ++k) {
    const LinksStages stages = links_stages(frames[k]);
    std::set<std::string> run = light, reused = links;
    (k == 4 ? run : reused).insert("links.albedo");
    EXPECT_EQ(stages.run, run) << "frame " << k + 1;
    EXPECT_EQ(stages.reused, reused) << "frame " << k + 1;
    EXPECT_NE(frames[k]["pixels_sha256"], frames[k - 1]["pixels_sha256"]) << "frame " << k + 1;
    // No picture depends on what was there.
    EXPECT_EQ(pixels(base, {states[k]}, request, 2)[0], frames[k]["pixels_sha256"]) << "frame " << k + 1 << " alone";
    EXPECT_EQ(pixels(scene::posed(base, states[k], "own"), {}, request, 1)[0], frames[k]["pixels_sha256"])
        << "frame " << k + 1 << ", a scene of its own";
  }
}

}  // namespace
}  // namespace gleaner::test
