#pragma once
// A coordinator inside a fuzzer's process, and calls to it that are bytes: what arrives is what the fuzzer made, not
// what a library of messages can say.

#include <google/protobuf/stubs/logging.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/impl/codegen/proto_utils.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "tests/farm/wire_farm.h"

namespace gleaner::fuzz {

namespace pb = gleaner::v1;

inline grpc::ByteBuffer buffer_of(const std::string& bytes) {
  const grpc::Slice slice(bytes);
  return {&slice, 1};
}

class CalledFarm {
 public:
  CalledFarm() : channel_(farm_.socket_channel()), stub_(channel_) {
    google::protobuf::SetLogHandler(nullptr);  // of text that is not UTF-8
  }

  test::WireFarm& farm() { return farm_; }

  // A stream of any kind of call: all messages, then nothing more; answers are read and dropped. An answer that the
  // call must not have, such as an exception that nobody caught, ends the process.
  grpc::StatusCode call(const std::string& method, const std::vector<std::string>& messages) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
    grpc::CompletionQueue queue;
    const auto step = [&] {
      void* tag = nullptr;
      bool ok = false;
      return queue.Next(&tag, &ok) && ok;
    };
    auto stream = stub_.PrepareCall(&context, method, &queue);
    stream->StartCall(nullptr);
    bool open = step();
    for (const std::string& message : messages) {
      if (!open) break;
      stream->Write(buffer_of(message), nullptr);
      open = step();
    }
    if (open) {
      stream->WritesDone(nullptr);
      step();
    }
    for (grpc::ByteBuffer answer; stream->Read(&answer, nullptr), step();) continue;
    grpc::Status status;
    stream->Finish(&status, nullptr);
    step();
    if (status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED ||
        status.error_code() == grpc::StatusCode::UNKNOWN) {
      std::fprintf(stderr, "%s: status %d, %s\n", method.c_str(), status.error_code(), status.error_message().c_str());
      std::abort();
    }
    return status.error_code();
  }

  // What a call left behind, and would pile up.
  void tidy() {
    for (const auto& job : farm_.farm().list())
      if (!coordinator::ended(job.state)) farm_.farm().cancel(job.id);
  }

 private:
  test::WireFarm farm_{[] {
    test::WireBounds bounds;
    bounds.upload_bytes = 1 << 20;
    return bounds;
  }()};
  std::shared_ptr<grpc::Channel> channel_;
  grpc::GenericStub stub_;
};

// The input as messages: before each its length, two bytes.
inline std::vector<std::string> messages_of(std::span<const std::uint8_t> input) {
  std::vector<std::string> messages;
  while (input.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(input[0] + 256u * input[1], input.size() - 2);
    messages.emplace_back(reinterpret_cast<const char*>(input.data()) + 2, length);
    input = input.subspan(2 + length);
  }
  return messages;
}

inline std::string input_of(std::uint8_t first, const std::vector<std::string>& messages) {
  std::string input(1, static_cast<char>(first));
  for (const std::string& message : messages) {
    input += static_cast<char>(message.size() & 255);
    input += static_cast<char>(message.size() >> 8);
    input += message;
  }
  return input;
}

}  // namespace gleaner::fuzz
