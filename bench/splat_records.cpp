// How many records a picture of radiance cache splatting takes: by rounds of blocks of pixels, as it is made, and by
// the paper's serial loop on the same points.
//
//   build/bench/bench_splat_records SCENE WIDTHxHEIGHT ACCURACY [SAMPLES [REACH]]
//
// SAMPLES: points of a pixel; 1, as the paper has them, where it is not given. REACH: how far a record reaches at
// least, in pixels (accuracy * the least R_k); as pictures have it where it is not given.

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "cli/local_frame.h"
#include "kernels/splat_records.h"
#include "scene/import/import.h"

namespace {

using namespace gleaner;

void print(const char* what, worker::Executor& executor, worker::StageTask task, std::uint32_t block_tiles,
           double reach) {
  kernels::SplatSelectParameters p;
  std::memcpy(&p, task.parameters.data(), sizeof p);
  p.block_tiles = block_tiles;
  if (reach > 0) p.least_radius = static_cast<float>(reach / p.accuracy);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  const auto start = std::chrono::steady_clock::now();
  const worker::BatchResult result = executor.run(task, 0, 1);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  kernels::SplatSelectFacts facts;
  std::memcpy(&facts, result.facts.data(), sizeof facts);
  std::printf("  %-22s %6llu records of %llu points, %llu probed, %llu rounds, %.2f s\n", what,
              static_cast<unsigned long long>(facts.records), static_cast<unsigned long long>(facts.points),
              static_cast<unsigned long long>(facts.probes), static_cast<unsigned long long>(facts.rounds), seconds);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "usage: bench_splat_records SCENE WIDTHxHEIGHT ACCURACY [SAMPLES [REACH]]\n");
    return 2;
  }
  try {
    coordinator::FrameSettings settings;
    if (std::sscanf(argv[2], "%ux%u", &settings.width, &settings.height) != 2)
      throw Error::usage(std::string("size: expected WIDTHxHEIGHT, found ") + argv[2]);
    settings.method = "splat";
    settings.spp = argc > 4 ? static_cast<std::uint32_t>(std::atoi(argv[4])) : 1;
    const double reach = argc > 5 ? std::atof(argv[5]) : 0;
    settings.set = {{"splat.accuracy", argv[3]}};
    coordinator::check_settings(settings, {});
    auto scene = std::make_shared<const scene::Scene>(scene::import_scene(argv[1]));
    if (scene->cameras.empty()) throw Error::bad_input(argv[1], "cameras", "one", "none");
    settings.camera = scene->cameras.front().camera;
    settings.camera.half_width =
        settings.camera.half_height * static_cast<float>(settings.width) / static_cast<float>(settings.height);
    worker::Executor executor({});
    executor.load_scene("scene", scene, nullptr);
    std::printf("%s %s, accuracy %s, %u points a pixel:\n", argv[1], argv[2], argv[3], settings.spp);
    auto plan = coordinator::make_plan(settings, coordinator::summarize(*scene));
    cli::run_frame(*plan, executor, "scene", [&](const auto& stage, const worker::StageTask& task) {
      if (stage.kind != "splat_select") return true;
      kernels::SplatSelectParameters p;
      std::memcpy(&p, task.parameters.data(), sizeof p);
      print("rounds of blocks:", executor, task, p.block_tiles, reach);
      print("one after the other:", executor, task, 0, reach);
      return false;
    });
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_splat_records: %s\n", error.what());
    return 1;
  }
}
