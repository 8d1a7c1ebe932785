#pragma once
// A call of any method of any service, by its name.

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/impl/codegen/proto_utils.h>

#include <chrono>
#include <memory>
#include <string>

namespace gleaner::test {

// Sends one message of these bytes, whatever the method takes, and nothing more. A call that lasts longer than 10 s
// ends as DEADLINE_EXCEEDED.
inline grpc::Status raw_call(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
                             const std::string& message = {}) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(10));
  grpc::CompletionQueue queue;
  const grpc::Slice slice(message);
  grpc::ByteBuffer reply, request(&slice, 1);
  grpc::Status status;
  auto reader = stub.PrepareUnaryCall(&context, method, request, &queue);
  reader->StartCall();
  reader->Finish(&reply, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  return status;
}

}  // namespace gleaner::test
