#pragma once
// A worker that says that it lives, takes what it is given and never answers.

#include <grpcpp/grpcpp.h>

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "coordinator/gateway/convert.h"
#include "gleaner/v1/worker.grpc.pb.h"

namespace gleaner::test {

class MuteWorker {
 public:
  // `device`: a real worker's, so that it is asked to compare.
  MuteWorker(const std::string& coordinator, const std::string& name, const v1::Device& device)
      : stub_(v1::WorkerHub::NewStub(grpc::CreateChannel(coordinator, grpc::InsecureChannelCredentials()))),
        stream_(stub_->Work(&context_)) {
    v1::WorkerMessage hello;
    hello.mutable_hello()->set_name(name);
    hello.mutable_hello()->set_protocol(protocol_version);
    *hello.mutable_hello()->mutable_device() = device;
    stream_->Write(hello);
    reader_ = std::thread([this] {
      for (v1::HubMessage message; stream_->Read(&message);) leases_ += message.has_lease();
    });
    writer_ = std::thread([this] {
      v1::WorkerMessage beat;
      beat.mutable_heartbeat();
      std::unique_lock lock(mutex_);
      while (!leaves_.wait_for(lock, std::chrono::milliseconds(500), [&] { return gone_; })) stream_->Write(beat);
    });
  }
  ~MuteWorker() {
    {
      std::lock_guard lock(mutex_);
      gone_ = true;
    }
    leaves_.notify_all();
    context_.TryCancel();
    writer_.join();
    reader_.join();
    stream_->Finish();
  }
  int leases() const { return leases_; }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<v1::WorkerHub::Stub> stub_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::WorkerMessage, v1::HubMessage>> stream_;
  std::mutex mutex_;
  std::condition_variable leaves_;
  bool gone_ = false;
  std::atomic<int> leases_{0};
  std::thread reader_, writer_;
};

}  // namespace gleaner::test
