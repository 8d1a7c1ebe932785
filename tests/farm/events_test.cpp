// What a farm tells programs that act upon it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "coordinator/jobs/event_log.h"
#include "tests/farm/scripted_farm.h"
#include "tests/farm/wire_farm.h"

namespace gleaner::test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

std::vector<std::string> words_of(const std::vector<FarmEvent>& events) {
  std::vector<std::string> words;
  for (const FarmEvent& event : events) words.push_back(event.kind + " " + event.what);
  return words;
}

TEST(EventLog, NumbersGrowAndWhatIsNoLongerThereIsSaid) {
  EventLog log(3);
  EXPECT_EQ(log.last(), std::uint64_t{3} << 32);
  for (int i = 0; i < 10003; ++i)
    log.add({.kind = "job", .what = "submitted", .job = i % 2 ? "a" : "b", .worker = {}, .message = {}});
  const std::uint64_t last = log.last();
  EXPECT_EQ(last, (std::uint64_t{3} << 32) + 10003);
  EXPECT_THAT(log.after(last, ""), IsEmpty());
  EXPECT_THAT(log.after(last - 2, ""), SizeIs(2));
  EXPECT_THAT(log.after(last - 3, "b"), SizeIs(2));
  EXPECT_THAT(log.after(last - 10000, ""), SizeIs(10000));
  for (const std::uint64_t before : {last - 10001, std::uint64_t{7}}) {
    const auto all = log.after(before, "");
    ASSERT_THAT(all, SizeIs(10001));
    EXPECT_EQ(all.front().kind, "missed");
    EXPECT_EQ(all.front().number + 1, all[1].number);
  }
  EXPECT_GT(EventLog(4).last(), last) << "of the coordinator's next start";
}

class Events : public FarmEngine {};

TEST_F(Events, AJobFromItsSubmissionToItsEnd) {
  Farm farm(settings(), blobs_);
  const std::uint64_t begin = farm.last_event();
  ScriptedWorker ada;
  ada.join(farm, "ada");
  JobRequest two = request();
  two.last_frame = 2;
  const std::string job = farm.submit(two);
  farm.pause(job, true);
  farm.pause(job, false);
  serve(farm, ada, job);
  const auto of_job = farm.events(begin, job, 0);
  std::vector<std::string> words = words_of(of_job);
  // The next frame begins before or after the one before it is written.
  std::erase(words, "frame started");
  EXPECT_THAT(words, ElementsAre("job submitted", "job started", "job paused", "job resumed", "frame written",
                                 "frame written", "job done"));
  EXPECT_EQ(of_job.size(), words.size() + 1) << "two frames that show one picture begin as one";
  for (std::size_t i = 1; i < of_job.size(); ++i) EXPECT_GT(of_job[i].number, of_job[i - 1].number);
  ada.leave();
  const auto all = farm.events(begin, "", 0);
  EXPECT_EQ(words_of(all).front(), "worker joined");
  EXPECT_EQ(words_of(all).back(), "worker left");
  EXPECT_EQ(all.back().worker, "ada");
}

TEST_F(Events, FailuresSayWhy) {
  FarmSettings farm_settings = settings();
  farm_settings.paths = [this](const std::string&, std::uint32_t) {
    std::ofstream(folder_.path() / "file") << "not a folder";
    return FramePaths{folder_.path() / "file" / "frame.exr", {}, {}};
  };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker ada;
  ada.join(farm, "ada");
  const std::uint64_t begin = farm.last_event();
  const std::string job = farm.submit(request());
  serve(farm, ada, job);
  std::vector<FarmEvent> failed = farm.events(begin, job, 0);
  std::erase_if(failed, [](const FarmEvent& event) { return event.what != "failed"; });
  ASSERT_EQ(words_of(failed), (std::vector<std::string>{"frame failed", "job failed"}));
  for (const FarmEvent& event : failed) EXPECT_THAT(event.message, HasSubstr("cannot make the folder"));
}

TEST(EventsOnTheWire, AStreamOfOneJobEndsWithIt) {
  WireFarm farm;
  auto people = pb::Farm::NewStub(farm.socket_channel());
  const auto watch = [&](grpc::ClientContext& context, const std::string& job, std::uint64_t after) {
    pb::WatchEventsRequest request;
    request.set_job(job);
    request.set_after(after);
    return people->WatchEvents(&context, request);
  };
  grpc::ClientContext all_context, context, again_context, unknown_context;
  auto all = watch(all_context, "", 0);
  all->WaitForInitialMetadata();
  grpc::ClientContext submitting;
  pb::SubmitJobReply submitted;
  ASSERT_TRUE(people->SubmitJob(&submitting, farm.good_request(), &submitted).ok());
  pb::Event event;
  ASSERT_TRUE(all->Read(&event));
  EXPECT_EQ(event.kind() + " " + event.what(), "job submitted");
  EXPECT_EQ(event.job(), submitted.job());
  auto one = watch(context, submitted.job(), event.number());
  ASSERT_TRUE(one->Read(&event));
  EXPECT_EQ(event.what(), "started");
  farm.farm().cancel(submitted.job());
  std::string last;
  while (one->Read(&event)) last = event.what();
  EXPECT_TRUE(one->Finish().ok());
  EXPECT_EQ(last, "cancelled");
  auto again = watch(again_context, submitted.job(), 0);
  EXPECT_FALSE(again->Read(&event)) << "it has ended";
  EXPECT_TRUE(again->Finish().ok());
  auto unknown = watch(unknown_context, "no-such-job", 0);
  EXPECT_FALSE(unknown->Read(&event));
  EXPECT_EQ(unknown->Finish().error_code(), grpc::StatusCode::NOT_FOUND);
  all_context.TryCancel();
  all->Finish();
}

}  // namespace
}  // namespace gleaner::test
