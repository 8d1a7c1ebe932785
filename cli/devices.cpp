// `gleaner devices`: the OpenCL devices of this machine, and what each would trace with.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstring>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/commands.h"
#include "cli/local_frame.h"
#include "kernels/path_records.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "worker/stages/executor.h"

namespace gleaner::cli {
namespace {

using nlohmann::ordered_json;

struct DevicesWords {
  bool json = false, compile = false;
};

// Renders a few pixels of the scenes that a newcomer meets first, so that their kernels lie compiled in the cache.
double compile_kernels(const worker::DeviceInfo& device) {
  const auto start = std::chrono::steady_clock::now();
  worker::Executor executor({.device = device.index, .threads = 1});
  for (const char* name : {"cornell-box", "cornell-glossy"}) {
    auto scene = std::make_shared<scene::Scene>(scene::make_scene(name));
    std::shared_ptr<const scene::Bvh> bvh;
    if (executor.needs_bvh()) bvh = std::make_shared<scene::Bvh>(scene::build_bvh(*scene));
    executor.load_scene(name, scene, bvh);
    kernels::PathParameters parameters{};
    parameters.camera = scene->cameras.front().camera;
    parameters.width = parameters.height = 4;
    parameters.samples_per_item = parameters.last_item_samples = 16;
    parameters.items_low = 16;
    worker::StageTask task;
    task.kind = "path";
    task.scene = name;
    task.parameters.resize(sizeof parameters);
    std::memcpy(task.parameters.data(), &parameters, sizeof parameters);
    executor.run(task, 0, 16);
  }
  coordinator::FrameSettings settings;
  settings.method = "vpl";
  settings.width = settings.height = 16;
  settings.spp = 2;
  const scene::Scene box = scene::make_scene("cornell-box");
  settings.camera = box.cameras.front().camera;
  auto plan = coordinator::make_plan(settings, coordinator::summarize(box));
  run_frame(*plan, executor, "cornell-box");
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

int devices(const DevicesWords& words) {
  const std::vector<worker::DeviceInfo> all = worker::list_devices();
  if (all.empty())
    throw Error::failed("no OpenCL device found: install a driver (on Debian: pocl-opencl-icd for the CPU)");
  ordered_json list = ordered_json::array();
  for (const worker::DeviceInfo& device : all) {
    ordered_json entry = {{"index", device.index},
                          {"name", device.name},
                          {"platform", device.platform},
                          {"driver", device.driver},
                          {"version", device.version},
                          {"cpu", device.cpu},
                          {"compute_units", device.compute_units},
                          {"threads", device.threads},
                          {"memory_bytes", device.memory_bytes},
                          {"trace", worker::trace_kind_name(device.trace)},
                          {"tracer", device.tracer}};
    if (!words.json)
      fmt::print("{}  {}\n   {}, driver {}\n   {}, {:.1f} GiB, traces with {}\n", device.index, device.name,
                 device.platform, device.driver,
                 device.cpu ? fmt::format("{} threads", device.threads)
                            : fmt::format("{} compute units", device.compute_units),
                 double(device.memory_bytes) / (1u << 30), device.tracer);
    if (words.compile) {
      const double seconds = compile_kernels(device);
      entry["compile_seconds"] = seconds;
      if (!words.json) fmt::print("   kernels compiled or found in {:.1f} s\n", seconds);
    }
    list.push_back(std::move(entry));
  }
  if (words.json) std::cout << list.dump(2, ' ', false, ordered_json::error_handler_t::replace) << '\n';
  return 0;
}

}  // namespace

void add_devices(CLI::App& app, Run& run) {
  auto* command = app.add_subcommand("devices", "OpenCL devices of this machine, and what each traces with");
  auto words = std::make_shared<DevicesWords>();
  command->add_flag("--compile", words->compile, "compile the usual kernels for each, so that a first frame need not");
  command->add_flag("--json", words->json, "one JSON array on standard output");
  command->callback([words, &run] { run = [words] { return devices(*words); }; });
}

}  // namespace gleaner::cli
