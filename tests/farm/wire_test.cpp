// Every call with hostile input: a clear status, and a farm that goes on.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <set>

#include "coordinator/blobs/sha256.h"
#include "proto/packing.h"
#include "scene/model/error.h"
#include "tests/farm/wire_farm.h"

namespace gleaner::test {
namespace {

using grpc::ClientContext;
using grpc::StatusCode;
using testing::HasSubstr;

const std::string no_such_id(64, 'a');

class Wire : public testing::Test {
 protected:
  grpc::Status upload(const std::vector<pb::UploadBlobRequest>& parts) {
    ClientContext context;
    return upload(*people_, context, parts);
  }
  static grpc::Status upload(pb::Farm::StubInterface& to, ClientContext& context,
                             const std::vector<pb::UploadBlobRequest>& parts) {
    pb::UploadBlobReply reply;
    auto writer = to.UploadBlob(&context, &reply);
    for (const auto& part : parts)
      if (!writer->Write(part)) break;
    writer->WritesDone();
    return writer->Finish();
  }

  static pb::UploadBlobRequest header(const std::string& id, std::uint64_t bytes) {
    pb::UploadBlobRequest part;
    part.mutable_header()->set_id(id);
    part.mutable_header()->set_bytes(bytes);
    return part;
  }
  static pb::UploadBlobRequest data(const std::string& bytes) {
    pb::UploadBlobRequest part;
    part.set_data(bytes);
    return part;
  }
  static std::string id_of(const std::string& bytes) {
    return coordinator::sha256_hex(std::as_bytes(std::span(bytes)));
  }

  grpc::Status submit(const pb::SubmitJobRequest& request, std::string* job = nullptr) {
    ClientContext context;
    pb::SubmitJobReply reply;
    grpc::Status status = people_->SubmitJob(&context, request, &reply);
    if (job) *job = reply.job();
    return status;
  }

  // What a worker hears of after it said these words.
  grpc::Status work(const std::vector<pb::WorkerMessage>& words, bool wait_for_lease = false) {
    ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(10));
    auto stream = workers_->Work(&context);
    pb::HubMessage heard;
    for (const auto& word : words) {
      if (!stream->Write(word)) break;
      if (word.has_hello() && wait_for_lease)
        while (stream->Read(&heard) && !heard.has_lease()) continue;
    }
    stream->WritesDone();
    while (stream->Read(&heard)) continue;
    return stream->Finish();
  }

  static pb::WorkerMessage hello(const std::string& name = "peer", std::uint32_t protocol = protocol_version) {
    pb::WorkerMessage message;
    message.mutable_hello()->set_name(name);
    message.mutable_hello()->set_protocol(protocol);
    return message;
  }

  // After every attack: the farm still takes a job and nobody is left behind.
  void TearDown() override {
    EXPECT_TRUE(eventually([&] { return farm_.farm().workers().empty(); }));
    std::string job;
    EXPECT_TRUE(submit(farm_.good_request(), &job).ok());
    EXPECT_TRUE(farm_.farm().status(job));
  }

  WireFarm farm_{std::uint64_t{4} << 20, 3};
  std::unique_ptr<pb::Farm::Stub> people_ = pb::Farm::NewStub(farm_.socket_channel());
  std::unique_ptr<pb::WorkerHub::Stub> workers_ = pb::WorkerHub::NewStub(farm_.socket_channel());
};

TEST_F(Wire, UploadsComeWholeOrNotAtAll) {
  std::string bytes(3000000, 'x');
  bytes.back() = 'z';
  const std::string id = id_of(bytes);
  const std::string one = bytes.substr(0, 1 << 20), two = bytes.substr(1 << 20, 1 << 20), three = bytes.substr(2 << 20);
  struct {
    const char* what;
    std::vector<pb::UploadBlobRequest> parts;
    StatusCode code;
  } const attacks[] = {
      {"nothing", {}, StatusCode::INVALID_ARGUMENT},
      {"no header", {data("x")}, StatusCode::INVALID_ARGUMENT},
      {"an empty part", {pb::UploadBlobRequest{}}, StatusCode::INVALID_ARGUMENT},
      {"an id that is none", {header("../../etc/passwd", 1), data("x")}, StatusCode::INVALID_ARGUMENT},
      {"upper case", {header(std::string(64, 'A'), 1), data("x")}, StatusCode::INVALID_ARGUMENT},
      {"too large a blob", {header(no_such_id, 5 << 20)}, StatusCode::RESOURCE_EXHAUSTED},
      {"more than can be",
       {header(no_such_id, std::numeric_limits<std::uint64_t>::max())},
       StatusCode::RESOURCE_EXHAUSTED},
      {"too few bytes", {header(id, bytes.size()), data(one), data(two)}, StatusCode::INVALID_ARGUMENT},
      {"too many bytes",
       {header(id, bytes.size()), data(one), data(two), data(three), data("x")},
       StatusCode::INVALID_ARGUMENT},
      {"other bytes", {header(no_such_id, 1), data("x")}, StatusCode::INVALID_ARGUMENT},
      {"out of order", {header(id, bytes.size()), data(three), data(one), data(two)}, StatusCode::INVALID_ARGUMENT},
      {"a second header",
       {header(id, bytes.size()), data(one), header(id, bytes.size())},
       StatusCode::INVALID_ARGUMENT},
      {"too large a piece",
       {header(id, bytes.size()), data(bytes.substr(0, (1 << 20) + 1))},
       StatusCode::INVALID_ARGUMENT},
      {"too large a message", {header(id, bytes.size()), data(bytes)}, StatusCode::RESOURCE_EXHAUSTED},
  };
  for (const auto& attack : attacks) {
    grpc::Status status = upload(attack.parts);
    EXPECT_EQ(status.error_code(), attack.code) << attack.what << ": " << status.error_message();
  }
  const std::string other(100000, 'y');
  EXPECT_EQ(upload({header(id_of(other), other.size()), data(other)}).error_code(), StatusCode::OK);
  EXPECT_TRUE(farm_.blobs().has(id_of(other)));
  EXPECT_FALSE(farm_.blobs().has(no_such_id));
  // Nothing half-finished is left on the disk.
  EXPECT_TRUE(std::filesystem::is_empty(farm_.folder() / "blobs" / "incoming"));
}

TEST_F(Wire, MissingBlobsAreNamed) {
  ClientContext context;
  pb::MissingBlobsRequest request;
  std::string held = farm_.blobs().put(bytes_of(std::vector<int>{9}));
  request.add_ids(held);
  request.add_ids(no_such_id);
  pb::MissingBlobsReply reply;
  ASSERT_TRUE(people_->MissingBlobs(&context, request, &reply).ok());
  ASSERT_EQ(reply.ids_size(), 1);
  EXPECT_EQ(reply.ids(0), no_such_id);

  ClientContext bad_context;
  request.add_ids("not an id");
  EXPECT_EQ(people_->MissingBlobs(&bad_context, request, &reply).error_code(), StatusCode::INVALID_ARGUMENT);
  ClientContext long_context;
  request.clear_ids();
  for (int i = 0; i < 1025; ++i) request.add_ids(no_such_id);
  EXPECT_EQ(people_->MissingBlobs(&long_context, request, &reply).error_code(), StatusCode::INVALID_ARGUMENT);
}

TEST_F(Wire, SubmissionsAreChecked) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::string garbage = farm_.blobs().put(bytes_of(std::vector<std::uint64_t>(100, 0xdeadbeef)));
  auto truncated_bytes = scene::serialize(small_scene());
  truncated_bytes.resize(truncated_bytes.size() / 2);
  std::string truncated = farm_.blobs().put(truncated_bytes);
  using Request = pb::SubmitJobRequest;
  struct {
    const char* what;
    std::function<void(Request&)> spoil;
    StatusCode code;
  } const attacks[] = {
      {"no scene", [](Request& r) { r.clear_scene_blob(); }, StatusCode::INVALID_ARGUMENT},
      {"a path for a blob", [](Request& r) { r.set_scene_blob("/etc/passwd"); }, StatusCode::INVALID_ARGUMENT},
      {"a blob that is not there", [](Request& r) { r.set_scene_blob(no_such_id); }, StatusCode::FAILED_PRECONDITION},
      {"a BVH that is not there", [](Request& r) { r.set_bvh_blob(no_such_id); }, StatusCode::FAILED_PRECONDITION},
      {"garbage for a scene", [&](Request& r) { r.set_scene_blob(garbage); }, StatusCode::INVALID_ARGUMENT},
      {"half a scene", [&](Request& r) { r.set_scene_blob(truncated); }, StatusCode::INVALID_ARGUMENT},
      {"no name", [](Request& r) { r.clear_scene_name(); }, StatusCode::INVALID_ARGUMENT},
      {"a long name", [](Request& r) { r.set_scene_name(std::string(10000, 'n')); }, StatusCode::INVALID_ARGUMENT},
      {"no settings", [](Request& r) { r.clear_settings(); }, StatusCode::INVALID_ARGUMENT},
      {"an unknown method", [](Request& r) { r.mutable_settings()->set_method("paint"); },
       StatusCode::INVALID_ARGUMENT},
      {"no pixels", [](Request& r) { r.mutable_settings()->set_width(0); }, StatusCode::INVALID_ARGUMENT},
      {"no samples", [](Request& r) { r.mutable_settings()->set_samples_per_pixel(0); }, StatusCode::INVALID_ARGUMENT},
      {"a negative error", [](Request& r) { r.mutable_settings()->set_target_error(-1); },
       StatusCode::INVALID_ARGUMENT},
      {"an error that is no number", [&](Request& r) { r.mutable_settings()->set_target_error(nan); },
       StatusCode::INVALID_ARGUMENT},
      {"no camera", [](Request& r) { r.mutable_settings()->clear_camera(); }, StatusCode::INVALID_ARGUMENT},
      {"a camera nowhere", [&](Request& r) { r.mutable_settings()->mutable_camera()->mutable_origin()->set_x(nan); },
       StatusCode::INVALID_ARGUMENT},
      {"an axis of no length", [](Request& r) { r.mutable_settings()->mutable_camera()->clear_up(); },
       StatusCode::INVALID_ARGUMENT},
      {"a flat film", [](Request& r) { r.mutable_settings()->mutable_camera()->set_half_width(0); },
       StatusCode::INVALID_ARGUMENT},
      {"an unknown camera type",
       [](Request& r) { r.mutable_settings()->mutable_camera()->set_type(static_cast<pb::CameraType>(77)); },
       StatusCode::INVALID_ARGUMENT},
      {"frames backwards",
       [](Request& r) {
         r.set_first_frame(9);
         r.set_last_frame(3);
       },
       StatusCode::INVALID_ARGUMENT},
      {"too many frames",
       [](Request& r) {
         r.set_first_frame(0);
         r.set_last_frame(4294967295u);
       },
       StatusCode::INVALID_ARGUMENT},
      {"an exposure that is no number", [&](Request& r) { r.set_exposure_stops(nan); }, StatusCode::INVALID_ARGUMENT},
      {"too many settings",
       [](Request& r) {
         for (int i = 0; i < 300; ++i) (*r.mutable_settings()->mutable_set())[std::to_string(i)] = std::string("1");
       },
       StatusCode::INVALID_ARGUMENT},
  };
  for (const auto& attack : attacks) {
    Request request = farm_.good_request();
    attack.spoil(request);
    grpc::Status status = submit(request);
    EXPECT_EQ(status.error_code(), attack.code) << attack.what << ": " << status.error_message();
    EXPECT_FALSE(status.error_message().empty()) << attack.what;
  }
  EXPECT_TRUE(farm_.farm().list().empty());
}

// What is too much for a message comes as a blob.
TEST_F(Wire, ManyMovingFramesComeInABlob) {
  pb::SubmitJobRequest request = farm_.good_request();
  pb::JobFrames frames;
  const std::uint32_t count = 20000;
  for (std::uint32_t i = 0; i < count; ++i) {
    *frames.add_cameras() = request.settings().camera();
    pb::FrameScene& scene = *frames.add_scenes();
    scene.set_scene_blob(request.scene_blob());
    scene.set_bvh_blob(request.bvh_blob());
  }
  request.set_last_frame(count);
  request.set_first_frame(1);
  ASSERT_GT(frames.ByteSizeLong(), 2u << 20);
  const std::string bytes = frames.SerializeAsString();
  request.set_frames_blob(farm_.blobs().put(bytes_of(std::vector<char>(bytes.begin(), bytes.end()))));
  std::string job;
  grpc::Status status = submit(request, &job);
  ASSERT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(farm_.farm().status(job)->frames, count);
  request.set_frames_blob(request.scene_blob());
  EXPECT_EQ(submit(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT) << "a scene is no list of frames";
  request.set_frames_blob(std::string(64, '0'));
  EXPECT_EQ(submit(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT) << "it is not there";
}

TEST_F(Wire, UnknownJobsAreNotFound) {
  for (const std::string& job :
       {std::string("no-such-job"), std::string(), std::string(100000, 'j'), std::string("../../etc")}) {
    pb::Job status;
    {
      ClientContext context;
      pb::GetJobRequest request;
      request.set_job(job);
      EXPECT_EQ(people_->GetJob(&context, request, &status).error_code(), StatusCode::NOT_FOUND);
    }
    {
      ClientContext context;
      pb::CancelJobRequest request;
      request.set_job(job);
      EXPECT_EQ(people_->CancelJob(&context, request, &status).error_code(), StatusCode::NOT_FOUND);
    }
    {
      ClientContext context;
      pb::WatchJobRequest request;
      request.set_job(job);
      auto reader = people_->WatchJob(&context, request);
      while (reader->Read(&status)) ADD_FAILURE();
      EXPECT_EQ(reader->Finish().error_code(), StatusCode::NOT_FOUND);
    }
    {
      ClientContext context;
      pb::GetPreviewRequest request;
      request.set_job(job);
      pb::GetPreviewReply reply;
      EXPECT_EQ(people_->GetPreview(&context, request, &reply).error_code(), StatusCode::NOT_FOUND);
    }
    {
      ClientContext context;
      pb::WhyRequest request;
      request.set_job(job);
      pb::WhyReply reply;
      EXPECT_EQ(people_->Why(&context, request, &reply).error_code(), StatusCode::NOT_FOUND);
    }
    {
      ClientContext context;
      pb::ListFilesRequest request;
      request.set_job(job);
      pb::ListFilesReply reply;
      EXPECT_EQ(people_->ListFiles(&context, request, &reply).error_code(), StatusCode::NOT_FOUND);
    }
    {
      ClientContext context;
      pb::FetchFileRequest request;
      request.set_job(job);
      request.set_name("frame_1.exr");
      auto reader = people_->FetchFile(&context, request);
      pb::FetchFileReply piece;
      while (reader->Read(&piece)) ADD_FAILURE();
      EXPECT_EQ(reader->Finish().error_code(), StatusCode::NOT_FOUND);
    }
  }
}

TEST_F(Wire, OnlyAJobsOwnFilesAreFetched) {
  std::string job;
  ASSERT_TRUE(submit(farm_.good_request(), &job).ok());
  for (const char* name : {"", "..", "../../blobs", "/etc/passwd", "frame_1.exr/../../../x", "frame_1.exr"}) {
    ClientContext context;
    pb::FetchFileRequest request;
    request.set_job(job);
    request.set_name(name);
    auto reader = people_->FetchFile(&context, request);
    pb::FetchFileReply piece;
    while (reader->Read(&piece)) ADD_FAILURE() << name;
    EXPECT_EQ(reader->Finish().error_code(), StatusCode::NOT_FOUND) << name;
  }
}

TEST_F(Wire, APreviewOfNothingSaysSo) {
  std::string job;
  ASSERT_TRUE(submit(farm_.good_request(), &job).ok());
  ClientContext context;
  pb::GetPreviewRequest request;
  request.set_job(job);
  pb::GetPreviewReply reply;
  EXPECT_EQ(people_->GetPreview(&context, request, &reply).error_code(), StatusCode::FAILED_PRECONDITION);
}

TEST_F(Wire, WorkersSpeakInOrder) {
  pb::WorkerMessage heartbeat, nothing, leaving;
  heartbeat.mutable_heartbeat();
  leaving.mutable_leaving();
  pb::WorkerMessage long_name = hello(std::string(65, 'n'));
  struct {
    const char* what;
    std::vector<pb::WorkerMessage> words;
    StatusCode code;
  } const attacks[] = {
      {"silence", {}, StatusCode::OK},
      {"no hello", {heartbeat}, StatusCode::INVALID_ARGUMENT},
      {"an empty message", {nothing}, StatusCode::INVALID_ARGUMENT},
      {"another protocol", {hello("peer", protocol_version + 1)}, StatusCode::FAILED_PRECONDITION},
      {"no name", {hello("")}, StatusCode::INVALID_ARGUMENT},
      {"a name with a slash", {hello("../peer")}, StatusCode::INVALID_ARGUMENT},
      {"a long name", {long_name}, StatusCode::INVALID_ARGUMENT},
      {"hello twice", {hello(), hello()}, StatusCode::INVALID_ARGUMENT},
      {"an empty message later", {hello(), nothing}, StatusCode::INVALID_ARGUMENT},
      {"goodbye", {hello(), heartbeat, leaving}, StatusCode::OK},
  };
  for (const auto& attack : attacks) {
    grpc::Status status = work(attack.words);
    EXPECT_EQ(status.error_code(), attack.code) << attack.what << ": " << status.error_message();
  }
}

// A name that ends within a character must not break the list for everybody, nor one with escape sequences a terminal.
TEST_F(Wire, NamesOfStrangersAreOneLineOfText) {
  pb::WorkerMessage words = hello();
  words.mutable_hello()->mutable_device()->set_name(std::string(255, 'a') + "\u00e9");
  words.mutable_hello()->mutable_device()->set_driver("\x1b[2Jgone\nworker eve joined");
  words.mutable_hello()->mutable_device()->set_version("\u009b2J");
  words.mutable_hello()->mutable_device()->set_platform(std::string(100, '\n') + "\u202e");
  ClientContext context, list;
  auto stream = workers_->Work(&context);
  pb::HubMessage welcome;
  ASSERT_TRUE(stream->Write(words) && stream->Read(&welcome));
  pb::ListWorkersReply reply;
  const grpc::Status status = people_->ListWorkers(&list, {}, &reply);
  stream->WritesDone();
  while (stream->Read(&welcome)) continue;
  stream->Finish();
  ASSERT_TRUE(status.ok()) << status.error_message();
  ASSERT_EQ(reply.workers_size(), 1);
  const pb::Device& device = reply.workers(0).device();
  EXPECT_EQ(device.name(), std::string(255, 'a'));  // no half of a character
  EXPECT_EQ(device.driver(), "\\x1b[2Jgone\\x0aworker eve joined");
  EXPECT_EQ(device.version(), "\\xc2\\x9b2J");
  EXPECT_EQ(device.platform().size(), 4 * 64u);  // escaped, it is no longer than names may be

  pb::SubmitJobRequest request = farm_.good_request();
  request.set_scene_name("a\nb\x1b[31m.glb");
  std::string job;
  ASSERT_TRUE(submit(request, &job).ok());
  EXPECT_EQ(farm_.farm().status(job)->scene_name, "a\\x0ab\\x1b[31m.glb");
}

TEST_F(Wire, ResultsArePiecedTogetherInOrder) {
  std::string job;
  ASSERT_TRUE(submit(farm_.good_request(), &job).ok());
  auto piece = [](std::uint64_t lease, std::uint64_t epoch, std::uint64_t offset, std::size_t bytes, bool last,
                  double seconds = 0.1) {
    pb::WorkerMessage message;
    message.mutable_result()->set_lease(lease);
    message.mutable_result()->set_epoch(epoch);
    message.mutable_result()->set_offset(offset);
    message.mutable_result()->set_records(std::string(bytes, 'r'));
    if (last) message.mutable_result()->mutable_cost()->set_seconds(seconds);
    return message;
  };
  pb::WorkerMessage failed;
  failed.mutable_failed()->set_lease(12345);
  failed.mutable_failed()->set_epoch(12345);
  failed.mutable_failed()->set_message(std::string(100000, 'f'));
  const double infinity = std::numeric_limits<double>::infinity();
  struct {
    const char* what;
    std::vector<pb::WorkerMessage> words;
    StatusCode code;
  } const attacks[] = {
      {"a lease that nobody gave", {hello(), piece(777, 777, 0, 100, true)}, StatusCode::OK},
      {"the failure of a lease that nobody gave", {hello(), failed}, StatusCode::OK},
      {"a result from its middle on", {hello(), piece(1, 1, 100, 100, true)}, StatusCode::INVALID_ARGUMENT},
      {"a gap", {hello(), piece(1, 1, 0, 100, false), piece(1, 1, 200, 100, true)}, StatusCode::INVALID_ARGUMENT},
      {"an overlap", {hello(), piece(1, 1, 0, 100, false), piece(1, 1, 50, 100, true)}, StatusCode::INVALID_ARGUMENT},
      {"too large a piece", {hello(), piece(1, 1, 0, (1 << 20) + 1, true)}, StatusCode::INVALID_ARGUMENT},
      {"too large a message", {hello(), piece(1, 1, 0, 3 << 20, true)}, StatusCode::RESOURCE_EXHAUSTED},
      {"negative seconds", {hello(), piece(1, 1, 0, 10, true, -1)}, StatusCode::INVALID_ARGUMENT},
      {"seconds without end", {hello(), piece(1, 1, 0, 10, true, infinity)}, StatusCode::INVALID_ARGUMENT},
      {"seconds that are no number",
       {hello(), piece(1, 1, 0, 10, true, infinity - infinity)},
       StatusCode::INVALID_ARGUMENT},
  };
  for (const auto& attack : attacks) {
    grpc::Status status = work(attack.words);
    EXPECT_EQ(status.error_code(), attack.code) << attack.what << ": " << status.error_message();
  }
  EXPECT_EQ(farm_.farm().status(job)->stages.at(0).items_done, 0u);
}

TEST_F(Wire, ResultsHaveTheBytesOfTheirLease) {
  const auto packed = [](std::size_t bytes) { return pack(scene::Bytes(bytes, std::byte{'r'}), 8); };
  constexpr std::size_t right = 256 * 8;
  struct {
    const char* what;
    std::string records;
    std::uint32_t packed;
    StatusCode code;
  } const answers[] = {
      {"a byte more", std::string(right + 1, 'r'), 0, StatusCode::INVALID_ARGUMENT},
      {"a byte more, packed", packed(right + 1), 8, StatusCode::INVALID_ARGUMENT},
      {"a piece that is too large when unpacked", packed((1 << 20) + 1), 8, StatusCode::INVALID_ARGUMENT},
      {"no packed bytes", std::string(100, 'r'), 8, StatusCode::INVALID_ARGUMENT},
      {"half of the packed bytes", packed(right).substr(0, 8), 8, StatusCode::INVALID_ARGUMENT},
      {"all bytes", std::string(right, 'r'), 0, StatusCode::OK},
      {"all bytes, packed", packed(right), 8, StatusCode::OK},
  };
  for (const auto& answer : answers) {
    std::string job;
    ASSERT_TRUE(submit(farm_.good_request(), &job).ok());
    ClientContext context;
    auto stream = workers_->Work(&context);
    ASSERT_TRUE(stream->Write(hello()));
    pb::HubMessage heard;
    ASSERT_TRUE(stream->Read(&heard));
    ASSERT_TRUE(heard.has_welcome());
    ASSERT_TRUE(stream->Read(&heard));
    ASSERT_TRUE(heard.has_lease());
    EXPECT_EQ(heard.lease().job(), job);
    EXPECT_EQ(heard.lease().count(), 256u);
    EXPECT_EQ(heard.lease().record_bytes(), 8u);
    pb::WorkerMessage result;
    result.mutable_result()->set_lease(heard.lease().lease());
    result.mutable_result()->set_epoch(heard.lease().epoch());
    result.mutable_result()->set_records(answer.records);
    result.mutable_result()->set_packed(answer.packed);
    result.mutable_result()->mutable_cost()->set_seconds(0.1);
    stream->Write(result);
    stream->WritesDone();
    while (stream->Read(&heard)) continue;
    EXPECT_EQ(stream->Finish().error_code(), answer.code) << answer.what;
    EXPECT_EQ(farm_.farm().status(job)->stages.at(0).items_done, answer.code == StatusCode::OK ? 256u : 0u)
        << answer.what;
    farm_.farm().cancel(job);
    // Until it has ended, its items may go to the next worker.
    EXPECT_TRUE(eventually([&] { return ended(farm_.farm().status(job)->state); }));
    EXPECT_TRUE(eventually([&] { return farm_.farm().workers().empty(); }));
  }
}

TEST_F(Wire, SeatsAreCounted) {
  std::vector<std::unique_ptr<ClientContext>> contexts;
  std::vector<std::unique_ptr<grpc::ClientReaderWriter<pb::WorkerMessage, pb::HubMessage>>> streams;
  for (int i = 0; i < 3; ++i) {
    contexts.push_back(std::make_unique<ClientContext>());
    streams.push_back(workers_->Work(contexts.back().get()));
    streams.back()->Write(hello());
    pb::HubMessage heard;
    ASSERT_TRUE(streams.back()->Read(&heard));
  }
  EXPECT_EQ(work({hello()}).error_code(), StatusCode::RESOURCE_EXHAUSTED);
  for (auto& context : contexts) context->TryCancel();
  for (auto& stream : streams) stream->Finish();
  EXPECT_TRUE(eventually([&] { return work({hello()}).ok(); })) << "a seat is free again";
}

// Each holds a thread: without an end to them a few thousand hold all there are.
TEST_F(Wire, SilentStreamsAreEnded) {
  gateway::ServerSettings settings;
  settings.listen = "127.0.0.1:0";
  settings.hello_seconds = settings.silent_seconds = 2;
  settings.most_uploads = 2;
  gateway::Server impatient(farm_.farm(), farm_.blobs(), settings);
  const auto channel = grpc::CreateChannel(impatient.address(), grpc::InsecureChannelCredentials());
  const auto within = [](ClientContext& context) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
  };
  {
    auto stub = pb::WorkerHub::NewStub(channel);
    ClientContext context;
    within(context);
    auto stream = stub->Work(&context);
    pb::HubMessage heard;
    EXPECT_FALSE(stream->Read(&heard));
    EXPECT_EQ(stream->Finish().error_code(), StatusCode::CANCELLED);
  }
  auto stub = pb::Farm::NewStub(channel);
  ClientContext contexts[3];
  pb::UploadBlobReply replies[3];
  std::unique_ptr<grpc::ClientWriter<pb::UploadBlobRequest>> uploads[3];
  for (int i = 0; i < 3; ++i) {
    within(contexts[i]);
    uploads[i] = stub->UploadBlob(&contexts[i], &replies[i]);
  }
  std::multiset<StatusCode> codes;
  for (auto& upload : uploads) codes.insert(upload->Finish().error_code());
  EXPECT_EQ(codes,
            (std::multiset<StatusCode>{StatusCode::CANCELLED, StatusCode::CANCELLED, StatusCode::RESOURCE_EXHAUSTED}));
  // A call that was cancelled leaves its seat when its thread has noticed, which may be after its caller has.
  const std::string bytes = "a blob";
  StatusCode code = StatusCode::UNKNOWN;
  eventually(
      [&] {
        ClientContext context;
        within(context);
        code = upload(*stub, context, {header(id_of(bytes), bytes.size()), data(bytes)}).error_code();
        return code != StatusCode::RESOURCE_EXHAUSTED;
      },
      5);
  EXPECT_EQ(code, StatusCode::OK) << "there is room again";
}

TEST_F(Wire, BlobsAreFetchedByTheirIdsAlone) {
  std::string bytes(2500000, 'b');
  std::string id = farm_.blobs().put(scene::Bytes(reinterpret_cast<const std::byte*>(bytes.data()),
                                                  reinterpret_cast<const std::byte*>(bytes.data()) + bytes.size()));
  auto fetch = [&](const std::string& wanted, std::string* out) {
    ClientContext context;
    pb::FetchBlobRequest request;
    request.set_id(wanted);
    auto reader = workers_->FetchBlob(&context, request);
    pb::BlobPiece piece;
    while (reader->Read(&piece)) {
      EXPECT_LE(piece.data().size(), std::size_t{1} << 20);
      if (out) *out += piece.data();
    }
    return reader->Finish();
  };
  std::string got;
  EXPECT_TRUE(fetch(id, &got).ok());
  EXPECT_EQ(got, bytes);
  EXPECT_EQ(fetch(no_such_id, nullptr).error_code(), StatusCode::NOT_FOUND);
  for (const std::string& bad : {std::string(), std::string("../blobs"), std::string(64, '/'), std::string(64, 'G')})
    EXPECT_EQ(fetch(bad, nullptr).error_code(), StatusCode::INVALID_ARGUMENT) << bad;
}

TEST_F(Wire, RangesOfBlobsLieInsideOfThem) {
  std::string bytes(2500000, 'b');
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * 31 >> 7);
  ASSERT_TRUE(upload({header(id_of(bytes), bytes.size()), data(bytes.substr(0, 1 << 20)),
                      data(bytes.substr(1 << 20, 1 << 20)), data(bytes.substr(2 << 20))})
                  .ok());
  std::uint64_t travelled = 0;
  auto fetch = [&](std::uint64_t offset, std::uint64_t length, std::uint32_t pack, std::string& out) {
    ClientContext context;
    pb::FetchBlobRequest request;
    request.set_id(id_of(bytes));
    request.set_pack(pack);
    request.set_offset(offset);
    request.set_length(length);
    auto reader = workers_->FetchBlob(&context, request);
    pb::BlobPiece piece;
    while (reader->Read(&piece)) {
      EXPECT_EQ(piece.total_bytes(), bytes.size());
      travelled += piece.data().size();
      if (piece.packed() > 0) {
        EXPECT_EQ(piece.packed(), pack);
        const scene::Bytes unpacked = unpack(piece.data(), piece.packed(), std::size_t{1} << 20);
        out.append(reinterpret_cast<const char*>(unpacked.data()), unpacked.size());
      } else {
        out += piece.data();
      }
    }
    return reader->Finish().error_code();
  };
  constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
  struct {
    std::uint64_t offset, length;
    StatusCode code;
  } const ranges[] = {
      {0, 0, StatusCode::OK},
      {7, 1200000, StatusCode::OK},
      {2400000, 0, StatusCode::OK},
      {2400000, 100000, StatusCode::OK},
      {2499999, 1, StatusCode::OK},
      {2500000, 0, StatusCode::OK},  // nothing is left, and nothing comes
      {2500000, 1, StatusCode::OUT_OF_RANGE},
      {2400000, 100001, StatusCode::OUT_OF_RANGE},
      {2500001, 0, StatusCode::OUT_OF_RANGE},
      {1, most, StatusCode::OUT_OF_RANGE},
      {most, 2, StatusCode::OUT_OF_RANGE},
      {most, most, StatusCode::OUT_OF_RANGE},
  };
  for (const std::uint32_t pack : {0u, 1u, 12u})
    for (const auto& [offset, length, code] : ranges) {
      std::string got;
      EXPECT_EQ(fetch(offset, length, pack, got), code) << length << " from " << offset;
      if (code == StatusCode::OK)
        EXPECT_EQ(got, bytes.substr(offset, length > 0 ? length : std::string::npos)) << length << " from " << offset;
      else
        EXPECT_TRUE(got.empty());
    }
  for (const std::uint32_t pack : {0u, 1u}) {
    travelled = 0;
    std::string got;
    EXPECT_EQ(fetch(0, 0, pack, got), StatusCode::OK);
    if (pack)
      EXPECT_LT(travelled, bytes.size() / 2);
    else
      EXPECT_EQ(travelled, bytes.size());
  }
}

TEST_F(Wire, ADamagedBlobOnDiskIsNotServedAndCanBeSentAgain) {
  std::string bytes(100000, 'd'), id = id_of(bytes);
  ASSERT_TRUE(upload({header(id, bytes.size()), data(bytes)}).ok());
  std::filesystem::path file = farm_.folder() / "blobs" / id.substr(0, 2) / id;
  ASSERT_TRUE(std::filesystem::exists(file));
  {
    std::FILE* damaged = std::fopen(file.c_str(), "r+b");
    ASSERT_TRUE(damaged);
    std::fputc('!', damaged);
    std::fclose(damaged);
  }
  ClientContext context;
  pb::FetchBlobRequest request;
  request.set_id(id);
  auto reader = workers_->FetchBlob(&context, request);
  pb::BlobPiece piece;
  while (reader->Read(&piece)) ADD_FAILURE();
  EXPECT_EQ(reader->Finish().error_code(), StatusCode::INTERNAL);
  EXPECT_TRUE(upload({header(id, bytes.size()), data(bytes)}).ok());
  EXPECT_TRUE(farm_.blobs().get(id));
}

TEST_F(Wire, ATakenPortIsAnErrorAndNotAShare) {
  gateway::ServerSettings settings;
  settings.listen = farm_.server().address();
  EXPECT_THROW(gateway::Server(farm_.farm(), farm_.blobs(), settings), Error);
}

TEST_F(Wire, RandomBytesDoNotHurt) {
  // The same seed every time; each message is a valid one with some bytes replaced, so that all kinds are reached.
  std::uint64_t state = 42;
  std::vector<pb::WorkerMessage> seeds(5);
  seeds[0] = hello();
  seeds[1].mutable_result()->set_records(std::string(50, 'r'));
  seeds[1].mutable_result()->mutable_cost()->set_seconds(1);
  seeds[2].mutable_failed()->set_message("no");
  seeds[3].mutable_heartbeat();
  seeds[4].mutable_leaving();
  int delivered = 0;
  for (int round = 0; round < 200; ++round) {
    std::vector<pb::WorkerMessage> words = {hello()};
    for (int i = 0; i < 3; ++i) {
      std::string bytes = seeds[hash_of(1, state++) % seeds.size()].SerializeAsString();
      for (int k = 0; k < 3 && !bytes.empty(); ++k) {
        std::size_t at = hash_of(2, state++) % bytes.size();
        bytes[at] = static_cast<char>(hash_of(3, state++));
      }
      pb::WorkerMessage message;
      if (message.ParseFromString(bytes)) words.push_back(message);
    }
    delivered += static_cast<int>(words.size()) - 1;
    grpc::Status status = work(words);
    EXPECT_NE(status.error_code(), StatusCode::UNAVAILABLE) << round;
    EXPECT_NE(status.error_code(), StatusCode::DEADLINE_EXCEEDED) << round;
    EXPECT_NE(status.error_code(), StatusCode::INTERNAL) << round << ": " << status.error_message();
  }
  EXPECT_GT(delivered, 100);
}

// Streams of workers that are slow, each on a farm of its own.
class SlowWorker : public testing::Test {
 protected:
  // Says hello. Where all places are taken, the stream may end before that is written: who joins looks for its welcome.
  auto join(WireFarm& farm, ClientContext& context) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    auto stream = pb::WorkerHub::NewStub(farm.socket_channel())->Work(&context);
    pb::WorkerMessage hello;
    hello.mutable_hello()->set_name("slow");
    hello.mutable_hello()->set_protocol(protocol_version);
    stream->Write(hello);
    return stream;
  }

  static void submit(WireFarm& farm, const coordinator::FrameSettings& settings) {
    ClientContext context;
    pb::SubmitJobReply reply;
    grpc::Status status =
        pb::Farm::NewStub(farm.socket_channel())->SubmitJob(&context, farm.good_request(settings), &reply);
    ASSERT_TRUE(status.ok()) << status.error_message();
  }
};

TEST_F(SlowWorker, PiecesOfALongResultAreSignsOfLife) {
  WireFarm farm(64 << 20, 16, 1.0);
  submit(farm, fake_settings());
  ClientContext context;
  auto stream = join(farm, context);
  pb::HubMessage heard;
  while (stream->Read(&heard) && !heard.has_lease()) continue;
  ASSERT_TRUE(heard.has_lease());
  const auto seed = values_of<std::uint64_t>(
      bytes_of(std::vector<char>(heard.lease().parameters().begin(), heard.lease().parameters().end())));
  const Bytes records = fake_scatter(seed.at(0), heard.lease().first(), heard.lease().count());
  pb::WorkerMessage message;
  pb::Result& piece = *message.mutable_result();
  piece.set_lease(heard.lease().lease());
  piece.set_epoch(heard.lease().epoch());
  const std::size_t size = records.size() / 16;
  for (std::size_t offset = 0; offset < records.size(); offset += size) {  // four times as long as silence is borne
    piece.set_offset(offset);
    piece.set_records(records.data() + offset, size);
    if (offset + size == records.size()) piece.mutable_cost()->set_seconds(0.1);
    ASSERT_TRUE(stream->Write(message)) << "the worker was given up after " << offset << " bytes";
    std::this_thread::sleep_for(std::chrono::milliseconds(250));
  }
  EXPECT_EQ(farm.farm().workers().size(), 1u);
  EXPECT_EQ(farm.farm().list().at(0).stages.at(0).items_done, heard.lease().count());
  context.TryCancel();
}

TEST_F(SlowWorker, OneThatReadsNothingHoldsNobodyUpWhenItLeaves) {
  WireFarm farm(64 << 20, 1);
  coordinator::FrameSettings settings = fake_settings();
  settings.set["padding"] = std::to_string(3 << 20);  // leases that flow control does not let through unread
  submit(farm, settings);
  ClientContext stuck_context;
  auto stuck = join(farm, stuck_context);
  ASSERT_TRUE(eventually([&] { return farm.farm().workers().size() == 1; }));
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  stuck->WritesDone();  // it has left, as far as it is concerned, and its place is free for another
  EXPECT_TRUE(eventually(
      [&] {
        ClientContext context;
        auto stream = join(farm, context);
        pb::HubMessage heard;
        return stream->Read(&heard) && heard.has_welcome();
      },
      15));
  stuck_context.TryCancel();
}

}  // namespace
}  // namespace gleaner::test
