// Light paths that begin where photons are of use: the guide's cells, the power that photons carry by it, and what is
// gained.

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <functional>

#include "kernels/photon_records.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "scene/model/order.h"
#include "tests/radiometry/rendered_frame.h"
#include "worker/stages/photon/guide.h"

namespace gleaner::test {
namespace {

using kernels::PhotonTraceParameters;
using worker::GuideRow;
using worker::PathNumbers;

constexpr double kChance = 1e-3;  // of a false alarm of one test

// Every number of a cube of five.
double number(std::uint64_t i, std::size_t d) { return scene::unit_hash(i * 0x9e3779b97f4a7c15ull + 77 * (d + 1)); }

// Of so many even paths, those with u0 in [0.25, 0.5) and d1 below 0.125.
std::vector<PathNumbers> useful_of(std::size_t count) {
  std::vector<PathNumbers> useful;
  for (std::size_t i = 0; i < count; ++i) {
    PathNumbers path{};
    for (std::size_t d = 0; d < GUIDE_NUMBERS; ++d) path[d] = static_cast<std::uint16_t>(65536 * number(i, d));
    if (path[1] >= 16384 && path[1] < 32768 && path[4] < 8192) useful.push_back(path);
  }
  return useful;
}

TEST(PhotonGuide, CellsDivideTheCube) {
  const std::vector<GuideRow> guide = worker::make_guide(useful_of(65536));
  double shares = 0, volumes = 0, thinnest = 1, densest = 0;
  std::size_t cells = 0;
  for (const GuideRow& row : guide) {
    if (row.child) continue;
    ++cells;
    shares += row.share;
    volumes += row.box.volume();
    thinnest = std::min(thinnest, row.density());
    densest = std::max(densest, row.density());
  }
  EXPECT_NEAR(shares, 1, 1e-9);
  EXPECT_NEAR(volumes, 1, 1e-9);
  EXPECT_GE(thinnest, worker::kGuideEven * (1 - 1e-9));
  double of_use = 0;
  for (std::uint64_t i = 0; i < 10'000; ++i) {
    double density = 0;
    unsigned holding = 0;
    std::array<double, GUIDE_NUMBERS> at{};
    for (std::size_t d = 0; d < GUIDE_NUMBERS; ++d) at[d] = number(1'000'000 + i, d);
    for (const GuideRow& row : guide) {
      bool inside = row.child == 0;
      for (std::size_t d = 0; d < GUIDE_NUMBERS; ++d)
        inside = inside && at[d] >= row.box.lower[d] && at[d] < row.box.lower[d] + row.box.extent[d];
      if (!inside) continue;
      ++holding;
      density = row.density();
    }
    ASSERT_EQ(holding, 1u);
    if (at[1] >= 0.25 && at[1] < 0.5 && at[4] < 0.125) of_use += density / 10'000;
  }
  std::printf("  %zu cells, density %.3f to %.1f; %.1f %% of the paths are of use, 3.1 %% without\n", cells, thinnest,
              densest, 100 * of_use);
  EXPECT_GT(of_use, 0.7);
}

TEST(PhotonGuide, EvenUseNeedsOneCell) {
  EXPECT_EQ(worker::make_guide({}).size(), 1u);
  std::vector<PathNumbers> even;
  for (std::uint64_t i = 0; i < 65536; ++i) {
    PathNumbers path{};
    for (std::size_t d = 0; d < GUIDE_NUMBERS; ++d) path[d] = static_cast<std::uint16_t>(65536 * number(i, d));
    even.push_back(path);
  }
  const std::vector<GuideRow> guide = worker::make_guide(std::move(even));
  ASSERT_EQ(guide.size(), 1u);
  EXPECT_EQ(guide[0].share, 1);
}

// --- Photons ---

worker::StageTask trace_task(const std::shared_ptr<const Scene>& scene, const PhotonTraceParameters& p,
                             const scene::Bytes& guide) {
  worker::StageTask task = task_of({}, load(executor(worker::TraceKind::automatic), scene));
  task.kind = "photon_trace";
  task.parameters.resize(sizeof p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  if (!guide.empty()) task.inputs["emission"] = std::make_shared<const scene::Bytes>(guide);
  return task;
}

// A closed room under the sun, on a square of ground four times as wide, with a hole in its roof.
Scene skylight() {
  scene::SceneBuilder b("skylight");
  const std::uint32_t grey = b.material("grey", scene::lambert(scene::grey(0.5)));
  b.mesh("ground");
  b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, grey);
  b.mesh("room");
  const auto slab = [&](double x0, double x1, double y0, double y1, double z0, double z1) {
    b.box({(x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2}, {(x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2}, 0, grey);
  };
  for (const double side : {-0.55, 0.55}) {
    slab(side - 0.05, side + 0.05, 0, 1, -0.6, 0.6);
    slab(-0.5, 0.5, 0, 1, side - 0.05, side + 0.05);
  }
  slab(-0.6, 0, 1, 1.1, -0.6, 0.6);
  slab(0, 0.6, 1, 1.1, -0.6, 0);
  b.directional_light({0.05, -1, -0.05}, scene::grey(10));
  b.camera("camera", {0.4, 0.6, 0.4}, {-0.4, 0.3, -0.4}, 70, 64, 64);
  return b.finish();
}

Frame frame_of(const char* guide, std::uint32_t spp) {
  return square_frame("photon", skylight(), {}, 24, spp,
                      {{"photon.count", "80000"}, {"photon.clusters", "0"}, {"photon.guide", guide}});
}

// The skylight's guide, as a frame makes it.
const scene::Bytes& made_guide() {
  static const scene::Bytes guide = render(frame_of("65536", 1)).results.at("photon.guide.global").records;
  return guide;
}

// Power of the photons in the room, W, and how many there are.
struct InRoom {
  double power = 0, photons = 0;
};
InRoom in_room(const std::shared_ptr<const Scene>& scene, const scene::Bytes& guide, std::uint32_t seed) {
  PhotonTraceParameters p{};
  p.items_low = 40'000;
  p.most_depth = GLEANER_NONE;
  p.classes = PHOTON_ALL_CLASSES;
  p.seed_low = seed;
  const auto result = executor(worker::TraceKind::automatic).run(trace_task(scene, p, guide), 0, p.items_low);
  InRoom found;
  for (std::size_t at = 0; at < result.records.size(); at += std::size_t{PHOTON_WORDS} * 4) {
    float words[PHOTON_WORDS];
    std::memcpy(words, &result.records[at], sizeof words);
    if (std::abs(words[0]) > 0.501f || words[1] > 1.001f || std::abs(words[2]) > 0.501f) continue;
    found.power += double{words[PHOTON_POWER + 1]};
    found.photons += 1;
  }
  return found;
}

TEST(PhotonGuide, PhotonsCarryTheSamePower) {
  const auto scene = std::make_shared<const Scene>(skylight());
  Sample even, guided, more;
  for (std::uint32_t seed = 1; seed <= 12; ++seed) {
    const InRoom a = in_room(scene, {}, seed), b = in_room(scene, made_guide(), seed);
    even.add(a.power);
    guided.add(b.power);
    more.add(b.photons / a.photons);
  }
  std::printf("  %.1f times the photons in the room; power deviates by %.2f %%, %.2f %% without a guide\n", more.mean,
              100 * guided.standard_error() / guided.mean, 100 * even.standard_error() / even.mean);
  EXPECT_GT(more.mean, 5);
  EXPECT_LT(guided.standard_error(), even.standard_error());
  expect_mean(guided, even.mean, "power in the room, W", kChance, 0.01, 3 * even.standard_error());
}

// All of the emitted power is stored, absorbed or gone, as without a guide: densities integrate to 1.
TEST(PhotonGuide, PowerIsBalanced) {
  const auto scene = std::make_shared<const Scene>(scene::make_scene("cornell-glass", {}));
  const scene::Bytes guide = worker::guide_bytes(worker::make_guide(useful_of(65536)));
  const auto emitted = [&](const scene::Bytes& by, std::uint32_t seed) {
    PhotonTraceParameters p{};
    p.items_low = 20'000;
    p.seed_low = seed;
    p.most_depth = GLEANER_NONE;
    p.balance = 1;
    const auto result = executor(worker::TraceKind::automatic).run(trace_task(scene, p, by), 0, p.items_low);
    double power = 0;
    for (std::size_t at = 0; at < result.records.size(); at += std::size_t{PHOTON_WORDS} * 4) {
      float words[PHOTON_WORDS];
      std::memcpy(words, &result.records[at], sizeof words);
      power += double{words[PHOTON_POWER + 1]};
    }
    return power;
  };
  Sample guided;
  for (std::uint32_t seed = 1; seed <= 8; ++seed) guided.add(emitted(guide, seed));
  expect_mean(guided, emitted({}, 1), "power of all paths, W", kChance, 0.01);
}

// At equal photons, in means of 4 x 4 pixels: what photons are off by is wider than a pixel, the noise of paths is not.
TEST(PhotonGuide, PicturesAreNearer) {
  Frame truth = frame_of("0", 4096);
  truth.settings.method = "path";
  const Film reference = render(truth).film;
  const double mean = mean_of(reference, "indirect.G");
  const auto off = [&](const char* guide) {
    Sample squared, means;
    for (unsigned seed = 1; seed <= 3; ++seed) {
      Frame frame = frame_of(guide, 512);
      frame.settings.seed = seed;
      const Film film = render(frame).film;
      squared.add(std::pow(block_error(film, reference, {"indirect.G"}, 4), 2));
      means.add(mean_of(film, "indirect.G") / mean);
    }
    std::printf("  pilot of %5s paths: error %.2f %%, mean %.4f +- %.4f of path's\n", guide,
                100 * std::sqrt(squared.mean), means.mean, means.standard_error());
    return std::pair(std::sqrt(squared.mean), means.mean);
  };
  const auto [even, even_mean] = off("0");
  const auto [guided, guided_mean] = off("65536");
  EXPECT_LT(guided, 0.6 * even);
  EXPECT_LT(std::abs(guided_mean - 1), std::max(0.01, std::abs(even_mean - 1)));
}

TEST(PhotonGuide, RefusesWhatIsNoGuide) {
  const auto scene = std::make_shared<const Scene>(scene::make_scene("cornell-box", {}));
  PhotonTraceParameters p{};
  p.items_low = 16;
  p.classes = PHOTON_ALL_CLASSES;
  const scene::Bytes sound = worker::guide_bytes(worker::make_guide(useful_of(65536)));
  worker::Executor& on = executor(worker::TraceKind::automatic);
  on.run(trace_task(scene, p, sound), 0, 16);
  const std::size_t last = sound.size() / 4 - GUIDE_WORDS;  // a cell's row
  const auto real = [](float value) { return std::bit_cast<std::uint32_t>(value); };
  for (const auto& [word, value] :
       std::vector<std::pair<std::size_t, std::uint32_t>>{{GUIDE_AXIS, GUIDE_NUMBERS},
                                                          {GUIDE_CHILD, 0},
                                                          {GUIDE_CHILD, 3},
                                                          {GUIDE_CHILD, 1u << 31},
                                                          {GUIDE_SHARE, real(1)},
                                                          {GUIDE_SHARE, real(NAN)},
                                                          {last + GUIDE_AXIS, 0},
                                                          {last + GUIDE_DENSITY, real(0)},
                                                          {last + GUIDE_LOWER, real(1)},
                                                          {last + GUIDE_EXTENT, real(NAN)}}) {
    scene::Bytes broken = sound;
    std::memcpy(&broken[word * 4], &value, 4);
    EXPECT_THROW(on.run(trace_task(scene, p, broken), 0, 16), Error) << "word " << word;
  }
}

}  // namespace
}  // namespace gleaner::test
