#include "cli/embedded.h"

#include <algorithm>
#include <exception>
#include <iostream>

#include "cli/machine_memory.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace {

coordinator::FarmSettings farm_settings(const EmbeddedSettings& settings) {
  coordinator::FarmSettings farm;
  farm.scheduler.fixed_batch_items = settings.batch_items;
  // The first batch compiles kernels, and a process does not lose its own workers: leases may last.
  farm.scheduler.lease_floor = 3600;
  farm.silence = 3600;
  farm.paths = settings.paths;
  farm.memory_bytes = machine_memory() / 4 * 3;
  farm.preview = false;  // nobody can look
  return farm;
}

}  // namespace

EmbeddedFarm::EmbeddedFarm(const EmbeddedSettings& settings)
    : farm_(farm_settings(settings), blobs_), server_(farm_, blobs_, gateway::ServerSettings{}) {
  // All parts lie in this process: each worker reads the others' where they are.
  const auto parts = std::make_shared<worker::PartStore>(worker::AgentSettings{}.retained_bytes);
  unsigned threads = std::max(1u, std::thread::hardware_concurrency() / std::max(1u, settings.workers));
  for (unsigned number = 1; number <= settings.workers; ++number) {
    worker::DeviceChoice choice = settings.device;
    // One compiler for all of them: they build the same.
    if (number > 1) choice.compiler.clear();
    if (choice.threads == 0 && settings.workers > 1) choice.threads = static_cast<int>(threads);
    auto runner = worker::open_device(choice);
    needs_bvh_ = needs_bvh_ || runner->needs_bvh();
    worker::AgentSettings agent;
    agent.name = "worker-" + std::to_string(number);
    agent.reconnect = false;
    agent.parts = parts;
    agent.pack = false;
    agents_.push_back(
        std::make_unique<worker::Agent>(server_.in_process_channel(), std::move(runner), std::move(agent)));
  }
  for (auto& agent : agents_)
    threads_.emplace_back([&worker = *agent] {
      try {
        worker.run();
      } catch (const std::exception& error) {
        std::cerr << "gleaner: a worker ended: " << printable_lines(error.what()) << "\n";
      }
    });
}

EmbeddedFarm::~EmbeddedFarm() {
  for (auto& agent : agents_) agent->stop();
  for (auto& thread : threads_) thread.join();
}

}  // namespace gleaner::cli
