// How much of a coordinator one caller may have, and what becomes of the calls of one whose certificate is revoked.

#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <gtest/gtest.h>

#include <future>

#include "coordinator/blobs/sha256.h"
#include "proto/authority.h"
#include "tests/farm/raw_call.h"
#include "tests/farm/wire_farm.h"

namespace gleaner::test {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class Bounded : public testing::Test {
 protected:
  grpc::Status list(pb::Farm::Stub& stub) {
    grpc::ClientContext context;
    pb::ListJobsReply reply;
    return stub.ListJobs(&context, {}, &reply);
  }
  grpc::Status submit(pb::Farm::Stub& stub, std::string* job = nullptr) {
    grpc::ClientContext context;
    pb::SubmitJobReply reply;
    const grpc::Status status = stub.SubmitJob(&context, farm_->good_request(), &reply);
    if (job) *job = reply.job();
    return status;
  }
  void start(gateway::CallerLimits limits, std::size_t jobs = 0) {
    WireBounds bounds;
    bounds.caller = limits;
    bounds.jobs_an_owner = jobs;
    farm_ = std::make_unique<WireFarm>(bounds);
    people_ = pb::Farm::NewStub(farm_->socket_channel());
    inside_ = pb::Farm::NewStub(farm_->server().in_process_channel());
  }

  std::unique_ptr<WireFarm> farm_;
  std::unique_ptr<pb::Farm::Stub> people_, inside_;
};

TEST_F(Bounded, RequestsASecond) {
  start({.requests_a_second = 20});
  int taken = 0;
  grpc::Status last;
  const auto begun = std::chrono::steady_clock::now();
  for (; taken < 1000; ++taken)
    if (last = list(*people_); !last.ok()) break;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
  EXPECT_EQ(last.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(last.error_message(), HasSubstr("127.0.0.1 makes more than 20 requests a second"));
  EXPECT_GE(taken, 40) << "twice as many at once";
  EXPECT_LE(taken, 41 + 20 * seconds);
  EXPECT_TRUE(list(*inside_).ok()) << "the process itself has no bound";
  EXPECT_TRUE(eventually([&] { return list(*people_).ok(); })) << "after a while there are more";
}

// Whoever adds a method to the service need not know of this test.
TEST_F(Bounded, EveryMethodCountsRequests) {
  start({.requests_a_second = 0.01});  // two at once
  const auto channel = farm_->socket_channel();
  pb::GetJobRequest request;  // all others that name a job begin with it, too
  request.set_job("none");
  const auto* service = google::protobuf::DescriptorPool::generated_pool()->FindServiceByName("gleaner.v1.Farm");
  ASSERT_NE(service, nullptr);
  ASSERT_GT(service->method_count(), 10);
  for (int i = 0; i < service->method_count(); ++i) {
    const std::string method = "/gleaner.v1.Farm/" + service->method(i)->name();
    for (int taken = 0; taken < 2; ++taken) raw_call(channel, method, request.SerializeAsString());
    const grpc::Status third = raw_call(channel, method, request.SerializeAsString());
    EXPECT_EQ(third.error_code(), StatusCode::RESOURCE_EXHAUSTED) << method;
    EXPECT_THAT(third.error_message(), HasSubstr("requests a second")) << method;
  }
}

TEST_F(Bounded, CallsThatLast) {
  start({.calls = 2});
  std::string job;
  ASSERT_TRUE(submit(*people_, &job).ok());
  pb::WatchJobRequest request;
  request.set_job(job);
  pb::Job seen;
  {
    grpc::ClientContext first, second, third;
    auto one = people_->WatchJob(&first, request);
    auto two = people_->WatchJob(&second, request);
    ASSERT_TRUE(one->Read(&seen));
    ASSERT_TRUE(two->Read(&seen));
    auto three = people_->WatchJob(&third, request);
    EXPECT_FALSE(three->Read(&seen));
    const grpc::Status status = three->Finish();
    EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
    EXPECT_THAT(status.error_message(), HasSubstr("127.0.0.1 has 2 watches and downloads open"));
    EXPECT_TRUE(list(*people_).ok()) << "other calls are taken";
    first.TryCancel();
    second.TryCancel();
    one->Finish();
    two->Finish();
  }
  EXPECT_TRUE(eventually([&] {
    grpc::ClientContext again;
    auto watch = people_->WatchJob(&again, request);
    const bool read = watch->Read(&seen);
    again.TryCancel();
    watch->Finish();
    return read;
  }));
}

TEST_F(Bounded, ASilentUploadGivesWayToANewOne) {
  start({.calls = 1});
  std::unique_ptr<grpc::ClientContext> silent_context;
  pb::UploadBlobReply silent_reply;
  std::unique_ptr<grpc::ClientWriter<pb::UploadBlobRequest>> silent;
  const std::string bytes = "bytes";
  const auto upload = [&] {
    grpc::ClientContext context;
    pb::UploadBlobReply reply;
    auto writer = people_->UploadBlob(&context, &reply);
    pb::UploadBlobRequest part;
    part.mutable_header()->set_id(coordinator::sha256_hex(std::as_bytes(std::span(bytes))));
    part.mutable_header()->set_bytes(bytes.size());
    writer->Write(part);
    part.set_data(bytes);
    writer->Write(part);
    writer->WritesDone();
    return writer->Finish();
  };
  std::string job;
  // Whichever of the two calls reaches the coordinator first has the seat: the silent one shall.
  EXPECT_TRUE(eventually(
      [&] {
        silent_context = std::make_unique<grpc::ClientContext>();
        silent = people_->UploadBlob(silent_context.get(), &silent_reply);
        if (upload().error_code() == StatusCode::RESOURCE_EXHAUSTED) return true;
        silent_context->TryCancel();
        silent->Finish();
        return false;
      },
      3));
  ASSERT_TRUE(submit(*people_, &job).ok());
  pb::WatchJobRequest request;
  request.set_job(job);
  grpc::ClientContext watching;
  pb::Job seen;
  auto watch = people_->WatchJob(&watching, request);
  EXPECT_TRUE(watch->Read(&seen)) << "it is of another kind";
  EXPECT_TRUE(eventually([&] { return upload().ok(); })) << "the silent one is ended";
  EXPECT_EQ(silent->Finish().error_code(), StatusCode::CANCELLED);
  watching.TryCancel();
  watch->Finish();
}

TEST_F(Bounded, JobsThatWaitOrRun) {
  start({}, 3);
  std::string job;
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(submit(*people_, &job).ok());
  const grpc::Status status = submit(*people_);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), HasSubstr("127.0.0.1 has 3 jobs that run or wait"));
  EXPECT_TRUE(submit(*inside_).ok());
  EXPECT_EQ(farm_->farm().status(job)->owner, "127.0.0.1");
  farm_->farm().cancel(job);
  EXPECT_TRUE(eventually([&] { return coordinator::ended(farm_->farm().status(job)->state); }));
  EXPECT_TRUE(submit(*people_).ok());
}

// With keys a caller is who its certificate or its token says.
class Revoked : public testing::Test {
 protected:
  Keys token(const std::string& name, Role role) {
    authority_.issue_token(name, {role}, 30, folder_.path() / name);
    return load_keys(folder_.path() / name);
  }
  Keys issue(const std::string& name, Role role) {
    authority_.issue(name, {role}, 30, folder_.path() / name);
    return load_keys(folder_.path() / name);
  }
  std::shared_ptr<grpc::Channel> dial(const Keys& keys) {
    grpc::ChannelArguments arguments;
    arguments.SetInt("grpc.use_local_subchannel_pool", 1);
    const auto credentials = channel_credentials(&keys, Role::coordinate, arguments);
    return grpc::CreateCustomChannel(farm_->server().address(), credentials, arguments);
  }
  void start(gateway::CallerLimits limits) {
    WireBounds bounds;
    bounds.caller = limits;
    bounds.keys = std::make_shared<const Keys>(load_keys(folder_.path() / "farm" / "coordinator"));
    farm_ = std::make_unique<WireFarm>(bounds);
  }

  TemporaryFolder folder_;
  Authority authority_ = Authority::init(folder_.path() / "farm", 100);
  std::unique_ptr<WireFarm> farm_;
};

TEST_F(Revoked, OpenStreamsAreEnded) {
  start({});
  const Keys eve = issue("eve", Role::work), anna = token("anna", Role::submit), otto = issue("otto", Role::submit);
  auto workers = pb::WorkerHub::NewStub(dial(eve));
  grpc::ClientContext working;
  auto stream = workers->Work(&working);
  pb::WorkerMessage hello;
  hello.mutable_hello()->set_name("eve");
  hello.mutable_hello()->set_protocol(protocol_version);
  ASSERT_TRUE(stream->Write(hello));
  pb::HubMessage heard;
  ASSERT_TRUE(stream->Read(&heard));
  ASSERT_TRUE(eventually([&] { return farm_->farm().workers().size() == 1; }));

  pb::WatchJobRequest request;
  const auto watch = [&](pb::Farm::Stub& stub, grpc::ClientContext& context) {
    auto watching = stub.WatchJob(&context, request);
    pb::Job job;
    EXPECT_TRUE(watching->Read(&job));
    return watching;
  };
  auto of_anna = pb::Farm::NewStub(dial(anna)), of_otto = pb::Farm::NewStub(dial(otto));
  grpc::ClientContext context;
  pb::SubmitJobReply submitted;
  ASSERT_TRUE(of_anna->SubmitJob(&context, farm_->good_request(), &submitted).ok());
  EXPECT_EQ(farm_->farm().status(submitted.job())->owner, "anna");
  request.set_job(submitted.job());
  grpc::ClientContext annas, ottos;
  auto watched_by_anna = watch(*of_anna, annas), watched_by_otto = watch(*of_otto, ottos);

  authority_.revoke("eve");
  authority_.revoke("anna");
  const auto begun = std::chrono::steady_clock::now();
  while (stream->Read(&heard)) continue;
  EXPECT_FALSE(stream->Finish().ok());
  pb::Job job;
  while (watched_by_anna->Read(&job)) continue;
  EXPECT_EQ(watched_by_anna->Finish().error_code(), StatusCode::CANCELLED);
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(5));
  EXPECT_TRUE(eventually([&] { return farm_->farm().workers().empty(); })) << "it holds nothing any more";
  EXPECT_TRUE(watched_by_otto->Read(&job)) << "nobody else is cut off";
  ottos.TryCancel();
  watched_by_otto->Finish();
}

TEST_F(Revoked, BoundsCountByName) {
  start({.requests_a_second = 1});
  const Keys anna = issue("anna", Role::observe), otto = token("otto", Role::observe);
  const auto list = [&](const Keys& keys) {
    grpc::ClientContext context;
    pb::ListJobsReply reply;
    return pb::Farm::NewStub(dial(keys))->ListJobs(&context, {}, &reply);
  };
  grpc::Status status;
  for (int i = 0; i < 100 && status.ok(); ++i) status = list(anna);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), HasSubstr("anna makes more than 1 requests a second"));
  status = list(otto);
  EXPECT_TRUE(status.ok()) << "from the same host";
  for (int i = 0; i < 100 && status.ok(); ++i) status = list(otto);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
}

}  // namespace
}  // namespace gleaner::test
