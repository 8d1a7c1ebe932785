// Radiance links: what they weigh, how fast they are made, and how fast light flows through them. The paper's table 1
// and the columns of its table 2, on scenes of the library, on one worker in this process.
//
//   build/bench/bench_links [THREADS [VERTICES ...]]      default: 1 thread, 1600 7100 11900 76500 122800 vertices

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "kernels/links_records.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"

namespace {

using namespace gleaner;

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

// STREAM's copy: bytes a second read and written by so many threads, the best of five.
double stream_copy(unsigned threads) {
  constexpr std::size_t words = std::size_t{1} << 23;  // of each thread: far beyond its share of the caches
  std::vector<std::vector<double>> from(threads, std::vector<double>(words, 1.0)), to = from;
  double best = 0;
  for (int round = 0; round < 5; ++round) {
    const double start = now();
    std::vector<std::jthread> all;
    for (unsigned t = 0; t < threads; ++t)
      all.emplace_back([&, t] { std::memcpy(to[t].data(), from[t].data(), words * 8); });
    all.clear();
    best = std::max(best, 2.0 * 8 * static_cast<double>(words) * threads / (now() - start));
  }
  return best;
}

struct StageTime {
  double seconds = 0, trace = 0;
  std::uint64_t bytes = 0, items = 0, rays = 0;
};

// A frame's stages, and how long each took in all.
std::map<std::string, StageTime> run(worker::Executor& on, const std::string& id, const scene::Scene& scene,
                                     std::uint32_t vertices, bool compress) {
  coordinator::FrameSettings settings;
  settings.method = "links";
  settings.width = settings.height = 64;
  settings.spp = 1;
  settings.set = {{"links.vertices", std::to_string(vertices)},
                  {"links.directions", "256"},
                  {"links.light_samples", "16"},
                  {"links.bounces", "3"}};
  if (!compress) settings.set["links.compress"] = "0";
  settings.camera = scene.cameras.at(0).camera;
  settings.camera.half_width = settings.camera.half_height;
  auto plan = coordinator::make_plan(settings, coordinator::summarize(scene));
  std::map<std::string, StageTime> times;
  double start = 0;
  cli::run_frame(
      *plan, on, id,
      [&](const auto&, const auto&) {
        start = now();
        return true;
      },
      [&](const auto& stage, const worker::BatchResult& result) {
        times[stage.name] = {now() - start, result.counters.trace_seconds, result.records.size(), stage.items,
                             result.counters.scatter_rays};
      });
  return times;
}

// What grows with the number of vertices.
struct Growth {
  double vertices = 0, raw = 0, links = 0, bytes = 0, seconds = 0;
};

// The exponent of `of` in the vertices' number, by least squares of logarithms.
double exponent(const std::vector<Growth>& all, double Growth::*of) {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  for (const Growth& one : all) {
    const double a = std::log(one.vertices), b = std::log(one.*of);
    n += 1, x += a, y += b, xx += a * a, xy += a * b;
  }
  return (n * xy - x * y) / (n * xx - x * x);
}

Growth measure(unsigned threads, std::uint32_t vertices) {
  worker::Executor on({.device = -1, .threads = static_cast<int>(threads), .trace = worker::TraceKind::automatic});
  const auto scene = std::make_shared<const scene::Scene>(
      scene::make_scene("hall", {{"triangles", std::to_string(std::max(100u, vertices))}}));
  std::shared_ptr<const scene::Bvh> bvh;
  const double build = now();
  if (on.needs_bvh()) bvh = std::make_shared<const scene::Bvh>(scene::build_bvh(*scene));
  on.load_scene("hall", scene, bvh);
  const double loaded = now() - build;
  run(on, "hall", *scene, vertices, true);  // compiles the kernels
  const auto raw = run(on, "hall", *scene, vertices, false), times = run(on, "hall", *scene, vertices, true);
  const double stream = stream_copy(threads);  // now: other programs may take memory's time
  const StageTime &make = times.at("links.make"), &light = times.at("links.light");
  const auto rays = static_cast<double>(make.rays);
  // Compressed links take 6 bytes; so do raw ones.
  const double links = static_cast<double>(make.bytes) / 6,
               raw_links = static_cast<double>(raw.at("links.make").bytes) / 6;
  double gather = 1e30, bounces = 0, scratch = loaded;
  for (const auto& [name, time] : times) {
    if (name.starts_with("links.gather")) gather = std::min(gather, time.seconds), bounces += time.seconds;
    if (name.starts_with("links.")) scratch += time.seconds;
  }
  const double update = light.seconds + bounces + times.at("links.smooth").seconds;
  // What a bounce reads and writes: the links, and each element's rows.
  const double moved =
      static_cast<double>(make.bytes) + static_cast<double>(make.items) * (3 * RADIOSITY_WORDS * 4 + ALBEDO_WORDS * 4);
  std::printf(
      "| %7.1fk | %6.2fM | %6.2fM | %4.1f | %6.1f MB | %5.0fk | %4.2f | %6.1f ms | %6.1f ms | %6.2f s | %5.1f | %4.2f "
      "of %4.1f GB/s |\n",
      static_cast<double>(make.items) / 2000, raw_links / 1e6, links / 1e6, raw_links / links,
      static_cast<double>(make.bytes) / 1e6, rays / make.seconds / 1e3, make.trace / make.seconds, light.seconds * 1e3,
      gather * 1e3, scratch, scratch / update, moved / gather / stream, stream / 1e9);
  std::fflush(stdout);
  return {static_cast<double>(make.items) / 2, raw_links, links, static_cast<double>(make.bytes), make.seconds};
}

}  // namespace

int main(int count, char** words) {
  const unsigned threads = count > 1 ? static_cast<unsigned>(std::max(1, std::atoi(words[1]))) : 1;
  std::vector<std::uint32_t> sizes;
  for (int k = 2; k < count; ++k) sizes.push_back(static_cast<std::uint32_t>(std::max(1, std::atoi(words[k]))));
  if (sizes.empty()) sizes = {1600, 7100, 11900, 76500, 122800};
  std::printf("%u threads; 256 directions, 16 light samples, 3 bounces, 6 bytes a link\n\n", threads);
  std::printf(
      "| vertices | raw | compressed | ratio | memory | rays/s | of the bare trace | light links | a bounce | from "
      "scratch "
      "| over a light move | of a STREAM copy |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  std::vector<Growth> all;
  for (const std::uint32_t vertices : sizes) all.push_back(measure(threads, vertices));
  if (all.size() > 1)
    std::printf("\nas a power of the vertices' number: raw links %.2f, compressed %.2f, bytes %.2f, making them %.2f\n",
                exponent(all, &Growth::raw), exponent(all, &Growth::links), exponent(all, &Growth::bytes),
                exponent(all, &Growth::seconds));
}
