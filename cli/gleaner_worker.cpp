// `gleaner-worker`: one device at a farm's disposal.

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <exception>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "cli/kernel_compiler.h"
#include "cli/program.h"
#include "cli/signals.h"
#include "gleaner/version.h"
#include "scene/model/error.h"
#include "scene/model/names.h"
#include "worker/agent/agent.h"
#include "worker/device/device.h"

namespace gleaner::cli {

namespace {

struct WorkerOptions {
  std::string coordinator, trace = "auto", name, peers = "auto";
  int device = -1, threads = 0;
  bool all_devices = false;
  double cache_gib = 2, retained_gib = 1, give_up_seconds = 0;
};

// HOSTNAME-PID, in the letters that names may have.
std::string default_name() {
  char host[256] = "worker";
  ::gethostname(host, sizeof host - 1);
  std::string name(host);
  std::replace_if(
      name.begin(), name.end(), [](unsigned char c) { return !std::isalnum(c) && c != '.' && c != '_' && c != '-'; },
      '-');
  return name.substr(0, 48) + "-" + std::to_string(::getpid());
}

using Log = std::shared_ptr<spdlog::logger>;

worker::AgentSettings settings_of(const WorkerOptions& options, const Log& log) {
  worker::AgentSettings settings;
  settings.name = options.name.empty() ? default_name() : options.name;
  settings.cache_bytes = static_cast<std::uint64_t>(options.cache_gib * 1024 * 1024 * 1024);
  settings.retained_bytes = static_cast<std::uint64_t>(options.retained_gib * 1024 * 1024 * 1024);
  settings.peers = options.peers == "auto"  ? worker::usual_peers(options.coordinator)
                   : options.peers == "off" ? std::string()
                                            : options.peers;
  settings.give_up_seconds = options.give_up_seconds;
  settings.log = [log](const std::string& line) { log->info(printable(line)); };
  settings.keys = own_keys();
  if (settings.keys) require_certificate(*settings.keys, "a worker");
  return settings;
}

std::unique_ptr<worker::Runner> open_runner(const WorkerOptions& options, int device, const Log& log) {
  worker::DeviceChoice choice;
  choice.device = device;
  choice.threads = options.threads;
  choice.compiler = kernel_compiler();
  choice.trace = worker::parse_trace_kind(options.trace);
  auto runner = worker::open_device(choice);
  log->info("device " + printable(runner->info().name) + ", traces with " + runner->info().tracer);
  return runner;
}

// Those of all devices that can be opened, or of the one that was chosen.
std::vector<std::unique_ptr<worker::Runner>> open_runners(const WorkerOptions& options, const Log& log) {
  std::vector<std::unique_ptr<worker::Runner>> runners;
  if (!options.all_devices) {
    runners.push_back(open_runner(options, options.device, log));
    return runners;
  }
  for (const worker::DeviceInfo& device : worker::list_devices()) {
    try {
      runners.push_back(open_runner(options, device.index, log));
    } catch (const Error& error) {
      log->info(printable("device " + device.name + " is left out: " + error.what()));
    }
  }
  if (runners.empty()) throw Error::failed("--all-devices: none of this machine's OpenCL devices can be opened");
  return runners;
}

// Each agent in a thread of its own. Where one ends by an error the others go on; throws the first such error when all
// have ended.
void run_all(const std::vector<std::unique_ptr<worker::Agent>>& agents, const Log& log) {
  std::vector<std::exception_ptr> errors(agents.size());
  {
    std::vector<std::jthread> threads;
    for (std::size_t i = 0; i < agents.size(); ++i)
      threads.emplace_back([&, i] {
        try {
          agents[i]->run();
        } catch (const std::exception& error) {
          errors[i] = std::current_exception();
          if (agents.size() > 1) log->info(printable(std::string("one of the workers ended: ") + error.what()));
        }
      });
  }
  for (const std::exception_ptr& error : errors)
    if (error) std::rethrow_exception(error);
}

int work(const WorkerOptions& options) {
  if (options.coordinator.empty())
    throw Error::usage("which coordinator? --coordinator HOST:PORT, or $GLEANER_COORDINATOR");
  Signals signals;
  auto log = std::make_shared<spdlog::logger>("gleaner-worker", std::make_shared<spdlog::sinks::stderr_sink_mt>());
  log->set_pattern("%Y-%m-%dT%H:%M:%S.%e %v");
  std::vector<std::unique_ptr<worker::Runner>> runners = open_runners(options, log);
  const bool several = runners.size() > 1;
  if (several && options.peers != "auto" && options.peers != "off" && !options.peers.ends_with(":0"))
    throw Error::usage("--peers " + options.peers + ": expected port 0, as several workers listen");
  std::vector<std::unique_ptr<worker::Agent>> agents;
  for (auto& runner : runners) {
    worker::AgentSettings settings = settings_of(options, log);
    if (several) settings.name += "-" + std::to_string(runner->info().index);
    agents.push_back(std::make_unique<worker::Agent>(worker::dial(options.coordinator, settings.keys.get()),
                                                     std::move(runner), settings));
  }
  signals.watch([&] {
    log->info("leaving when the batch that runs is done");
    for (const auto& agent : agents) agent->stop();
  });
  run_all(agents, log);
  signals.watch({});
  return 0;
}

}  // namespace

}  // namespace gleaner::cli

int main(int argc, char** argv) {
  using namespace gleaner::cli;
  if (served_as_kernel_compiler(argc, argv)) return 0;
  silence_grpc();
  gleaner::worker::prepare_environment();
  CLI::App app{"Runs a farm's batches on one OpenCL device", "gleaner-worker"};
  app.set_version_flag("--version", std::string("gleaner-worker ") + gleaner::version);
  WorkerOptions options;
  app.add_option("--coordinator", options.coordinator, "HOST:PORT (default: $GLEANER_COORDINATOR)")
      ->envname("GLEANER_COORDINATOR");
  add_keys_option(app);
  CLI::Option* device =
      app.add_option("--device", options.device,
                     "OpenCL device, as `gleaner devices` counts (default: the first GPU, else the first)");
  app.add_flag("--all-devices", options.all_devices, "a worker for each of this machine's OpenCL devices")
      ->excludes(device);
  app.add_option("--threads", options.threads, "of a CPU device (default: all)")->check(CLI::NonNegativeNumber);
  app.add_option("--trace", options.trace, "auto, embree or opencl")->capture_default_str();
  app.add_option("--name", options.name, "1 to 64 of [A-Za-z0-9._-] (default: the host's and the process's)");
  app.add_option("--cache", options.cache_gib, "memory for what was fetched and may be read again, in GiB")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  app.add_option("--retained", options.retained_gib,
                 "memory for records that this worker keeps, in GiB; more lies in temporary files in $TMPDIR")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  app.add_option("--peers", options.peers,
                 "HOST:PORT on which other workers fetch them, or off: through the coordinator (auto: any port of "
                 "127.0.0.1 where the coordinator is reached there, else off)")
      ->capture_default_str();
  app.add_option("--give-up", options.give_up_seconds,
                 "end with status 4 after so many seconds without a connection (default: never)")
      ->check(CLI::NonNegativeNumber);
  return run_program(app, argc, argv, [&] { return work(options); });
}
