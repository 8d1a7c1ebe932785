// What the farm says of itself at a glance: whom it names, in which order, and that there is little of it.

#include <gmock/gmock.h>

#include <cmath>
#include <optional>

#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using testing::ElementsAre;

std::vector<std::string> ids_of(const FarmOverview& overview) {
  std::vector<std::string> ids;
  for (const auto& job : overview.jobs) ids.push_back(job.status.id);
  return ids;
}

std::size_t jobs_in(const FarmOverview& overview, JobState state) {
  const auto found = overview.jobs_in.find(state);
  return found == overview.jobs_in.end() ? 0 : found->second;
}

using Overview = FarmEngine;

TEST_F(Overview, AFarmWithNothing) {
  Farm farm(settings(), blobs_);
  const FarmOverview overview = farm.overview();
  EXPECT_TRUE(overview.jobs.empty());
  EXPECT_TRUE(overview.workers.empty());
  EXPECT_TRUE(overview.gone.empty());
  EXPECT_TRUE(overview.events.empty());
  EXPECT_NEAR(overview.unix_seconds, unix_now(), 10);
}

TEST_F(Overview, JobsThatRunThenThoseThatWaitThenThoseThatEnded) {
  FarmSettings one_at_a_time = settings();
  one_at_a_time.active_jobs = 1;
  Farm farm(one_at_a_time, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string first = farm.submit(request());
  serve(farm, worker, first);
  const std::string second = farm.submit(request());
  serve(farm, worker, second);
  const std::string runs = farm.submit(request());
  const std::string waits = farm.submit(request()), waits_more = farm.submit(request());
  farm.pause(waits_more, true);
  const FarmOverview all = farm.overview();
  EXPECT_THAT(ids_of(all), ElementsAre(runs, waits, waits_more, second, first));
  EXPECT_EQ(jobs_in(all, JobState::running), 1u);
  EXPECT_EQ(jobs_in(all, JobState::queued), 2u);
  EXPECT_EQ(jobs_in(all, JobState::done), 2u);
  EXPECT_EQ(all.paused, 1u);
  // Of each group the first one; all are counted.
  const FarmOverview few = farm.overview({.workers = 1, .gone = 1, .jobs = 1, .events = 3});
  EXPECT_THAT(ids_of(few), ElementsAre(runs, waits, second));
  EXPECT_EQ(few.jobs_in, all.jobs_in);
  ASSERT_EQ(few.events.size(), 3u);
  EXPECT_EQ(few.events[0].number, farm.last_event());  // the latest first
  EXPECT_EQ(few.events[2].number, farm.last_event() - 2);
}

TEST_F(Overview, BatchesOfAWorkerTheOneItHasAndTheLastOne) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  EXPECT_FALSE(farm.overview().workers.at(0).batch);
  EXPECT_FALSE(farm.overview().workers.at(0).last);
  const std::string job = farm.submit(request());
  const std::optional<Offered> offer = worker.next();
  ASSERT_TRUE(offer);
  const auto given = farm.overview().workers.at(0).batch;
  ASSERT_TRUE(given);
  EXPECT_EQ(given->job, job);
  EXPECT_EQ(given->stage, "scatter");
  EXPECT_EQ(given->kind, "fake-scatter");
  EXPECT_EQ(given->first, offer->lease.first);
  EXPECT_EQ(given->items, 256u);
  EXPECT_GE(given->seconds, 0);
  worker.deliver(*offer, worker.compute(*offer, blobs_), 0.25);
  const auto last = farm.overview().workers.at(0).last;
  ASSERT_TRUE(last);
  EXPECT_EQ(last->kind, "fake-scatter");
  EXPECT_EQ(last->items, 256u);
  EXPECT_EQ(last->seconds, 0.25);
}

TEST_F(Overview, WorkersThatGetNothingComeFirstAndThoseThatWentAreKnown) {
  Farm farm(settings(), blobs_);
  ScriptedWorker failing, serving, draining;
  std::optional<ScriptedWorker> lost(std::in_place), left(std::in_place);
  failing.join(farm, "failing");
  draining.join(farm, "draining");
  serving.join(farm, "serving");
  lost->join(farm, "lost");
  left->join(farm, "left");
  farm.drain(draining.id);
  farm.drain(left->id);
  left.reset();
  lost.reset();
  farm.submit(request());
  for (int time = 0; time < 3; ++time) {
    const auto offer = failing.next();
    ASSERT_TRUE(offer);
    farm.failed(failing.id, offer->lease.id, offer->lease.epoch, "no");
  }
  const FarmOverview overview = farm.overview();
  std::vector<std::string> names;
  for (const auto& worker : overview.workers) names.push_back(worker.status.id);
  EXPECT_THAT(names, ElementsAre("draining", "failing", "serving"));
  EXPECT_EQ(overview.workers_connected, 3u);
  EXPECT_EQ(overview.draining, 1u);
  EXPECT_EQ(overview.aside, 1u);
  ASSERT_EQ(overview.gone.size(), 2u);
  EXPECT_EQ(overview.gone[0].name, "lost");
  EXPECT_TRUE(overview.gone[0].lost);
  EXPECT_EQ(overview.gone[1].name, "left");
  EXPECT_FALSE(overview.gone[1].lost);
  EXPECT_EQ(overview.gone[1].device, "a script");
}

TEST_F(Overview, TheErrorOfTheFrameThatWasWrittenLast) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string unknown = farm.submit(request());
  serve(farm, worker, unknown);
  end_of(farm, unknown);
  EXPECT_FALSE(farm.overview().jobs.at(0).error);
  FrameSettings noisy = fake_settings();
  noisy.set["variance"] = "9";
  const std::string job = farm.submit(request(noisy));
  serve(farm, worker, job);
  end_of(farm, job);
  double mean = 0;
  const auto values = values_of<float>(fake_gather(fake_scatter(noisy.seed, 0, 32 * 16 * items_a_pixel), 0, 32 * 16));
  for (const float value : values) mean += value / static_cast<double>(values.size());
  const auto error = farm.overview().jobs.at(0).error;
  ASSERT_TRUE(error);
  EXPECT_EQ(error->frame, 1u);
  EXPECT_FALSE(error->denoised);
  EXPECT_NEAR(error->relative, 3 / mean, 1e-6 * 3 / mean);
}

// Jobs whose frames' numbers, stages or awaited jobs are many are told briefly.
TEST_F(Overview, LargeJobsAreTold) {
  FarmSettings one_at_a_time = settings();
  one_at_a_time.active_jobs = 1;
  Farm farm(one_at_a_time, blobs_);
  JobRequest large = request();
  for (std::uint32_t k = 0; k < most_frames; ++k) large.numbers.push_back(2 * k + 1);
  const std::string job = farm.submit(large);
  JobRequest awaiting = request();
  awaiting.after.assign(1000, job);
  farm.submit(awaiting);
  const FarmOverview overview = farm.overview();
  ASSERT_EQ(overview.jobs.size(), 2u);
  EXPECT_EQ(overview.jobs[0].status.frames, most_frames);
  EXPECT_TRUE(overview.jobs[0].status.written.empty());
  EXPECT_TRUE(overview.jobs[1].status.after.empty());
  EXPECT_EQ(farm.status(overview.jobs[1].status.id)->after.size(), 1000u);
}

}  // namespace
}  // namespace gleaner::test
