// Where a stage's inputs lie decides who gets which items, and when: spans near a worker, ranges computed again,
// pauses.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "coordinator/schedule/adjoining.h"
#include "coordinator/schedule/item_pool.h"
#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {
namespace {

using testing::HasSubstr;

constexpr WorkerId ada = 11, bob = 12, eve = 13;

SchedulerSettings fixed(std::uint64_t batch) {
  SchedulerSettings settings;
  settings.fixed_batch_items = batch;
  settings.in_flight = 1;
  return settings;
}

ScheduledStage stage_of(std::uint64_t items, std::uint32_t tile = 1) {
  ScheduledStage stage;
  stage.kind = "shade";
  stage.items = items;
  stage.tile = tile;
  return stage;
}

using Range = std::pair<std::uint64_t, std::uint64_t>;

// The ranges that the workers get, one after the other, each done before the next is asked for.
std::vector<Range> served(Scheduler& farm, const std::vector<WorkerId>& workers) {
  std::vector<Range> got;
  for (const WorkerId worker : workers) {
    const auto lease = farm.next_lease(worker, 0);
    got.emplace_back(lease ? lease->first : 999, lease ? lease->count : 999);
    if (lease) farm.result(worker, lease->id, lease->epoch, 0.1, 0.1);
  }
  return got;
}

TEST(ScheduleNear, AWorkerGetsItemsOfItsSpansFirst) {
  Scheduler farm(fixed(20));
  for (const WorkerId worker : {ada, bob, eve}) farm.worker_joined(worker, 0);
  ScheduledStage stage = stage_of(100);
  stage.near = {{bob, {{60, 30}, {95, 5}}}, {ada, {{30, 30}}}};
  const StageId id = farm.add_stage(stage, 0);
  EXPECT_EQ(
      served(farm, {bob, ada, bob, bob, ada, ada, eve, eve, bob}),
      (std::vector<Range>{{60, 20}, {30, 20}, {80, 10}, {95, 5}, {50, 10}, {0, 20}, {20, 10}, {90, 5}, {999, 999}}));
  EXPECT_TRUE(farm.complete(id));
}

TEST(ScheduleNear, SpansAreCutAtTiles) {
  Scheduler farm(fixed(1000));
  farm.worker_joined(ada, 0);
  ScheduledStage stage = stage_of(100, 16);
  stage.near = {{ada, {{10, 30}, {90, 10}}}};
  const StageId id = farm.add_stage(stage, 0);
  EXPECT_EQ(served(farm, {ada, ada, ada, ada}), (std::vector<Range>{{16, 16}, {96, 4}, {0, 16}, {32, 64}}));
  EXPECT_TRUE(farm.complete(id));
}

TEST(ScheduleNear, ItemsThatComeBackAreOfferedToWhoHoldsTheirInputs) {
  Scheduler farm(fixed(10));
  for (const WorkerId worker : {ada, bob, eve}) farm.worker_joined(worker, 0);
  ScheduledStage stage = stage_of(40);
  stage.near = {{ada, {{20, 10}}}};
  farm.add_stage(stage, 0);
  const auto first = farm.next_lease(ada, 0);
  ASSERT_EQ(first->first, 20u);
  EXPECT_EQ(served(farm, {bob}), (std::vector<Range>{{0, 10}}));
  ASSERT_TRUE(farm.failed(ada, first->id, first->epoch, 0, true).known);
  EXPECT_EQ(served(farm, {ada, ada}), (std::vector<Range>{{20, 10}, {10, 10}}));
}

SchedulerSettings one_at_a_time() {
  SchedulerSettings settings;
  settings.in_flight = 1;
  settings.first_batch_items = 100;
  return settings;
}

// Both have done 1,000 items a second.
void measure_both(Scheduler& farm) {
  for (const WorkerId worker : {ada, bob}) farm.worker_joined(worker, 0);
  const StageId all = farm.add_stage(stage_of(200), 0);
  while (!farm.complete(all))
    for (const WorkerId worker : {ada, bob})
      if (const auto lease = farm.next_lease(worker, 0))
        farm.result(worker, lease->id, lease->epoch, static_cast<double>(lease->count) / 1000, 0);
}

TEST(ScheduleNear, ItemsAreLeftToWhoHoldsTheirInputsWhereItIsSoonDone) {
  for (const std::uint64_t others : {80u, 5000u}) {
    Scheduler farm(one_at_a_time());
    measure_both(farm);
    ScheduledStage stage = stage_of(100 + others);
    stage.near = {{ada, {{0, 100}}}, {bob, {{100, others}}}};
    const StageId id = farm.add_stage(stage, 1);
    for (std::uint64_t own = 0; own < 100;) {
      const auto lease = farm.next_lease(ada, 1);
      ASSERT_TRUE(lease);
      ASSERT_EQ(lease->first, own);
      own += lease->count;
      farm.result(ada, lease->id, lease->epoch, static_cast<double>(lease->count) / 1000, 1.1);
    }
    const auto of_bob = farm.next_lease(bob, 1.1);
    ASSERT_TRUE(of_bob);
    ASSERT_LT(of_bob->count, others);
    const auto next = farm.next_lease(ada, 1.1);
    if (others == 5000) {
      EXPECT_TRUE(next) << "bob would take five seconds";
      continue;
    }
    EXPECT_FALSE(next) << "bob takes 80 ms";
    EXPECT_THAT(farm.why_waiting(id, 1.1), HasSubstr("kept for the workers that hold its inputs"));
    farm.worker_lost(bob, 1.2);
    EXPECT_TRUE(farm.next_lease(ada, 1.2)) << "nobody holds their inputs any more";
  }
}

// Bob holds what its items read: a hundredth of a second to fetch at 1 MB an item.
void add_stage_of_bob(Scheduler& farm, std::uint64_t items, double megabytes) {
  ScheduledStage stage = stage_of(items);
  stage.near = {{bob, {{0, items}}}};
  stage.near_bytes = megabytes * 1e6;
  farm.add_stage(stage, 1);
}

TEST(ScheduleNear, ItemsAreFetchedOnlyWhereTheirHolderWouldTakeLonger) {
  for (const double megabytes : {0.0, 1.0}) {
    Scheduler farm(one_at_a_time());
    measure_both(farm);
    add_stage_of_bob(farm, 500, megabytes);
    ASSERT_TRUE(farm.next_lease(bob, 1));
    const auto fetched = farm.next_lease(ada, 1);
    ASSERT_EQ(fetched.has_value(), megabytes == 0) << "bob takes half a second for all";
  }
  // Where it is long enough, a worker that fetches gets less.
  std::uint64_t got[2];
  for (const int megabytes : {0, 1}) {
    SchedulerSettings settings = one_at_a_time();
    settings.growth = 100;
    Scheduler farm(settings);
    measure_both(farm);
    add_stage_of_bob(farm, 5000, megabytes);
    ASSERT_TRUE(farm.next_lease(bob, 1));
    const auto fetched = farm.next_lease(ada, 1);
    ASSERT_TRUE(fetched);
    got[megabytes] = fetched->count;
  }
  EXPECT_LT(got[1], got[0] / 2);
}

TEST(ScheduleNear, WhoWouldHaveToFetchCopiesNoLeaseThatIsLittleLate) {
  for (const double megabytes : {0.0, 1.0}) {
    Scheduler farm(one_at_a_time());
    measure_both(farm);
    add_stage_of_bob(farm, 100, megabytes);
    for (std::uint64_t given = 0; given < 100;) {
      const auto lease = farm.next_lease(bob, 1);
      ASSERT_TRUE(lease);
      if ((given += lease->count) < 100) farm.result(bob, lease->id, lease->epoch, 0.001 * lease->count, 1);
    }
    const bool copies = farm.next_lease(ada, 1.4).has_value();
    EXPECT_EQ(copies, megabytes == 0);
    EXPECT_TRUE(copies || farm.next_lease(ada, 4)) << "it may never come";
  }
}

TEST(ScheduleNear, WhoIsIdleKeepsNoItems) {
  Scheduler farm(one_at_a_time());
  measure_both(farm);
  ScheduledStage stage = stage_of(50);
  stage.near = {{bob, {{0, 50}}}};
  farm.add_stage(stage, 1);
  EXPECT_TRUE(farm.next_lease(ada, 1)) << "bob may never ask";
}

TEST(ScheduleNear, WhoIsBusyWithASoloStageKeepsNoItems) {
  Scheduler farm(one_at_a_time());
  measure_both(farm);
  ScheduledStage solo = stage_of(1);
  solo.kind = "tree";
  solo.solo = true;
  solo.preferred = {bob};
  farm.add_stage(solo, 1);
  ASSERT_TRUE(farm.next_lease(bob, 1));
  ScheduledStage stage = stage_of(50);
  stage.near = {{bob, {{0, 50}}}};
  farm.add_stage(stage, 1);
  EXPECT_TRUE(farm.next_lease(ada, 1));
}

TEST(ScheduleAdjoining, EachWorkersItemsLieTogether) {
  Scheduler farm(fixed(10));
  for (const WorkerId worker : {ada, bob, eve}) farm.worker_joined(worker, 0);
  ScheduledStage stage = stage_of(100);
  stage.adjoining = true;
  const StageId id = farm.add_stage(stage, 0);
  EXPECT_EQ(served(farm, {ada, bob, eve, ada, bob, eve}),
            (std::vector<Range>{{0, 10}, {50, 10}, {80, 10}, {10, 10}, {60, 10}, {90, 10}}));
  // Eve has come to the end: she gets the last of what ada would come to.
  EXPECT_EQ(served(farm, {eve, bob, eve, ada}), (std::vector<Range>{{30, 10}, {70, 10}, {40, 10}, {20, 10}}));
  EXPECT_TRUE(farm.complete(id));
}

// Whatever runs are free, who goes on where, and how much is wanted: fewer than one item, where a worker is slow.
TEST(ScheduleAdjoining, FreeItemsAreOfferedWhereThereAreAny) {
  std::mt19937 random(5);
  for (int round = 0; round < 2000; ++round) {
    const std::uint32_t tile = std::vector<std::uint32_t>{1, 2, 16}[random() % 3];
    ItemPool pool;
    pool.put({0, 1 + random() % 64, {}});
    Adjoining adjoining;
    while (pool.items() > 0) {
      const WorkerId worker = 1 + random() % 3;
      const double wanted = std::vector<double>{0.1, 1, 2.5, 7, 100}[random() % 5];
      const Piece piece = adjoining.offer(pool, worker, tile, wanted);
      ASSERT_GT(piece.count, 0u) << pool.items() << " items are free";
      ASSERT_EQ(piece.first % tile, 0u);
      ASSERT_EQ(pool.from(piece.first).count, piece.count);
      const std::uint64_t count = std::min<std::uint64_t>(piece.count, tile * (1 + random() % 3));
      pool.take(piece.first, count);
      adjoining.gave(worker, piece.first + count);
      if (random() % 8 == 0) adjoining.forget(1 + random() % 3);
    }
  }
}

TEST(ScheduleAdjoining, NobodyMakesRoomForWhoIsGone) {
  Scheduler farm(fixed(16));
  for (const WorkerId worker : {ada, bob}) farm.worker_joined(worker, 0);
  ScheduledStage stage = stage_of(96, 16);
  stage.adjoining = true;
  farm.add_stage(stage, 0);
  EXPECT_EQ(served(farm, {ada}), (std::vector<Range>{{0, 16}}));
  farm.worker_lost(ada, 1);
  EXPECT_EQ(served(farm, {bob, bob}), (std::vector<Range>{{16, 16}, {32, 16}}));
}

TEST(ScheduleAdjoining, ItemsThatFailedComeFirstAndMoveNobody) {
  Scheduler farm(fixed(10));
  for (const WorkerId worker : {ada, bob}) farm.worker_joined(worker, 0);
  ScheduledStage stage = stage_of(100);
  stage.adjoining = true;
  farm.add_stage(stage, 0);
  const auto bad = farm.next_lease(ada, 0);
  EXPECT_EQ(served(farm, {bob}), (std::vector<Range>{{50, 10}}));
  farm.failed(ada, bad->id, bad->epoch, 0);
  EXPECT_EQ(served(farm, {bob, bob, ada}), (std::vector<Range>{{0, 10}, {60, 10}, {10, 10}}));
}

TEST(ScheduleRanges, RunsThoseAloneThatAreAskedFor) {
  Scheduler farm(fixed(15));
  farm.worker_joined(ada, 0);
  ScheduledStage stage = stage_of(100);
  stage.only = {{10, 20}, {70, 5}};
  const StageId id = farm.add_stage(stage, 0);
  EXPECT_EQ(served(farm, {ada, ada}), (std::vector<Range>{{10, 15}, {25, 5}}));
  EXPECT_FALSE(farm.complete(id));
  EXPECT_EQ(served(farm, {ada, ada}), (std::vector<Range>{{70, 5}, {999, 999}}));
  EXPECT_TRUE(farm.complete(id));
}

TEST(ScheduleRanges, AvoidsWorkersWhileOthersCan) {
  Scheduler farm(fixed(100));
  farm.worker_joined(ada, 0);
  farm.worker_joined(bob, 0);
  ScheduledStage stage = stage_of(100);
  stage.only = {{10, 20}};
  stage.avoid = {ada};
  stage.solo = true;
  farm.add_stage(stage, 0);
  EXPECT_FALSE(farm.next_lease(ada, 0));
  const auto lease = farm.next_lease(bob, 0);
  ASSERT_TRUE(lease);
  EXPECT_EQ(lease->count, 20u);
  farm.worker_lost(bob, 1);
  EXPECT_TRUE(farm.next_lease(ada, 1)) << "nobody else is left";
}

TEST(SchedulePause, APausedStageHandsOutNothingAndTakesWhatIsOut) {
  Scheduler farm(fixed(10));
  farm.worker_joined(ada, 0);
  farm.worker_joined(bob, 0);
  const StageId paused = farm.add_stage(stage_of(20), 0), other = farm.add_stage(stage_of(10), 0);
  const auto out = farm.next_lease(ada, 0);
  farm.pause(paused);
  EXPECT_THAT(farm.why_waiting(paused, 0), HasSubstr("inputs"));
  const auto elsewhere = farm.next_lease(bob, 0);
  ASSERT_TRUE(elsewhere);
  EXPECT_EQ(elsewhere->stage, other);
  farm.result(bob, elsewhere->id, elsewhere->epoch, 0.1, 1);
  EXPECT_EQ(farm.result(ada, out->id, out->epoch, 0.1, 1).verdict, Verdict::accepted);
  EXPECT_FALSE(farm.next_lease(ada, 2));
  farm.resume(paused);
  const auto next = farm.next_lease(ada, 3);
  ASSERT_TRUE(next);
  EXPECT_EQ(next->stage, paused);
}

TEST(SchedulePause, NobodyRunsACopyOfAPausedStagesSlowLease) {
  Scheduler farm(fixed(10));
  farm.worker_joined(ada, 0);
  farm.worker_joined(bob, 0);
  const StageId stage = farm.add_stage(stage_of(10), 0);
  ASSERT_TRUE(farm.next_lease(ada, 0));
  farm.pause(stage);
  EXPECT_FALSE(farm.next_lease(bob, 100));
  farm.resume(stage);
  EXPECT_TRUE(farm.next_lease(bob, 100));
}

TEST(ScheduleBlame, AnInputThatIsNotThereIsNobodysFault) {
  SchedulerSettings settings = fixed(10);
  settings.strikes = 2;
  Scheduler farm(settings);
  farm.worker_joined(ada, 0);
  farm.add_stage(stage_of(10), 0);
  for (int i = 0; i < 10; ++i) {
    const auto lease = farm.next_lease(ada, i);
    ASSERT_TRUE(lease) << "neither the items nor the worker has a strike";
    const FailureOutcome outcome = farm.failed(ada, lease->id, lease->epoch, i, true);
    EXPECT_TRUE(outcome.known);
    EXPECT_FALSE(outcome.stage_failed);
  }
  const auto lease = farm.next_lease(ada, 20);
  EXPECT_FALSE(farm.failed(ada, lease->id, lease->epoch, 20).stage_failed) << "the first strike";
}

TEST(ItemPoolTake, FromAnywhereInARunAgainstAPlainSet) {
  std::mt19937 random(3);
  for (int round = 0; round < 100; ++round) {
    ItemPool pool;
    std::vector<bool> free(200, true);
    pool.put({0, 200, {}});
    for (int step = 0; step < 60; ++step) {
      const std::uint64_t first = random() % 200, count = 1 + random() % 40;
      const std::uint32_t tile = std::vector<std::uint32_t>{1, 4, 16}[random() % 3];
      const Piece piece = pool.within(first, count, tile);
      // The same, looked for item by item.
      std::uint64_t begin = first;
      const auto is_free = [&](std::uint64_t i) { return i < 200 && free[i]; };
      std::uint64_t end = begin;
      for (; begin < first + count; ++begin) {
        if (!is_free(begin) || begin % tile != 0) continue;
        for (end = begin; end < first + count && is_free(end); ++end) continue;
        if (is_free(end)) end = end / tile * tile;  // the run goes on behind it
        if (end > begin) break;
      }
      if (begin >= first + count || end <= begin) {
        ASSERT_EQ(piece.count, 0u);
        continue;
      }
      ASSERT_EQ(piece.first, begin);
      ASSERT_EQ(piece.count, end - begin);
      const std::uint64_t some = 1 + random() % piece.count;
      pool.take(piece.first, some);
      for (std::uint64_t i = 0; i < some; ++i) free[piece.first + i] = false;
      ASSERT_EQ(pool.items(), static_cast<std::uint64_t>(std::count(free.begin(), free.end(), true)));
      if (random() % 4 == 0) {
        pool.put({piece.first, some, {}});
        for (std::uint64_t i = 0; i < some; ++i) free[piece.first + i] = true;
      }
    }
  }
}

}  // namespace
}  // namespace gleaner::coordinator
