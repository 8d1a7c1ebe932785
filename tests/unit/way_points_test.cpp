// A camera's way: which cameras stand for it, how their points become one set, and what a plan asks for in its frames.

#include "coordinator/plan/way_points.h"

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
#include "kernels/cluster_records.h"
#include "kernels/vpl_records.h"
#include "tests/unit/plan_frame.h"

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

TEST(WayOf, NoneWhereTheCameraStandsStill) {
  EXPECT_TRUE(way_of({}).empty());
  EXPECT_TRUE(way_of({camera_at(1)}).empty());
  EXPECT_TRUE(way_of(std::vector<Camera>(50, camera_at(1))).empty());
}

TEST(WayOf, IsSpreadEvenlyFromTheFirstToTheLast) {
  for (const std::size_t frames : {2u, 3u, 31u, 32u, 33u, 100u, 4001u}) {
    std::vector<Camera> cameras;
    for (std::size_t k = 0; k < frames; ++k) cameras.push_back(camera_at(static_cast<float>(k)));
    const auto way = way_of(cameras);
    ASSERT_EQ(way.size(), std::min<std::size_t>(frames, 32));
    EXPECT_TRUE(same(way.front(), cameras.front()));
    EXPECT_TRUE(same(way.back(), cameras.back()));
    const float step = static_cast<float>(frames - 1) / static_cast<float>(way.size() - 1);
    for (std::size_t k = 1; k < way.size(); ++k)
      EXPECT_NEAR(way[k].origin[0] - way[k - 1].origin[0], step, 1) << frames << " frames, camera " << k;
  }
}

TEST(WayOf, APauseIsOneCamera) {
  std::vector<Camera> cameras(10, camera_at(0));
  cameras.resize(20, camera_at(1));
  const auto way = way_of(cameras);
  ASSERT_EQ(way.size(), 2u);
  EXPECT_TRUE(same(way[0], camera_at(0)) && same(way[1], camera_at(1)));
}

TEST(MergePoints, ACameraAloneKeepsItsPoints) {
  const auto rows = wall(camera_at(0), 40, 3);
  const WayPoints merged = merge_points({{camera_at(0), bytes_of(rows)}});
  EXPECT_EQ(rows_of(merged.rows), rows);
  EXPECT_EQ(merged.points, 1600u);
  EXPECT_EQ(merged.most_of_a_camera, 1600u);
}

TEST(MergePoints, WhatSeveralSeeAlikeIsTakenOnce) {
  const auto rows = bytes_of(wall(camera_at(0), 40, 3));
  const WayPoints merged = merge_points({{camera_at(0), rows}, {camera_at(0), rows}, {camera_at(0), rows}});
  EXPECT_EQ(merged.rows, *rows);
}

TEST(MergePoints, WhatOneAloneSeesIsTakenWhole) {
  // Film edges at -1.5 to 1.5 and 8.5 to 11.5 metres.
  const auto a = wall(camera_at(0), 40, 3), b = wall(camera_at(10), 40, 3, 1);
  const WayPoints merged = merge_points({{camera_at(0), bytes_of(a)}, {camera_at(10), bytes_of(b)}});
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
  const WayPoints merged = merge_points(cameras);
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
  const WayPoints merged = merge_points({{camera_at(0), bytes_of(front)}, {camera_at(0, 0, -6), bytes_of(back)}});
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
  const WayPoints merged = merge_points(
      {{camera_at(0), bytes_of({nothing(), row_of(1, 2, -3), row_of(inf, 0, 0), row_of(0, 0, 0, NAN), on_camera})},
       {camera_at(1), bytes_of({nothing()})},
       {camera_at(2), bytes_of({})}});
  EXPECT_EQ(rows_of(merged.rows), (std::vector<Row>{row_of(1, 2, -3), on_camera}));
  EXPECT_EQ(merged.most_of_a_camera, 2u);
  EXPECT_EQ(merge_points({}).points, 0u);
}

// --- The plan ---

// A worker whose records are functions of what it is asked, and of nothing else.
struct VplFrame {
  std::map<std::string, StageSpec> stages;
  std::map<ArtifactId, std::shared_ptr<const Bytes>> artifacts;
  nlohmann::json parameters;
  Film film;
};

using Points = std::function<std::vector<Row>(const Camera&, unsigned side)>;

VplFrame run(const FrameSettings& settings, const Points& see, bool backwards = false) {
  VplFrame frame;
  const auto plan = make_plan(settings, {});
  std::deque<StageSpec> waiting;
  Step step = plan->next(nullptr);
  while (!step.done) {
    frame.artifacts.merge(step.artifacts);
    for (const StageSpec& spec : step.stages) waiting.push_back(spec);
    if (waiting.empty()) {
      ADD_FAILURE() << "the plan waits for nothing";
      return frame;
    }
    const StageSpec spec = backwards ? waiting.back() : waiting.front();
    if (backwards)
      waiting.pop_back();
    else
      waiting.pop_front();
    EXPECT_TRUE(frame.stages.emplace(spec.name, spec).second) << spec.name << " twice";
    auto records = std::make_shared<Bytes>(spec.items * spec.output.record_bytes);
    const auto put = [&](const void* from, std::size_t bytes) {
      std::memcpy(records->data(), from, std::min(bytes, records->size()));
    };
    if (spec.kind == "vpl_trace") {
      std::vector<float> rows(records->size() / 4);
      for (std::size_t at = 0; at < rows.size(); at += VPL_WORDS) {
        for (std::size_t k = 0; k < 3; ++k) rows[at + VPL_POSITION + k] = static_cast<float>(unit(at + k));
        rows[at + VPL_FLUX] = rows[at + VPL_FLUX + 1] = rows[at + VPL_FLUX + 2] = 1;
        rows[at + VPL_COUNT] = 1;
      }
      put(rows.data(), records->size());
    } else if (spec.kind == "vpl_points") {
      kernels::VplPointParameters p;
      std::memcpy(&p, spec.parameters.data(), sizeof p);
      std::vector<Row> rows = see(p.camera, static_cast<unsigned>(std::sqrt(static_cast<double>(spec.items))));
      rows.resize(spec.items, nothing());
      put(rows.data(), records->size());
    } else if (spec.kind == "vpl_cluster") {
      // The first lights stand for the others.
      kernels::ClusterParameters p;
      std::memcpy(&p, spec.parameters.data(), sizeof p);
      const std::size_t clusters = std::size_t{p.clusters} * VPL_WORDS * 4;
      put(frame.artifacts.at(spec.inputs.at(0).artifact)->data(), clusters);
      for (std::uint32_t i = 0; i < p.lights; ++i) {
        const std::uint32_t cluster = i % p.clusters;
        std::memcpy(records->data() + clusters + std::size_t{i} * 4, &cluster, 4);
      }
    } else if (spec.kind == "point_cluster") {
      std::vector<Row> none(spec.items, nothing());
      put(none.data(), records->size());
      const Bytes& input = *frame.artifacts.at(spec.inputs.at(0).artifact);
      put(input.data(), input.size());
    }
    const FinishedStage finished{spec.name, records};
    step = plan->next(&finished);
  }
  frame.parameters = nlohmann::json::parse(plan->parameters_json());
  frame.film = plan->film();
  return frame;
}

FrameSettings vpl_settings(const Camera& camera, const std::vector<Camera>& way) {
  FrameSettings settings;
  settings.method = "vpl";
  settings.width = settings.height = 64;
  settings.spp = 4;
  settings.camera = camera;
  settings.way = way;
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

TEST(VplWay, FramesAskForTheSameStages) {
  const auto cameras = cameras_along(5, 0.3f);
  const auto way = way_of(cameras);
  const VplFrame first = run(vpl_settings(cameras[0], way), see_wall),
                 third = run(vpl_settings(cameras[2], way), see_wall);
  std::size_t shared = 0;
  ASSERT_EQ(first.stages.size(), third.stages.size());
  for (const auto& [name, spec] : first.stages) {
    ASSERT_TRUE(third.stages.contains(name)) << name;
    if (name.starts_with("path.")) continue;
    const StageSpec& other = third.stages.at(name);
    if (name.starts_with("vpl.shade.")) {
      // Seen by another camera, lit by the same.
      EXPECT_NE(spec.parameters, other.parameters);
      StageSpec aimed = other;
      aimed.parameters = spec.parameters;
      expect_same(spec, aimed);
      EXPECT_EQ(spec.inputs.size(), 4u);  // lights, members, points, visibility
      continue;
    }
    expect_same(spec, other);
    EXPECT_TRUE(spec.output.reusable && other.output.reusable) << name;
    ++shared;
  }
  // trace, cluster, points of 5 cameras, point_cluster, visibility
  EXPECT_EQ(shared, 9u);
}

TEST(VplWay, TheOrderInWhichPointsComeIsNothing) {
  const auto cameras = cameras_along(5, 0.3f);
  const VplFrame forth = run(vpl_settings(cameras[0], way_of(cameras)), see_wall),
                 back = run(vpl_settings(cameras[0], way_of(cameras)), see_wall, true);
  expect_same(forth.stages.at("vpl.shade.0"), back.stages.at("vpl.shade.0"));
  EXPECT_EQ(forth.film.find("R")->values, back.film.find("R")->values);
}

TEST(VplWay, ASingleCameraIsNoWay) {
  const VplFrame frame = run(vpl_settings(camera_at(0), {}), see_wall);
  EXPECT_FALSE(frame.stages.at("vpl.points").output.reusable);
  EXPECT_FALSE(frame.stages.at("vpl.point_cluster").output.reusable);
  EXPECT_FALSE(frame.stages.at("vpl.visibility.0").output.reusable);
  EXPECT_EQ(frame.stages.at("vpl.point_cluster").items, 128u);
  EXPECT_FALSE(frame.parameters["vpl"].contains("way"));
}

// As many clusters a place as of the camera that sees it best, within bounds.
TEST(VplWay, ClustersGrowWithWhatIsSeen) {
  const auto clusters = [](const std::vector<Camera>& cameras, std::map<std::string, std::string> set = {}) {
    FrameSettings settings = vpl_settings(cameras[0], cameras);
    for (const auto& [key, value] : set) settings.set[key] = value;
    const VplFrame frame = run(settings, see_wall);
    const std::uint64_t items = frame.stages.at("vpl.point_cluster").items;
    EXPECT_EQ(frame.parameters["vpl"]["way"]["point_clusters"], items);
    EXPECT_EQ(frame.parameters["vpl"]["way"]["cameras"], cameras.size());
    return items;
  };
  // The wall's visible part is 3 metres wide.
  EXPECT_EQ(clusters(std::vector<Camera>(3, camera_at(0))), 128u);
  EXPECT_NEAR(static_cast<double>(clusters(cameras_along(3, 100))), 3 * 128, 1);
  EXPECT_NEAR(static_cast<double>(clusters(cameras_along(5, 0.75f))), 2 * 128, 0.3 * 128);
  EXPECT_EQ(clusters(cameras_along(32, 100)), 16u * 128);
  // A bit for each light: 2^30 bits in all sets are enough.
  EXPECT_EQ(clusters(cameras_along(8, 100), {{"vpl.passes", "4096"}, {"vpl.clusters", "512"}, {"vpl.count", "600"}}),
            512u);
}

TEST(VplWay, AWayThatSeesNothingIsLitByNothing) {
  const VplFrame frame =
      run(vpl_settings(camera_at(0), cameras_along(2, 1)), [](const Camera&, unsigned) { return std::vector<Row>{}; });
  EXPECT_FALSE(frame.stages.contains("vpl.point_cluster"));
  EXPECT_FALSE(frame.stages.contains("vpl.visibility.0"));
  EXPECT_EQ(frame.stages.at("vpl.shade.0").inputs.size(), 2u);  // lights, members
}

TEST(VplWay, IsToldBeforehand) {
  const auto plan = make_plan(vpl_settings(camera_at(0), cameras_along(7, 1)), {});
  EXPECT_THAT(plan->outline(), testing::Contains(testing::AllOf(testing::StartsWith("vpl.points: "),
                                                                testing::HasSubstr("7 cameras of the way"))));
  EXPECT_THAT(plan->outline(), testing::Contains(testing::AllOf(testing::StartsWith("vpl.point_cluster: "),
                                                                testing::HasSubstr("128 to 2048 clusters"))));
}

// Of large pictures with many clusters fewer cameras are asked for: four million points in all.
TEST(VplWay, ManyPointsAreTakenFromFewCameras) {
  for (const auto& [clusters, cameras] : {std::pair{"4096", "32"}, {"262144", "4"}}) {
    FrameSettings settings = vpl_settings(camera_at(0), cameras_along(32, 1));
    settings.width = settings.height = 1024;
    settings.set["vpl.point_clusters"] = clusters;
    const auto plan = make_plan(settings, {});
    EXPECT_THAT(plan->outline(), testing::Contains(testing::HasSubstr(std::string("each of ") + cameras + " cameras")));
    const Step step = plan->next(nullptr);
    std::vector<Camera> asked;
    for (const StageSpec& spec : step.stages) {
      if (spec.kind != "vpl_points") continue;
      kernels::VplPointParameters p;
      std::memcpy(&p, spec.parameters.data(), sizeof p);
      asked.push_back(p.camera);
    }
    ASSERT_EQ(std::to_string(asked.size()), cameras);
    EXPECT_TRUE(same(asked.front(), settings.way.front()) && same(asked.back(), settings.way.back()));
  }
}

TEST(VplWay, RefusesPointsThatItDidNotAskFor) {
  const auto plan = make_plan(vpl_settings(camera_at(0), cameras_along(2, 1)), {});
  plan->next(nullptr);
  const FinishedStage good{"vpl.points.1", bytes_of(wall(camera_at(1), 32, 3))}, other{"vpl.points.2", good.records};
  EXPECT_THROW(plan->next(&other), std::exception);
  plan->next(&good);
  EXPECT_THROW(plan->next(&good), std::exception);
}

}  // namespace
}  // namespace gleaner::coordinator
