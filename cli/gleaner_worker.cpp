// `gleaner-worker`: one device at a farm's disposal.

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>

#include "cli/kernel_compiler.h"
#include "cli/program.h"
#include "cli/signals.h"
#include "gleaner/version.h"
#include "scene/model/error.h"
#include "scene/model/names.h"
#include "worker/agent/agent.h"

namespace gleaner::cli {

namespace {

struct WorkerOptions {
  std::string coordinator, trace = "auto", name, peers = "auto";
  int device = -1, threads = 0;
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

int work(const WorkerOptions& options) {
  if (options.coordinator.empty())
    throw Error::usage("which coordinator? --coordinator HOST:PORT, or $GLEANER_COORDINATOR");
  Signals signals;
  auto log = std::make_shared<spdlog::logger>("gleaner-worker", std::make_shared<spdlog::sinks::stderr_sink_mt>());
  log->set_pattern("%Y-%m-%dT%H:%M:%S.%e %v");

  worker::DeviceChoice choice;
  choice.device = options.device;
  choice.threads = options.threads;
  choice.compiler = kernel_compiler();
  choice.trace = worker::parse_trace_kind(options.trace);
  auto runner = worker::open_device(choice);
  log->info("device " + printable(runner->info().name) + ", traces with " + runner->info().tracer);
  worker::AgentSettings settings;
  settings.name = options.name.empty() ? default_name() : options.name;
  settings.cache_bytes = static_cast<std::uint64_t>(options.cache_gib * 1024 * 1024 * 1024);
  settings.retained_bytes = static_cast<std::uint64_t>(options.retained_gib * 1024 * 1024 * 1024);
  settings.peers = options.peers == "auto"  ? worker::usual_peers(options.coordinator)
                   : options.peers == "off" ? std::string()
                                            : options.peers;
  settings.give_up_seconds = options.give_up_seconds;
  settings.log = [log](const std::string& line) { log->info(printable(line)); };
  settings.keys = keys_of({});
  worker::Agent agent(worker::dial(options.coordinator, settings.keys.get()), std::move(runner), settings);
  signals.watch([&] {
    log->info("leaving when the batch that runs is done");
    agent.stop();
  });
  agent.run();
  signals.watch({});
  return 0;
}

}  // namespace

}  // namespace gleaner::cli

int main(int argc, char** argv) {
  using namespace gleaner::cli;
  if (served_as_kernel_compiler(argc, argv)) return 0;
  silence_grpc();
  CLI::App app{"Runs a farm's batches on one OpenCL device", "gleaner-worker"};
  app.set_version_flag("--version", std::string("gleaner-worker ") + gleaner::version);
  WorkerOptions options;
  app.add_option("--coordinator", options.coordinator, "HOST:PORT (default: $GLEANER_COORDINATOR)")
      ->envname("GLEANER_COORDINATOR");
  add_keys_option(app);
  app.add_option("--device", options.device,
                 "OpenCL device, as `gleaner devices` counts (default: the first GPU, else the first)");
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
