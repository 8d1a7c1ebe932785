// A camera trajectory: which cameras represent it, how their points are merged, what a plan asks for in its frames.

#include "coordinator/plan/trajectory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <deque>
#include <functional>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>

#include "coordinator/plan/plan.h"
#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "tests/unit/plan_frame.h"
#include "tests/unit/vpl_frame.h"

namespace gleaner::coordinator {
namespace {

using scene::Camera;

Camera camera_at(float x, float y = 0, float z = 0) {
  Camera camera{};
  camera.type = GLEANER_CAMERA_PERSPECTIVE;
  camera.origin[0] = x;
  camera.origin[1] = y;
  camera.origin[2] = z;
  camera.right[0] = camera.up[1] = 1;
  camera.forward[2] = -1;
  camera.half_width = camera.half_height = 0.5f;
  return camera;
}

bool same(const Camera& a, const Camera& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

using Row = std::array<float, POINT_WORDS>;

Row row_of(float x, float y, float z, float nz = 1) {
  Row row{};
  row[POINT_POSITION] = x;
  row[POINT_POSITION + 1] = y;
  row[POINT_POSITION + 2] = z;
  row[POINT_NORMAL + 2] = nz;
  return row;
}

Row nothing() {
  Row row{};
  std::memset(&row[POINT_TRIANGLE], 0xff, 4);
  return row;
}

std::shared_ptr<const Bytes> bytes_of(const std::vector<Row>& rows) {
  auto bytes = std::make_shared<Bytes>(rows.size() * sizeof(Row));
  if (!rows.empty()) std::memcpy(bytes->data(), rows.data(), bytes->size());
  return bytes;
}

std::vector<Row> rows_of(const Bytes& bytes) {
  std::vector<Row> rows(bytes.size() / sizeof(Row));
  if (!rows.empty()) std::memcpy(rows.data(), bytes.data(), rows.size() * sizeof(Row));
  return rows;
}

// What the camera sees of a wall at z = -depth: `side` times `side` points, each somewhere in its part of the film.
std::vector<Row> wall(const Camera& camera, unsigned side, float depth, std::uint64_t seed = 0) {
  std::vector<Row> rows;
  const float distance = camera.origin[2] + depth;
  const float reach = camera.half_width * (camera.type == GLEANER_CAMERA_PERSPECTIVE ? distance : 1.0f);
  for (unsigned i = 0; i < side * side; ++i) {
    const auto at = [&](unsigned cell, std::uint64_t key) {
      return (2 * (static_cast<float>(cell) + static_cast<float>(unit(seed * 7919 + key))) / static_cast<float>(side) -
              1) *
             reach;
    };
    rows.push_back(row_of(camera.origin[0] + at(i % side, 2 * i), camera.origin[1] + at(i / side, 2 * i + 1), -depth));
  }
  return rows;
}

TEST(TrajectoryOf, NoneWhereTheCameraStandsStill) {
  EXPECT_TRUE(trajectory_of({}).empty());
  EXPECT_TRUE(trajectory_of({camera_at(1)}).empty());
  EXPECT_TRUE(trajectory_of(std::vector<Camera>(50, camera_at(1))).empty());
}

TEST(TrajectoryOf, IsSpreadEvenlyFromTheFirstToTheLast) {
  for (const std::size_t frames : {2u, 3u, 31u, 32u, 33u, 100u, 4001u}) {
    std::vector<Camera> cameras;
    for (std::size_t k = 0; k < frames; ++k) cameras.push_back(camera_at(static_cast<float>(k)));
    const auto trajectory = trajectory_of(cameras);
    ASSERT_EQ(trajectory.size(), std::min<std::size_t>(frames, 32));
    EXPECT_TRUE(same(trajectory.front(), cameras.front()));
    EXPECT_TRUE(same(trajectory.back(), cameras.back()));
    const float step = static_cast<float>(frames - 1) / static_cast<float>(trajectory.size() - 1);
    for (std::size_t k = 1; k < trajectory.size(); ++k)
      EXPECT_NEAR(trajectory[k].origin[0] - trajectory[k - 1].origin[0], step, 1) << frames << " frames, camera " << k;
  }
}

TEST(TrajectoryOf, APauseIsOneCamera) {
  std::vector<Camera> cameras(10, camera_at(0));
  cameras.resize(20, camera_at(1));
  const auto trajectory = trajectory_of(cameras);
  ASSERT_EQ(trajectory.size(), 2u);
  EXPECT_TRUE(same(trajectory[0], camera_at(0)) && same(trajectory[1], camera_at(1)));
}

// What stage kind vpl_points made for one camera.
struct CameraPoints {
  Camera camera{};
  std::shared_ptr<const Bytes> rows;
};
struct Merged {
  Bytes rows;
  std::uint64_t points = 0, most_of_a_camera = 0;
};

Merged merge_points(const std::vector<CameraPoints>& cameras) {
  worker::StageTask task;
  task.kind = "vpl_merge_points";
  const kernels::VplMergePointsParameters p{.cameras = static_cast<std::uint32_t>(cameras.size())};
  task.parameters.resize(sizeof p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  auto all = std::make_shared<Bytes>(cameras.size() * sizeof(Camera));
  for (std::size_t k = 0; k < cameras.size(); ++k) {
    std::memcpy(all->data() + k * sizeof(Camera), &cameras[k].camera, sizeof(Camera));
    task.inputs["points." + std::to_string(k)] = worker::TaskInput(cameras[k].rows);
  }
  task.inputs["cameras"] = worker::TaskInput(all);
  worker::BatchResult result = worker::merge_points(task);
  kernels::VplMergePointsFacts facts;
  EXPECT_EQ(result.facts.size(), sizeof facts);
  std::memcpy(&facts, result.facts.data(), sizeof facts);
  EXPECT_EQ(result.records.size(), facts.points * POINT_WORDS * 4);
  EXPECT_EQ(result.counts, std::vector<std::uint32_t>{static_cast<std::uint32_t>(facts.points)});
  return {std::move(result.records), facts.points, facts.most_of_a_camera};
}

TEST(MergePoints, ACameraAloneKeepsItsPoints) {
  const auto rows = wall(camera_at(0), 40, 3);
  const Merged merged = merge_points({{camera_at(0), bytes_of(rows)}});
  EXPECT_EQ(rows_of(merged.rows), rows);
  EXPECT_EQ(merged.points, 1600u);
  EXPECT_EQ(merged.most_of_a_camera, 1600u);
}

TEST(MergePoints, WhatSeveralSeeAlikeIsTakenOnce) {
  const auto rows = bytes_of(wall(camera_at(0), 40, 3));
  const Merged merged = merge_points({{camera_at(0), rows}, {camera_at(0), rows}, {camera_at(0), rows}});
  EXPECT_EQ(merged.rows, *rows);
}

TEST(MergePoints, WhatOneAloneSeesIsTakenWhole) {
  // Film edges at -1.5 to 1.5 and 8.5 to 11.5 metres.
  const auto a = wall(camera_at(0), 40, 3), b = wall(camera_at(10), 40, 3, 1);
  const Merged merged = merge_points({{camera_at(0), bytes_of(a)}, {camera_at(10), bytes_of(b)}});
  auto both = a;
  both.insert(both.end(), b.begin(), b.end());
  EXPECT_EQ(rows_of(merged.rows), both);
  EXPECT_EQ(merged.most_of_a_camera, 1600u);
}

// Many cameras through nearly the same film: no finer than one of them, but for the luck of the points.
TEST(MergePoints, ManyCamerasDoNotAddUp) {
  std::vector<CameraPoints> cameras;
  for (std::uint64_t k = 0; k < 32; ++k) {
    const Camera camera = camera_at(0.001f * static_cast<float>(k));
    cameras.push_back({camera, bytes_of(wall(camera, 64, 3, k))});
  }
  const Merged merged = merge_points(cameras);
  EXPECT_GE(merged.points, merged.most_of_a_camera * 95 / 100);
  EXPECT_LE(merged.points, merged.most_of_a_camera * 16 / 10);
  // Nowhere a hole: each of 16 x 16 parts of the wall holds points, within reach of one camera's 16.
  std::map<std::pair<int, int>, int> parts;
  for (const Row& row : rows_of(merged.rows))
    if (std::abs(row[0]) < 1.4f && std::abs(row[1]) < 1.4f)
      ++parts[{static_cast<int>((row[0] + 1.4f) / 0.175f), static_cast<int>((row[1] + 1.4f) / 0.175f)}];
  ASSERT_EQ(parts.size(), 256u);
  for (const auto& [part, count] : parts) {
    EXPECT_GE(count, 6) << part.first << ", " << part.second;
    EXPECT_LE(count, 50) << part.first << ", " << part.second;
  }
}

// Of a place's cameras the one that has most points there decides, whether it comes first or last: from 3 metres there
// are 11 in a cell, from 4.5 there are 5.
TEST(MergePoints, TheNearestCameraDecides) {
  const Camera near = camera_at(0), far = camera_at(0, 0, 1.5f);
  const auto from_near = wall(near, 40, 3), from_far = wall(far, 40, 3, 1);
  for (const bool near_first : {false, true}) {
    std::vector<CameraPoints> cameras = {{far, bytes_of(from_far)}, {near, bytes_of(from_near)}};
    if (near_first) std::swap(cameras[0], cameras[1]);
    const auto merged = rows_of(merge_points(cameras).rows);
    const auto within = [&](const std::vector<Row>& rows) {
      return static_cast<double>(std::ranges::count_if(rows, [&](const Row& row) {
        return std::abs(row[0]) < 1.25f && std::abs(row[1]) < 1.25f && std::ranges::find(merged, row) != merged.end();
      }));
    };
    EXPECT_GT(within(from_near), 0.95 * 1600 * 2.5 * 2.5 / 9);
    EXPECT_LT(within(from_far), 0.05 * 1600 * 2.5 * 2.5 / 4.5 / 4.5);
  }
}

TEST(MergePoints, BothSidesOfAWallAreTwoSurfaces) {
  std::vector<Row> front, back;
  for (const Row& row : wall(camera_at(0), 40, 3)) {
    front.push_back(row_of(row[0], row[1], row[2], 1));
    back.push_back(row_of(row[0], row[1], row[2], -1));
  }
  // The other camera stands behind it, as far away.
  const Merged merged = merge_points({{camera_at(0), bytes_of(front)}, {camera_at(0, 0, -6), bytes_of(back)}});
  EXPECT_EQ(merged.points, 3200u);
}

// To an orthographic camera distance is nothing: from wherever along its axis, cells are the same.
TEST(MergePoints, OrthographicCamerasHaveNoDistance) {
  Camera near = camera_at(0), far = camera_at(0, 0, 1000);
  near.type = far.type = GLEANER_CAMERA_ORTHOGRAPHIC;
  const auto rows = bytes_of(wall(near, 40, 3));
  EXPECT_EQ(merge_points({{near, rows}, {far, rows}}).rows, *rows);
  // A wider film of as many points has larger cells, which are others.
  far.half_width = far.half_height = 50;
  EXPECT_EQ(merge_points({{near, rows}, {far, rows}}).points, 3200u);
}

TEST(MergePoints, LeavesOutWhatCannotBeShaded) {
  constexpr float inf = std::numeric_limits<float>::infinity();
  const Row on_camera = row_of(0, 0, 0);
  const Merged merged = merge_points(
      {{camera_at(0), bytes_of({nothing(), row_of(1, 2, -3), row_of(inf, 0, 0), row_of(0, 0, 0, NAN), on_camera})},
       {camera_at(1), bytes_of({nothing()})},
       {camera_at(2), bytes_of({})}});
  EXPECT_EQ(rows_of(merged.rows), (std::vector<Row>{row_of(1, 2, -3), on_camera}));
  EXPECT_EQ(merged.most_of_a_camera, 2u);
  EXPECT_THROW(merge_points({}), Error);
}

// --- The plan ---

// A device whose records are functions of the stage and its inputs alone.
struct VplFrame {
  std::map<std::string, PlannedStage> stages;
  nlohmann::json parameters;
  Film film;
};

using Points = std::function<std::vector<Row>(const Camera&, unsigned side)>;

worker::BatchResult wall_stage(const PlannedStage& stage, const Points& see) {
  const StageSpec& spec = stage.spec;
  if (spec.kind == "vpl_cluster") return first_lights(stage);
  if (spec.kind == "point_cluster") return first_points(stage);
  worker::BatchResult result;
  if (spec.kind == "vpl_trace") {
    std::vector<float> rows(spec.items * VPL_PATH_SLOTS * VPL_WORDS);
    for (std::size_t at = 0; at < rows.size(); at += VPL_WORDS) {
      for (std::size_t k = 0; k < 3; ++k) rows[at + VPL_POSITION + k] = static_cast<float>(unit(at + k));
      rows[at + VPL_FLUX] = rows[at + VPL_FLUX + 1] = rows[at + VPL_FLUX + 2] = 1;
      rows[at + VPL_COUNT] = 1;
    }
    result.records = bytes_of_floats(rows);
    result.counts.assign(spec.items, VPL_PATH_SLOTS);
    return result;
  }
  result.records.resize(spec.items * spec.output.record_bytes);
  if (spec.kind == "vpl_points") {
    kernels::VplPointParameters p;
    std::memcpy(&p, spec.parameters.data(), sizeof p);
    std::vector<Row> rows = see(p.camera, static_cast<unsigned>(std::sqrt(static_cast<double>(spec.items))));
    rows.resize(spec.items, nothing());
    result.records = *bytes_of(rows);
  }
  return result;
}

VplFrame run(const FrameSettings& settings, const Points& see, bool backwards = false) {
  const DeviceStage device = [&](const PlannedStage& stage) { return wall_stage(stage, see); };
  RunFrame frame(make_plan(settings, {}), device,
                 [backwards](std::size_t count) { return backwards ? count - 1 : std::size_t{0}; });
  frame.run();
  return {frame.stages, nlohmann::json::parse(frame.plan().parameters_json()), frame.plan().film()};
}

FrameSettings vpl_settings(const Camera& camera, const std::vector<Camera>& trajectory) {
  FrameSettings settings;
  settings.method = "vpl";
  settings.width = settings.height = 64;
  settings.spp = 4;
  settings.camera = camera;
  settings.trajectory = trajectory;
  settings.set = {{"vpl.count", "100"}, {"vpl.clusters", "40"}, {"vpl.point_clusters", "128"}};
  return settings;
}

std::vector<Camera> cameras_along(std::size_t count, float step) {
  std::vector<Camera> cameras;
  for (std::size_t k = 0; k < count; ++k) cameras.push_back(camera_at(step * static_cast<float>(k)));
  return cameras;
}

std::vector<Row> see_wall(const Camera& camera, unsigned side) { return wall(camera, side, 3); }

// What a farm's address is made of.
void expect_same(const StageSpec& a, const StageSpec& b) {
  EXPECT_EQ(a.kind, b.kind) << a.name;
  EXPECT_EQ(a.items, b.items) << a.name;
  EXPECT_EQ(a.output.record_bytes, b.output.record_bytes) << a.name;
  EXPECT_EQ(a.parameters, b.parameters) << a.name;
  ASSERT_EQ(a.inputs.size(), b.inputs.size()) << a.name;
  for (std::size_t k = 0; k < a.inputs.size(); ++k) {
    EXPECT_EQ(a.inputs[k].name, b.inputs[k].name) << a.name;
    EXPECT_EQ(a.inputs[k].artifact, b.inputs[k].artifact) << a.name << " " << a.inputs[k].name;
  }
}

TEST(VplTrajectory, FramesAskForTheSameStages) {
  const auto cameras = cameras_along(5, 0.3f);
  const auto trajectory = trajectory_of(cameras);
  const VplFrame first = run(vpl_settings(cameras[0], trajectory), see_wall),
                 third = run(vpl_settings(cameras[2], trajectory), see_wall);
  std::size_t shared = 0;
  ASSERT_EQ(first.stages.size(), third.stages.size());
  for (const auto& [name, stage] : first.stages) {
    const StageSpec& spec = stage.spec;
    ASSERT_TRUE(third.stages.contains(name)) << name;
    if (name.starts_with("path.")) continue;
    const StageSpec& other = third.stages.at(name).spec;
    if (name.starts_with("vpl.shade.")) {
      // Seen by another camera, lit by the same.
      EXPECT_NE(spec.parameters, other.parameters);
      StageSpec aimed = other;
      aimed.parameters = spec.parameters;
      expect_same(spec, aimed);
      EXPECT_EQ(spec.inputs.size(), 3u);  // lights, points, visibility
      continue;
    }
    expect_same(spec, other);
    EXPECT_TRUE(spec.output.reusable && other.output.reusable) << name;
    ++shared;
  }
  // trace, resample, cluster, order; points of 5 cameras, merge_points, point_cluster; visibility, skipped
  EXPECT_EQ(shared, 13u);
}

TEST(VplTrajectory, TheOrderInWhichPointsComeIsNothing) {
  const auto cameras = cameras_along(5, 0.3f);
  const VplFrame forth = run(vpl_settings(cameras[0], trajectory_of(cameras)), see_wall),
                 back = run(vpl_settings(cameras[0], trajectory_of(cameras)), see_wall, true);
  expect_same(forth.stages.at("vpl.shade.0").spec, back.stages.at("vpl.shade.0").spec);
  EXPECT_EQ(forth.film.find("R")->values, back.film.find("R")->values);
}

TEST(VplTrajectory, ASingleCameraIsNoTrajectory) {
  const VplFrame frame = run(vpl_settings(camera_at(0), {}), see_wall);
  // Points serve frames of this camera whose lights change.
  EXPECT_TRUE(frame.stages.at("vpl.points").spec.output.reusable);
  EXPECT_TRUE(frame.stages.at("vpl.point_cluster").spec.output.reusable);
  EXPECT_FALSE(frame.stages.at("vpl.visibility.0").spec.output.reusable);
  EXPECT_EQ(frame.stages.at("vpl.point_cluster").spec.items, 128u);
  EXPECT_FALSE(frame.parameters["vpl"].contains("trajectory"));
}

// As many clusters a place as of the camera that sees it best, within bounds.
TEST(VplTrajectory, ClustersGrowWithWhatIsSeen) {
  const auto clusters = [](const std::vector<Camera>& cameras, std::map<std::string, std::string> set = {}) {
    FrameSettings settings = vpl_settings(cameras[0], cameras);
    for (const auto& [key, value] : set) settings.set[key] = value;
    const VplFrame frame = run(settings, see_wall);
    const std::uint64_t items = frame.stages.at("vpl.point_cluster").spec.items;
    EXPECT_EQ(frame.parameters["vpl"]["trajectory"]["point_clusters"], items);
    EXPECT_EQ(frame.parameters["vpl"]["trajectory"]["cameras"], cameras.size());
    return items;
  };
  // The wall's visible part is 3 metres wide.
  EXPECT_EQ(clusters(std::vector<Camera>(3, camera_at(0))), 128u);
  EXPECT_NEAR(static_cast<double>(clusters(cameras_along(3, 100))), 3 * 128, 1);
  EXPECT_NEAR(static_cast<double>(clusters(cameras_along(5, 0.75f))), 2 * 128, 0.3 * 128);
  EXPECT_EQ(clusters(cameras_along(32, 100)), 16u * 128);
  // A bit for each light: 2^30 bits in all passes are the most.
  EXPECT_EQ(clusters(cameras_along(8, 100), {{"vpl.passes", "64"}, {"vpl.clusters", "32768"}, {"vpl.count", "600"}}),
            512u);
}

TEST(VplTrajectory, ATrajectoryThatSeesNothingIsLitByNothing) {
  const VplFrame frame =
      run(vpl_settings(camera_at(0), cameras_along(2, 1)), [](const Camera&, unsigned) { return std::vector<Row>{}; });
  EXPECT_FALSE(frame.stages.contains("vpl.point_cluster"));
  EXPECT_FALSE(frame.stages.contains("vpl.visibility.0"));
  EXPECT_EQ(frame.stages.at("vpl.shade.0").inputs.size(), 1u);  // lights
}

TEST(VplTrajectory, IsToldBeforehand) {
  const auto plan = make_plan(vpl_settings(camera_at(0), cameras_along(7, 1)), {});
  EXPECT_THAT(plan->outline(), testing::Contains(testing::AllOf(testing::StartsWith("vpl.points: "),
                                                                testing::HasSubstr("7 cameras of the trajectory"))));
  EXPECT_THAT(plan->outline(), testing::Contains(testing::AllOf(testing::StartsWith("vpl.point_cluster: "),
                                                                testing::HasSubstr("128 to 2048 clusters"))));
}

// Of large pictures with many clusters fewer cameras are asked for: four million points in all.
TEST(VplTrajectory, ManyPointsAreTakenFromFewCameras) {
  for (const auto& [clusters, cameras] : {std::pair{"4096", "32"}, {"262144", "4"}}) {
    FrameSettings settings = vpl_settings(camera_at(0), cameras_along(32, 1));
    settings.width = settings.height = 1024;
    settings.set["vpl.point_clusters"] = clusters;
    const auto plan = make_plan(settings, {});
    EXPECT_THAT(plan->outline(), testing::Contains(testing::HasSubstr(std::string("each of ") + cameras + " cameras")));
    const Step step = plan->next(nullptr);
    std::vector<Camera> seen;
    for (const StageSpec& spec : step.stages) {
      if (spec.kind != "vpl_points") continue;
      kernels::VplPointParameters p;
      std::memcpy(&p, spec.parameters.data(), sizeof p);
      seen.push_back(p.camera);
    }
    ASSERT_EQ(std::to_string(seen.size()), cameras);
    EXPECT_TRUE(same(seen.front(), settings.trajectory.front()) && same(seen.back(), settings.trajectory.back()));
  }
}

TEST(VplTrajectory, RefusesPointsThatItDidNotAskFor) {
  const auto plan = make_plan(vpl_settings(camera_at(0), cameras_along(2, 1)), {});
  std::uint64_t items = 0;
  for (const StageSpec& spec : plan->next(nullptr).stages)
    if (spec.name == "vpl.points.1") items = spec.items;
  const FinishedStage good{"vpl.points.1", nullptr, items, {}}, other{"vpl.points.2", nullptr, items, {}};
  EXPECT_THROW(plan->next(&other), std::exception);
  plan->next(&good);
  EXPECT_THROW(plan->next(&good), std::exception);
}

}  // namespace
}  // namespace gleaner::coordinator
