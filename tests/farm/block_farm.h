#pragma once
// A frame of blocks (block_frame.h) on workers that are processes, with a coordinator in this one. What each process
// needs of memory is measured.

#include <sys/resource.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coordinator/gateway/server.h"
#include "tests/farm/block_frame.h"
#include "tests/farm/processes.h"
#include "tests/farm/small_scene.h"

namespace gleaner::test {

struct BlockFarmSettings {
  std::filesystem::path worker;  // the program block_worker
  std::uint64_t bytes = 0;       // of the artifact; whole blocks
  unsigned workers = 4;
  std::uint64_t retained_bytes = 64 << 20, cache_bytes = 64 << 20;  // of each worker
  bool peers = true;                                                // else all goes through the coordinator
  bool kill = true;       // one worker, by SIGKILL, once a quarter of "shuffled" is done
  double patience = 600;  // seconds after which the job is cancelled
};

struct BlockFarmOutcome {
  std::string state, message;  // of the job
  BlockDigests digests;
  bool killed = false;                                    // while the frame still ran
  double seconds = 0;                                     // of the frame
  std::map<std::string, std::uint64_t> stage_items;       // by stage; what was computed again beside
  std::uint64_t uploaded = 0, downloaded = 0, peers = 0;  // bytes, as the report has them
  std::map<std::string, std::uint64_t> peak_bytes;        // resident, by process
};

// The highest resident size of a process so far; 0: it is gone.
inline std::uint64_t peak_resident_bytes(pid_t process) {
  std::ifstream status("/proc/" + std::to_string(process) + "/status");
  for (std::string word; status >> word;)
    if (word == "VmHWM:") {
      std::uint64_t kilobytes = 0;
      status >> kilobytes;
      return kilobytes << 10;
    }
  return 0;
}

inline coordinator::FarmSettings block_farm_settings(const std::filesystem::path& folder) {
  coordinator::FarmSettings settings;
  settings.plan = make_block_plan;
  settings.check = check_fake_settings;
  settings.scheduler.fixed_batch_items = (4 << 20) / block_bytes;
  settings.paths = [folder](const std::string& job, std::uint32_t) {
    return coordinator::FramePaths{(folder / (job + ".exr")).string(), {}, (folder / (job + ".json")).string()};
  };
  return settings;
}

// Throws where the farm cannot be set up; what becomes of the job is in the outcome.
inline BlockFarmOutcome run_block_farm(const BlockFarmSettings& settings) {
  const TemporaryFolder folder;
  coordinator::BlobStore blobs(folder.path() / "blobs");
  coordinator::Farm farm(block_farm_settings(folder.path()), blobs);
  gateway::ServerSettings server_settings;
  server_settings.listen = "127.0.0.1:0";
  gateway::Server server(farm, blobs, server_settings);

  std::vector<std::pair<std::string, std::unique_ptr<Process>>> workers;
  for (unsigned i = 0; i < settings.workers; ++i) {
    const std::string name = std::string("worker-").append(std::to_string(i + 1));
    std::vector<std::string> words = {settings.worker.string(), server.address(), name,
                                      std::to_string(settings.retained_bytes), std::to_string(settings.cache_bytes)};
    if (settings.peers) words.push_back("127.0.0.1:0");
    workers.emplace_back(name, std::make_unique<Process>(words, folder.path() / name));
  }
  if (!eventually([&] { return farm.workers().size() == settings.workers; }, 60))
    throw Error::failed("the workers do not connect: " + workers[0].second->err());

  coordinator::JobRequest request;
  request.scene_name = "triangle.glb";
  request.scenes = {{blobs.put(scene::serialize(small_scene())), {}, {}, {}}};
  request.settings = fake_settings(static_cast<std::uint32_t>(settings.bytes / block_bytes), 1);
  const std::string job = farm.submit(request);

  BlockFarmOutcome outcome;
  const auto measure = [&] {
    for (const auto& [name, process] : workers)
      outcome.peak_bytes[name] = std::max(outcome.peak_bytes[name], peak_resident_bytes(process->id()));
  };
  bool kill = settings.kill;
  for (coordinator::JobStatus status; !coordinator::ended((status = *farm.status(job)).state);) {
    measure();
    if (status.seconds > settings.patience) farm.cancel(job);
    for (const auto& stage : status.stages)
      if (kill && stage.name == "shuffled" && stage.items_done >= stage.items / 4) {
        workers[0].second->signal(SIGKILL);
        workers[0].second->wait();
        kill = false;
        outcome.killed = !coordinator::ended(farm.status(job)->state);
      }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  const coordinator::JobStatus status = *farm.status(job);
  outcome.state = coordinator::job_state_name(status.state);
  outcome.message = status.message;
  outcome.seconds = status.seconds;
  rusage own{};
  ::getrusage(RUSAGE_SELF, &own);
  outcome.peak_bytes["coordinator"] = static_cast<std::uint64_t>(own.ru_maxrss) << 10;
  if (status.state != coordinator::JobState::done) return outcome;
  const auto report = nlohmann::json::parse(read_text(folder.path() / (job + ".json")));
  outcome.digests = {report["parameters"]["artifact"], report["parameters"]["shuffled"]};
  for (const auto& stage : report["stages"]) outcome.stage_items[stage["name"]] += stage["items"].get<std::uint64_t>();
  outcome.uploaded = report["bytes"]["uploaded"];
  outcome.downloaded = report["bytes"]["downloaded"];
  outcome.peers = report["bytes"]["peers"];
  return outcome;
}

}  // namespace gleaner::test
