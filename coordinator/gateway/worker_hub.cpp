#include "coordinator/gateway/worker_hub.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>

#include "coordinator/gateway/convert.h"
#include "gleaner/kernels_build.h"
#include "proto/packing.h"
#include "proto/sha256.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;
using grpc::Status;
using grpc::StatusCode;
using Stream = grpc::ServerReaderWriter<pb::HubMessage, pb::WorkerMessage>;

namespace {

constexpr std::chrono::seconds last_words{2};  // for a write that is under way when a session ends

// A worker's words end up on terminals and in other messages. They may have lines, which are made one.
std::string said_by_worker(std::string words) {
  constexpr std::size_t most_bytes = 4096;
  std::replace(words.begin(), words.end(), '\n', ' ');
  return printable(words, most_bytes);
}

Status no_such_reader() { return {StatusCode::PERMISSION_DENIED, "no lease of this worker reads the artifact"}; }

// Pieces that are asked of a holder before the first one has arrived.
constexpr std::size_t pieces_ahead = 4;

// A worker that listens at all of its addresses is reached at the one from which it dials. `dialled_from` is gRPC's
// word for it: ipv4:1.2.3.4:5678 or ipv6:[::1]:5678, percent-encoded.
std::string reachable_address(const std::string& listens, const std::string& dialled_from) {
  const std::size_t port = listens.rfind(':');
  if (port == std::string::npos) return {};
  const std::string host = listens.substr(0, port);
  if (host != "0.0.0.0" && host != "[::]") return listens;
  std::string from = dialled_from;
  for (const auto& [code, letter] : {std::pair("%5B", "["), std::pair("%5D", "]")})
    if (const std::size_t at = from.find(code); at != std::string::npos) from.replace(at, 3, letter);
  const std::size_t begin = from.find(':') + 1, end = from.rfind(':');
  if ((from.rfind("ipv4:", 0) != 0 && from.rfind("ipv6:", 0) != 0) || end <= begin) return {};
  return from.substr(begin, end - begin) + listens.substr(port);
}

// What is said to one worker: queued by the farm, written by a thread of the session's own, so that no worker that
// reads slowly can hold up the farm.
class StreamSession final : public WorkerSession {
 public:
  StreamSession(grpc::ServerContext& context, Stream& stream, double heartbeat_seconds, std::string token)
      : context_(context),
        stream_(stream),
        heartbeat_seconds_(heartbeat_seconds),
        token_(std::move(token)),
        writer_([this] { write(); }) {}

  ~StreamSession() override { stop(); }

  void welcome(const std::string& name) override {
    say([name, seconds = heartbeat_seconds_, token = token_](pb::HubMessage& message) {
      message.mutable_welcome()->set_worker(name);
      message.mutable_welcome()->set_heartbeat_seconds(seconds);
      message.mutable_welcome()->set_token(token);
    });
  }

  void lease(const Lease& lease, std::shared_ptr<const StageWork> work) override {
    say([lease, work = std::move(work)](pb::HubMessage& message) {
      pb::Lease& out = *message.mutable_lease();
      out.set_lease(lease.id);
      out.set_epoch(lease.epoch);
      out.set_first(lease.first);
      out.set_count(lease.count);
      out.set_job(work->job);
      out.set_stage(work->stage);
      out.set_kind(work->kind);
      out.set_parameters(work->parameters.data(), work->parameters.size());
      for (const auto& input : work->inputs) *out.add_inputs() = to_proto(input, lease);
      out.set_record_bytes(work->output.record_bytes);
      out.set_artifact(work->artifact);
      out.set_retain(work->output.placement == Placement::retain);
      out.set_counted(work->output.counted);
      out.set_most_records(work->output.most_records);
      out.set_scene_blob(work->scene_blob);
      out.set_bvh_blob(work->bvh_blob);
      out.set_state_blob(work->state_blob);
      out.set_at_rest(work->at_rest);
    });
  }

  void revoke(const Lease& lease) override {
    say([id = lease.id, epoch = lease.epoch](pb::HubMessage& message) {
      message.mutable_revoke()->set_lease(id);
      message.mutable_revoke()->set_epoch(epoch);
    });
  }

  void drain() override {
    say([](pb::HubMessage& message) { message.mutable_drain(); });
  }

  void release(const std::vector<ArtifactId>& artifacts) override {
    say([artifacts](pb::HubMessage& message) {
      for (const ArtifactId& id : artifacts) message.mutable_release()->add_artifacts(id);
    });
  }

  void drop_part(const ArtifactId& artifact, std::uint64_t first, const std::string& digest) override {
    say([artifact, first, digest](pb::HubMessage& message) {
      message.mutable_release()->add_artifacts(artifact);
      message.mutable_release()->set_first(first);
      message.mutable_release()->set_digest(digest);
    });
  }

  void send_part(std::uint64_t request, const PartRange& range) override {
    say([request, range](pb::HubMessage& message) {
      message.mutable_send_part()->set_request(request);
      pb::FetchPartRequest& wanted = *message.mutable_send_part()->mutable_range();
      wanted.set_artifact(range.artifact);
      wanted.set_first(range.first);
      wanted.set_digest(range.digest);
      wanted.set_sums(range.sums);
      wanted.set_offset(range.offset);
      wanted.set_length(range.length);
    });
  }

  void close(const std::string& reason) override {
    std::lock_guard lock(mutex_);
    if (stopped_) return;
    reason_ = reason;
    context_.TryCancel();
  }

  std::string reason() const {
    std::lock_guard lock(mutex_);
    return reason_;
  }

  // Before the stream ends: the farm may still hold the session, but nothing touches the stream any more. A worker that
  // does not read what was written to it is not waited for.
  void stop() {
    std::unique_lock lock(mutex_);
    stopped_ = true;
    queue_.clear();
    queued_.notify_all();
    if (!writer_ended_.wait_for(lock, last_words, [&] { return ended_; })) context_.TryCancel();
    lock.unlock();
    if (writer_.joinable()) writer_.join();
  }

 private:
  using Fill = std::function<void(pb::HubMessage&)>;

  static pb::StageInput to_proto(const StageWork::Input& input, const Lease& lease) {
    pb::StageInput to;
    to.set_name(input.name);
    to.set_artifact(input.blob);
    to.set_own_items(input.own_items);
    to.set_retained(!input.data);
    to.set_counted(input.counted);
    to.set_record_bytes(input.record_bytes);
    to.set_items(input.items);
    if (input.data) to.set_bytes(input.data->bytes());
    if (input.data && input.data->index && input.own_items)
      to.set_first_record(input.data->index->first_record(lease.first));
    return to;
  }

  void say(Fill fill) {
    {
      std::lock_guard lock(mutex_);
      if (stopped_) return;
      queue_.push_back(std::move(fill));
    }
    queued_.notify_one();
  }

  void write() {
    std::unique_lock lock(mutex_);
    for (bool written = true; written;) {
      queued_.wait(lock, [&] { return stopped_ || !queue_.empty(); });
      if (stopped_) break;
      Fill fill = std::move(queue_.front());
      queue_.pop_front();
      lock.unlock();
      pb::HubMessage message;
      fill(message);
      written = stream_.Write(message);
      lock.lock();
    }
    ended_ = true;
    writer_ended_.notify_all();
  }

  grpc::ServerContext& context_;
  Stream& stream_;
  double heartbeat_seconds_;
  std::string token_;
  mutable std::mutex mutex_;
  std::condition_variable queued_;
  std::condition_variable writer_ended_;
  std::deque<Fill> queue_;
  bool stopped_ = false, ended_ = false;
  std::string reason_;
  std::thread writer_;
};

// Pieces of one result on their way to a whole.
class ResultAssembly {
 public:
  ResultAssembly(Farm& farm, WorkerId worker) : farm_(farm), worker_(worker) {}

  void add(const pb::Result& piece) {
    if (piece.records().size() > piece_bytes) throw Error::bad_input("result", "records", "pieces of at most 1 MiB");
    if (piece.offset() == 0 || piece.lease() != lease_ || piece.epoch() != epoch_) begin(piece);
    if (piece.offset() != received_)
      throw Error::bad_input("result", "offset", std::to_string(received_), std::to_string(piece.offset()));
    Bytes unpacked;
    auto bytes = std::as_bytes(std::span(piece.records()));
    if (piece.packed() > 0) bytes = unpacked = unpack(piece.records(), piece.packed(), piece_bytes);
    received_ += bytes.size();
    sent_ += piece.records().size();
    if (wanted_) {
      if (received_ > expected_)
        throw Error::bad_input("result", "records", std::to_string(expected_) + " bytes", "more");
      records_.insert(records_.end(), bytes.begin(), bytes.end());
    }
    if (!piece.has_cost()) {
      farm_.heard(worker_);  // a result may take a slow line longer than silence is borne
      return;
    }
    BatchCost cost = from_proto(piece.cost());
    BatchOutput output{.image = std::exchange(records_, {}), .sent_bytes = sent_};
    if (piece.has_part()) output.part = from_proto(piece.part());
    const auto facts = std::as_bytes(std::span(piece.facts()));
    output.facts.assign(facts.begin(), facts.end());
    received_ = sent_ = 0;
    lease_ = epoch_ = 0;
    farm_.result(worker_, piece.lease(), piece.epoch(), std::move(output), cost);
  }

 private:
  void begin(const pb::Result& piece) {
    lease_ = piece.lease();
    epoch_ = piece.epoch();
    received_ = sent_ = 0;
    records_.clear();
    // A result that nobody waits for any more takes no memory; the farm is told of its end all the same.
    auto expected = farm_.expected_bytes(worker_, lease_, epoch_);
    wanted_ = expected.has_value();
    expected_ = expected.value_or(0);
    if (wanted_) records_.reserve(expected_);
  }

  Farm& farm_;
  WorkerId worker_;
  LeaseId lease_ = 0;
  Epoch epoch_ = 0;
  bool wanted_ = false;
  std::uint64_t expected_ = 0, received_ = 0;  // bytes, unpacked
  std::uint64_t sent_ = 0;                     // bytes as they travelled
  Bytes records_;
};

}  // namespace

Status WorkerHub::Work(grpc::ServerContext* context, Stream* stream) {
  const Callers::Call open(callers_, *context, Callers::Call::work);
  pb::WorkerMessage message;
  {
    // Who takes no seat yet holds a thread all the same.
    const SilenceWatch::Call call(silence_, *context, settings_.hello_seconds);
    if (!stream->Read(&message)) return Status::OK;
  }
  const Seat seat(workers_);
  if (seat.before >= settings_.most_workers)
    return {StatusCode::RESOURCE_EXHAUSTED,
            "this coordinator takes " + std::to_string(settings_.most_workers) + " workers"};
  if (!message.has_hello()) return {StatusCode::INVALID_ARGUMENT, "a worker's first message must be Hello"};
  if (message.hello().protocol() != protocol_version)
    return {StatusCode::FAILED_PRECONDITION, "this coordinator speaks protocol " + std::to_string(protocol_version) +
                                                 ", the worker " + std::to_string(message.hello().protocol())};
  if (!message.hello().kernels_build().empty() && message.hello().kernels_build() != kernels_build())
    return {StatusCode::FAILED_PRECONDITION,
            "this worker was built with other kernels than the coordinator: its records would differ"};
  WorkerHello hello;
  if (Status status = guarded([&] {
        hello = from_proto(message.hello());
        return Status::OK;
      });
      !status.ok())
    return status;
  hello.address = context->peer();
  hello.peer_address = reachable_address(hello.peer_address, hello.address);
  hello.token = new_token();

  auto session = std::make_shared<StreamSession>(*context, *stream, settings_.heartbeat_seconds, hello.token);
  const WorkerId worker = farm_.join(hello, session).id;
  Status status = guarded([&]() -> Status {
    ResultAssembly assembly(farm_, worker);
    while (stream->Read(&message)) {
      switch (message.message_case()) {
        case pb::WorkerMessage::kResult:
          assembly.add(message.result());
          break;
        case pb::WorkerMessage::kFailed:
          farm_.failed(worker, message.failed().lease(), message.failed().epoch(),
                       said_by_worker(message.failed().message()), message.failed().input_unavailable());
          break;
        case pb::WorkerMessage::kHeartbeat:
          farm_.heard(worker);
          break;
        case pb::WorkerMessage::kLeaving:
          farm_.drain(worker);
          break;
        case pb::WorkerMessage::kWrongPart:
          farm_.wrong_part(worker, message.wrong_part().artifact(), message.wrong_part().first(),
                           message.wrong_part().digest(), message.wrong_part().holder());
          break;
        case pb::WorkerMessage::kHello:
          return {StatusCode::INVALID_ARGUMENT, "a second Hello"};
        case pb::WorkerMessage::MESSAGE_NOT_SET:
          return {StatusCode::INVALID_ARGUMENT, "a message that this coordinator does not know"};
      }
    }
    return Status::OK;
  });
  farm_.leave(worker);
  relay_.worker_lost(worker);
  session->stop();
  if (std::string reason = session->reason(); !reason.empty()) return {StatusCode::ABORTED, reason};
  return status;
}

Status WorkerHub::FetchBlob(grpc::ServerContext* context, const pb::FetchBlobRequest* request,
                            grpc::ServerWriter<pb::BlobPiece>* stream) {
  return guarded([&]() -> Status {
    if (!is_sha256_hex(request->id()))
      return {StatusCode::INVALID_ARGUMENT,
              "blob id: expected 64 lower-case hexadecimal digits, found \"" + request->id().substr(0, 80) + "\""};
    auto blob = blobs_.source(request->id());
    if (!blob) return {StatusCode::NOT_FOUND, "no blob " + request->id()};
    if (request->offset() > blob->bytes() || request->length() > blob->bytes() - request->offset())
      return {StatusCode::OUT_OF_RANGE, "blob " + request->id() + ": expected a range inside of its " +
                                            std::to_string(blob->bytes()) + " bytes, found " +
                                            std::to_string(request->length()) + " from " +
                                            std::to_string(request->offset()) + " on"};
    std::uint64_t left = request->length() > 0 ? request->length() : blob->bytes() - request->offset();
    std::uint64_t offset = request->offset();
    Bytes bytes;
    const Callers::Call open(callers_, *context, Callers::Call::work);
    SilenceWatch::Call call(silence_, *context, settings_.silent_seconds);
    pb::BlobPiece piece;
    piece.set_total_bytes(blob->bytes());
    do {
      bytes.resize(std::min<std::uint64_t>(piece_bytes, left));
      blob->read(offset, bytes);
      offset += bytes.size();
      left -= bytes.size();
      std::string packed = request->pack() > 0 ? pack(bytes, request->pack()) : std::string();
      piece.set_packed(packed.empty() ? 0 : request->pack());
      if (packed.empty())
        piece.set_data(bytes.data(), bytes.size());
      else
        piece.set_data(std::move(packed));
      if (!stream->Write(piece)) return Status::OK;
      call.heard();
    } while (left > 0);
    return Status::OK;
  });
}

Status WorkerHub::LocateArtifact(grpc::ServerContext*, const pb::LocateArtifactRequest* request,
                                 pb::LocateArtifactReply* reply) {
  const std::string& id = request->artifact();
  const Farm::Located located = farm_.locate(request->token(), request->epoch(), id);
  if (located.answer == Farm::Located::refused) return no_such_reader();
  if (located.answer == Farm::Located::unavailable)
    return {StatusCode::UNAVAILABLE, "parts of it were lost and are computed again"};
  for (const Farm::Located::At& at : located.parts) {
    pb::Part& part = *reply->add_parts();
    part.set_first(at.part.items.first);
    part.set_items(at.part.items.count);
    part.set_bytes(at.part.bytes);
    part.set_records(at.part.records);
    part.set_records_before(at.part.records_before);
    part.set_digest(at.part.digest);
    part.set_own(at.own);
    for (const auto& holder : at.holders) {
      pb::Holder& to = *part.add_holders();
      to.set_worker(holder.worker);
      to.set_address(holder.address);
      to.set_ticket(holder.ticket);
    }
  }
  return Status::OK;
}

Status WorkerHub::FetchPart(grpc::ServerContext* context, const pb::FetchPartRequest* request,
                            grpc::ServerWriter<pb::PartPiece>* stream) {
  PartRange range{.artifact = request->artifact(),
                  .first = request->first(),
                  .digest = request->digest(),
                  .sums = request->sums(),
                  .offset = request->offset(),
                  .length = 0};
  const Farm::RelaySource source = farm_.relay_source(request->ticket(), request->epoch(), request->holder(), range);
  if (source.answer == Farm::Located::refused) return no_such_reader();
  if (source.answer == Farm::Located::unavailable)
    return {StatusCode::NOT_FOUND, "that worker does not hold this part"};
  // The sums are 32 bytes for every 64 KiB of the image (worker.proto).
  const std::uint64_t bytes = range.sums ? (source.part_bytes + 65535) / 65536 * 32 : source.part_bytes;
  if (request->offset() > bytes || request->length() > bytes - request->offset())
    return {StatusCode::OUT_OF_RANGE, "part: expected a range inside of its " + std::to_string(bytes) +
                                          " bytes, found " + std::to_string(request->length()) + " from " +
                                          std::to_string(request->offset()) + " on"};
  const std::uint64_t end = request->offset() + request->length();
  std::deque<Relay::Piece> coming;
  const Callers::Call open(callers_, *context, Callers::Call::work);
  try {
    while (range.offset < end || !coming.empty()) {
      while (range.offset < end && coming.size() < pieces_ahead) {
        range.length = std::min<std::uint64_t>(piece_bytes, end - range.offset);
        coming.push_back(relay_.begin(source.holder, range, [&](std::uint64_t number) {
          return farm_.ask_for_part(source.holder, number, range);
        }));
        range.offset += range.length;
      }
      pb::PartPiece piece;
      piece.set_data(relay_.wait(coming.front()));
      coming.pop_front();
      farm_.relayed(request->epoch(), piece.data().size());
      if (context->IsCancelled() || !stream->Write(piece)) return Status::OK;
    }
  } catch (const Error& error) {
    if (error.kind() == ErrorKind::failed) farm_.not_held(source.holder, range.artifact, range.first, range.digest);
    return {StatusCode::UNAVAILABLE, error.what()};
  }
  return Status::OK;
}

Status WorkerHub::DeliverPart(grpc::ServerContext*, const pb::DeliverPartRequest* request, pb::DeliverPartReply*) {
  const auto worker = farm_.worker_of(request->token());
  if (!worker) return {StatusCode::PERMISSION_DENIED, "no connected worker has this token"};
  if (request->data().size() > piece_bytes) return {StatusCode::INVALID_ARGUMENT, "a piece is at most 1 MiB"};
  farm_.heard(*worker);
  if (!relay_.deliver(*worker, request->request(), request->data(), said_by_worker(request->error())))
    return {StatusCode::NOT_FOUND, "nobody waits for it"};
  return Status::OK;
}

}  // namespace gleaner::gateway
