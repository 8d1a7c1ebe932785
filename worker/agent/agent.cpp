#include "worker/agent/agent.h"

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <thread>
#include <utility>

#include "gleaner/kernels_build.h"
#include "gleaner/v1/worker.grpc.pb.h"
#include "proto/packing.h"
#include "proto/protocol.h"
#include "proto/sha256.h"
#include "scene/model/error.h"
#include "scene/model/names.h"
#include "worker/agent/blob_client.h"
#include "worker/agent/input_loader.h"
#include "worker/agent/part_client.h"
#include "worker/agent/part_server.h"
#include "worker/device/clock.h"

namespace gleaner::worker {

namespace pb = gleaner::v1;

namespace {

constexpr std::size_t most_facts_bytes = std::size_t{64} << 10;
constexpr std::size_t most_unsent = 2;  // results: a device faster than the network waits
constexpr std::chrono::milliseconds unavailable_pause{200};
constexpr double first_backoff_seconds = 1, longest_backoff_seconds = 30;

using Clock = std::chrono::steady_clock;

pb::Device describe(const DeviceInfo& info) {
  pb::Device device;
  device.set_name(info.name);
  device.set_platform(info.platform);
  device.set_driver(info.driver);
  device.set_version(info.version);
  device.set_tracer(info.tracer);
  device.set_cpu(info.cpu);
  device.set_compute_units(info.compute_units);
  device.set_threads(info.threads);
  device.set_memory_bytes(info.memory_bytes);
  device.set_denoiser(info.denoiser);
  return device;
}

// A batch that was computed, or why it was not.
struct Outgoing {
  std::optional<pb::Failed> failed;
  pb::Lease lease;
  BatchResult result;                      // without its records where they are retained
  std::shared_ptr<const StoredPart> part;  // retained: what is kept
  std::uint64_t records = 0;               // how many
  std::uint64_t fetched_bytes = 0, peer_bytes = 0;
  std::optional<MotionReport> shown;  // where a base was shown in another state for it
};

using Stream = grpc::ClientReaderWriter<pb::WorkerMessage, pb::HubMessage>;

// What the stage program made must have the shape that the lease asks for. Returns the number of records.
std::uint64_t check_result(const pb::Lease& lease, const BatchResult& result) {
  std::uint64_t records = lease.count();
  if (lease.counted()) {
    if (result.counts.size() != lease.count())
      throw Error::failed("the stage program counted the records of " + std::to_string(result.counts.size()) +
                          " items instead of " + std::to_string(lease.count()));
    records = 0;
    for (const std::uint32_t count : result.counts) {
      if (count > lease.most_records())
        throw Error::failed("the stage program made " + std::to_string(count) +
                            " records of an item instead of at most " + std::to_string(lease.most_records()));
      records += count;
    }
  }
  if (result.records.size() != records * lease.record_bytes())
    throw Error::failed("the stage program made " + std::to_string(result.records.size()) + " bytes instead of " +
                        std::to_string(records * lease.record_bytes()));
  if (result.facts.size() > most_facts_bytes)
    throw Error::failed("the stage program told " + std::to_string(result.facts.size()) + " bytes instead of at most " +
                        std::to_string(most_facts_bytes));
  return records;
}

pb::ShownFrame to_proto(const MotionReport& report) {
  pb::ShownFrame shown;
  shown.set_load_seconds(report.load_seconds);
  shown.set_pose_seconds(report.pose_seconds);
  shown.set_table_seconds(report.table_seconds);
  shown.set_written_bytes(report.written_bytes);
  shown.set_top_level_seconds(report.top_level_seconds);
  for (const MotionReport::Mesh& mesh : report.meshes) {
    if (mesh.rebuilt) {
      shown.set_rebuilt(shown.rebuilt() + 1);
      shown.set_rebuild_seconds(shown.rebuild_seconds() + mesh.seconds);
    } else {
      shown.set_refitted(shown.refitted() + 1);
      shown.set_refit_seconds(shown.refit_seconds() + mesh.seconds);
    }
    // Of a tree without extent it may be anything.
    if (mesh.growth < 1e6) shown.set_most_growth(std::max(shown.most_growth(), mesh.growth));
  }
  return shown;
}

pb::BatchCost cost_of(const Outgoing& out) {
  const BatchCounters& counters = out.result.counters;
  pb::BatchCost cost;
  cost.set_seconds(counters.seconds);
  cost.set_trace_seconds(counters.trace_seconds);
  cost.set_kernel_seconds(counters.kernel_seconds);
  cost.set_camera_rays(counters.camera_rays);
  cost.set_scatter_rays(counters.scatter_rays);
  cost.set_shadow_rays(counters.shadow_rays);
  cost.set_nonfinite(counters.nonfinite);
  for (std::uint64_t item : counters.nonfinite_items) cost.add_nonfinite_items(item);
  cost.set_fetched_bytes(out.fetched_bytes);
  cost.set_peer_bytes(out.peer_bytes);
  if (out.shown) *cost.mutable_shown() = to_proto(*out.shown);
  return cost;
}

}  // namespace

std::string usual_peers(const std::string& coordinator) {
  const std::string host = coordinator.substr(0, coordinator.rfind(':'));
  if (host == "localhost" || host.rfind("127.", 0) == 0) return "127.0.0.1:0";
  if (host == "[::1]") return "[::1]:0";
  return {};
}

std::shared_ptr<grpc::Channel> dial(const std::string& address, const Keys* keys) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 15000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10000);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  // The agent has a backoff of its own; gRPC's must not be longer.
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, static_cast<int>(longest_backoff_seconds * 1000));
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, static_cast<int>(first_backoff_seconds * 1000));
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 1000);
  arguments.SetMaxReceiveMessageSize(static_cast<int>(4 * piece_bytes));
  const auto credentials = channel_credentials(keys, Role::coordinate, arguments);
  return grpc::CreateCustomChannel(address, credentials, arguments);
}

struct Agent::Impl {
  Impl(std::shared_ptr<grpc::Channel> the_channel, std::unique_ptr<Runner> the_runner, AgentSettings the_settings)
      : channel(std::move(the_channel)),
        runner(std::move(the_runner)),
        settings(std::move(the_settings)),
        stub(pb::WorkerHub::NewStub(channel)),
        parts(settings.parts ? settings.parts : std::make_shared<PartStore>(settings.retained_bytes)),
        owner(parts->new_owner()),
        cache(std::make_shared<ByteCache>(settings.cache_bytes)),
        blobs(channel, settings.pack),
        part_client(channel, parts, cache, settings.keys, [this](const pb::WrongPart& wrong) { report(wrong); }),
        inputs(blobs, part_client, cache),
        responder(channel, parts) {
    if (!settings.log) settings.log = [](const std::string&) {};
    if (!settings.peers.empty()) peers = std::make_unique<PeerServer>(settings.peers, parts, settings.keys);
  }

  void run() {
    std::mt19937_64 random{std::random_device{}()};
    double backoff = first_backoff_seconds;
    Clock::time_point lost = Clock::now();
    bool said = false;
    for (;;) {
      grpc::Status status = serve();
      std::unique_lock lock(mutex);
      if (stopping || drained) return;
      if (welcomed) {
        backoff = first_backoff_seconds;
        lost = Clock::now();
        said = false;
      }
      std::string reason = status.error_message().empty() ? "the stream ended" : status.error_message();
      if (status.error_code() == grpc::StatusCode::FAILED_PRECONDITION ||
          status.error_code() == grpc::StatusCode::UNIMPLEMENTED ||
          status.error_code() == grpc::StatusCode::INVALID_ARGUMENT)
        throw Error::failed("the coordinator refuses this worker: " + reason);
      if (!settings.reconnect) throw Error::connection("no connection to the coordinator: " + reason);
      if (settings.give_up_seconds > 0 && seconds_since(lost) > settings.give_up_seconds)
        throw Error::connection("no connection to the coordinator for " +
                                std::to_string(static_cast<int>(seconds_since(lost))) + " s: " + reason);
      if (!std::exchange(said, true)) settings.log("no connection to the coordinator (" + reason + "); trying again");
      // Jitter: a farm's workers must not all come back in the same instant.
      double wait = backoff * std::uniform_real_distribution<double>(0.5, 1.5)(random);
      backoff = std::min(backoff * 2, longest_backoff_seconds);
      changed.wait_for(lock, std::chrono::duration<double>(wait), [&] { return stopping; });
      if (stopping) return;
    }
  }

  // One connection, from Hello to its end.
  grpc::Status serve() {
    grpc::ClientContext context;
    {
      std::lock_guard lock(mutex);
      if (stopping) return grpc::Status::CANCELLED;
      welcomed = false;
      connection_ended = false;
      work_ended = false;
      leases.clear();
      outgoing.clear();
      notes.clear();
      revoked.clear();
      connection = &context;
    }
    // The coordinator has given up what the last connection's worker held.
    parts->clear(owner);
    auto stream = stub->Work(&context);
    pb::WorkerMessage hello;
    hello.mutable_hello()->set_protocol(protocol_version);
    hello.mutable_hello()->set_name(printable(settings.name));
    *hello.mutable_hello()->mutable_device() = describe(runner->info());
    hello.mutable_hello()->set_needs_bvh(runner->needs_bvh());
    hello.mutable_hello()->set_kernels_build(kernels_build());
    if (peers) hello.mutable_hello()->set_peer_address(peers->address());
    pb::HubMessage message;
    if (stream->Write(hello) && stream->Read(&message) && message.has_welcome()) {
      {
        std::lock_guard lock(mutex);
        welcomed = true;
        heartbeat_seconds = std::clamp(message.welcome().heartbeat_seconds(), 0.1, 60.0);
      }
      part_client.connected(message.welcome().token());
      responder.connected(message.welcome().token());
      if (peers) peers->connected(message.welcome().token());
      settings.log("connected as " + message.welcome().worker() +
                   (peers ? "; other workers reach it at " + peers->address() : ""));
      std::thread executor([&] { execute(); });
      std::thread sender([&] { send(*stream); });
      while (stream->Read(&message)) obey(message);
      {
        std::lock_guard lock(mutex);
        connection_ended = true;
        if (given_up) *given_up = true;
      }
      changed.notify_all();
      executor.join();
      sender.join();
    }
    {
      std::lock_guard lock(mutex);
      connection = nullptr;
    }
    return stream->Finish();
  }

  void obey(pb::HubMessage& message) {
    {
      std::lock_guard lock(mutex);
      switch (message.message_case()) {
        case pb::HubMessage::kLease:
          if (!stopping) leases.push_back(std::move(*message.mutable_lease()));
          break;
        case pb::HubMessage::kRevoke: {
          std::uint64_t epoch = message.revoke().epoch();
          if (std::erase_if(leases, [&](const pb::Lease& lease) { return lease.epoch() == epoch; }) == 0)
            revoked.insert(epoch);
          if (given_up && epoch == running_epoch) *given_up = true;
          break;
        }
        case pb::HubMessage::kDrain:
          drained = true;
          break;
        case pb::HubMessage::kRelease:
          release(message.release());
          break;
        case pb::HubMessage::kSendPart:
          responder.answer(message.send_part());
          break;
        default:
          break;  // a newer coordinator may say more than this worker knows
      }
    }
    changed.notify_all();
  }

  void release(const pb::Release& what) {
    for (const std::string& artifact : what.artifacts())
      if (what.digest().empty())
        parts->drop(owner, artifact);
      else
        parts->drop(owner, artifact, what.first(), what.digest());
  }

  void report(const pb::WrongPart& wrong) {
    settings.log("artifact " + wrong.artifact() + ": worker " + wrong.holder() + " has no bytes of its digest");
    {
      std::lock_guard lock(mutex);
      *notes.emplace_back().mutable_wrong_part() = wrong;
    }
    changed.notify_all();
  }

  // A result that nobody wants.
  void drop(const Outgoing& out) {
    if (out.part) parts->drop(owner, out.lease.artifact(), out.lease.first(), out.part->digest());
  }

  // The executor's thread: one lease after another.
  void execute() {
    std::unique_lock lock(mutex);
    for (;;) {
      changed.wait(lock, [&] {
        return connection_ended || stopping || drained || (!leases.empty() && outgoing.size() < most_unsent);
      });
      if (connection_ended || stopping || leases.empty()) {
        if (!connection_ended && !stopping && !drained) continue;
        work_ended = true;
        lock.unlock();
        changed.notify_all();
        return;
      }
      if (outgoing.size() >= most_unsent) {
        changed.wait(lock, [&] { return connection_ended || outgoing.size() < most_unsent; });
        continue;
      }
      pb::Lease lease = std::move(leases.front());
      leases.pop_front();
      running_epoch = lease.epoch();
      given_up = std::make_shared<std::atomic<bool>>(false);
      lock.unlock();
      Outgoing done = run_lease(std::move(lease));
      lock.lock();
      // Whoever held the input may just have been lost: the coordinator is about to notice.
      if (done.failed && done.failed->input_unavailable())
        changed.wait_for(lock, unavailable_pause, [&] { return connection_ended || stopping; });
      if (revoked.erase(done.lease.epoch()) == 0)
        outgoing.push_back(std::move(done));
      else
        drop(done);
      changed.notify_all();
    }
  }

  Outgoing run_lease(pb::Lease lease) {
    Outgoing out;
    const std::uint64_t fetched_before = blobs.fetched_bytes(), peer_before = part_client.peer_bytes();
    std::string failure;
    bool unavailable = false;
    try {
      out.result = run_stage(lease, out.shown);
      out.records = check_result(lease, out.result);
      if (lease.retain())
        out.part = parts->put(owner, lease.artifact(), lease.first(), lease.count(), out.result.counts,
                              std::exchange(out.result.records, {}));
    } catch (const Error& error) {
      failure = error.what();
      unavailable = error.kind() == ErrorKind::connection;
    } catch (const std::exception& error) {
      failure = error.what();
    }
    out.fetched_bytes = blobs.fetched_bytes() - fetched_before;
    out.peer_bytes = part_client.peer_bytes() - peer_before;
    if (!failure.empty()) {
      if (!*given_up)
        settings.log("stage " + lease.stage() + ", items " + std::to_string(lease.first()) + " to " +
                     std::to_string(lease.first() + lease.count() - 1) + ": " + failure);
      out.failed.emplace();
      out.failed->set_lease(lease.lease());
      out.failed->set_epoch(lease.epoch());
      out.failed->set_message(printable(failure.substr(0, 4096)));
      out.failed->set_input_unavailable(unavailable);
    }
    out.lease = std::move(lease);
    return out;
  }

  BatchResult run_stage(const pb::Lease& lease, std::optional<MotionReport>& shown) {
    StageTask task;
    task.kind = lease.kind();
    auto parameters = std::as_bytes(std::span(lease.parameters()));
    task.parameters.assign(parameters.begin(), parameters.end());
    task.given_up = given_up;
    task.scene = prepare_scene(lease, shown);
    for (const pb::StageInput& input : lease.inputs()) task.inputs[input.name()] = inputs.load(input, lease);
    Clock::time_point begin = Clock::now();
    BatchResult result = runner->run(task, lease.first(), lease.count());
    // The device's own clock leaves out what comes once, such as the kernels' compilation.
    if (!(result.counters.seconds > 0)) result.counters.seconds = seconds_since(begin);
    return result;
  }

  // Returns the name under which the runner holds what the lease shows. `shown`: what that took, where it is a base in
  // a state that the runner did not hold.
  std::string prepare_scene(const pb::Lease& lease, std::optional<MotionReport>& shown) {
    const std::string& id = lease.scene_blob();
    if (lease.state_blob().empty() && !lease.at_rest()) {
      if (!runner->holds_scene(id)) {
        auto [scene, bvh] = fetch_scene(lease);
        runner->load_scene(id, std::move(scene), std::move(bvh));
      }
      return id;
    }
    // At rest it is the scene itself.
    const std::string name = lease.at_rest() ? id : id + "+" + lease.state_blob();
    if (runner->holds_scene(name)) return name;
    if (!runner->holds_base(id)) {
      auto [scene, bvh] = fetch_scene(lease);
      runner->load_base(id, std::move(scene), std::move(bvh));
    }
    std::optional<scene::FrameState> state;
    if (!lease.at_rest())
      state = scene::parse_frame_state(*inputs.blob(lease.state_blob()), "state blob " + lease.state_blob());
    shown = runner->load_frame(name, id, state);
    return name;
  }

  std::pair<std::shared_ptr<const scene::Scene>, std::shared_ptr<const scene::Bvh>> fetch_scene(
      const pb::Lease& lease) {
    const std::string& id = lease.scene_blob();
    auto scene = std::make_shared<const scene::Scene>(scene::parse_scene(*inputs.blob(id), "scene blob " + id));
    std::shared_ptr<const scene::Bvh> bvh;
    if (runner->needs_bvh()) {
      if (lease.bvh_blob().empty()) throw Error::failed("this worker traces in OpenCL, and the job came without a BVH");
      bvh = std::make_shared<const scene::Bvh>(
          scene::parse_bvh(*inputs.blob(lease.bvh_blob()), scene->triangle_count(), "BVH blob " + lease.bvh_blob()));
    }
    return {std::move(scene), std::move(bvh)};
  }

  // The sender's thread: results as they come, a heartbeat where there are none.
  void send(Stream& stream) {
    bool said_leaving = false;
    std::unique_lock lock(mutex);
    for (;;) {
      bool something = changed.wait_for(lock, std::chrono::duration<double>(heartbeat_seconds), [&] {
        return connection_ended || !outgoing.empty() || !notes.empty() || work_ended || (stopping && !said_leaving);
      });
      if (connection_ended) return;
      pb::WorkerMessage message;
      if (!something) {
        message.mutable_heartbeat();
      } else if (!notes.empty()) {
        message = std::move(notes.front());
        notes.pop_front();
      } else if (stopping && !said_leaving) {
        said_leaving = true;
        message.mutable_leaving();
      } else if (!outgoing.empty()) {
        Outgoing out = std::move(outgoing.front());
        outgoing.pop_front();
        bool wanted = revoked.erase(out.lease.epoch()) == 0;
        if (!wanted) drop(out);
        lock.unlock();
        changed.notify_all();
        if (wanted && !send_outgoing(stream, out)) return;
        lock.lock();
        continue;
      } else {  // all work is done and sent
        lock.unlock();
        stream.WritesDone();
        return;
      }
      lock.unlock();
      if (!stream.Write(message)) return;
      lock.lock();
    }
  }

  bool send_outgoing(Stream& stream, const Outgoing& out) const {
    if (!out.failed) return send_result(stream, out);
    pb::WorkerMessage message;
    *message.mutable_failed() = *out.failed;
    return stream.Write(message);
  }

  void set_records(pb::Result& piece, std::span<const std::byte> bytes, std::uint32_t stride) const {
    std::string packed = settings.pack ? pack(bytes, stride) : std::string();
    piece.set_packed(packed.empty() ? 0 : stride);
    if (packed.empty())
      piece.set_records(bytes.data(), bytes.size());
    else
      piece.set_records(std::move(packed));
  }

  bool send_result(Stream& stream, const Outgoing& out) const {
    pb::WorkerMessage message;
    pb::Result& piece = *message.mutable_result();
    piece.set_lease(out.lease.lease());
    piece.set_epoch(out.lease.epoch());
    if (out.part) {
      piece.mutable_part()->set_bytes(out.part->bytes());
      piece.mutable_part()->set_records(out.records);
      piece.mutable_part()->set_digest(out.part->digest());
      piece.mutable_part()->set_artifact(out.lease.artifact());
      piece.mutable_part()->set_first(out.lease.first());
      piece.mutable_part()->set_items(out.lease.count());
    }
    // The image: counts (of a fixed stride there are none), then records. A retained one has gone into its part.
    const std::span<const std::byte> counts = std::as_bytes(std::span(out.result.counts));
    const std::span<const std::byte> records = out.result.records;
    const std::size_t total = out.part ? 0 : counts.size() + records.size();
    for (std::size_t offset = 0;;) {
      const bool in_counts = offset < counts.size();
      const auto rest =
          in_counts ? counts.subspan(offset) : records.subspan(std::min(records.size(), offset - counts.size()));
      const auto now = rest.first(std::min({piece_bytes, rest.size(), total - offset}));
      piece.set_offset(offset);
      set_records(piece, now, in_counts ? sizeof(std::uint32_t) : out.lease.record_bytes());
      offset += now.size();
      const bool last = offset == total;
      if (last) {
        *piece.mutable_cost() = cost_of(out);
        piece.set_facts(out.result.facts.data(), out.result.facts.size());
      }
      if (!stream.Write(message)) return false;
      if (last) return true;
    }
  }

  void stop() {
    {
      std::lock_guard lock(mutex);
      stopping = true;
      leases.clear();  // not begun: they go to others when the stream ends
      // Before the welcome there is nothing to finish.
      if (connection && !welcomed) connection->TryCancel();
    }
    changed.notify_all();
  }

  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<Runner> runner;
  AgentSettings settings;
  std::unique_ptr<pb::WorkerHub::Stub> stub;
  std::shared_ptr<PartStore> parts;
  const PartStore::Owner owner;
  std::shared_ptr<ByteCache> cache;
  BlobClient blobs;
  PartClient part_client;
  InputLoader inputs;                 // the executor's thread
  std::unique_ptr<PeerServer> peers;  // null: nobody reaches this worker
  PartResponder responder;

  std::mutex mutex;  // guards what follows
  std::condition_variable changed;
  bool stopping = false, drained = false;
  // Of the lease that runs. Only the executor's thread replaces the pointer.
  std::uint64_t running_epoch = 0;
  std::shared_ptr<std::atomic<bool>> given_up;
  bool welcomed = false, connection_ended = false, work_ended = false;
  double heartbeat_seconds = 5;
  grpc::ClientContext* connection = nullptr;
  std::deque<pb::Lease> leases;  // not begun
  std::deque<Outgoing> outgoing;
  std::deque<pb::WorkerMessage> notes;  // short ones, which go before results
  std::set<std::uint64_t> revoked;      // epochs of what was already begun
};

Agent::Agent(std::shared_ptr<grpc::Channel> channel, std::unique_ptr<Runner> runner, AgentSettings settings)
    : impl_(std::make_unique<Impl>(std::move(channel), std::move(runner), std::move(settings))) {}

Agent::~Agent() = default;

void Agent::run() { impl_->run(); }

void Agent::stop() { impl_->stop(); }

}  // namespace gleaner::worker
