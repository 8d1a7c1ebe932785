// Radiance links on a farm of 64 workers, SIMULATED: the real scheduler hands batches out on a virtual clock, to
// workers that each take as long for a batch as one worker of one thread took in this process just now.
//
//   build/bench/bench_links_farm [VERTICES]      default: 40000, of a hall with as many triangles
//
// Measured: seconds an element of link generation and of one bounce, batch by batch. Simulated: messages (2 ms each
// way), what the scheduler knows of its workers, the last batches that some wait for. Left out: bytes on the network,
// and what workers that share a machine take from each other. Efficiency: the time of one worker without any farm, over
// the number of workers times the time that the stage took.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "tests/farm/schedule_simulation.h"

namespace {

using namespace gleaner;

constexpr std::uint64_t kBatches = 32;

struct Measured {
  coordinator::StageSpec stage;
  double seconds = 0;  // of an item
  double spread = 0;   // a batch takes up to this part more or less, and in the middle half of it
};

double median(std::vector<double> values) {
  std::ranges::nth_element(values, values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2));
  return values[values.size() / 2];
}

Measured measure(worker::Executor& on, const coordinator::StageSpec& stage, const worker::StageTask& task) {
  std::vector<double> items, off;  // seconds of one, batch by batch
  const std::uint64_t step = (stage.items / kBatches + stage.tile - 1) / stage.tile * stage.tile;
  for (std::uint64_t first = 0; first < stage.items; first += step) {
    const std::uint64_t count = std::min(step, stage.items - first);
    items.push_back(on.run(task, first, count).counters.seconds / static_cast<double>(count));
  }
  // Medians: other programs of the machine hold up a batch now and then.
  Measured measured{stage, median(items), 0};
  for (const double seconds : items) off.push_back(std::abs(seconds / measured.seconds - 1));
  measured.spread = std::min(1.0, 2 * median(off));
  return measured;
}

// The stages of a frame whose kernels are compiled.
std::map<std::string, Measured> measure_stages(std::uint32_t vertices) {
  worker::Executor on({.device = -1, .threads = 1, .trace = worker::TraceKind::automatic});
  const auto scene = std::make_shared<const scene::Scene>(
      scene::make_scene("hall", {{"triangles", std::to_string(std::max(100u, vertices))}}));
  std::shared_ptr<const scene::Bvh> bvh;
  if (on.needs_bvh()) bvh = std::make_shared<const scene::Bvh>(scene::build_bvh(*scene));
  on.load_scene("hall", scene, bvh);
  coordinator::FrameSettings settings;
  settings.method = "links";
  settings.width = settings.height = 32;
  settings.spp = 1;
  settings.set = {{"links.vertices", std::to_string(vertices)},
                  {"links.directions", "256"},
                  {"links.light_samples", "16"},
                  {"links.bounces", "2"}};
  settings.camera = scene->cameras.at(0).camera;
  settings.camera.half_width = settings.camera.half_height;
  std::map<std::string, Measured> stages;
  for (const bool compiled : {false, true}) {
    auto plan = coordinator::make_plan(settings, coordinator::summarize(*scene));
    cli::run_frame(*plan, on, "hall", [&](const auto& stage, const worker::StageTask& task) {
      if (compiled && (stage.name == "links.make" || stage.name == "links.gather.2"))
        stages[stage.kind] = measure(on, stage, task);
      return true;
    });
  }
  return stages;
}

// So many of the stage one after the other, of so many times its items. The first one finds out how fast workers are.
double makespan(const Measured& measured, unsigned workers, std::uint64_t times, std::size_t stages) {
  farm::ScheduledStage stage;
  stage.kind = measured.stage.kind;
  stage.items = measured.stage.items * times;
  stage.tile = measured.stage.tile;
  farm::Network network;
  network.noise = measured.spread;
  const auto policy = farm::gleaners_policy({});
  farm::Simulation simulation(*policy, std::vector<farm::WorkerScript>(workers, {1 / measured.seconds}), network, 1);
  const farm::Outcome outcome = simulation.run(std::vector<std::vector<farm::ScheduledStage>>(stages, {stage}), 1e6);
  if (!outcome.complete || !outcome.broken.empty()) {
    std::fprintf(stderr, "the simulation broke: %s\n", outcome.broken.c_str());
    std::exit(1);
  }
  return outcome.makespan;
}

void simulate(const std::string& what, const Measured& measured, const std::vector<std::uint64_t>& sizes) {
  std::printf("\n%s: measured %.1f us an element, batches within %.0f %%; efficiency, first time / known workers\n\n",
              what.c_str(), measured.seconds * 1e6, 100 * measured.spread);
  std::printf("| work of one worker |");
  constexpr unsigned counts[] = {1, 2, 4, 16, 64};
  for (const unsigned workers : counts) std::printf(" %u workers |", workers);
  std::printf("\n|---|---|---|---|---|---|\n");
  for (const std::uint64_t times : sizes) {
    const double work = measured.seconds * static_cast<double>(measured.stage.items * times);
    std::printf("| %.2f s |", work);
    for (const unsigned workers : counts) {
      const double first = makespan(measured, workers, times, 1), both = makespan(measured, workers, times, 2);
      std::printf(" %.2f / %.2f |", work / workers / first, work / workers / (both - first));
    }
    std::printf("\n");
  }
}

}  // namespace

int main(int count, char** words) {
  const auto vertices = static_cast<std::uint32_t>(count > 1 ? std::max(1, std::atoi(words[1])) : 40000);
  const std::map<std::string, Measured> stages = measure_stages(vertices);
  const Measured& make = stages.at("links_make");
  std::printf("SIMULATED farms; measured: a hall of %.1fk vertices, 256 directions\n",
              static_cast<double>(make.stage.items) / 2000);
  simulate("link generation", make, {1, 4, 16, 64});
  simulate("a bounce", stages.at("links_gather"), {1, 16, 256});
}
