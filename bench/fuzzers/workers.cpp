// libFuzzer: what workers say and ask (gleaner.v1.WorkerHub). The first byte chooses the method; the second one, of
// Work, whether an honest Hello comes first.

#include "bench/fuzzers/called_farm.h"
#include "bench/fuzzers/seeds.h"

using namespace gleaner;
namespace pb = gleaner::v1;

namespace {

fuzz::CalledFarm& farm() {
  static auto* called = [] {
    auto* made = new fuzz::CalledFarm;
    // There is work: leases are handed out, results may be of one.
    coordinator::JobRequest job;
    job.scene_name = "fake.glb";
    job.scenes = {{made->farm().blobs().put(test::bytes_of(std::vector<int>{1, 2, 3})), {}, {}, {}}};
    job.settings = test::fake_settings();
    made->farm().farm().submit(job);
    return made;
  }();
  return *called;
}

const std::vector<std::string> methods = {"/gleaner.v1.WorkerHub/Work", "/gleaner.v1.WorkerHub/FetchBlob",
                                          "/gleaner.v1.WorkerHub/LocateArtifact", "/gleaner.v1.WorkerHub/FetchPart",
                                          "/gleaner.v1.WorkerHub/DeliverPart"};

std::string hello() {
  pb::WorkerMessage message;
  message.mutable_hello()->set_name("peer");
  message.mutable_hello()->set_protocol(protocol_version);
  return message.SerializeAsString();
}

}  // namespace

std::vector<std::string> fuzz::seeds() {
  std::vector<std::string> all;
  pb::WorkerMessage result, failed, beat, leaving, wrong;
  result.mutable_result()->set_lease(1);
  result.mutable_result()->set_epoch(std::uint64_t{1} << 32);
  result.mutable_result()->set_records(std::string(64, 'r'));
  result.mutable_result()->mutable_cost()->set_seconds(1);
  result.mutable_result()->mutable_part()->set_digest(std::string(32, 'd'));
  result.mutable_result()->mutable_part()->set_artifact(std::string(64, 'a'));
  failed.mutable_failed()->set_message("no");
  beat.mutable_heartbeat();
  leaving.mutable_leaving();
  wrong.mutable_wrong_part()->set_artifact(std::string(64, 'a'));
  for (const pb::WorkerMessage& message : {result, failed, beat, leaving, wrong})
    all.push_back(fuzz::input_of(0, {hello(), message.SerializeAsString(), beat.SerializeAsString()}));
  pb::FetchBlobRequest blob;
  blob.set_id(std::string(64, 'b'));
  blob.set_length(7);
  pb::LocateArtifactRequest locate;
  locate.set_token("token");
  locate.set_artifact(std::string(64, 'a'));
  pb::FetchPartRequest part;
  part.set_artifact(std::string(64, 'a'));
  part.set_ticket("ticket");
  part.set_length(1);
  pb::DeliverPartRequest deliver;
  deliver.set_token("token");
  deliver.set_data("data");
  std::uint8_t method = 1;
  for (const std::string& message :
       {blob.SerializeAsString(), locate.SerializeAsString(), part.SerializeAsString(), deliver.SerializeAsString()})
    all.push_back(fuzz::input_of(method++, {message}));
  return all;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string& method = methods[data[0] % methods.size()];
  auto messages = fuzz::messages_of({data + 1, size - 1});
  if (data[0] >= 128) messages.insert(messages.begin(), hello());
  farm().call(method, messages);
  return 0;
}
