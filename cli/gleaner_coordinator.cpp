// `gleaner-coordinator`: jobs in, leases out, files on disk.

#include <malloc.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <future>
#include <iostream>
#include <optional>

#include "cli/client.h"
#include "cli/data_lock.h"
#include "cli/listeners.h"
#include "cli/machine_memory.h"
#include "cli/program.h"
#include "cli/signals.h"
#include "coordinator/blobs/store.h"
#include "coordinator/gateway/http.h"
#include "coordinator/gateway/listener.h"
#include "coordinator/gateway/server.h"
#include "coordinator/jobs/farm.h"
#include "coordinator/jobs/frame_name.h"
#include "coordinator/journal/journal_writer.h"
#ifdef GLEANER_POSTGRES
#include "coordinator/journal/postgres_journal.h"
#endif
#include "coordinator/journal/sqlite_journal.h"
#include "gleaner/version.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace fs = std::filesystem;
using namespace gleaner::coordinator;

namespace {

constexpr double gib = 1024.0 * 1024 * 1024;
constexpr Seconds disk_patience = 3600;  // somebody may be asleep
constexpr Seconds grace = 5;             // for a plan that computes when the coordinator is to end

struct CoordinatorOptions {
  std::string listen = "127.0.0.1:8780";
  std::string http;  // empty: none
  std::vector<std::string> http_hosts;
  bool insecure = false;
  std::string check;  // HOST:PORT; empty: be a coordinator
  std::string data;
  std::string journal;  // address of a PostgreSQL database; empty: a file in `data`
  unsigned active_jobs = 2;
  unsigned frames_at_once = coordinator::FarmSettings{}.frames_at_once;
  double upload_gib = 64;
  double memory_gib = 0;  // 0: three quarters of the machine's
  std::uint64_t batch_items = 0;
  std::size_t keep_jobs = FarmSettings{}.ended_jobs;
  double keep_days = 30;
  double recheck = 0.02;
  std::size_t jobs_an_owner = 1000;
  gateway::CallerLimits caller = gateway::ServerSettings{}.caller;
};

constexpr const char* against_strangers =
    "give --keys (gleaner keys init makes them), listen on 127.0.0.1, or say --insecure on a network that you trust";

// For health checks: cheaper to start than `gleaner`. The farm itself must answer, not its sockets alone.
int check(const std::string& address) {
  Client(address).workers();
  return 0;
}

std::unique_ptr<Journal> open_journal(const CoordinatorOptions& options, const fs::path& data) {
  if (options.journal.empty()) return open_sqlite_journal(data / "journal.sqlite");
#ifdef GLEANER_POSTGRES
  return open_postgres_journal(options.journal);
#else
  throw Error::usage("--journal: this program was built without PostgreSQL (libpq-dev)");
#endif
}

// Results come and go in megabytes, on many threads. glibc would soon keep what each of them frees for itself: half a
// gigabyte beside a large frame.
void give_back_large_memory() { ::mallopt(M_MMAP_THRESHOLD, 512 << 10); }

int coordinate(const CoordinatorOptions& options) {
  if (options.data.empty()) throw Error::usage("--data is required: a folder of blobs and pictures");
  const std::shared_ptr<const Keys> keys = own_keys();
  if (keys) require_certificate(*keys, "a coordinator");
  if (!options.insecure) {
    if (!keys) refuse_strangers("--listen", options.listen, against_strangers);
    if (!options.http.empty()) refuse_strangers("--http", options.http, against_strangers);
  }
  Signals signals;
  auto log = std::make_shared<spdlog::logger>("gleaner-coordinator", std::make_shared<spdlog::sinks::stderr_sink_mt>());
  log->set_pattern("%Y-%m-%dT%H:%M:%S.%e %v");

  const fs::path data = fs::absolute(options.data);
  const DataLock lock(data);
  BlobStore blobs(data / "blobs");
  FarmSettings settings;
  settings.scheduler.fixed_batch_items = options.batch_items;
  // A worker's first batch of a scene includes fetching and loading it.
  settings.scheduler.lease_floor = 30;
  settings.log = [log](const std::string& line) { log->info(printable(line)); };
  settings.journal = std::make_shared<JournalWriter>(open_journal(options, data), settings.log);
  settings.scheduler.incarnation = settings.journal->begin();
  settings.records = data / "records";
  settings.recheck_share = options.recheck;
  settings.disk_patience = disk_patience;
  settings.jobs_an_owner = options.jobs_an_owner;
  settings.active_jobs = options.active_jobs;
  settings.frames_at_once = options.frames_at_once;
  settings.ended_jobs = options.keep_jobs;
  settings.ended_seconds = options.keep_days * 24 * 3600;
  settings.memory_bytes =
      options.memory_gib > 0 ? static_cast<std::uint64_t>(options.memory_gib * gib) : machine_memory() / 4 * 3;
  settings.paths = [data](const std::string& job, std::uint32_t frame) {
    const fs::path base = data / "jobs" / job / frame_stem(frame);
    return FramePaths{base.string() + ".exr", base.string() + ".png", base.string() + ".json"};
  };
  Farm farm(settings, blobs);
  gateway::ServerSettings server_settings;
  server_settings.listen = options.listen;
  server_settings.keys = keys;
  server_settings.caller = options.caller;
  server_settings.upload_bytes = static_cast<std::uint64_t>(options.upload_gib * gib);
  gateway::Server server(farm, blobs, server_settings);
  std::optional<gateway::HttpServer> http;
  if (!options.http.empty()) http.emplace(farm, options.http, options.http_hosts);
  // Alone on standard output, so that scripts that ask for port 0 learn what they got.
  std::cout << server.address() << std::endl;
  log->info("listening on " + server.address() + (http ? ", HTTP on " + http->address() : "") + ", data in " +
            data.string());

  std::promise<void> asked_to_end;
  signals.watch([&] { asked_to_end.set_value(); });
  asked_to_end.get_future().wait();
  log->info("ending");
  server.shutdown();
  if (!farm.end(grace)) {
    log->info("a plan still computes; it is not waited for");
    if (!settings.journal->flush()) log->info(settings.journal->trouble());
    log->flush();
    std::_Exit(0);  // its thread uses what main's end would destroy
  }
  return 0;
}

}  // namespace

}  // namespace gleaner::cli

int main(int argc, char** argv) {
  using namespace gleaner::cli;
  give_back_large_memory();
  gleaner::gateway::raise_descriptor_limit();
  silence_grpc();
  CLI::App app{"Takes jobs, splits their frames among workers, writes the pictures", "gleaner-coordinator"};
  app.set_version_flag("--version", std::string("gleaner-coordinator ") + gleaner::version);
  CoordinatorOptions options;
  app.add_option("--listen", options.listen, "HOST:PORT; port 0 takes a free one. Prints HOST:PORT on standard output")
      ->capture_default_str();
  app.add_option("--http", options.http,
                 "HOST:PORT of a page that shows the farm, /healthz and /metrics (default: none)");
  app.add_option("--http-host", options.http_hosts,
                 "NAME by which --http may be asked for, beside localhost and addresses; may be given again (default: "
                 "on loopback none, else any)")
      ->take_all()
      ->allow_extra_args(false);
  add_keys_option(app);
  app.add_flag("--insecure", options.insecure,
               "other machines may reach the listeners, without encryption or authentication");
  app.add_option("--data", options.data, "folder of blobs and pictures; made where it is not there; required");
  app.add_option("--journal", options.journal,
                 "postgresql://USER@HOST/DATABASE that holds the journal (default: journal.sqlite in --data)")
      ->envname("GLEANER_JOURNAL");
  app.add_option("--check", options.check,
                 "HOST:PORT: do nothing but ask the coordinator there for a sign of life; 4 where it gives none");
  app.add_option("--active-jobs", options.active_jobs, "jobs that run at the same time")
      ->capture_default_str()
      ->check(CLI::Range(1u, 64u));
  app.add_option("--frames-at-once", options.frames_at_once,
                 "frames of a job that run side by side, where workers idle that fewer cannot feed")
      ->capture_default_str()
      ->check(CLI::Range(1u, 1024u));
  app.add_option("--upload-limit", options.upload_gib, "largest blob, in GiB")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--memory", options.memory_gib,
                 "memory of the frames that run at the same time, in GiB; larger frames are refused, others wait "
                 "(default: three quarters of the machine's)")
      ->check(CLI::PositiveNumber);
  app.add_option("--keep-jobs", options.keep_jobs, "jobs that ended and are still listed; pictures are always kept")
      ->capture_default_str();
  app.add_option("--keep-days", options.keep_days, "... and for how many days")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  app.add_option("--recheck", options.recheck,
                 "share of the batches that a second worker computes too, so that liars are found; 0: none")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 1.0));
  app.add_option("--jobs-a-person", options.jobs_an_owner,
                 "jobs of one person (by certificate; in the clear: of one host) that run or wait; 0: any number")
      ->capture_default_str();
  app.add_option("--requests-a-person", options.caller.requests_a_second,
                 "requests of one person a second, on average; 0: any number")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  app.add_option("--calls-a-person", options.caller.calls,
                 "uploads, and watches and downloads, of one person at the same time; 0: any number")
      ->capture_default_str();
  app.add_option("--batch-items", options.batch_items, "every batch of this size")->group("");
  return run_program(app, argc, argv,
                     [&] { return options.check.empty() ? coordinate(options) : check(options.check); });
}
