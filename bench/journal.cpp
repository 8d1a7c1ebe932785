// What the journal costs.
//
//   bench_journal frame [METHOD [WIDTH HEIGHT SPP [ROUNDS]]]
//     Frames of the Cornell box on three farms in this process, in turns on the same device (path 256 256 64, 9
//     rounds): one has a journal. The two without show how far a ratio can be trusted.
//   bench_journal fill FOLDER [QUEUED [FRAMES [ENDED]]]
//     Makes a coordinator's --data folder: jobs that wait, of so many frames each with a camera of its own, and jobs
//     that have ended (100 100 1000). bench/journal starts a coordinator on it.

#include <grpcpp/grpcpp.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/blobs/store.h"
#include "coordinator/gateway/server.h"
#include "coordinator/jobs/farm.h"
#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/sqlite_journal.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "worker/agent/agent.h"

namespace {

using namespace gleaner;
using namespace gleaner::coordinator;
namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

struct Spent {
  double wall = 0, processor = 0;  // seconds
};

double processor_seconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

JobRequest request_of(const scene::Scene& scene, BlobStore& blobs) {
  JobRequest request;
  request.scene_name = "cornell-box";
  request.scenes = {
      {blobs.put(scene::serialize(scene)), blobs.put(scene::serialize(scene::build_bvh(scene))), summarize(scene), ""}};
  request.settings.camera = scene.cameras.front().camera;
  request.settings.width = request.settings.height = 256;
  return request;
}

FarmSettings settings_in(const fs::path& folder, bool journal) {
  FarmSettings settings;
  settings.paths = [folder](const std::string& job, std::uint32_t frame) {
    const fs::path base = folder / "jobs" / job / std::to_string(frame);
    return FramePaths{base.string() + ".exr", base.string() + ".png", base.string() + ".json"};
  };
  if (!journal) return settings;
  settings.journal = std::make_shared<JournalWriter>(open_sqlite_journal(folder / "journal.sqlite"), settings.log);
  settings.scheduler.incarnation = settings.journal->begin();
  settings.records = folder / "records";
  return settings;
}

worker::AgentSettings agent_settings() {
  worker::AgentSettings settings;
  settings.name = "worker";
  settings.reconnect = false;
  return settings;
}

// A farm in this process, with one worker.
class LocalFarm {
 public:
  LocalFarm(const fs::path& folder, bool journal)
      : blobs_((fs::create_directories(folder), folder / "blobs")),
        farm_(settings_in(folder, journal), blobs_),
        server_(farm_, blobs_, gateway::ServerSettings{}),
        agent_(server_.in_process_channel(), worker::open_device({}), agent_settings()),
        thread_([this] { agent_.run(); }) {}
  ~LocalFarm() {
    agent_.stop();
    thread_.join();
  }

  Spent render(JobRequest request, const scene::Scene& scene) {
    request.scenes = request_of(scene, blobs_).scenes;
    const double processor = processor_seconds();
    const Clock::time_point begun = Clock::now();
    const std::string job = farm_.submit(request);
    for (std::uint64_t seen = 0;;) {
      const JobStatus status = *farm_.wait(job, seen, 1);
      seen = status.version;
      if (!ended(status.state)) continue;
      if (status.state != JobState::done) throw Error::failed(status.message);
      return {std::chrono::duration<double>(Clock::now() - begun).count(), processor_seconds() - processor};
    }
  }

 private:
  BlobStore blobs_;
  Farm farm_;
  gateway::Server server_;
  worker::Agent agent_;
  std::thread thread_;
};

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

int frame(const std::string& method, unsigned width, unsigned height, unsigned spp, unsigned rounds) {
  constexpr std::size_t kinds = 3;
  const char* names[kinds] = {"without a journal", "with a journal", "without, again"};
  const fs::path folder = fs::temp_directory_path() / ("bench_journal_" + std::to_string(::getpid()));
  const scene::Scene scene = scene::make_scene("cornell-box");
  std::vector<double> wall[kinds], processor[kinds], wall_ratios[kinds], processor_ratios[kinds];
  {
    std::vector<std::unique_ptr<LocalFarm>> farms;
    for (std::size_t kind = 0; kind < kinds; ++kind)
      farms.push_back(std::make_unique<LocalFarm>(folder / std::to_string(kind), kind == 1));
    BlobStore blobs;
    JobRequest request = request_of(scene, blobs);
    request.settings.method = method;
    request.settings.width = width;
    request.settings.height = height;
    request.settings.spp = spp;
    for (const auto& farm : farms) farm->render(request, scene);  // compiles kernels, loads the scene
    for (unsigned round = 1; round <= rounds; ++round) {
      request.settings.seed = round;  // nothing of the last frame serves this one
      Spent spent[kinds];
      for (std::size_t turn = 0; turn < kinds; ++turn) {
        const std::size_t kind = (turn + round) % kinds;
        spent[kind] = farms[kind]->render(request, scene);
      }
      for (std::size_t kind = 0; kind < kinds; ++kind) {
        wall[kind].push_back(spent[kind].wall);
        processor[kind].push_back(spent[kind].processor);
        wall_ratios[kind].push_back(spent[kind].wall / spent[0].wall);
        processor_ratios[kind].push_back(spent[kind].processor / spent[0].processor);
      }
    }
  }
  fs::remove_all(folder);
  std::printf("%s, %ux%u, %u samples, %u rounds: medians, and of the ratios to the first line\n", method.c_str(), width,
              height, spp, rounds);
  for (std::size_t kind = 0; kind < kinds; ++kind)
    std::printf("%-18s %.3f s (%.4f)  %.3f processor s (%.4f)\n", names[kind], median(wall[kind]),
                median(wall_ratios[kind]), median(processor[kind]), median(processor_ratios[kind]));
  return 0;
}

int fill(const fs::path& folder, unsigned queued, unsigned frames, unsigned ended_jobs) {
  fs::create_directories(folder);
  const scene::Scene scene = scene::make_scene("cornell-box");
  BlobStore blobs(folder / "blobs");
  JobRequest request = request_of(scene, blobs);
  FarmSettings settings = settings_in(folder, true);
  Farm farm(settings, blobs);
  for (unsigned i = 0; i < ended_jobs; ++i) farm.cancel(farm.submit(request));
  request.last_frame = frames;
  for (unsigned i = 0; i < frames; ++i) {
    request.cameras.push_back(request.settings.camera);
    request.cameras.back().origin[0] += 1e-3f * static_cast<float>(i);
  }
  for (unsigned i = 0; i < queued; ++i) farm.submit(request);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  const auto number = [&](std::size_t at, unsigned usual) {
    return at < words.size() ? static_cast<unsigned>(std::stoul(words[at])) : usual;
  };
  try {
    if (!words.empty() && words[0] == "frame")
      return frame(words.size() > 1 ? words[1] : "path", number(2, 256), number(3, 256), number(4, 64), number(5, 9));
    if (words.size() > 1 && words[0] == "fill") return fill(words[1], number(2, 100), number(3, 100), number(4, 1000));
    std::fprintf(stderr, "usage: bench_journal frame|fill ... (see bench/journal.cpp)\n");
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_journal: %s\n", error.what());
    return 1;
  }
}
