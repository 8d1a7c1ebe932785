// Method `photon` against the path tracer, the balance of its photons' power, and the limits in which it is a path
// tracer.

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <functional>
#include <numbers>
#include <numeric>
#include <set>

#include "kernels/photon_records.h"
#include "kernels/rays.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/radiometry/rendered_frame.h"
#include "worker/stages/photon/illumination_cut.h"
#include "worker/stages/photon/map_blocks.h"
#include "worker/stages/photon/prediction.h"
#include "worker/stages/photon/seeding.h"
#include "worker/stages/photon/select_place.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/points.h"

namespace gleaner::test {
namespace {

using kernels::PhotonMapParameters;
using kernels::PhotonTraceParameters;

constexpr double kFamily = 1e-3;  // chance of a false alarm of one test

Frame frame_of(Scene scene, std::uint32_t size, std::uint32_t spp, const Settings& set) {
  return square_frame("photon", std::move(scene), {}, size, spp, set);
}

// --- The balance of power ---

worker::StageTask trace_task(const std::shared_ptr<const Scene>& scene, const PhotonTraceParameters& p) {
  worker::StageTask task = task_of({}, load(executor(worker::TraceKind::automatic), scene));
  task.kind = "photon_trace";
  task.parameters.resize(sizeof p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  return task;
}

struct Row {
  float position[3], power[3];
  std::uint32_t direction, surface;
  std::uint32_t kind() const { return surface >> PHOTON_CLASS_SHIFT & PHOTON_CLASS_MASK; }
  std::uint32_t depth() const { return surface >> PHOTON_DEPTH_SHIFT; }
};
static_assert(sizeof(Row) == PHOTON_WORDS * 4);

std::vector<Row> rows_of(const scene::Bytes& records) {
  std::vector<Row> rows(records.size() / sizeof(Row));
  std::memcpy(rows.data(), records.data(), records.size());
  return rows;
}

// Power that the scene's triangles emit, W, of the green channel: pi times radiance times area.
double emitted_power(const Scene& scene) {
  double power = 0;
  for (std::size_t t = 0; t < scene.triangle_material.size(); ++t) {
    const double radiance = scene.materials[scene.triangle_material[t]].emission[1];
    const auto corner = [&](std::size_t k) { return &scene.positions[std::size_t{3} * scene.indices[3 * t + k]]; };
    double e1[3], e2[3];
    for (int k = 0; k < 3; ++k) {
      e1[k] = double{corner(1)[k]} - corner(0)[k];
      e2[k] = double{corner(2)[k]} - corner(0)[k];
    }
    const double n[3] = {e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]};
    power += std::numbers::pi * radiance * 0.5 * std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
  }
  return power;
}

// Stored + absorbed + escaped = emitted, which the lamps' geometry tells.
TEST(Photon, PowerIsBalanced) {
  for (const char* name : {"cornell-box", "cornell-glass", "cornell-glossy", "cornell-mirror"}) {
    const auto scene = std::make_shared<const Scene>(scene::make_scene(name, {}));
    const double emitted = emitted_power(*scene);
    for (const std::uint32_t depth : {0u, 2u, 8u}) {
      PhotonTraceParameters p{};
      p.items_low = 20'000;
      p.most_depth = depth;
      p.classes = PHOTON_ALL_CLASSES;
      p.seed_low = 7;
      p.balance = 1;
      const auto result = executor(worker::TraceKind::automatic).run(trace_task(scene, p), 0, p.items_low);
      double stored = 0, absorbed = 0, escaped = 0;
      for (const Row& row : rows_of(result.records)) {
        if (row.kind() == PHOTON_ABSORBED)
          absorbed += row.power[1];
        else if (row.kind() == PHOTON_ESCAPED)
          escaped += row.power[1];
        else if (row.depth() == depth)
          stored += row.power[1];
      }
      std::printf("  %s, depth %u: stored %.6f + absorbed %.6f + escaped %.6f of %.6f\n", name, depth, stored, absorbed,
                  escaped, emitted);
      EXPECT_NEAR((stored + absorbed + escaped) / emitted, 1, 1e-5) << name << ", depth " << depth;
      EXPECT_GT(stored, 0) << name;
    }
  }
}

// --- The map ---

worker::BatchResult map_of(const std::string& scene, const scene::Bytes& photons, std::uint32_t classes) {
  const PhotonMapParameters p{.classes = classes, .neighbours = 16, .shine = 1};
  worker::StageTask task;
  task.kind = "photon_map";
  task.scene = scene;
  task.parameters.resize(sizeof p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  task.inputs["photons"] = std::make_shared<const scene::Bytes>(photons);
  return executor(worker::TraceKind::automatic).run(task, 0, 1);
}

std::uint32_t word_of(const scene::Bytes& map, std::size_t row, unsigned word) {
  std::uint32_t value;
  std::memcpy(&value, map.data() + (row * PHOTON_WORDS + word) * 4, 4);
  return value;
}
float real_of(const scene::Bytes& map, std::size_t row, unsigned word) {
  const std::uint32_t value = word_of(map, row, word);
  float real;
  std::memcpy(&real, &value, 4);
  return real;
}

// Every photon of the classes lies in one leaf, within the boxes of all nodes above it; caustic ones in a tree of their
// own.
TEST(Photon, MapHoldsEveryPhoton) {
  PhotonTraceParameters p{};
  p.items_low = 5000;
  p.most_depth = GLEANER_NONE;
  p.classes = PHOTON_ALL_CLASSES;
  const auto scene = std::make_shared<const Scene>(scene::make_scene("cornell-glass", {}));
  const worker::StageTask trace = trace_task(scene, p);
  const auto photons = executor(worker::TraceKind::automatic).run(trace, 0, p.items_low).records;
  for (const std::uint32_t classes : {PHOTON_ALL_CLASSES, PHOTON_CLASS_BIT(PHOTON_CAUSTIC)}) {
    std::multiset<std::array<float, 3>> expected, found;
    for (const Row& row : rows_of(photons))
      if (classes >> row.kind() & 1) expected.insert({row.position[0], row.position[1], row.position[2]});
    ASSERT_GT(expected.size(), 100u);
    const scene::Bytes map = map_of(trace.scene, photons, classes).records;
    const std::uint32_t nodes = word_of(map, 0, MAP_NODES), blocks = word_of(map, 0, MAP_BLOCKS);
    EXPECT_EQ(word_of(map, 0, MAP_PHOTONS), expected.size());
    const std::uint32_t caustics = word_of(map, 0, MAP_CAUSTICS);
    ASSERT_EQ(map.size() / sizeof(Row), 1 + nodes + std::size_t{blocks} * RAY_BLOCK);
    const auto photon = [&](std::uint32_t block, unsigned lane, unsigned word) {
      const std::size_t at = (std::size_t{block} * PHOTON_WORDS + word) * RAY_BLOCK + lane;
      return real_of(map, 1 + nodes + at / PHOTON_WORDS, static_cast<unsigned>(at % PHOTON_WORDS));
    };
    for (std::uint32_t node = 0; node < nodes; ++node) {
      // The leaves below it are those between it and its skip.
      for (std::uint32_t below = node; below < word_of(map, 1 + node, NODE_SKIP); ++below) {
        const std::uint32_t block = word_of(map, 1 + below, NODE_BLOCK) & NODE_BLOCK_MASK;
        if (block == NODE_NO_BLOCK) continue;
        for (unsigned lane = 0; lane < RAY_BLOCK; ++lane) {
          const std::array<float, 3> at = {photon(block, lane, 0), photon(block, lane, 1), photon(block, lane, 2)};
          if (at[0] > 1e18f) continue;  // padding
          if (below == node) found.insert(at);
          const std::uint32_t surface = std::bit_cast<std::uint32_t>(photon(block, lane, PHOTON_SURFACE));
          ASSERT_EQ((surface >> PHOTON_CLASS_SHIFT & (PHOTON_CLASSES - 1)) == PHOTON_CAUSTIC, below >= caustics);
          for (unsigned k = 0; k < 3; ++k) {
            ASSERT_GE(at[k], real_of(map, 1 + node, NODE_LOWER + k));
            ASSERT_LE(at[k], real_of(map, 1 + node, NODE_UPPER + k));
          }
        }
      }
    }
    EXPECT_EQ(found, expected);
  }
}

// Photons lie evenly on a floor with a box on it. A block's photons shine as far as the density says, and it is known
// whether the floor goes on about it.
TEST(Photon, BlocksTellDensityAndEdges) {
  scene::SceneBuilder b("floor");
  const std::uint32_t grey = b.material("grey", scene::lambert(scene::grey(0.5)));
  b.mesh("floor");
  b.quad({-1, 0, 1}, {1, 0, 1}, {1, 0, -1}, {-1, 0, -1}, grey);
  b.mesh("box");
  b.box({0, 0.2, 0}, {0.2, 0.2, 0.2}, 0, grey);
  b.directional_light({0, -1, 0}, scene::grey(1));
  PhotonTraceParameters p{};
  p.items_low = 100'000;
  p.classes = PHOTON_CLASS_BIT(PHOTON_DIRECT);
  const worker::StageTask trace = trace_task(std::make_shared<const Scene>(b.finish()), p);
  const auto photons = executor(worker::TraceKind::automatic).run(trace, 0, p.items_low).records;
  scene::Bytes map = map_of(trace.scene, photons, p.classes).records;
  std::vector<std::uint32_t> words(map.size() / 4);
  std::memcpy(words.data(), map.data(), map.size());
  double count = 0;
  for (const Row& row : rows_of(photons)) count += std::abs(row.position[1]) < 1e-4f ? 1 : 0;
  const double density = count / (4 - 0.16);
  const worker::MapBlocks blocks(words);
  Sample neighbours;
  unsigned inner = 0, at_edges = 0;
  for (std::size_t node = 0; node < words[MAP_NODES]; ++node) {
    const std::uint32_t block = words[(1 + node) * PHOTON_WORDS + NODE_BLOCK] & NODE_BLOCK_MASK;
    if (block == NODE_NO_BLOCK) continue;
    const auto middle = blocks.middle(block);
    if (!middle || std::abs(middle->position[1]) > 1e-4f) continue;
    const double reach = std::sqrt(worker::node_reach2(words, node));
    neighbours.add(std::numbers::pi * reach * reach * density);
    const double x = std::abs(middle->position[0]), z = std::abs(middle->position[2]);
    const double edge = std::min({1 - x, 1 - z, std::max(x, z) - 0.2});
    const std::size_t at = (std::size_t{1} + words[MAP_NODES]) * PHOTON_WORDS +
                           (std::size_t{block} * PHOTON_WORDS + PHOTON_SURFACE) * RAY_BLOCK;
    const bool says_inner = (words[at] & PHOTON_INNER) != 0;
    if (edge > 1.3 * reach) {
      EXPECT_TRUE(says_inner) << x << ", " << z;
      ++inner;
    } else if (edge < reach) {
      EXPECT_FALSE(says_inner) << x << ", " << z;
      ++at_edges;
    }
  }
  std::printf("  %.1f neighbours within a photon's reach, %u blocks inside and %u at edges\n", neighbours.mean, inner,
              at_edges);
  // Photons of a low-discrepancy sequence keep their distances: more of them lie about a place than about a photon.
  EXPECT_GT(neighbours.mean, 16);
  EXPECT_LT(neighbours.mean, 24);
  EXPECT_GT(inner, 100u);
  EXPECT_GT(at_edges, 20u);
}

// The same division as std::nth_element's, of places of which many are equal along the axis.
TEST(Photon, PlacesAreDividedAtTheMedian) {
  std::uint32_t state = 1;
  for (const std::size_t count : {1u, 2u, 31u, 33u, 1000u, 20'000u})
    for (const std::uint32_t kinds : {1u, 3u, 1u << 20}) {
      std::vector<worker::PhotonPlace> places(count);
      for (std::uint32_t i = 0; i < count; ++i) {
        state = state * 1664525u + 1013904223u;
        places[i].words = {0, static_cast<float>((state >> 8) % kinds) - 1, 0, std::bit_cast<float>(i)};
      }
      std::vector<worker::PhotonPlace> expected = places;
      const std::size_t middle = count / 2;
      const auto numbers = [&](const std::vector<worker::PhotonPlace>& of) {
        std::vector<std::uint32_t> found;
        for (std::size_t i = 0; i < middle; ++i) found.push_back(of[i].photon());
        std::ranges::sort(found);
        return found;
      };
      std::ranges::sort(expected, {}, [](const auto& place) { return std::pair(place.at(1), place.photon()); });
      worker::select_place(places, middle, 1);
      EXPECT_EQ(numbers(places), numbers(expected)) << count << " places of " << kinds << " kinds";
      EXPECT_EQ(places[middle].photon(), expected[middle].photon());
    }
}

// --- The path tracer ---

// Paths alone, bit by bit, where both maps are switched off.
TEST(Photon, WithoutPhotonsItIsThePathTracer) {
  Frame photon =
      frame_of(scene::make_scene("cornell-glass", {}), 24, 16, {{"photon.count", "0"}, {"photon.caustics", "0"}});
  Frame path = photon;
  path.settings.method = "path";
  const Film a = render(photon).film, b = render(path).film;
  for (const char* channel : {"R", "G", "B"}) EXPECT_EQ(a.find(channel)->values, b.find(channel)->values) << channel;
}

// Rough lobes on the boxes, one of bare metal.
Scene rough_boxes() { return scene::make_scene("cornell-glossy", {{"short", "0.6"}, {"tall", "0.5"}}); }
// The metal's is too sharp for harmonics of order 4.
Scene half_rough_boxes() { return scene::make_scene("cornell-glossy", {{"short", "0.7"}, {"tall", "0.46"}}); }
// The metal throws caustics.
Scene sharp_metal() { return scene::make_scene("cornell-glossy", {{"short", "0.7"}, {"tall", "0.2"}}); }

Scene scene_of(const std::string& name) {
  if (name == "rough-boxes") return rough_boxes();
  if (name == "half-rough-boxes") return half_rough_boxes();
  if (name == "sharp-metal") return sharp_metal();
  return scene::make_scene(name, {});
}

struct Meeting {
  const char* scene;
  const char* why;
  Settings set{};
};

const Settings kClusters = {{"photon.clusters", "150"}};

class PhotonMeetsPath : public testing::TestWithParam<Meeting> {};

void PrintTo(const Meeting& meeting, std::ostream* out) { *out << meeting.scene << ", " << meeting.why; }

TEST_P(PhotonMeetsPath, InTheMean) {
  const Meeting& p = GetParam();
  Settings set = {{"photon.count", "100000"},
                  {"photon.caustics", "50000"},
                  {"photon.passes", "4"},
                  {"photon.clusters", "0"},
                  {"photon.gather_rays", "128"}};
  for (const auto& [name, value] : p.set) set[name] = value;
  Frame photon = frame_of(scene_of(p.scene), 24, 32, set);
  Frame path = photon;
  path.settings.method = "path";
  path.settings.spp = 512;
  const Sample truth = means_of(path, "indirect.G", 6);
  // The truth's own noise, and what densities of so many photons lose at edges.
  expect_mean(means_of(photon, "indirect.G", 6), truth.mean, std::string(p.scene) + ", " + p.why, sidak(kFamily, 21),
              0.05, 3 * truth.standard_error() + 0.02 * truth.mean);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, PhotonMeetsPath,
    testing::Values(
        Meeting{"cornell-box", "diffuse"}, Meeting{"cornell-mirror", "mirrors and their caustics"},
        Meeting{"cornell-glass", "glass and its caustics"},
        Meeting{"cornell-glass", "caustics alone", {{"photon.count", "0"}}},
        Meeting{"cornell-glass", "paths find caustics", {{"photon.caustics", "0"}}},
        Meeting{"cornell-glass", "three scatterings", {{"depth", "3"}}}, Meeting{"cornell-glossy", "lobes over layers"},
        Meeting{"rough-boxes", "rough lobes"}, Meeting{"cornell-box", "clusters", kClusters},
        Meeting{"cornell-mirror", "clusters seen in mirrors", kClusters},
        Meeting{"cornell-glass", "clusters behind glass", kClusters},
        Meeting{"cornell-glass",
                "clusters beside caustics that paths find",
                {{"photon.clusters", "150"}, {"photon.caustics", "0"}}},
        Meeting{"cornell-box", "clusters, three scatterings", {{"photon.clusters", "150"}, {"depth", "3"}}},
        Meeting{"cornell-glossy", "clusters under lobes", kClusters},
        Meeting{"rough-boxes", "clusters carry rough lobes", kClusters},
        Meeting{"rough-boxes", "clusters under rough lobes", {{"photon.clusters", "150"}, {"photon.order", "0"}}},
        Meeting{"half-rough-boxes", "clusters carry one of two lobes", kClusters},
        Meeting{"sharp-metal",
                "clusters carry a rough lobe and paths find caustics",
                {{"photon.clusters", "150"}, {"photon.caustics", "0"}}},
        Meeting{"rough-boxes",
                "clusters carry rough lobes, three scatterings",
                {{"photon.clusters", "150"}, {"depth", "3"}}},
        Meeting{"cornell-textured", "clusters on textures", kClusters},
        Meeting{"cornell-textured", "cut-outs, textured lobes, bent normals"}),
    [](const auto& test) { return std::to_string(test.index); });

// More photons: the picture goes to the path tracer's.
TEST(Photon, BiasFallsWithMorePhotons) {
  Frame truth = frame_of(scene::make_scene("cornell-box", {}), 24, 2048, {});
  truth.settings.method = "path";
  const Film reference = render(truth).film;
  std::vector<double> off;
  for (const char* count : {"2000", "16000", "128000"}) {
    const Sample means = means_of(
        frame_of(scene::make_scene("cornell-box", {}), 24, 64, {{"photon.count", count}, {"photon.clusters", "0"}}),
        "indirect.G", 4);
    off.push_back(1 - means.mean / mean_of(reference, "indirect.G"));
    std::printf("  %6s light paths: indirect light short of %.4f +- %.4f\n", count, off.back(),
                means.standard_error() / means.mean);
  }
  std::printf("  order %.2f\n", std::log(std::abs(off.front() / off.back())) / std::log(64.0));
  EXPECT_LT(std::abs(off[1]), std::abs(off[0]));
  EXPECT_LT(std::abs(off[2]), std::abs(off[0]) / 2);
  // Discs that hang over edges, counted whole, are short of a per cent.
  EXPECT_LT(std::abs(off[2]), 0.005);
}

// A lamp in a niche of a room's wall, behind a blind: two layers, 0.3 mm apart, each of which lets a fifth of the light
// through.
Scene blind() {
  constexpr double wall = -0.9, half = 0.5;
  scene::SceneBuilder b("blind");
  b.mesh("room");
  const std::uint32_t grey = b.material("walls", scene::lambert(scene::grey(0.5)));
  // Across x, from (y, z) to (y, z).
  const auto sheet = [&](double x, double y0, double z0, double y1, double z1, std::uint32_t material) {
    b.quad({x, y0, z0}, {x, y1, z0}, {x, y1, z1}, {x, y0, z1}, material);
  };
  sheet(1, -1, -1, 1, 1, grey);
  sheet(wall, -1, -1, 1, -half, grey);
  sheet(wall, -1, half, 1, 1, grey);
  sheet(wall, -1, -half, -half, half, grey);
  sheet(wall, half, -half, 1, half, grey);
  const auto tube = [&](double x0, double x1, double to) {
    for (const double side : {-to, to}) {
      b.quad({x0, side, -to}, {x1, side, -to}, {x1, side, to}, {x0, side, to}, grey);
      b.quad({x0, -to, side}, {x1, -to, side}, {x1, to, side}, {x0, to, side}, grey);
    }
  };
  tube(wall, 1, 1);
  tube(wall - 0.2, wall, half);
  sheet(wall - 0.2, -half, -half, half, half, grey);
  sheet(wall - 0.19, -0.4, -0.4, 0.4, 0.4, b.material("lamp", scene::emitter(scene::grey(10))));
  scene::Material cloth = scene::lambert(scene::grey(0.8));
  cloth.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
  cloth.alpha = 0.8f;
  const std::uint32_t layer = b.material("cloth", cloth);
  sheet(wall, -half, -half, half, half, layer);
  sheet(wall - 0.0003, -half, -half, half, half, layer);
  b.camera("camera", {-0.7, 0, 0}, {1, 0, 0}, 80, 64, 64);
  return b.finish();
}

// Between a blind's layers it is brighter than on the side that the room sees. What the photons there say of their
// density is not the room's.
TEST(Photon, LightInsideABlindStaysThere) {
  Frame path = frame_of(blind(), 24, 2048, {});
  path.settings.method = "path";
  const Sample truth = means_of(path, "indirect.G", 4);
  for (const char* cut : {"0", "2000"}) {
    const Settings set = {{"photon.count", "50000"}, {"photon.cut", cut}, {"photon.clusters", "0"}};
    expect_mean(means_of(frame_of(blind(), 24, 64, set), "indirect.G", 6), truth.mean, std::string("a cut of ") + cut,
                sidak(kFamily, 2), 0.05, 3 * truth.standard_error() + 0.02 * truth.mean);
  }
}

// --- Shading clusters ---

// As many clusters as points: each point gathers at its own place what its pixel's samples gather otherwise.
TEST(Photon, AsManyClustersAsPointsGatherAtEveryPoint) {
  const Settings plain = {{"photon.count", "20000"}, {"photon.clusters", "0"}};
  const Settings every = {{"photon.count", "20000"}, {"photon.clusters", "100000"}, {"photon.gather_rays", "256"}};
  // Seeds are the same: so are the photons. A scene without textures: points are at most 16 a pixel, too few for them.
  const scene::Scene scene = scene::make_scene("cornell-box");
  const Rendered found = render(frame_of(scene, 24, 16, every));
  EXPECT_EQ(found.parameters["photon"]["places"], found.parameters["photon"]["points"]);
  const double expected = mean_of(render(frame_of(scene, 24, 1024, plain)).film, "indirect.G");
  const double mean = mean_of(found.film, "indirect.G");
  std::printf("  %.6f at every point, %.6f by every sample\n", mean, expected);
  EXPECT_NEAR(mean / expected, 1, 0.005);
}

TEST(Photon, ClustersMeanIsThePathTracers) {
  const Scene scene = scene::make_scene("cornell-box", {});
  const Film path = render(square_frame("path", scene, {}, 48, 2048, {})).film;
  const Film film = render(frame_of(scene, 48, 64, {{"photon.clusters", "500"}, {"photon.gather_rays", "384"}})).film;
  for (const char* channel : {"R", "G", "B"}) {
    const double expected = mean_of(path, channel), mean = mean_of(film, channel);
    std::printf("  %s: %.6f, expected %.6f\n", channel, mean, expected);
    EXPECT_NEAR(mean / expected, 1, 0.005) << channel;
  }
}

// Light differs from place to place: samples are added in rounds, one for a cluster at most. Where every point has a
// record of its own, none is.
TEST(Photon, ClustersAreRefined) {
  const auto rounds = [](const char* clusters, const char* rays) {
    const Rendered made =
        render(frame_of(scene::make_scene("cornell-box", {}), 32, 4,
                        {{"photon.count", "20000"}, {"photon.clusters", clusters}, {"photon.gather_rays", rays}}));
    std::vector<std::size_t> places;
    for (const char* stage : {"photon.cluster_refine.0", "photon.cluster_refine.1", "photon.cluster_refine.2"})
      if (made.results.contains(stage))
        places.push_back(made.results.at(stage).records.size() / sizeof(worker::SplatPoint));
    EXPECT_EQ(made.parameters["photon"]["refined"], places.back());
    return places;
  };
  const auto some = rounds("120", "384"), noisy = rounds("120", "64");
  ASSERT_EQ(some.size(), 3u);
  std::printf("  %zu, %zu, %zu samples for 120 clusters\n", some[0], some[1], some[2]);
  EXPECT_GT(some[0], 0u);
  EXPECT_GT(some[2], some[0]);
  EXPECT_LE(some[0], 40u);
  EXPECT_LE(some[2], 120u);
  EXPECT_EQ(noisy.size(), 1u) << "records' noise is larger than what more rounds would mend";
  EXPECT_EQ(rounds("100000", "384")[2], 0u);
}

// A look at some of the sample points tells their noise, the first pass that of caustics, and the first samples that of
// paths: beside it as many rays and passes as usual are not worth their time.
TEST(Photon, CountsFollowWhatIsNoisy) {
  const Scene scene = scene::make_scene("cornell-glass", {});
  const auto passes = [](const Rendered& made) {
    std::size_t count = 0;
    while (made.results.contains("photon.caustics." + std::to_string(count))) ++count;
    return count;
  };
  const Settings set = {{"photon.count", "20000"}, {"photon.caustics", "20000"}};
  const Rendered made = render(frame_of(scene, 64, 64, set));
  const auto& photon = made.parameters["photon"];
  const std::size_t all =
      expect_spread_look(made.floats("photon.look"), made.floats("photon.clusters"), SPLAT_POINT_WORDS);
  const std::uint32_t rays = photon["gather_rays"];
  std::printf("  a sample is off by %.4f, a ray by %.4f, a pass by %.4f; %zu sample points; %u rays, %zu passes\n",
              photon["sample_error"].get<double>(), photon["ray_error"].get<double>(),
              photon["pass_error"].get<double>(), all, rays, passes(made));
  EXPECT_EQ(made.specs.at("photon.cluster_gather").work, static_cast<double>(all) * rays);
  EXPECT_GE(rays, 96u);
  EXPECT_LT(rays, 1024u);
  EXPECT_EQ(passes(made), photon["passes"]);
  EXPECT_EQ(passes(made), 16u) << "glass: as many as usual";
  const std::size_t of_glossy = passes(render(frame_of(scene::make_scene("cornell-glossy", {}), 64, 64, set)));
  EXPECT_GE(of_glossy, 2u);
  EXPECT_LT(of_glossy, 12u) << "rough lobes: their caustics are less beside the noise of paths";
  Settings given = set;
  given["photon.gather_rays"] = "128";
  given["photon.passes"] = "16";
  const Rendered as_given = render(frame_of(scene, 64, 64, given));
  EXPECT_FALSE(as_given.results.contains("photon.look")) << "what is set stays";
  EXPECT_EQ(passes(as_given), 16u);
}

// Beside a gather at every point: contact shadows, corners, light by a glass ball.
TEST(Photon, InterpolationIsNear) {
  const Settings set = {
      {"photon.count", "50000"}, {"photon.clusters", "400"}, {"photon.gather_rays", "1024"}, {"photon.cut", "0"}};
  Settings every = set;
  every["photon.clusters"] = "100000";
  const Scene scene = scene::make_scene("cornell-glass", {});
  // A point of each pixel, the same in both. Rays differ: some 3 % is noise of both. 5.8 % without refinement and the
  // mean of gradients.
  const Rendered found = render(frame_of(scene, 64, 1, set)), expected = render(frame_of(scene, 64, 1, every));
  const auto &a = found.film.find("indirect.G")->values, &b = expected.film.find("indirect.G")->values;
  double squared = 0;
  for (std::size_t i = 0; i < a.size(); ++i) squared += std::pow(double{a[i]} - b[i], 2);
  const double error = std::sqrt(squared / static_cast<double>(a.size())) / mean_of(expected.film, "indirect.G");
  std::printf("  off by %.4f, %.4f in the mean\n", error,
              mean_of(found.film, "indirect.G") / mean_of(expected.film, "indirect.G") - 1);
  EXPECT_LT(error, 0.05);
  EXPECT_GT(error, 0.005);
}

// Records on a grid of the plane z = 0, 1 m apart, whose light is `light` and its gradient `gradient` at (x, y).
std::vector<worker::CacheRecord> records_on_plane(
    const std::function<double(double, double)>& light,
    const std::function<std::array<double, 2>(double, double)>& gradient) {
  std::vector<worker::CacheRecord> records;
  for (int y = -5; y <= 5; ++y)
    for (int x = -5; x <= 5; ++x) {
      worker::CacheRecord record{};
      record.position = {static_cast<float>(x), static_cast<float>(y), 0};
      record.normal = {0, 0, 1};
      record.radius = 4;
      record.spare = {2, 0.1f};
      const auto [dx, dy] = gradient(x, y);
      for (std::size_t c = 0; c < 3; ++c) {
        record.irradiance[c] = static_cast<float>(light(x, y));
        record.translation[3 * c] = static_cast<float>(dx);
        record.translation[3 * c + 1] = static_cast<float>(dy);
      }
      records.push_back(record);
    }
  return records;
}

worker::SplatPoint point_on_plane(double x, double y) {
  worker::SplatPoint point{};
  point.position = {static_cast<float>(x), static_cast<float>(y), 0};
  point.normal = point.geometric = {0, 0, 1};
  point.footprint = 0.01f;
  return point;
}

// Light that bends: no record's own gradient tells it, but their mean does.
TEST(Photon, MeanGradientsMeetLightThatBends) {
  const auto light = [](double x, double y) { return 10 - 0.1 * x * x - 0.05 * y * y + 0.3 * x; };
  const auto records = records_on_plane(light, [](double x, double y) {
    return std::array<double, 2>{0.3 - 0.2 * x, -0.1 * y};
  });
  const worker::ClusterPrediction prediction(records, 0);
  std::vector<worker::ClusterPrediction::Read> reads;
  double worst = 0;
  for (const auto& [x, y] : {std::pair{0.5, 0.5}, {0.3, -0.8}, {-1.5, 0.1}, {2.45, 1.7}})
    worst = std::max(worst, std::abs(prediction.at(point_on_plane(x, y), reads).irradiance / 3 - light(x, y)));
  std::printf("  off by %.5f of 10, by own gradients alone it would be %.3f\n", worst, 0.15 / 4);
  EXPECT_LT(worst, 0.01);
}

// What tells of errors: records that differ from what others say of them, and surfaces that are near. Not noise, and
// not what lies next to a record.
double off_by(const std::vector<worker::CacheRecord>& records, double noise, double x, double y) {
  std::vector<worker::ClusterPrediction::Read> reads;
  return worker::ClusterPrediction(records, noise).at(point_on_plane(x, y), reads).off / 3;
}

TEST(Photon, ErrorsArePredicted) {
  const auto flat = [](double, double) { return std::array<double, 2>{}; };
  const auto off = [](const std::vector<worker::CacheRecord>& records, double x, double y) {
    return off_by(records, 0.03, x, y);
  };
  auto records = records_on_plane([](double, double) { return 10; }, flat);
  for (auto& record : records) record.radius = 100;  // nothing is near
  const double plain = off(records, 0.5, 0.5);
  const auto noisy = records_on_plane([](double x, double y) { return 10 + 0.2 * std::sin(37 * x + 91 * y); }, flat);
  auto far = noisy;
  for (auto& record : far) record.radius = 100;
  auto dark = records;
  dark[60].irradiance = {1, 1, 1};  // at the origin
  auto near = records;
  near[60].radius = 0.5f;
  const double of_dark = off(dark, 0.5, 0.5), of_near = off(near, 0.5, 0.5);
  std::printf("  of 10: flat %.4f, noise %.4f, beside a dark record %.4f, beside a surface %.4f\n", plain,
              off(far, 0.5, 0.5), of_dark, of_near);
  EXPECT_LT(plain, 0.02);
  EXPECT_LT(off(far, 0.5, 0.5), 0.02);
  EXPECT_GT(of_dark, 0.1);
  EXPECT_GT(of_near, 0.1);
  // Records are so noisy that their differences tell nothing; a residual beside its own, small noise still does.
  EXPECT_GT(off_by(dark, 0.5, 0.5, 0.5), 0.05);
  EXPECT_LT(off(dark, 0.05, 0), of_dark / 4);
  EXPECT_LT(off(near, 0.05, 0), of_near / 4);
  EXPECT_LT(off(dark, 4.5, 4.5), 0.02);
}

// Who chooses samples and who shades points agree on what records say.
TEST(Photon, PointsReadWhatIsPredicted) {
  const Rendered made =
      render(frame_of(scene::make_scene("cornell-glass", {}), 32, 1,
                      {{"photon.count", "20000"}, {"photon.clusters", "100"}, {"photon.gather_rays", "384"}}));
  std::vector<worker::CacheRecord> records;
  for (const char* stage :
       {"photon.cluster_gather", "photon.cluster_gather.1", "photon.cluster_gather.2", "photon.cluster_gather.3"}) {
    const scene::Bytes& rows = made.results.at(stage).records;
    const std::size_t before = records.size();
    records.resize(before + rows.size() / sizeof(worker::CacheRecord));
    std::memcpy(&records[before], rows.data(), rows.size());
  }
  // Points that reflect all irradiance, of all colours.
  worker::StageTask task = made.tasks.at("photon.shade");
  scene::Bytes bytes = *task.inputs.at("points").load();
  std::vector<worker::SplatPoint> points(bytes.size() / sizeof(worker::SplatPoint));
  std::memcpy(points.data(), bytes.data(), bytes.size());
  for (auto& point : points) point.factor = {1, 1, 1};
  std::memcpy(bytes.data(), points.data(), bytes.size());
  task.inputs["points"] = std::make_shared<const scene::Bytes>(std::move(bytes));
  const worker::BatchResult shaded =
      executor(worker::TraceKind::automatic).run(task, 0, made.specs.at("photon.shade").items);
  const worker::ClusterPrediction prediction(records, 0.03);
  std::vector<worker::ClusterPrediction::Read> reads;
  std::size_t looked = 0, different = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!points[i].exists()) continue;
    std::array<float, 3> rgb{};
    std::memcpy(rgb.data(), shaded.records.data() + i * sizeof rgb, sizeof rgb);
    const double seen = double{rgb[0]} + rgb[1] + rgb[2], told = prediction.at(points[i], reads).irradiance;
    ++looked;
    different += std::abs(seen - told) <= 1e-3 * told ? 0 : 1;
  }
  std::printf("  %zu points, %zu differ\n", looked, different);
  EXPECT_GT(looked, 900u);
  // Host and device round differently where a record just counts.
  EXPECT_LT(different, looked / 100);
}

// The ceiling goes on above the Cornell box's lamp, a centimetre away from it. What a pixel shows of that is in the
// clusters of what lies beside it, but has sample points of its own, which light no other pixel.
TEST(Photon, GapsAreNotAsBrightAsWhatLiesBesideThem) {
  const Scene scene = scene::make_scene("cornell-box", {});
  const Settings set = {
      {"photon.count", "50000"}, {"photon.clusters", "400"}, {"photon.gather_rays", "512"}, {"photon.cut", "0"}};
  Settings every = set;
  every["photon.clusters"] = "100000";
  // A point of each pixel, the same in both.
  const Rendered found = render(frame_of(scene, 96, 1, set)), expected = render(frame_of(scene, 96, 1, every));
  const auto *a = found.film.find("indirect.G"), *b = expected.film.find("indirect.G");
  const double mean = mean_of(expected.film, "indirect.G");
  double worst = 0;
  for (std::size_t i = 0; i < a->values.size() / 4; ++i)
    if (b->values[i] < 0.1 * mean) worst = std::max(worst, double{a->values[i]} - b->values[i]);
  std::printf("  the brightest pixel that is dark: %.3f of the mean\n", worst / mean);
  EXPECT_LT(worst, 0.3 * mean);
}

// Clusters of a camera stand for what the next one sees of their members. It adds some for what is new to it, in
// proportion, and for what it sees from nearby.
TEST(Photon, KeptClustersStandForTheirMembers) {
  constexpr std::uint32_t clusters = 150;
  Frame frame = frame_of(scene::make_scene("cornell-box", {}), 48, 4,
                         {{"photon.count", "20000"}, {"photon.clusters", "150"}, {"photon.gather_rays", "64"}});
  scene::Camera aside = frame.settings.camera, near = frame.settings.camera;
  aside.origin[0] += 0.8f;
  near.origin[2] -= 2.9f;
  frame.settings.trajectory = {frame.settings.camera, frame.settings.camera, aside, near};
  const Rendered made = render(frame);
  std::vector<std::vector<worker::SplatPoint>> places;
  for (unsigned k = 0; k < 4; ++k) {
    const scene::Bytes& rows = made.results.at("photon.extend." + std::to_string(k)).records;
    std::vector<worker::SplatPoint> all(rows.size() / sizeof(worker::SplatPoint));
    std::memcpy(all.data(), rows.data(), rows.size());
    places.push_back(std::move(all));
  }
  std::vector<std::size_t> added{places[0].size()};
  for (std::size_t k = 1; k < 4; ++k) {
    added.push_back(places[k].size() - places[k - 1].size());
    EXPECT_EQ(std::memcmp(places[k].data(), places[k - 1].data(), places[k - 1].size() * sizeof places[k][0]), 0) << k;
  }
  std::printf("  %zu places, %zu more of the same camera, %zu aside, %zu nearby\n", added[0], added[1], added[2],
              added[3]);
  EXPECT_GT(added[0], clusters * 9 / 10);
  EXPECT_LT(added[1], clusters / 5);
  EXPECT_GT(added[2], added[1]);
  EXPECT_LT(added[2], clusters / 2);
  EXPECT_GT(added[3], clusters / 2);
  // What the same camera sees was refined.
  const auto refined = [&](unsigned camera) {
    const std::string stage = "photon.extend_refine." + std::to_string(camera) + ".0";
    return made.results.at(stage).records.size() / sizeof(worker::SplatPoint);
  };
  std::printf("  refined: %zu, %zu with the same camera, %zu, %zu\n", refined(0), refined(1), refined(2), refined(3));
  EXPECT_GT(refined(0), clusters / 4);
  EXPECT_LT(refined(1) - refined(0), clusters / 10);
  // The frame is the first camera's: its clusters are there.
  const auto& told = made.parameters["photon"];
  EXPECT_EQ(told["cameras"], 4);
  EXPECT_EQ(told["kept"], places[3].size());
  EXPECT_LT(told["places"].get<std::size_t>() - places[3].size(), clusters / 5);
}

// A frame that begins with the clusters of others is as near to the path tracer's as one of its own clusters.
TEST(Photon, KeptClustersMeanIsThePathTracers) {
  Frame frame = frame_of(scene::make_scene("cornell-box", {}), 48, 64,
                         {{"photon.clusters", "500"}, {"photon.gather_rays", "384"}});
  const Film path = render(square_frame("path", scene::make_scene("cornell-box", {}), {}, 48, 2048, {})).film;
  const auto off = [&](const Film& film) {
    const auto *a = film.find("indirect.G"), *b = path.find("indirect.G");
    double squared = 0;
    for (std::size_t i = 0; i < a->values.size(); ++i) squared += std::pow(double{a->values[i]} - b->values[i], 2);
    return std::sqrt(squared / static_cast<double>(a->values.size())) / mean_of(path, "indirect.G");
  };
  const double alone = off(render(frame).film);
  for (const float x : {-0.3f, -0.2f, -0.1f, 0.1f, 0.2f, 0.3f}) {
    frame.settings.trajectory.push_back(frame.settings.camera);
    frame.settings.trajectory.back().origin[0] += x;
  }
  const Film film = render(frame).film;
  std::printf("  indirect light is off by %.4f, alone by %.4f; mean %.5f of %.5f\n", off(film), alone,
              mean_of(film, "G"), mean_of(path, "G"));
  EXPECT_NEAR(mean_of(film, "G") / mean_of(path, "G"), 1, 0.005);
  EXPECT_LT(off(film), 1.08 * alone);
}

// Of the records that stage `stage` made: how far their irradiance is off in the mean (rms), over its mean.
double records_off(const Rendered& found, const Rendered& expected, const char* stage) {
  const auto irradiance = [&](const Rendered& made) {
    const scene::Bytes& records = made.results.at(stage).records;
    std::vector<float> words(records.size() / 4);
    std::memcpy(words.data(), records.data(), records.size());
    return words;
  };
  const std::vector<float> a = irradiance(found), b = irradiance(expected);
  EXPECT_EQ(a.size(), b.size());
  double squared = 0, sum = 0, count = 0;
  for (std::size_t at = CACHE_IRRADIANCE + 1; at < std::min(a.size(), b.size()); at += CACHE_WORDS, ++count) {
    squared += std::pow(double{a[at]} - b[at], 2);
    sum += double{b[at]};
  }
  return std::sqrt(squared * count) / sum;
}

// Few rays against many at the same places: neighbours' means are nearer to what many rays find.
TEST(Photon, SmoothingTakesNoiseOfRecords) {
  // Those of the clusters alone: which samples are added depends on records.
  const auto with_rays = [](const char* rays) {
    Rendered made =
        render(frame_of(scene::make_scene("cornell-box", {}), 32, 4,
                        {{"photon.count", "20000"}, {"photon.clusters", "900"}, {"photon.gather_rays", rays}}));
    worker::StageTask task = made.tasks.at("photon.cluster_smooth");
    std::erase_if(task.inputs, [](const auto& input) { return input.first != "records.0"; });
    made.results["photon.cluster_smooth"] = executor(worker::TraceKind::automatic).run(task, 0, 1);
    return made;
  };
  const Rendered few = with_rays("128"), many = with_rays("2048");
  const double gathered = records_off(few, many, "photon.cluster_gather"),
               smoothed = records_off(few, many, "photon.cluster_smooth");
  std::printf("  records of 128 rays are off by %.4f, smoothed by %.4f\n", gathered, smoothed);
  EXPECT_LT(smoothed, 0.9 * gathered);
  EXPECT_GT(smoothed, 0);
}

// A record twenty times as bright as one within its reach, a metre away: it weighs there no more than half of the
// other's light; without a darker one it keeps its radius.
TEST(Photon, BrightRecordsDoNotShineOnDarkOnes) {
  const auto radius_beside = [](float light) {
    std::vector<worker::CacheRecord> records(2);
    for (std::size_t i = 0; i < 2; ++i) {
      records[i].position = {static_cast<float>(i), 0, 0};
      records[i].normal = {0, 0, 1};
      records[i].radius = 1;
      records[i].spare = {2, 0.1f};
    }
    records[0].irradiance = {light, light, light};
    records[1].irradiance = {20, 20, 20};
    scene::Bytes bytes(records.size() * sizeof records[0]);
    std::memcpy(bytes.data(), records.data(), bytes.size());
    worker::StageTask task;
    task.kind = "photon_cluster_smooth";
    task.inputs["records.0"] = std::make_shared<const scene::Bytes>(std::move(bytes));
    const worker::BatchResult result = worker::smooth_photon_clusters(task);
    std::memcpy(records.data(), result.records.data(), result.records.size());
    return records[1].radius;
  };
  EXPECT_FLOAT_EQ(radius_beside(20), 1);
  EXPECT_FLOAT_EQ(radius_beside(5), 0.125f);
  EXPECT_FLOAT_EQ(radius_beside(1), 0.1f) << "the least: a twentieth of its reach";
}

// Points on a grid: a floor whose right half is bumpy.
struct Ground {
  std::vector<float> rows;
  std::vector<worker::ScreenPoint> screen;
};

Ground ground(std::uint32_t edge) {
  Ground made;
  for (std::uint32_t y = 0; y < edge; ++y)
    for (std::uint32_t x = 0; x < edge; ++x) {
      const bool bumpy = 2 * x >= edge;
      const float tilt = bumpy ? 0.5f * std::sin(0.9f * static_cast<float>(x + 3 * y)) : 0;
      made.screen.push_back({x, y, static_cast<std::uint32_t>(made.screen.size())});
      for (const float word :
           {static_cast<float>(x) / static_cast<float>(edge), static_cast<float>(y) / static_cast<float>(edge), 0.0f,
            std::sin(tilt), 0.0f, std::cos(tilt), 0.0f, 0.0f})
        made.rows.push_back(word);
    }
  return made;
}

TEST(Photon, SeedsLieWhereGeometryVaries) {
  constexpr std::uint32_t edge = 37;
  const Ground made = ground(edge);
  for (const std::uint32_t wanted : {1u, 2u, 7u, 100u, 700u, edge * edge}) {
    const auto seeds = worker::seeds_by_variation(made.rows, 8, made.screen, wanted, 5);
    const std::set<std::uint32_t> distinct(seeds.begin(), seeds.end());
    EXPECT_EQ(seeds.size(), wanted);
    EXPECT_EQ(distinct.size(), wanted);
    if (wanted != 100) continue;
    const auto bumpy = std::ranges::count_if(seeds, [](std::uint32_t row) { return 2 * (row % edge) >= edge; });
    std::printf("  %ld of %zu seeds on the bumpy half\n", static_cast<long>(bumpy), seeds.size());
    EXPECT_GT(bumpy, 60) << "its area alone would give it 50";
    EXPECT_LT(bumpy, 100) << "the flat half has none";
  }
}

// --- The illumination cut ---

std::vector<std::uint32_t> words_of(const scene::Bytes& bytes) {
  std::vector<std::uint32_t> words(bytes.size() / 4);
  std::memcpy(words.data(), bytes.data(), bytes.size());
  return words;
}

// A cut has the nodes that were asked for, refinement opens those that are off, and the rows that are read hold the
// cut's irradiance in the tree's order.
TEST(Photon, CutIsRefinedWhereItIsOff) {
  const Frame frame = frame_of(scene::make_scene("cornell-box", {}), 8, 1,
                               {{"photon.count", "20000"}, {"photon.clusters", "0"}, {"photon.cut", "0"}});
  const std::vector<std::uint32_t> map = words_of(render(frame).results.at("photon.map.global").records);
  worker::IlluminationCut cut(map);
  EXPECT_EQ(cut.size(), 1u);
  cut.choose(100);
  ASSERT_EQ(cut.size(), 100u);
  const double radius = cut.median_radius();
  // As bright as eq. 3 says, or ten times brighter; as bright all over a node, or not.
  const auto refined = [&](float times, float spread) {
    worker::IlluminationCut other(map);
    other.choose(100);
    std::vector<worker::CutLight> lights(other.size());
    for (std::size_t i = 0; i < other.size(); ++i) {
      lights[i].middle = {static_cast<float>(other.rough_irradiance(i)) * times, 0, 0};
      lights[i].spread = spread;
    }
    const std::size_t opened = other.refine(lights, 1.2, 0.1f).size() - 100;
    EXPECT_EQ(other.size(), 100 + opened);
    return opened;
  };
  EXPECT_EQ(refined(10, 0), 100u) << "all are off";
  EXPECT_EQ(refined(1, 0.2f), 100u) << "all are bright in one place and dark in another";
  const std::size_t bent = refined(1, 0.05f);
  EXPECT_GT(bent, 0u) << "nodes that straddle an edge";
  EXPECT_LT(bent, 80u) << "the others are as eq. 3 says";
  cut.choose(map[MAP_NODES]);
  EXPECT_EQ(cut.size(), map[MAP_BLOCKS]) << "all leaves";
  EXPECT_LT(cut.median_radius(), radius);
  std::vector<worker::CutLight> lights(cut.size());
  for (std::size_t i = 0; i < cut.size(); ++i) {
    lights[i].place = cut.place(i);
    lights[i].mean[1] = static_cast<float>(i);
  }
  const std::vector<std::uint32_t> rows = cut.rows(lights);
  // All are in the blocks, in the tree's order, and the boxes about a block hold what its nodes reach, on all levels.
  const std::size_t nodes = rows[MAP_NODES], blocks = rows[MAP_BLOCKS],
                    block_words = std::size_t{CUT_WORDS} * RAY_BLOCK;
  ASSERT_EQ(rows.size(), (1 + nodes) * PHOTON_WORDS + blocks * block_words);
  const auto real = [&](std::size_t at) { return std::bit_cast<float>(rows[at]); };
  std::size_t members = 0;
  for (std::size_t b = 0; b < blocks; ++b)
    for (std::size_t lane = 0; lane < RAY_BLOCK; ++lane) {
      const std::size_t block = (1 + nodes) * PHOTON_WORDS + b * block_words;
      const auto word = [&](unsigned k) { return real(block + k * RAY_BLOCK + lane); };
      if (!(word(CUT_NEARNESS) > 0)) continue;
      EXPECT_EQ(word(CUT_IRRADIANCE + 1), static_cast<float>(members++));
      const float reach = 0.999f / std::sqrt(word(CUT_NEARNESS));
      std::size_t first = 0, count = blocks, child = b;
      do {
        count = (count + RAY_BLOCK - 1) / RAY_BLOCK;
        const std::size_t at =
            2 * PHOTON_WORDS + (first + child / RAY_BLOCK) * CUT_BOX_WORDS * RAY_BLOCK + child % RAY_BLOCK;
        for (unsigned k = 0; k < 3; ++k) {
          EXPECT_LT(real(at + k * RAY_BLOCK), word(CUT_PLACE + k) - reach);
          EXPECT_GT(real(at + (3 + k) * RAY_BLOCK), word(CUT_PLACE + k) + reach);
        }
        first += count;
        child /= RAY_BLOCK;
      } while (count > 1);
    }
  EXPECT_EQ(members, cut.size());
}

// The same photons and the same rays: what differs is the cut, of 4,096 nodes before they are refined.
struct CutOff {
  double error = 0, mean = 0;  // over the map's mean
};

double off_by(const std::vector<float>& found, const std::vector<float>& expected, double* mean = nullptr) {
  double squared = 0, wanted = 0, sum = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    squared += std::pow(double{found[i]} - expected[i], 2);
    wanted += double{expected[i]};
    sum += double{found[i]};
  }
  if (mean) *mean = sum / wanted - 1;
  return std::sqrt(squared * static_cast<double>(expected.size())) / wanted;
}

Rendered by_map(const Scene& scene, const char* count, const char* cut) {
  return render(frame_of(
      scene, 32, 4,
      {{"photon.count", count}, {"photon.clusters", "200"}, {"photon.gather_rays", "1024"}, {"photon.cut", cut}}));
}

const std::vector<float>& indirect(const Rendered& rendered) { return rendered.film.find("indirect.G")->values; }

CutOff cut_beside_map(const Scene& scene, const Rendered& full, const Rendered& cut) {
  CutOff off;
  off.error = off_by(indirect(cut), indirect(full), &off.mean);
  std::printf("  %s: a cut of %s nodes is off by %.4f, %.4f in the mean\n", scene.name.c_str(),
              cut.parameters["photon"]["cut_nodes"].dump().c_str(), off.error, off.mean);
  return off;
}

TEST(Photon, CutStandsForTheMap) {
  for (const char* name : {"cornell-box", "cornell-glossy"}) {
    const Scene scene = scene::make_scene(name, {});
    const CutOff off = cut_beside_map(scene, by_map(scene, "100000", "0"), by_map(scene, "100000", "4096"));
    EXPECT_LT(off.error, 0.015) << name;
    EXPECT_GT(off.error, 0) << name << ": the cut is not read";
    EXPECT_NEAR(off.mean, 0, 0.005) << name;
  }
}

// The sun shines through a blind, in stripes on a laid table of a room that is dark otherwise. All that the room sees
// of it are some hundred photons.
Scene laid_table(bool blind = true) {
  scene::SceneBuilder b("laid-table");
  b.mesh("room");
  const std::uint32_t grey = b.material("grey", scene::lambert(scene::grey(0.5)));
  const std::uint32_t white = b.material("white", scene::lambert(scene::grey(0.8)));
  const auto box = [&](double x0, double y0, double z0, double x1, double y1, double z1, std::uint32_t material) {
    for (const double y : {y0, y1}) b.quad({x0, y, z0}, {x1, y, z0}, {x1, y, z1}, {x0, y, z1}, material);
    for (const double z : {z0, z1}) b.quad({x0, y0, z}, {x1, y0, z}, {x1, y1, z}, {x0, y1, z}, material);
    b.quad({x1, y0, z0}, {x1, y0, z1}, {x1, y1, z1}, {x1, y1, z0}, material);
    b.quad({x0, y0, z0}, {x0, y0, z1}, {x0, y1, z1}, {x0, y1, z0}, material);
  };
  // All of the room but the wall at x = -2, which has a window.
  for (const double y : {0.0, 3.0}) b.quad({-2, y, -2}, {2, y, -2}, {2, y, 2}, {-2, y, 2}, grey);
  for (const double z : {-2.0, 2.0}) b.quad({-2, 0, z}, {2, 0, z}, {2, 3, z}, {-2, 3, z}, grey);
  b.quad({2, 0, -2}, {2, 0, 2}, {2, 3, 2}, {2, 3, -2}, grey);
  const auto wall = [&](double y0, double z0, double y1, double z1) {
    b.quad({-2, y0, z0}, {-2, y0, z1}, {-2, y1, z1}, {-2, y1, z0}, grey);
  };
  wall(0, -2, 1, 2);
  wall(2, -2, 3, 2);
  wall(1, -2, 2, -0.5);
  wall(1, 0.5, 2, 2);
  for (int slat = 0; blind && slat < 10; ++slat) wall(1.03 + 0.1 * slat, -0.5, 1.1 + 0.1 * slat, 0.5);
  box(-1.6, 0.75, -0.6, 0.6, 0.8, 0.6, white);
  for (int cup = 0; cup < 5; ++cup) {
    const double x = -1.4 + 0.35 * cup, z = 0.3 - 0.15 * cup;
    box(x, 0.8001, z, x + 0.1, 0.95, z + 0.1, white);
  }
  b.directional_light({1, -0.75, -0.1}, scene::grey(10));
  b.camera("camera", {1.2, 1.7, 0.9}, {-0.6, 0.8, 0}, 50, 64, 64);
  return b.finish();
}

// Photons shine as far as they lie apart, and no farther: neither the dark beside a stripe nor the table's edges get
// light that is not there. By the nearest photons of each place the stripes were too bright by 23 %.
TEST(Photon, SunInStripesKeepsItsPower) {
  for (const bool blind : {true, false}) {
    Frame path = frame_of(laid_table(blind), 16, 4096, {});
    path.settings.method = "path";
    const Sample truth = means_of(path, "indirect.G", 6);
    const Settings set = {{"photon.count", "250000"}, {"photon.cut", "0"}, {"photon.clusters", "0"}};
    expect_means_meet(means_of(frame_of(laid_table(blind), 16, 256, set), "indirect.G", 6), truth,
                      blind ? "stripes" : "a patch of sun", 0.05);
  }
}

// Where the light changes within a node, or from one node to the next, photons are read. So few photons see the room
// that the map itself is far from a map of many: the cut is as near to that as the map is.
TEST(Photon, CutStandsForAMapOfStripes) {
  const Scene scene = laid_table();
  const Rendered full = by_map(scene, "60000", "0"), cut = by_map(scene, "60000", "4096"),
                 many = by_map(scene, "500000", "0");
  const CutOff off = cut_beside_map(scene, full, cut);
  EXPECT_LT(off.error, 0.07);
  EXPECT_GT(off.error, 0) << "the cut is not read";
  EXPECT_NEAR(off.mean, 0, 0.02);
  const double of_map = off_by(indirect(full), indirect(many)), of_cut = off_by(indirect(cut), indirect(many));
  std::printf("  beside a map of many photons the map is off by %.3f, the cut by %.3f\n", of_map, of_cut);
  EXPECT_LT(of_cut, 1.1 * of_map);
}

// A slanted floor, lit by a mirror beside it, seen from above; nothing beyond it.
Scene lit_by_a_mirror() {
  scene::SceneBuilder b("lit-by-a-mirror");
  b.mesh("floor");
  b.quad({-1, 0, 0.6}, {0.7, 0, 1}, {1, 0, -0.7}, {-0.6, 0, -1}, b.material("grey", scene::lambert(scene::grey(0.5))));
  b.mesh("mirror");
  b.quad({-1.2, -1, 2}, {-1.2, -1, -2}, {-1.2, 2, -2}, {-1.2, 2, 2},
         b.material("mirror", scene::metal(scene::grey(0.9), 0)));
  b.point_light({0.5, 1, 0}, scene::grey(1));
  b.camera("camera", {0, 3, 0.001}, {0, 0, 0}, 45, 64, 64);
  return b.finish();
}

// One sample of a pixel in each of 16 passes: how many of them see the floor's edge is as even as 16 samples of one
// sequence are, not as 16 that know nothing of each other.
TEST(Photon, PassesShareAPixelsSequence) {
  const auto seen = [](std::uint32_t seed) {
    Frame frame = frame_of(
        lit_by_a_mirror(), 24, 16,
        {{"photon.count", "0"}, {"photon.caustics", "1000"}, {"photon.passes", "16"}, {"photon.radius", "10"}});
    frame.settings.seed = seed;
    const Rendered made = render(frame);
    std::vector<double> passes(24 * 24, 0);
    for (unsigned pass = 0; pass < 16; ++pass) {
      const std::vector<float> light = made.floats("photon.caustics." + std::to_string(pass));
      for (std::size_t i = 0; i < passes.size(); ++i) passes[i] += light[3 * i] > 0 ? 1 : 0;
    }
    return passes;
  };
  const std::vector<double> first = seen(1), second = seen(2);
  double variance = 0, of_strangers = 0;
  std::size_t edges = 0;
  for (std::size_t i = 0; i < first.size(); ++i) {
    const double share = (first[i] + second[i]) / 32;
    if (share <= 0 || share >= 1) continue;
    ++edges;
    variance += std::pow(first[i] - second[i], 2) / 2;
    of_strangers += 16 * share * (1 - share);
  }
  std::printf("  %zu pixels at the edge, variance %.2f, of samples that know nothing of each other %.2f\n", edges,
              variance / static_cast<double>(edges), of_strangers / static_cast<double>(edges));
  EXPECT_GT(edges, 30u);
  EXPECT_LT(variance, 0.4 * of_strangers);
}

// --- Bits and malformed tasks ---

TEST(Photon, RecordsDoNotDependOnBatches) {
  worker::Executor two({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic});
  const Frame frame = frame_of(scene::make_scene("cornell-glass", {}), 24, 8,
                               {{"photon.count", "3000"},
                                {"photon.caustics", "3000"},
                                {"photon.passes", "1"},
                                {"photon.clusters", "100"},
                                {"photon.cut", "300"},
                                {"photon.guide", "3000"},
                                {"photon.gather_rays", "64"}});
  const Rendered whole = render(frame);
  two.load_scene("two", frame.scene, nullptr);
  for (const char* name :
       {"photon.trace.pilot", "photon.guide.global", "photon.guide.caustics", "photon.trace.global", "photon.trace.0",
        "photon.caustics.0", "photon_gather.0", "photon.cut", "photon.clusters", "photon.cluster_gather",
        "photon.cluster_refine.0", "photon.cluster_smooth", "photon.shade"}) {
    const coordinator::StageSpec& spec = whole.specs.at(name);
    const worker::BatchResult& all = whole.results.at(name);
    worker::StageTask again = whole.tasks.at(name);
    again.scene = "two";
    for (auto& [input, to] : again.inputs) to.own_items = false;
    std::size_t at = 0;
    // Batches begin where tiles do.
    const std::uint64_t step = spec.items < 144 ? 5 : 144;
    for (std::uint64_t first = 0; first < spec.items; first += step) {
      const std::uint64_t count = std::min<std::uint64_t>(step, spec.items - first);
      const auto part = two.run(again, first, count);
      ASSERT_LE(at + part.records.size(), all.records.size()) << name;
      ASSERT_EQ(std::memcmp(part.records.data(), all.records.data() + at, part.records.size()), 0)
          << name << " from " << first;
      at += part.records.size();
    }
    EXPECT_EQ(at, all.records.size()) << name;
  }
}

TEST(Photon, RefusesWhatIsOutOfRange) {
  const Frame frame = frame_of(scene::make_scene("cornell-glass", {}), 8, 1,
                               {{"photon.count", "500"},
                                {"photon.caustics", "500"},
                                {"photon.passes", "1"},
                                {"photon.clusters", "10"},
                                {"photon.cut", "20"},
                                {"photon.gather_rays", "64"}});
  const Rendered made = render(frame);
  worker::Executor& on = executor(worker::TraceKind::automatic);
  const auto refused = [&](const char* stage, const std::function<void(worker::StageTask&)>& change) {
    worker::StageTask task = made.tasks.at(stage);
    on.run(task, 0, 1);
    change(task);
    EXPECT_THROW(on.run(task, 0, 1), Error) << stage;
  };
  const auto set_word = [](std::size_t at, std::uint32_t value) {
    return [=](worker::StageTask& task) { std::memcpy(task.parameters.data() + at, &value, 4); };
  };
  refused("photon.trace.global", set_word(offsetof(PhotonTraceParameters, classes), 16));
  refused("photon_gather.0", set_word(offsetof(kernels::PhotonGatherParameters, estimate), 1000));
  refused("photon_gather.0",
          set_word(offsetof(kernels::PhotonGatherParameters, samples) + offsetof(kernels::PathParameters, filter),
                   PATH_CLASS_CAUSTIC));
  refused("photon.caustics.0", set_word(offsetof(kernels::PhotonCausticsParameters, shrink), 0));
  refused("photon.caustics.0", set_word(offsetof(kernels::PhotonCausticsParameters, samples), 3));
  using kernels::PhotonClusterGatherParameters;
  refused("photon.clusters", set_word(offsetof(kernels::PhotonClusterParameters, clusters), 0));
  refused("photon.clusters", set_word(offsetof(kernels::PhotonClusterParameters, width), 80));
  refused("photon.clusters", set_word(offsetof(kernels::PhotonClusterParameters, kept_footprint), 0x7fc00000u));  // NaN
  using kernels::PhotonClusterRefineParameters;
  refused("photon.cluster_refine.0", set_word(offsetof(PhotonClusterRefineParameters, most), 0));
  refused("photon.cluster_refine.0", set_word(offsetof(PhotonClusterRefineParameters, width), 80));
  refused("photon.cluster_refine.0", set_word(offsetof(PhotonClusterRefineParameters, noise), 0x7fc00000u));  // NaN
  refused("photon.cluster_gather", set_word(offsetof(PhotonClusterGatherParameters, estimate), 1000));
  refused("photon.cluster_gather", set_word(offsetof(PhotonClusterGatherParameters, records.azimuthal), 8));
  refused("photon.cluster_gather", set_word(offsetof(PhotonClusterGatherParameters, records.samples.filter), 32));
  refused("photon.cluster_gather", set_word(offsetof(PhotonClusterGatherParameters, records.samples.clamp), 0));
  refused("photon.cut", set_word(offsetof(kernels::PhotonCutParameters, nodes), 0));
  refused("photon.cut", set_word(offsetof(kernels::PhotonCutParameters, ratio), 0xbf800000u));  // -1
  refused("photon.cut", set_word(offsetof(kernels::PhotonCutParameters, spread), 0));
  refused("photon.cut", set_word(offsetof(kernels::PhotonCutParameters, estimate), 1000));
  // A cut whose header is wrong, whose boxes are not those of its blocks, or whose light is none.
  using Broken = std::pair<std::size_t, std::uint32_t>;
  const std::size_t cut_nodes = words_of(*made.tasks.at("photon.cluster_gather").inputs.at("cut").load())[MAP_NODES];
  for (const auto& [word, value] : {Broken{MAP_NODES, 1}, Broken{MAP_BLOCKS, 1u << 30}, Broken{MAP_BLOCKS, 0},
                                    Broken{(1 + cut_nodes) * PHOTON_WORDS + CUT_IRRADIANCE * RAY_BLOCK, 0xbf800000u},
                                    Broken{(1 + cut_nodes) * PHOTON_WORDS + CUT_SPREAD * RAY_BLOCK, 0x7f800000u}})
    refused("photon.cluster_gather", [word = word, value = value](worker::StageTask& task) {
      scene::Bytes cut = *task.inputs.at("cut").load();
      std::memcpy(cut.data() + word * 4, &value, 4);
      task.inputs["cut"] = std::make_shared<const scene::Bytes>(std::move(cut));
    });
  // A place without a reach, or that is nowhere.
  for (const unsigned word : {SPLAT_RADIUS, SPLAT_ACCURACY, SPLAT_POSITION})
    refused("photon.cluster_gather", [&](worker::StageTask& task) {
      scene::Bytes places = *task.inputs.at("places").load();
      const float bad = word == SPLAT_POSITION ? NAN : 0;
      std::memcpy(places.data() + word * 4, &bad, 4);
      task.inputs["places"] = std::make_shared<const scene::Bytes>(std::move(places));
    });
  // A record that reaches nowhere, or whose light is none.
  for (const unsigned word : {CACHE_RADIUS, CACHE_IRRADIANCE, CACHE_SPARE, CACHE_SPARE + 1})
    refused("photon.cluster_smooth", [word](worker::StageTask& task) {
      scene::Bytes records = *task.inputs.at("records.0").load();
      const float bad = word == CACHE_IRRADIANCE ? NAN : 0;
      std::memcpy(records.data() + word * 4, &bad, 4);
      task.inputs["records.0"] = std::make_shared<const scene::Bytes>(std::move(records));
    });
  // A map whose first node leads nowhere, has photons that are none, or whose walk would not end.
  const auto broken = [&](std::size_t row, unsigned word, std::uint32_t value) {
    return [=](worker::StageTask& task) {
      scene::Bytes map = *task.inputs.at("map").load();
      std::memcpy(map.data() + (row * PHOTON_WORDS + word) * 4, &value, 4);
      task.inputs["map"] = std::make_shared<const scene::Bytes>(std::move(map));
    };
  };
  for (const char* stage : {"photon_gather.0", "photon.caustics.0", "photon.cluster_gather"}) {
    refused(stage, broken(0, MAP_NODES, 1));
    refused(stage, broken(0, MAP_BLOCKS, 1u << 30));
    refused(stage, broken(0, MAP_CAUSTICS, 1u << 30));
    refused(stage, broken(0, MAP_REACH, 0x7fc00000u));  // NaN
    refused(stage, broken(1, NODE_BLOCK, 1u << 20));
    refused(stage, broken(1, NODE_SKIP, 0));
    refused(stage, broken(1, NODE_SKIP, 1u << 30));
  }
}

}  // namespace
}  // namespace gleaner::test
