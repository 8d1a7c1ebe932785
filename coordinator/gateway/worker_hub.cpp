#include "coordinator/gateway/worker_hub.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>

#include "coordinator/gateway/convert.h"
#include "scene/model/error.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;
using grpc::Status;
using grpc::StatusCode;
using Stream = grpc::ServerReaderWriter<pb::HubMessage, pb::WorkerMessage>;

namespace {

constexpr std::chrono::seconds last_words{2};  // for a write that is under way when a session ends

// A worker's words end up on terminals and in other messages: what is not plain text is left out, and so is what is too
// long.
std::string printable(const std::string& words) {
  std::string text = words.substr(0, 4096);
  std::replace_if(
      text.begin(), text.end(), [](unsigned char c) { return c != '\n' && (c < 0x20 || c > 0x7e); }, '?');
  return text;
}

// What is said to one worker: queued by the farm, written by a thread of the session's own, so that no worker that
// reads slowly can hold up the farm.
class StreamSession final : public WorkerSession {
 public:
  StreamSession(grpc::ServerContext& context, Stream& stream, double heartbeat_seconds)
      : context_(context), stream_(stream), heartbeat_seconds_(heartbeat_seconds), writer_([this] { write(); }) {}

  ~StreamSession() override { stop(); }

  void welcome(const std::string& name) override {
    say([name, seconds = heartbeat_seconds_](pb::HubMessage& message) {
      message.mutable_welcome()->set_worker(name);
      message.mutable_welcome()->set_heartbeat_seconds(seconds);
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
      for (const auto& input : work->inputs) {
        pb::StageInput& to = *out.add_inputs();
        to.set_name(input.name);
        to.set_artifact(input.blob);
      }
      out.set_record_bytes(work->record_bytes);
      out.set_scene_blob(work->scene_blob);
      out.set_bvh_blob(work->bvh_blob);
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
    received_ += piece.records().size();
    if (wanted_) {
      if (received_ > expected_)
        throw Error::bad_input("result", "records", std::to_string(expected_) + " bytes", "more");
      auto bytes = std::as_bytes(std::span(piece.records()));
      records_.insert(records_.end(), bytes.begin(), bytes.end());
    }
    if (!piece.has_cost()) {
      farm_.heard(worker_);  // a result may take a slow line longer than silence is borne
      return;
    }
    BatchCost cost = from_proto(piece.cost());
    Bytes records = std::move(records_);
    records_ = {};
    received_ = 0;
    lease_ = epoch_ = 0;
    farm_.result(worker_, piece.lease(), piece.epoch(), std::move(records), cost);
  }

 private:
  void begin(const pb::Result& piece) {
    lease_ = piece.lease();
    epoch_ = piece.epoch();
    received_ = 0;
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
  std::uint64_t expected_ = 0, received_ = 0;  // bytes
  Bytes records_;
};

}  // namespace

Status WorkerHub::Work(grpc::ServerContext* context, Stream* stream) {
  struct Seat {
    std::atomic<unsigned>& taken;
    unsigned before = taken.fetch_add(1);
    ~Seat() { taken.fetch_sub(1); }
  } seat{workers_};
  if (seat.before >= most_workers_)
    return {StatusCode::RESOURCE_EXHAUSTED, "this coordinator takes " + std::to_string(most_workers_) + " workers"};

  pb::WorkerMessage message;
  if (!stream->Read(&message)) return Status::OK;
  if (!message.has_hello()) return {StatusCode::INVALID_ARGUMENT, "a worker's first message must be Hello"};
  if (message.hello().protocol() != protocol_version)
    return {StatusCode::FAILED_PRECONDITION, "this coordinator speaks protocol " + std::to_string(protocol_version) +
                                                 ", the worker " + std::to_string(message.hello().protocol())};
  WorkerHello hello;
  if (Status status = guarded([&] {
        hello = from_proto(message.hello());
        return Status::OK;
      });
      !status.ok())
    return status;
  hello.address = context->peer();

  auto session = std::make_shared<StreamSession>(*context, *stream, heartbeat_seconds_);
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
                       printable(message.failed().message()));
          break;
        case pb::WorkerMessage::kHeartbeat:
          farm_.heard(worker);
          break;
        case pb::WorkerMessage::kLeaving:
          farm_.drain(worker);
          break;
        case pb::WorkerMessage::kWrongPart:  // nothing is retained yet that it could be about
          return {StatusCode::INVALID_ARGUMENT, "a part that was never told"};
        case pb::WorkerMessage::kHello:
          return {StatusCode::INVALID_ARGUMENT, "a second Hello"};
        case pb::WorkerMessage::MESSAGE_NOT_SET:
          return {StatusCode::INVALID_ARGUMENT, "a message that this coordinator does not know"};
      }
    }
    return Status::OK;
  });
  farm_.leave(worker);
  session->stop();
  if (std::string reason = session->reason(); !reason.empty()) return {StatusCode::ABORTED, reason};
  return status;
}

Status WorkerHub::FetchBlob(grpc::ServerContext*, const pb::FetchBlobRequest* request,
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
    pb::BlobPiece piece;
    piece.set_total_bytes(blob->bytes());
    do {
      piece.mutable_data()->resize(std::min<std::uint64_t>(piece_bytes, left));
      blob->read(offset, std::as_writable_bytes(std::span(*piece.mutable_data())));
      offset += piece.data().size();
      left -= piece.data().size();
      if (!stream->Write(piece)) return Status::OK;
    } while (left > 0);
    return Status::OK;
  });
}

}  // namespace gleaner::gateway
