// What the coordinator can bear. Workers are simulated: each is a connection of its own that answers every lease at
// once.
//
//   bench_coordinator rate [WORKERS [SECONDS]]
//     Batches a second through gRPC, and how long a result holds the farm's lock (200 workers, 10 seconds).
//   bench_coordinator memory HOST:PORT PROCESS [WIDTH HEIGHT SPP [QUEUED]]
//     The memory of a coordinator that runs there, by a frame of the path tracer with others waiting behind it (3840
//     2160 64, 50). bench/coordinator_memory starts one.
//   bench_coordinator jobs HOST:PORT PROCESS [JOBS [CANCELLED]]
//     Its memory after small jobs one after the other, and after jobs that were cancelled while they waited (300
//     2000). bench/coordinator_memory jobs starts one.

#include <grpcpp/grpcpp.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/gateway/convert.h"
#include "coordinator/gateway/server.h"
#include "gleaner/v1/farm.grpc.pb.h"
#include "gleaner/v1/worker.grpc.pb.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/error.h"

namespace {

using namespace gleaner;
using namespace gleaner::coordinator;
namespace pb = gleaner::v1;

constexpr std::uint32_t record_bytes = 24;    // as of the path tracer
constexpr std::uint64_t items_a_batch = 256;  // small: what costs is the batch, not its bytes

// One stage that never ends within the time of the measurement; what arrives is dropped.
class EndlessPlan final : public Plan {
 public:
  Step next(const FinishedStage* finished) override {
    Step step;
    step.done = finished != nullptr;
    StageSpec stage;
    stage.name = stage.kind = "simulated";
    stage.items = std::uint64_t{1} << 40;
    stage.output = {.record_bytes = record_bytes, .placement = Placement::stream};
    if (!finished) step.stages.push_back(std::move(stage));
    return step;
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return film(); }
  Film film() const override { return Film{1, 1, {}}; }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }
};

// Records that a renderer could have made: finite, noisy, the same for the same items.
void fill(std::string& records, std::uint64_t first, std::uint64_t bytes) {
  records.resize(bytes);
  std::uint64_t state = first * 0x9e3779b97f4a7c15u + 1;
  for (std::size_t at = 0; at + sizeof(float) <= bytes; at += sizeof(float)) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    const float value = static_cast<float>(state >> 40) * 0x1p-24f;
    std::memcpy(&records[at], &value, sizeof value);
  }
}

// A worker that answers each lease at once, as if it had run `items_per_second`, until the stream ends.
void work(const std::string& address, const std::string& name, double items_per_second) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // a connection of its own
  auto stub = pb::WorkerHub::NewStub(grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments));
  grpc::ClientContext context;
  auto stream = stub->Work(&context);
  pb::WorkerMessage message;
  message.mutable_hello()->set_name(name);
  message.mutable_hello()->set_protocol(protocol_version);
  bool open = stream->Write(message);
  pb::HubMessage heard;
  std::string records;
  while (open && stream->Read(&heard)) {
    if (!heard.has_lease()) continue;
    const pb::Lease& lease = heard.lease();
    fill(records, lease.first(), lease.count() * lease.record_bytes());
    pb::Result& piece = *message.mutable_result();
    piece.Clear();
    piece.set_lease(lease.lease());
    piece.set_epoch(lease.epoch());
    for (std::size_t offset = 0; open && offset < records.size(); offset += piece_bytes) {
      piece.set_offset(offset);
      piece.set_records(records.data() + offset, std::min(piece_bytes, records.size() - offset));
      if (offset + piece_bytes >= records.size())
        piece.mutable_cost()->set_seconds(static_cast<double>(lease.count()) / items_per_second);
      open = stream->Write(message);
    }
  }
  stream->Finish();
}

std::vector<std::thread> start_workers(const std::string& address, unsigned workers, double items_per_second) {
  std::vector<std::thread> threads;
  for (unsigned number = 0; number < workers; ++number)
    threads.emplace_back(work, address, std::string("simulated-").append(std::to_string(number)), items_per_second);
  return threads;
}

double seconds_of(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

double processor_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return seconds_of(usage.ru_utime) + seconds_of(usage.ru_stime);
}

// Batches a second of a farm in this process, behind its gateway.
int measure_rate(unsigned workers, double seconds) {
  BlobStore blobs;
  FarmSettings settings;
  settings.plan = [](const FrameSettings&, const SceneSummary&) { return std::make_unique<EndlessPlan>(); };
  settings.scheduler.fixed_batch_items = items_a_batch;
  settings.paths = [](const std::string&, std::uint32_t) { return FramePaths{}; };
  Farm farm(settings, blobs);
  gateway::ServerSettings server_settings;
  server_settings.listen = "127.0.0.1:0";
  gateway::Server server(farm, blobs, server_settings);
  std::vector<std::thread> threads = start_workers(server.address(), workers, 10.0 * items_a_batch);
  while (farm.workers().size() < workers) std::this_thread::sleep_for(std::chrono::milliseconds(20));

  JobRequest request;
  request.scene_name = "simulated";
  request.scenes = {{blobs.put(Bytes(8)), {}, {}, {}}};
  request.settings.width = request.settings.height = 1;
  farm.submit(request);
  std::this_thread::sleep_for(std::chrono::seconds(1));
  const FarmTotals before = farm.totals();
  const double processor_before = processor_seconds();
  const auto begun = std::chrono::steady_clock::now();
  std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
  const FarmTotals after = farm.totals();
  const double elapsed = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
  const double processor = processor_seconds() - processor_before;

  const auto batches = static_cast<double>(after.batches_accepted - before.batches_accepted);
  std::printf("workers connected         %u\n", workers);
  std::printf("batches a second          %.0f\n", batches / elapsed);
  std::printf("lock held a result        %.2f us\n",
              1e6 * (after.result_lock_seconds - before.result_lock_seconds) / batches);
  std::printf("processor time a batch    %.1f us (simulated workers included)\n", 1e6 * processor / batches);
  std::printf("processors used           %.2f of %ld\n", processor / elapsed, ::sysconf(_SC_NPROCESSORS_ONLN));
  std::fflush(stdout);
  farm.end(5);
  server.shutdown();
  for (std::thread& thread : threads) thread.join();
  return 0;
}

// MiB of the process, by its line in /proc: "VmRSS" now, "VmHWM" at most so far.
double memory_of(const std::string& process, const std::string& line) {
  std::ifstream file("/proc/" + process + "/status");
  for (std::string word; file >> word;)
    if (double kibibytes = 0; word == line + ":" && file >> kibibytes) return kibibytes / 1024;
  throw Error::failed("process " + process + ": no " + line);
}

FrameSettings frame_settings(std::uint32_t width, std::uint32_t height, std::uint32_t spp) {
  FrameSettings settings;
  settings.width = width;
  settings.height = height;
  settings.spp = spp;
  settings.camera.right[0] = settings.camera.up[1] = 1;
  settings.camera.forward[2] = -1;
  settings.camera.half_width = settings.camera.half_height = 0.5f;
  return settings;
}

void check(const grpc::Status& status) {
  if (!status.ok()) throw Error::failed(status.error_message());
}

// Frames of the Cornell box on a coordinator that runs elsewhere.
class Customer {
 public:
  Customer(const std::string& address, const FrameSettings& settings)
      : stub_(pb::Farm::NewStub(grpc::CreateChannel(address, grpc::InsecureChannelCredentials()))) {
    const scene::Scene scene = scene::make_scene("cornell-box", {});
    request_.set_scene_name("cornell-box");
    request_.set_scene_blob(upload(scene::serialize(scene)));
    request_.set_bvh_blob(upload(scene::serialize(scene::build_bvh(scene))));
    *request_.mutable_settings() = gateway::to_proto(settings);
  }

  std::string submit() {
    grpc::ClientContext context;
    pb::SubmitJobReply reply;
    check(stub_->SubmitJob(&context, request_, &reply));
    return reply.job();
  }
  void cancel(const std::string& job) {
    grpc::ClientContext context;
    pb::CancelJobRequest request;
    request.set_job(job);
    pb::Job reply;
    check(stub_->CancelJob(&context, request, &reply));
  }
  // As it stood when it ended.
  pb::Job end_of(const std::string& job) {
    pb::Job status;
    do {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      grpc::ClientContext context;
      pb::GetJobRequest get;
      get.set_job(job);
      check(stub_->GetJob(&context, get, &status));
    } while (status.state() == pb::JOB_STATE_RUNNING || status.state() == pb::JOB_STATE_QUEUED);
    return status;
  }

 private:
  std::string upload(const Bytes& bytes) {
    grpc::ClientContext context;
    pb::UploadBlobReply reply;
    auto writer = stub_->UploadBlob(&context, &reply);
    pb::UploadBlobRequest part;
    part.mutable_header()->set_id(sha256_hex(bytes));
    part.mutable_header()->set_bytes(bytes.size());
    writer->Write(part);
    part.set_data(bytes.data(), bytes.size());
    writer->Write(part);
    writer->WritesDone();
    check(writer->Finish());
    return sha256_hex(bytes);
  }

  std::unique_ptr<pb::Farm::Stub> stub_;
  pb::SubmitJobRequest request_;
};

// A frame of the path tracer, with others queued behind it: what memory it takes.
int measure_memory(const std::string& address, const std::string& process, const FrameSettings& settings,
                   unsigned queued) {
  Customer customer(address, settings);
  std::printf("before any job            %.1f MiB\n", memory_of(process, "VmRSS"));
  const std::string job = customer.submit();
  std::this_thread::sleep_for(std::chrono::seconds(3));  // its plan is made
  const double alone = memory_of(process, "VmRSS");
  for (unsigned i = 0; i < queued; ++i) customer.submit();
  if (queued > 0) std::printf("a job that waits          %.3f MiB\n", (memory_of(process, "VmRSS") - alone) / queued);

  std::vector<std::thread> threads = start_workers(address, 4, 2e6);
  const pb::Job status = customer.end_of(job);
  std::printf("%ux%u, %u spp: %s, %.1f s\n", settings.width, settings.height, settings.spp,
              status.state() == pb::JOB_STATE_DONE ? "done" : status.message().c_str(), status.seconds());
  std::printf("peak                      %.1f MiB\n", memory_of(process, "VmHWM"));
  std::fflush(stdout);
  ::_exit(status.state() == pb::JOB_STATE_DONE ? 0 : 1);  // the workers' streams end with the process
}

// Small jobs one after the other, then jobs that are cancelled while they wait: what memory they leave behind.
int measure_jobs(const std::string& address, const std::string& process, unsigned jobs, unsigned cancelled) {
  FrameSettings settings = frame_settings(32, 24, 4);
  Customer customer(address, settings);
  std::vector<std::thread> threads = start_workers(address, 1, 2e6);
  for (unsigned i = 1; i <= jobs; ++i) {
    if (const pb::Job job = customer.end_of(customer.submit()); job.state() != pb::JOB_STATE_DONE)
      throw Error::failed(job.message());
    if (i == 1 || i == jobs / 3 || i == 2 * jobs / 3 || i == jobs)
      std::printf("after %4u small jobs      %.1f MiB\n", i, memory_of(process, "VmRSS"));
  }
  settings.spp = 65536;
  Customer large(address, settings);
  large.submit();
  large.submit();  // what comes behind these two waits
  std::this_thread::sleep_for(std::chrono::seconds(3));
  std::vector<std::string> waiting;
  const double before = memory_of(process, "VmRSS");
  for (unsigned i = 0; i < cancelled; ++i) {
    if (waiting.size() == 500) {
      for (const std::string& job : waiting) large.cancel(job);
      waiting.clear();
    }
    waiting.push_back(large.submit());
  }
  for (const std::string& job : waiting) large.cancel(job);
  std::printf("after %4u cancelled       %+.1f MiB\n", cancelled, memory_of(process, "VmRSS") - before);
  std::fflush(stdout);
  ::_exit(0);
}

}  // namespace

int main(int argc, char** argv) try {
  const std::vector<std::string> words(argv + 1, argv + argc);
  const auto number = [&](std::size_t at, unsigned usual) {
    return at < words.size() ? static_cast<unsigned>(std::stoul(words[at])) : usual;
  };
  if (!words.empty() && words[0] == "rate") return measure_rate(number(1, 200), number(2, 10));
  if (words.size() >= 3 && words[0] == "memory")
    return measure_memory(words[1], words[2], frame_settings(number(3, 3840), number(4, 2160), number(5, 64)),
                          number(6, 50));
  if (words.size() >= 3 && words[0] == "jobs") return measure_jobs(words[1], words[2], number(3, 300), number(4, 2000));
  std::fprintf(stderr,
               "usage: bench_coordinator rate [WORKERS [SECONDS]]\n"
               "       bench_coordinator memory HOST:PORT PROCESS [WIDTH HEIGHT SPP [QUEUED]]\n"
               "       bench_coordinator jobs HOST:PORT PROCESS [JOBS [CANCELLED]]\n");
  return 2;
} catch (const std::exception& error) {
  std::fprintf(stderr, "bench_coordinator: error: %s\n", error.what());
  return 1;
}
