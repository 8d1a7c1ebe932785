#include "worker/agent/part_server.h"

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <chrono>
#include <cstring>

#include "proto/protocol.h"
#include "proto/sha256.h"
#include "scene/model/error.h"
#include "worker/artifacts/part_image.h"

namespace gleaner::worker {

namespace pb = gleaner::v1;
using grpc::Status;
using grpc::StatusCode;

namespace {

constexpr unsigned responder_threads = 2;    // one reads while the other one's answer is on its way
constexpr std::size_t most_requests = 1024;  // that wait; the coordinator has fewer in flight
constexpr int most_calls = 64;               // of peers at the same time

}  // namespace

Status ServedRange::open(const PartStore& store, const pb::FetchPartRequest& request, ServedRange& out) {
  out.part = store.find(request.artifact(), request.first(), request.digest());
  if (!out.part)
    return {StatusCode::NOT_FOUND,
            "no such part of artifact " + request.artifact().substr(0, 64) + ", or another version of it"};
  out.sums = request.sums();
  out.offset = request.offset();
  out.length = request.length();
  const std::uint64_t bytes = out.sums ? out.part->sums().size() : out.part->bytes();
  if (out.offset > bytes || out.length > bytes - out.offset)
    return {StatusCode::OUT_OF_RANGE, "part: expected a range inside of its " + std::to_string(bytes) +
                                          " bytes, found " + std::to_string(out.length) + " from " +
                                          std::to_string(out.offset) + " on"};
  return Status::OK;
}

std::string ServedRange::bytes(std::uint64_t from, std::uint64_t count) const {
  std::string data(count, '\0');
  const auto out = std::as_writable_bytes(std::span(data));
  if (sums && count > 0)
    std::memcpy(out.data(), part->sums().data() + offset + from, count);
  else if (!sums)
    part->read(offset + from, out);
  return data;
}

struct PeerServer::Impl final : pb::WorkerPeer::Service {
  explicit Impl(std::shared_ptr<PartStore> parts) : store(std::move(parts)) {}

  Status FetchPart(grpc::ServerContext*, const pb::FetchPartRequest* request,
                   grpc::ServerWriter<pb::PartPiece>* stream) override {
    {
      std::lock_guard lock(mutex);
      if (token.empty() || !same_secret(request->ticket(), artifact_ticket(token, request->artifact())))
        return {StatusCode::PERMISSION_DENIED, "the ticket is not of this artifact, or no longer valid"};
    }
    try {
      ServedRange range;
      if (Status status = ServedRange::open(*store, *request, range); !status.ok()) return status;
      pb::PartPiece piece;
      for (std::uint64_t at = 0; at < range.length; at += piece.data().size()) {
        piece.set_data(range.bytes(at, std::min(piece_bytes, range.length - at)));
        if (!stream->Write(piece)) break;
      }
      return Status::OK;
    } catch (const std::exception& error) {
      return {StatusCode::INTERNAL, error.what()};
    }
  }

  std::shared_ptr<PartStore> store;
  std::mutex mutex;
  std::string token;  // guarded by the mutex
  std::string address;
  std::unique_ptr<grpc::Server> server;
};

PeerServer::PeerServer(const std::string& listen, std::shared_ptr<PartStore> store, std::shared_ptr<const Keys> keys)
    : impl_(std::make_unique<Impl>(std::move(store))) {
  grpc::ServerBuilder builder;
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 20000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10000);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 5000);
  builder.SetMaxReceiveMessageSize(4096);  // requests are small
  grpc::ResourceQuota quota("gleaner peers");
  quota.SetMaxThreads(most_calls);
  builder.SetResourceQuota(quota);
  builder.RegisterService(impl_.get());
  int port = 0;
  builder.AddListeningPort(listen,
                           server_credentials(
                               std::move(keys), [](std::string_view) { return Role::work; }, Admits::certificates),
                           &port);
  impl_->server = builder.BuildAndStart();
  if (!impl_->server || port == 0)
    throw Error::failed("cannot listen for other workers on " + listen +
                        ": is the port taken, or the address not this machine's?");
  impl_->address = listen.substr(0, listen.rfind(':') + 1) + std::to_string(port);
}

PeerServer::~PeerServer() {
  impl_->server->Shutdown(std::chrono::system_clock::now() + std::chrono::milliseconds(500));
  impl_->server->Wait();
}

const std::string& PeerServer::address() const { return impl_->address; }

void PeerServer::connected(const std::string& token) {
  std::lock_guard lock(impl_->mutex);
  impl_->token = token;
}

PartResponder::PartResponder(std::shared_ptr<grpc::Channel> coordinator, std::shared_ptr<PartStore> store)
    : stub_(pb::WorkerHub::NewStub(std::move(coordinator))), store_(std::move(store)) {
  for (unsigned i = 0; i < responder_threads; ++i) threads_.emplace_back([this] { work(); });
}

PartResponder::~PartResponder() {
  {
    std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  queued_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void PartResponder::connected(const std::string& token) {
  std::lock_guard lock(mutex_);
  token_ = token;
  queue_.clear();
}

void PartResponder::answer(const pb::SendPart& request) {
  {
    std::lock_guard lock(mutex_);
    if (queue_.size() >= most_requests) return;  // the coordinator gives up waiting
    queue_.push_back(request);
  }
  queued_.notify_one();
}

void PartResponder::work() {
  std::unique_lock lock(mutex_);
  for (;;) {
    queued_.wait(lock, [&] { return stopping_ || !queue_.empty(); });
    if (stopping_) return;
    pb::SendPart wanted = std::move(queue_.front());
    queue_.pop_front();
    pb::DeliverPartRequest answer;
    answer.set_token(token_);
    lock.unlock();
    answer.set_request(wanted.request());
    ServedRange range;
    try {
      Status status = ServedRange::open(*store_, wanted.range(), range);
      if (status.ok() && range.length > piece_bytes) status = {StatusCode::OUT_OF_RANGE, "more than 1 MiB at once"};
      if (status.ok())
        answer.set_data(range.bytes(0, range.length));
      else
        answer.set_error(status.error_message());
    } catch (const std::exception& error) {
      answer.set_error(error.what());
    }
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(10));
    pb::DeliverPartReply reply;
    stub_->DeliverPart(&context, answer, &reply);  // where it fails, who waits for it gives up waiting
    lock.lock();
  }
}

}  // namespace gleaner::worker
