// libFuzzer: what people call (gleaner.v1.Farm), uploads among it. The first byte chooses the method.

#include <google/protobuf/descriptor.h>

#include "bench/fuzzers/called_farm.h"
#include "bench/fuzzers/seeds.h"
#include "proto/sha256.h"

using namespace gleaner;
namespace pb = gleaner::v1;

namespace {

fuzz::CalledFarm& farm() {
  static auto* called = new fuzz::CalledFarm;  // for as long as the process lasts
  return *called;
}

const std::vector<std::string>& methods() {
  static const std::vector<std::string> all = [] {
    std::vector<std::string> names;
    const auto* service = google::protobuf::DescriptorPool::generated_pool()->FindServiceByName("gleaner.v1.Farm");
    for (int i = 0; i < service->method_count(); ++i) names.push_back("/gleaner.v1.Farm/" + service->method(i)->name());
    return names;
  }();
  return all;
}

}  // namespace

std::vector<std::string> fuzz::seeds() {
  std::vector<std::string> all;
  for (std::size_t i = 0; i < methods().size(); ++i) {
    std::vector<std::string> messages = {""};
    if (methods()[i].ends_with("/SubmitJob")) {
      pb::SubmitJobRequest request = farm().farm().good_request();
      all.push_back(fuzz::input_of(static_cast<std::uint8_t>(i), {request.SerializeAsString()}));
      request.set_last_frame(5);
      request.set_first_frame(1);
      request.set_name("night");
      request.add_after("no-such-job");
      request.set_request_id("once");
      request.add_frame_cameras();
      messages = {request.SerializeAsString()};
    } else if (methods()[i].ends_with("/UploadBlob")) {
      pb::UploadBlobRequest header, data;
      data.set_data("bytes");
      header.mutable_header()->set_id(coordinator::sha256_hex(std::as_bytes(std::span(data.data()))));
      header.mutable_header()->set_bytes(5);
      messages = {header.SerializeAsString(), data.SerializeAsString()};
    } else if (methods()[i].ends_with("/MissingBlobs")) {
      pb::MissingBlobsRequest request;
      request.add_ids(std::string(64, 'a'));
      messages = {request.SerializeAsString()};
    } else {
      pb::FetchFileRequest request;  // all others begin with a job's id too
      request.set_job("20260101-000000-aaaaaa");
      request.set_name("frame_0001.exr");
      messages = {request.SerializeAsString()};
    }
    all.push_back(fuzz::input_of(static_cast<std::uint8_t>(i), messages));
  }
  return all;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string& method = methods()[data[0] % methods().size()];
  const auto messages = fuzz::messages_of({data + 1, size - 1});
  // Without a job it lasts as long as its caller: there is nothing to be read.
  if (method.ends_with("/WatchEvents") && !messages.empty()) {
    pb::WatchEventsRequest request;
    if (request.ParseFromString(messages[0]) && request.job().empty()) return 0;
  }
  if (farm().call(method, messages) == grpc::StatusCode::OK) farm().tidy();
  return 0;
}
