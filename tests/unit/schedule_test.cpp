#include "coordinator/schedule/scheduler.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

constexpr WorkerId kAda = 11, kBob = 12, kEve = 13;

SchedulerSettings fixed(std::uint64_t batch) {
  SchedulerSettings settings;
  settings.fixed_batch_items = batch;
  return settings;
}

ScheduledStage stage_of(std::uint64_t items, std::uint32_t tile = 1) {
  ScheduledStage stage;
  stage.kind = "shade";
  stage.items = items;
  stage.tile = tile;
  return stage;
}

ResultOutcome deliver(Scheduler& farm, const Lease& lease, Seconds seconds, Seconds now) {
  return farm.result(lease.worker, lease.id, lease.epoch, seconds, now);
}

// -- Ownership: result x epoch x state of the batch ------------------------------------------------------------------

struct Case {
  const char* state;
  // Brings the farm into the state and returns the lease whose result comes in.
  Lease (*bring)(Scheduler&);
  Verdict expected;
  const char* message = "as handed out";
  WorkerId worker = kAda;  // who sends it
  std::int64_t epoch_off = 0;
};

Lease take(Scheduler& farm, WorkerId worker, Seconds now = 0) {
  const auto lease = farm.next_lease(worker, now);
  EXPECT_TRUE(lease.has_value()) << "worker " << worker << " got no lease at " << now;
  return lease.value_or(Lease{});
}

// Every case begins with Ada holding items [0, 10) of stage 1, of 100 items, and Bob idle.
Lease held(Scheduler& farm) { return take(farm, kAda); }
Lease accepted(Scheduler& farm) {
  const Lease lease = held(farm);
  EXPECT_EQ(deliver(farm, lease, 1, 1).verdict, Verdict::accepted);
  return lease;
}
Lease lost(Scheduler& farm) {
  const Lease lease = held(farm);
  farm.worker_lost(kAda, 1);
  return lease;
}
Lease rejoined(Scheduler& farm) {
  const Lease lease = lost(farm);
  farm.worker_joined(kAda, 2);
  return lease;
}
Lease ran_out(Scheduler& farm) {
  const Lease lease = held(farm);
  EXPECT_EQ(farm.expire(1000).size(), 1u);
  return lease;
}
Lease ran_out_and_done_by_another(Scheduler& farm) {
  const Lease lease = ran_out(farm);
  const Lease again = take(farm, kBob, 1000);
  EXPECT_EQ(again.first, lease.first);
  EXPECT_EQ(deliver(farm, again, 1, 1001).verdict, Verdict::accepted);
  return lease;
}
Lease given_up(Scheduler& farm) {
  const Lease lease = held(farm);
  EXPECT_TRUE(farm.failed(kAda, lease.id, lease.epoch, 1).known);
  return lease;
}
Lease cancelled(Scheduler& farm) {
  const Lease lease = held(farm);
  EXPECT_EQ(farm.remove_stage(1).size(), 1u);
  return lease;
}
Lease all_done(Scheduler& farm) {
  const Lease first = held(farm);
  deliver(farm, first, 1, 1);
  for (int i = 1; i < 10; ++i) deliver(farm, take(farm, kBob, i), 1, i + 1);
  EXPECT_TRUE(farm.complete(1));
  return first;
}
Lease all_done_and_forgotten(Scheduler& farm) {
  const Lease lease = all_done(farm);
  EXPECT_TRUE(farm.remove_stage(1).empty());
  return lease;
}
Lease stage_failed(Scheduler& farm) {
  farm.worker_joined(kEve, 0);
  const Lease elsewhere = held(farm);
  for (int strike = 0; strike < 3; ++strike) {
    const WorkerId who[] = {kBob, kEve, kAda};
    const Lease bad = take(farm, who[strike], 0);
    EXPECT_EQ(bad.first, 10u);
    EXPECT_EQ(farm.failed(who[strike], bad.id, bad.epoch, 1).stage_failed, strike == 2);
  }
  return elsewhere;
}
Lease never_given(Scheduler& farm) {
  Lease lease = held(farm);
  lease.id += 1000;
  return lease;
}
Lease number_zero(Scheduler& farm) {
  Lease lease = held(farm);
  lease.id = 0;
  return lease;
}
// Everything is done but `slow` of Ada's batches; idle Bob runs one of them as well, and is first.
Lease beaten_by_twin(Scheduler& farm, int slow) {
  std::vector<Lease> leases;
  for (int i = 0; i < slow; ++i) leases.push_back(take(farm, kAda));
  for (int i = slow; i < 10; ++i) deliver(farm, take(farm, kBob, i), 1, i + 1);
  const Lease twin = take(farm, kBob, 50);
  EXPECT_TRUE(twin.duplicate);
  const ResultOutcome won = deliver(farm, twin, 1, 51);
  EXPECT_EQ(won.verdict, Verdict::accepted);
  EXPECT_EQ(won.revoke.size(), 1u);
  for (const Lease& lease : leases) {
    if (lease.first == twin.first) return lease;
  }
  ADD_FAILURE() << "the twin's items " << twin.first << " were nobody's";
  return {};
}
Lease twin_won(Scheduler& farm) { return beaten_by_twin(farm, 2); }
Lease twin_won_and_stage_done(Scheduler& farm) { return beaten_by_twin(farm, 1); }
Lease before_restart(Scheduler& farm) {
  SchedulerSettings before = fixed(10);
  before.incarnation = 6;
  Scheduler old(before);
  old.worker_joined(kAda, 0);
  old.add_stage(stage_of(100), 0);
  held(farm);  // the same worker holds the same items again
  return take(old, kAda);
}

const Case kOwnership[] = {
    {"held", held, Verdict::accepted},
    {"held", held, Verdict::stale, "an older epoch", kAda, -1},
    {"held", held, Verdict::stale, "a later epoch", kAda, +1},
    {"held", held, Verdict::wrong_worker, "from another worker", kBob},
    {"held", held, Verdict::wrong_worker, "from another worker, another epoch", kBob, 1},
    {"held", held, Verdict::wrong_worker, "from a worker that never joined", 99},
    {"accepted", accepted, Verdict::duplicate, "sent twice"},
    {"accepted", accepted, Verdict::stale, "sent twice, an older epoch", kAda, -1},
    {"accepted", accepted, Verdict::wrong_worker, "from another worker", kBob},
    {"its worker was lost", lost, Verdict::stale},
    {"its worker came back", rejoined, Verdict::stale},
    {"ran out", ran_out, Verdict::stale},
    {"ran out", ran_out, Verdict::wrong_worker, "from another worker", kBob},
    {"ran out, then done by another", ran_out_and_done_by_another, Verdict::stale},
    {"given up as failed", given_up, Verdict::stale},
    {"its twin was first", twin_won, Verdict::duplicate},
    {"its twin was first and finished the stage", twin_won_and_stage_done, Verdict::stage_gone},
    {"stage cancelled", cancelled, Verdict::stage_gone},
    {"stage cancelled", cancelled, Verdict::stage_gone, "from a worker that never joined", 99},
    {"stage complete", all_done, Verdict::stage_gone},
    {"stage complete and removed", all_done_and_forgotten, Verdict::stage_gone},
    {"stage failed", stage_failed, Verdict::stage_gone},
    {"never handed out", never_given, Verdict::unknown_lease},
    {"number zero", number_zero, Verdict::unknown_lease},
    {"handed out before a restart", before_restart, Verdict::unknown_lease},
};

TEST(Ownership, EachResultMeetsItsVerdictAndCountsOnce) {
  for (const Case& c : kOwnership) {
    SCOPED_TRACE(std::string(c.state) + ", result " + c.message);
    SchedulerSettings settings = fixed(10);
    settings.incarnation = 7;
    Scheduler farm(settings);
    farm.worker_joined(kAda, 0);
    farm.worker_joined(kBob, 0);
    const StageId stage = farm.add_stage(stage_of(100), 0);
    ASSERT_EQ(stage, 1u);
    const Lease lease = c.bring(farm);
    const std::uint64_t before = farm.items_done(stage);
    const Verdict verdict = farm.result(c.worker, lease.id, lease.epoch + c.epoch_off, 1, 2000).verdict;
    EXPECT_STREQ(verdict_name(verdict), verdict_name(c.expected));
    EXPECT_EQ(farm.items_done(stage) - before, c.expected == Verdict::accepted ? lease.count : 0u);
    // Whatever came, nothing is counted at a second time.
    const std::uint64_t after = farm.items_done(stage);
    EXPECT_NE(farm.result(c.worker, lease.id, lease.epoch + c.epoch_off, 1, 2001).verdict, Verdict::accepted);
    EXPECT_EQ(farm.items_done(stage), after);
  }
}

// -- Sizes of batches ------------------------------------------------------------------------------------------------

// One worker that runs `items_per_second`: takes a lease and delivers it when it is done.
Lease work(Scheduler& farm, WorkerId worker, double items_per_second, Seconds& now) {
  const Lease lease = take(farm, worker, now);
  const Seconds seconds = static_cast<double>(lease.count) / items_per_second;
  now += seconds;
  EXPECT_EQ(deliver(farm, lease, seconds, now).verdict, Verdict::accepted);
  return lease;
}

TEST(Batches, NeverCutATile) {
  for (const std::uint32_t tile : {1u, 7u, 64u, 1000u}) {
    Scheduler farm;
    for (WorkerId worker = 1; worker <= 5; ++worker) farm.worker_joined(worker, 0);
    const std::uint64_t items = 100'003;
    const StageId stage = farm.add_stage(stage_of(items, tile), 0);
    Seconds now = 0;
    for (int turn = 0; !farm.complete(stage); ++turn) {
      ASSERT_LT(turn, 1'000'000);
      const WorkerId worker = 1 + turn % 5;
      const auto lease = farm.next_lease(worker, now);
      if (!lease) continue;
      EXPECT_EQ(lease->first % tile, 0u);
      const std::uint64_t end = lease->first + lease->count;
      EXPECT_TRUE(end % tile == 0 || end == items) << "[" << lease->first << ", " << end << ") cuts a tile of " << tile;
      now += 0.01;
      deliver(farm, *lease, static_cast<double>(lease->count) / (1000.0 * static_cast<double>(worker)), now);
    }
  }
}

TEST(Batches, GrowByTheCapUntilTheyLastTheTarget) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(1'000'000'000), 0);
  Seconds now = 0;
  // 4096 items at 1e6 a second are too short to be measured, 8192 are not; 0.5 s would be 500,000.
  std::vector<std::uint64_t> sizes;
  for (int i = 0; i < 10; ++i) sizes.push_back(work(farm, kAda, 1e6, now).count);
  EXPECT_EQ(sizes,
            (std::vector<std::uint64_t>{4096, 8192, 16384, 32768, 65536, 131072, 262144, 500000, 500000, 500000}));
}

TEST(Batches, BelieveBadNewsMoreThanGood) {
  Scheduler farm(fixed(1000));
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(1'000'000), 0);
  Seconds now = 0;
  const auto news = [&](double rate) {
    work(farm, kAda, rate, now);
    return farm.items_per_second(kAda, "shade");
  };
  EXPECT_EQ(farm.items_per_second(kAda, "shade"), 0);
  EXPECT_DOUBLE_EQ(news(1000), 1000);
  EXPECT_DOUBLE_EQ(news(2000), 1000 + 0.2 * (2000 - 1000));
  EXPECT_DOUBLE_EQ(news(200), 1200 + 0.5 * (200 - 1200));
  EXPECT_EQ(farm.items_per_second(kAda, "another kind"), 0);
  EXPECT_EQ(farm.items_per_second(kBob, "shade"), 0);
}

TEST(Batches, IgnoreSamplesTooShortToMeanAnything) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(10'000), 0);
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  for (const Seconds seconds : {0.0, 0.0049, -1.0, nan, infinity}) {
    EXPECT_EQ(deliver(farm, take(farm, kAda), seconds, 1).verdict, Verdict::accepted);
    EXPECT_EQ(farm.items_per_second(kAda, "shade"), 0) << "after a batch of " << seconds << " s";
  }
  deliver(farm, take(farm, kAda), 0.005, 1);
  EXPECT_DOUBLE_EQ(farm.items_per_second(kAda, "shade"), 10 / 0.005);
  deliver(farm, take(farm, kAda), 0.001, 1);
  EXPECT_DOUBLE_EQ(farm.items_per_second(kAda, "shade"), 10 / 0.005);
}

TEST(Batches, DoubleWhileAWorkerThatBecameFastCannotBeMeasured) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(1'000'000'000), 0);
  Seconds now = 0;
  for (int i = 0; i < 5; ++i) work(farm, kAda, 1e4, now);
  // A thousand times faster: 5000 items take 0.5 ms.
  std::vector<std::uint64_t> sizes;
  for (int i = 0; i < 5; ++i) sizes.push_back(work(farm, kAda, 1e7, now).count);
  EXPECT_EQ(sizes, (std::vector<std::uint64_t>{5000, 10'000, 20'000, 40'000, 80'000}));
  EXPECT_GT(farm.items_per_second(kAda, "shade"), 1e6);
}

TEST(Batches, OneAtATimeUntilTheThroughputIsKnown) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  const StageId stage = farm.add_stage(stage_of(1'000'000), 0);
  const Lease first = take(farm, kAda);
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  EXPECT_EQ(farm.why_waiting(stage, 0), "worker 11 runs its first batch of shade");
  deliver(farm, first, 1, 1);
  take(farm, kAda, 1);
  EXPECT_TRUE(farm.next_lease(kAda, 1).has_value());
}

TEST(Batches, NothingWaitsForAWorkerThatHasItsShare) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  // Both are known to run 4096 items a second; of the last 400 each may have half.
  const StageId first = farm.add_stage(stage_of(160'000), 0);
  deliver(farm, take(farm, kAda), 1, 1);
  deliver(farm, take(farm, kBob), 1, 1);
  farm.remove_stage(first);
  const StageId stage = farm.add_stage(stage_of(400), 1);
  EXPECT_EQ(take(farm, kAda, 1).count, 204u);  // 0.05 s
  EXPECT_FALSE(farm.next_lease(kAda, 1).has_value());
  EXPECT_EQ(take(farm, kBob, 1).count, 196u);
  EXPECT_EQ(farm.why_waiting(stage, 1), "");
}

TEST(Batches, ThroughputIsRememberedAcrossStages) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  Seconds now = 0;
  const StageId first = farm.add_stage(stage_of(10'000'000), now);
  while (!farm.complete(first)) work(farm, kAda, 1e6, now);
  farm.remove_stage(first);
  farm.add_stage(stage_of(10'000'000), now);
  EXPECT_NEAR(static_cast<double>(take(farm, kAda, now).count), 500'000, 2);
}

TEST(Batches, ShrinkTowardsTheEndButNotBelowTheSmallest) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  const StageId stage = farm.add_stage(stage_of(4'000'000), 0);
  // Both run at the same pace, one batch after the other.
  std::map<WorkerId, Seconds> now;
  std::vector<std::uint64_t> sizes;
  while (!farm.complete(stage)) {
    const WorkerId worker = now[kAda] <= now[kBob] ? kAda : kBob;
    const auto lease = farm.next_lease(worker, now[worker]);
    if (!lease || lease->duplicate) break;
    sizes.push_back(lease->count);
    now[worker] += static_cast<double>(lease->count) / 1e6;
    deliver(farm, *lease, static_cast<double>(lease->count) / 1e6, now[worker]);
  }
  EXPECT_TRUE(farm.complete(stage));
  const auto largest = std::max_element(sizes.begin(), sizes.end());
  EXPECT_NEAR(static_cast<double>(*largest), 5e5, 1);
  // The last one is what is left; before it nothing is below 0.05 s.
  for (auto at = largest; at + 1 != sizes.end(); ++at) EXPECT_GE(*at, 49'999u);
  EXPECT_LE(sizes.back(), 50'001u);
  EXPECT_NEAR(now[kAda], now[kBob], 0.06);
}

TEST(Batches, AStageWithoutItemsIsCompleteAtOnce) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  const StageId stage = farm.add_stage(stage_of(0), 0);
  EXPECT_TRUE(farm.complete(stage));
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  EXPECT_EQ(farm.why_waiting(stage, 0), "");
}

TEST(Batches, ATileOfZeroIsAnError) {
  Scheduler farm;
  EXPECT_THROW(farm.add_stage(stage_of(10, 0), 0), Error);
}

// -- Loss, expiry, lateness ------------------------------------------------------------------------------------------

TEST(Leases, ALostWorkersItemsGoBackAtOnce) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(100), 0);
  const Lease first = take(farm, kAda), second = take(farm, kAda);
  EXPECT_EQ(take(farm, kBob).first, 20u);
  farm.worker_lost(kAda, 1);
  const Lease again = take(farm, kBob, 1);
  EXPECT_EQ(again.first, first.first);
  EXPECT_GT(again.epoch, second.epoch);
  EXPECT_FALSE(farm.next_lease(kAda, 1).has_value());
}

TEST(Leases, LastTheFloorOrSoManyTimesTheExpected) {
  for (const Seconds floor : {1.0, 10.0}) {
    SchedulerSettings settings;
    settings.lease_floor = floor;
    Scheduler farm(settings);
    farm.worker_joined(kAda, 0);
    farm.worker_joined(kBob, 0);
    farm.add_stage(stage_of(1'000'000'000), 0);
    const Lease first = take(farm, kAda);
    EXPECT_DOUBLE_EQ(first.expires, floor);  // nobody knows how long it takes
    EXPECT_EQ(farm.next_expiry(), first.expires);
    deliver(farm, first, 0.5, 0.5);
    // 8192 items a second: the next one takes 0.5 s, the one behind it ends 1 s from now; 8 times that.
    EXPECT_DOUBLE_EQ(take(farm, kAda, 0.5).expires, 0.5 + std::max(floor, 4.0));
    EXPECT_DOUBLE_EQ(take(farm, kAda, 0.5).expires, 0.5 + std::max(floor, 8.0));
  }
}

TEST(Leases, ThatRanOutAreHandedToOthersAndDroppedWhenLate) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  const StageId stage = farm.add_stage(stage_of(10), 0);
  const Lease slow = take(farm, kAda);
  const std::vector<Lease> out = farm.expire(slow.expires);
  ASSERT_EQ(out.size(), 1u);
  EXPECT_EQ(out[0].id, slow.id);
  EXPECT_FALSE(farm.next_lease(kAda, slow.expires).has_value()) << "a silent worker got more while another serves";
  const Lease again = take(farm, kBob, slow.expires);
  EXPECT_EQ(deliver(farm, slow, 11, slow.expires + 1).verdict, Verdict::stale);
  EXPECT_EQ(farm.items_done(stage), 0u);
  EXPECT_EQ(deliver(farm, again, 1, slow.expires + 2).verdict, Verdict::accepted);
}

TEST(Leases, ALateResultShowsThatItsWorkerLivesAndHowFastItIs) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(1'000'000), 0);
  const Lease slow = take(farm, kAda);
  EXPECT_EQ(farm.expire(10).size(), 1u);
  EXPECT_DOUBLE_EQ(farm.items_per_second(kAda, "shade"), 409.6) << "at most";
  EXPECT_FALSE(farm.next_lease(kAda, 11).has_value());
  EXPECT_EQ(deliver(farm, slow, 20, 12).verdict, Verdict::stale);
  EXPECT_DOUBLE_EQ(farm.items_per_second(kAda, "shade"), 409.6 + 0.5 * (204.8 - 409.6));
  EXPECT_TRUE(farm.next_lease(kAda, 12).has_value());
}

TEST(Leases, OfALoneWorkerWaitBehindALateBatch) {
  SchedulerSettings settings;
  settings.lease_floor = 1;
  Scheduler farm(settings);
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(100'000'000), 0);
  deliver(farm, take(farm, kAda), 0.5, 0.5);
  const Lease running = take(farm, kAda, 0.5), waiting = take(farm, kAda, 0.5);
  // Expected to end at 1.0 and 1.5.
  EXPECT_DOUBLE_EQ(running.expires, 4.5);
  EXPECT_DOUBLE_EQ(waiting.expires, 8.5);
  EXPECT_TRUE(farm.expire(4.4).empty()) << "nobody else could have it";
  EXPECT_EQ(deliver(farm, running, 3.9, 4.4).verdict, Verdict::accepted);
  // Its time begins now, and is that of a slower worker.
  const double rate = farm.items_per_second(kAda, "shade");
  EXPECT_LT(rate, 5000);
  const Seconds end = 4.4 + settings.lease_factor * static_cast<double>(waiting.count) / rate;
  EXPECT_GT(end, 10);
  EXPECT_TRUE(farm.expire(end - 0.01).empty());
  EXPECT_EQ(farm.expire(end + 0.01).size(), 1u);
}

TEST(Leases, ASlowLoneWorkerGetsThereInTheEnd) {
  // 10 items a second, and first batches of 4096 that run out after 10 s: it must be given less until it keeps up.
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  const StageId stage = farm.add_stage(stage_of(5000), 0);
  Seconds now = 0;
  for (int turn = 0; turn < 1000 && !farm.complete(stage); ++turn) {
    const auto lease = farm.next_lease(kAda, now);
    if (!lease) {
      ASSERT_TRUE(farm.next_expiry().has_value());
      now = std::max(now, *farm.next_expiry());
      farm.expire(now);
      continue;
    }
    const Seconds seconds = static_cast<double>(lease->count) / 10;
    const Seconds end = now + seconds;
    while (farm.next_expiry() && *farm.next_expiry() < end) farm.expire(*farm.next_expiry());
    now = end;
    deliver(farm, *lease, seconds, now);
  }
  EXPECT_TRUE(farm.complete(stage)) << farm.items_done(stage) << " of 5000 items after " << now << " s";
}

TEST(Leases, WaitingBehindALateBatchGoToOthers) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  const StageId stage = farm.add_stage(stage_of(100'000'000), 0);
  Seconds now = 0;
  for (int i = 0; i < 9; ++i) work(farm, kAda, 1e5, now);
  const Lease running = take(farm, kAda, now), waiting = take(farm, kAda, now);
  // Expected to take 0.5 s: late after three times that.
  const Seconds late = now + 1.5 + 1e-6;
  ASSERT_TRUE(farm.next_expiry().has_value());
  EXPECT_NEAR(*farm.next_expiry(), late, 1e-3);
  EXPECT_TRUE(farm.expire(late - 0.01).empty());
  const std::vector<Lease> recalled = farm.expire(late + 0.01);
  ASSERT_EQ(recalled.size(), 1u);
  EXPECT_EQ(recalled[0].id, waiting.id);
  EXPECT_FALSE(farm.next_lease(kAda, late + 0.01).has_value());
  EXPECT_EQ(take(farm, kBob, late + 0.01).first, waiting.first);
  EXPECT_EQ(deliver(farm, waiting, 1, late + 1).verdict, Verdict::stale);
  EXPECT_EQ(deliver(farm, running, 5, now + 5).verdict, Verdict::accepted);
  EXPECT_TRUE(farm.next_lease(kAda, now + 5).has_value());
  EXPECT_GT(farm.items_done(stage), 0u);
}

TEST(Leases, OutliveAClockThatJumpsBack) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 1000);
  farm.add_stage(stage_of(100), 1000);
  const Lease before = take(farm, kAda, 1000), after = take(farm, kAda, 10);
  EXPECT_EQ(after.issued, 1000);
  EXPECT_GE(after.expires, before.expires);
  EXPECT_TRUE(farm.expire(500).empty());
}

TEST(Leases, OfADrainingWorkerMayFinish) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(100), 0);
  const Lease lease = take(farm, kAda);
  farm.worker_draining(kAda);
  EXPECT_FALSE(farm.next_lease(kAda, 1).has_value());
  EXPECT_EQ(deliver(farm, lease, 1, 1).verdict, Verdict::accepted);
  EXPECT_FALSE(farm.next_lease(kAda, 1).has_value());
  farm.worker_joined(kAda, 2);
  EXPECT_TRUE(farm.next_lease(kAda, 2).has_value());
}

TEST(Leases, AreAtMostInFlightPerWorker) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(100), 0);
  const Lease lease = take(farm, kAda);
  take(farm, kAda);
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  deliver(farm, lease, 1, 1);
  EXPECT_TRUE(farm.next_lease(kAda, 1).has_value());
}

TEST(Leases, GoToTheMoreUrgentStageThenToTheOlder) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  ScheduledStage urgent = stage_of(10);
  urgent.priority = 1;
  const StageId old = farm.add_stage(stage_of(10), 0), young = farm.add_stage(stage_of(10), 0),
                first = farm.add_stage(urgent, 0);
  std::vector<StageId> order;
  for (int i = 0; i < 3; ++i) {
    const Lease lease = take(farm, kAda);
    order.push_back(lease.stage);
    deliver(farm, lease, 1, 1);
  }
  EXPECT_EQ(order, (std::vector<StageId>{first, old, young}));
}

// -- Second copies ---------------------------------------------------------------------------------------------------

// Ada and Bob each ran some batches of 100 items at the given rates and hold what is left; the stage has no items for
// Eve, who is known to run 100 items a second.
struct NearTheEnd {
  Scheduler farm{fixed(100)};
  StageId stage = 0;
  std::vector<Lease> ada, bob;

  NearTheEnd(double ada_rate, double bob_rate, int held_by_each) {
    for (const WorkerId worker : {kAda, kBob, kEve}) farm.worker_joined(worker, 0);
    stage = farm.add_stage(stage_of(300 + 200 * static_cast<std::uint64_t>(held_by_each)), 0);
    deliver(farm, take(farm, kAda), 100 / ada_rate, 0);
    deliver(farm, take(farm, kBob), 100 / bob_rate, 0);
    deliver(farm, take(farm, kEve), 1, 0);
    for (int i = 0; i < held_by_each; ++i) ada.push_back(take(farm, kAda));
    for (int i = 0; i < held_by_each; ++i) bob.push_back(take(farm, kBob));
  }
};

TEST(Duplicates, AreOfTheSlowestLeaseAndOneAtMost) {
  NearTheEnd end(10, 20, 1);  // Ada needs 10 s, Bob 5 s, Eve 1 s
  const Lease copy = take(end.farm, kEve);
  EXPECT_TRUE(copy.duplicate);
  EXPECT_EQ(copy.first, end.ada[0].first);
  EXPECT_EQ(copy.count, end.ada[0].count);
  EXPECT_NE(copy.epoch, end.ada[0].epoch);
  EXPECT_FALSE(end.farm.next_lease(kEve, 0).has_value()) << "a copy must not wait behind another";
  end.farm.worker_joined(99, 0);
  const Lease other = take(end.farm, 99);
  EXPECT_EQ(other.first, end.bob[0].first) << "a lease was copied twice";
  end.farm.worker_joined(100, 0);
  EXPECT_FALSE(end.farm.next_lease(100, 0).has_value());
}

TEST(Duplicates, TheFirstValidResultWins) {
  for (const bool copy_first : {false, true}) {
    NearTheEnd end(10, 20, 1);
    const Lease copy = take(end.farm, kEve);
    const Lease &winner = copy_first ? copy : end.ada[0], &loser = copy_first ? end.ada[0] : copy;
    const ResultOutcome won = deliver(end.farm, winner, 1, 1);
    EXPECT_EQ(won.verdict, Verdict::accepted);
    ASSERT_EQ(won.revoke.size(), 1u);
    EXPECT_EQ(won.revoke[0].id, loser.id);
    EXPECT_EQ(deliver(end.farm, loser, 1, 1).verdict, Verdict::duplicate);
    EXPECT_EQ(end.farm.items_done(end.stage), 400u);
    EXPECT_TRUE(deliver(end.farm, end.bob[0], 5, 5).stage_complete);
  }
}

TEST(Duplicates, TakeWhatWaitsBeforeWhatRuns) {
  NearTheEnd end(10, 80, 2);  // Ada's end after 10 and 20 s, Bob's after 1.25 and 2.5 s
  EXPECT_EQ(take(end.farm, kEve).first, end.ada[1].first);
  end.farm.worker_joined(99, 0);
  // Bob's waiting one ends at 2.5 s, long before Ada's running one, but nobody began it.
  EXPECT_EQ(take(end.farm, 99).first, end.bob[1].first);
}

TEST(Duplicates, AreNotMadeOfWhatIsDoneSooner) {
  NearTheEnd end(150, 120, 1);  // both end before the second that Eve would need
  EXPECT_FALSE(end.farm.next_lease(kEve, 0).has_value());
  // Overdue, they are expected to take as long again.
  EXPECT_FALSE(end.farm.next_lease(kEve, 0.9).has_value());
  EXPECT_TRUE(end.farm.next_lease(kEve, 1.1).has_value());
}

TEST(Duplicates, SurviveTheLossOfTheirTwin) {
  for (const bool lose_copy : {false, true}) {
    NearTheEnd end(10, 20, 1);
    const Lease copy = take(end.farm, kEve);
    end.farm.worker_lost(lose_copy ? kEve : kAda, 1);
    end.farm.worker_joined(99, 1);
    // One holder is left, so another copy may be made, but the items are not in the pool.
    const auto again = end.farm.next_lease(99, 1);
    ASSERT_TRUE(again.has_value());
    EXPECT_TRUE(again->duplicate);
    EXPECT_EQ(deliver(end.farm, lose_copy ? end.ada[0] : copy, 2, 2).verdict, Verdict::accepted);
  }
}

TEST(Duplicates, ComeAfterTheNextStagesItems) {
  NearTheEnd end(10, 20, 1);
  const StageId next = end.farm.add_stage(stage_of(100), 0);
  const Lease lease = take(end.farm, kEve);
  EXPECT_EQ(lease.stage, next);
  EXPECT_FALSE(lease.duplicate);
}

// -- Solo stages -----------------------------------------------------------------------------------------------------

ScheduledStage solo_of(std::uint64_t items, std::vector<WorkerId> preferred) {
  ScheduledStage stage = stage_of(items, 64);
  stage.kind = "cluster";
  stage.solo = true;
  stage.preferred = std::move(preferred);
  return stage;
}

TEST(Solo, OneLeaseHoldsAllItems) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(solo_of(1'000'000, {}), 0);
  const Lease lease = take(farm, kAda);
  EXPECT_EQ(lease.first, 0u);
  EXPECT_EQ(lease.count, 1'000'000u);
  EXPECT_GE(lease.expires, 300);
  EXPECT_FALSE(farm.next_lease(kBob, 0.9).has_value()) << "solo work must not be copied";
  EXPECT_TRUE(deliver(farm, lease, 3, 3).stage_complete);
}

// A worker that shows signs of life but never answers must not hold up a frame for a whole lease.
TEST(Solo, AnIdleWorkerBeginsItTooWhenItLastsFarTooLong) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  const StageId stage = farm.add_stage(solo_of(10, {}), 0);
  take(farm, kAda);
  EXPECT_EQ(farm.why_waiting(stage, 1), "");
  const auto name = [](WorkerId) { return std::string("ada"); };
  EXPECT_EQ(farm.why_waiting(stage, 10, {name, name}),
            "worker ada has not answered its batch for 10 s, expected 1 s at most");
  const Lease copy = take(farm, kBob, 10);
  EXPECT_TRUE(copy.duplicate);
  EXPECT_EQ(copy.count, 10u);
  const ResultOutcome outcome = deliver(farm, copy, 2, 12);
  EXPECT_EQ(outcome.verdict, Verdict::accepted);
  EXPECT_TRUE(outcome.stage_complete);
  ASSERT_EQ(outcome.revoke.size(), 1u);
  EXPECT_EQ(outcome.revoke[0].worker, kAda);
  // Of one that has answered before more is believed: 2 s are expected.
  farm.add_stage(solo_of(10, {}), 20);
  take(farm, kBob, 20);
  EXPECT_FALSE(farm.next_lease(kAda, 25.5).has_value());
  EXPECT_TRUE(farm.next_lease(kAda, 26.5).has_value());
}

TEST(Solo, WhoHasAnsweredBeforeComesFirst) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(solo_of(10, {}), 0);
  deliver(farm, take(farm, kAda), 0.1, 0.1);
  const StageId stage = farm.add_stage(solo_of(10, {}), 1);
  EXPECT_FALSE(farm.next_lease(kBob, 1).has_value()) << "it may be mute";
  EXPECT_TRUE(farm.next_lease(kBob, 2.5).has_value()) << "and it may be new";
  EXPECT_EQ(farm.why_waiting(stage, 2.5), "");
}

// Or both would hold the items for a whole lease.
TEST(Duplicates, OfOneThatNeverAnsweredAreForOneThatDid) {
  Scheduler farm;
  for (const WorkerId worker : {kAda, kBob, kEve}) farm.worker_joined(worker, 0);
  farm.add_stage(stage_of(64, 64), 0);
  farm.add_stage(stage_of(64, 64), 0);
  take(farm, kBob);
  deliver(farm, take(farm, kAda), 0.1, 0.1);
  EXPECT_FALSE(farm.next_lease(kEve, 5).has_value());
  EXPECT_TRUE(take(farm, kAda, 5).duplicate);
}

TEST(Solo, ThePreferredWorkerHasItsChanceFirst) {
  Scheduler farm;
  for (const WorkerId worker : {kAda, kBob, kEve}) farm.worker_joined(worker, 0);
  const StageId stage = farm.add_stage(solo_of(10, {kBob}), 5);
  EXPECT_FALSE(farm.next_lease(kAda, 5).has_value());
  EXPECT_EQ(farm.why_waiting(stage, 5), "worker 12 can take a batch and was not asked since");
  EXPECT_EQ(take(farm, kBob, 5.5).worker, kBob);
}

TEST(Solo, OthersFollowWhenThePreferredDoesNotCome) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(solo_of(10, {kBob}), 5);
  EXPECT_EQ(farm.next_expiry(), 6.0) << "nobody would ask again";
  EXPECT_TRUE(farm.expire(6).empty());
  EXPECT_EQ(take(farm, kAda, 6).worker, kAda);
}

TEST(Solo, NobodyWaitsForAPreferredWorkerThatDrainsOrIsGone) {
  Scheduler farm;
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.worker_draining(kBob);
  farm.add_stage(solo_of(10, {kBob, 77}), 5);
  EXPECT_EQ(take(farm, kAda, 5).worker, kAda);
}

TEST(Solo, GoesToWhoeverIsIdleRatherThanBehindABatch) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(10), 0);
  take(farm, kAda);
  const StageId solo = farm.add_stage(solo_of(10, {}), 0);
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  EXPECT_EQ(take(farm, kBob).stage, solo);
}

TEST(Solo, NothingWaitsBehindIt) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(solo_of(10, {}), 0);
  const StageId split = farm.add_stage(stage_of(100), 0);
  take(farm, kAda);
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  EXPECT_EQ(take(farm, kBob).stage, split);
}

// -- Failures --------------------------------------------------------------------------------------------------------

FailureOutcome fail(Scheduler& farm, const Lease& lease, Seconds now = 0) {
  return farm.failed(lease.worker, lease.id, lease.epoch, now);
}

TEST(Failures, GoToAnotherWorker) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(20), 0);
  const Lease bad = take(farm, kAda);
  EXPECT_TRUE(fail(farm, bad).known);
  EXPECT_FALSE(fail(farm, bad).known) << "a failure was counted twice";
  EXPECT_EQ(take(farm, kAda).first, 10u);
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  EXPECT_EQ(take(farm, kBob).first, 0u);
}

TEST(Failures, GoBackToTheOnlyWorker) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.add_stage(stage_of(20), 0);
  EXPECT_FALSE(fail(farm, take(farm, kAda)).stage_failed);
  EXPECT_EQ(take(farm, kAda).first, 0u);
}

TEST(Failures, OfTheSameItemsFailTheStageAfterThreeStrikes) {
  for (const int workers : {1, 2, 5}) {
    Scheduler farm(fixed(10));
    for (int i = 1; i <= workers; ++i) farm.worker_joined(static_cast<WorkerId>(i), 0);
    const StageId stage = farm.add_stage(stage_of(1000), 0);
    int strikes = 0;
    for (int turn = 0; turn < 100; ++turn) {
      const auto lease = farm.next_lease(1 + static_cast<WorkerId>(turn % workers), 0);
      if (!lease) continue;
      if (lease->first > 0) {
        deliver(farm, *lease, 1, 1);
        continue;
      }
      const FailureOutcome outcome = fail(farm, *lease);
      EXPECT_TRUE(outcome.known);
      EXPECT_EQ(outcome.stage_failed, ++strikes == 3);
      if (outcome.stage_failed) break;
    }
    EXPECT_EQ(strikes, 3) << workers << " workers";
    EXPECT_FALSE(farm.next_lease(1, 1).has_value());
    EXPECT_EQ(farm.why_waiting(stage, 1), "the same items failed 3 times");
  }
}

TEST(Failures, OfOneWorkerPutItAside) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  const StageId stage = farm.add_stage(stage_of(10'000), 0);
  for (int i = 0; i < 3; ++i) fail(farm, take(farm, kAda));
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  const Lease first = take(farm, kBob), second = take(farm, kBob);
  EXPECT_EQ(farm.why_waiting(stage, 0), "worker 11 is quarantined after 3 failures; worker 12 holds 2 leases");
  deliver(farm, first, 0.5, 0.5);
  deliver(farm, second, 0.5, 1);
  EXPECT_EQ(farm.next_expiry(), 10.0) << "nobody would ask again";
  farm.expire(9.9);
  EXPECT_FALSE(farm.next_lease(kAda, 9.9).has_value());
  farm.expire(10);
  // One more failure, and it waits twice as long.
  fail(farm, take(farm, kAda, 10), 10);
  farm.expire(29.9);
  EXPECT_FALSE(farm.next_lease(kAda, 29.9).has_value());
  farm.expire(30);
  EXPECT_TRUE(farm.next_lease(kAda, 30).has_value());
}

TEST(Failures, DoNotPutTheLastWorkerAside) {
  SchedulerSettings settings = fixed(10);
  Scheduler farm(settings);
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(10'000), 0);
  for (int i = 0; i < 3; ++i) fail(farm, take(farm, kAda));
  EXPECT_FALSE(farm.next_lease(kAda, 0).has_value());
  farm.worker_lost(kBob, 0);
  EXPECT_TRUE(farm.next_lease(kAda, 0).has_value());
}

TEST(Failures, ASuccessInBetweenClearsTheWorker) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  farm.add_stage(stage_of(10'000), 0);
  for (int i = 0; i < 9; ++i) {
    const Lease lease = take(farm, kAda);
    i % 3 == 2 ? void(deliver(farm, lease, 1, 1)) : void(fail(farm, lease));
  }
  EXPECT_TRUE(farm.next_lease(kAda, 0).has_value());
}

// -- Why a stage waits -----------------------------------------------------------------------------------------------

TEST(WhyWaiting, SaysOneReason) {
  Scheduler farm(fixed(10));
  const StageId stage = farm.add_stage(stage_of(1000), 0);
  EXPECT_EQ(farm.why_waiting(stage, 0), "no worker is connected");
  farm.worker_joined(1, 0);
  EXPECT_EQ(farm.why_waiting(stage, 0), "worker 1 can take a batch and was not asked since");
  for (const WorkerId worker : {2, 3}) farm.worker_joined(worker, 0);
  for (const WorkerId worker : {1, 2, 3}) {
    take(farm, worker);
    take(farm, worker);
  }
  EXPECT_EQ(farm.why_waiting(stage, 0), "all 3 workers hold 2 leases each");
  farm.worker_draining(2);
  EXPECT_EQ(farm.why_waiting(stage, 0), "worker 2 drains; workers 1, 3 hold 2 leases each");
  farm.worker_draining(1);
  farm.worker_draining(3);
  EXPECT_EQ(farm.why_waiting(stage, 0), "all 3 workers drain");
  const StageId later = farm.add_stage(stage_of(10), 0);
  EXPECT_EQ(farm.why_waiting(later, 0), "stage 1 goes first: it is older");
  ScheduledStage urgent = stage_of(10);
  urgent.priority = 5;
  farm.add_stage(urgent, 0);
  EXPECT_EQ(farm.why_waiting(stage, 0), "stage 3 goes first: its priority is higher");
  EXPECT_EQ(farm.why_waiting(999, 0), "");
}

TEST(WhyWaiting, IsEmptyWhereAllRuns) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  const StageId stage = farm.add_stage(stage_of(10), 0);
  take(farm, kAda);
  EXPECT_EQ(farm.why_waiting(stage, 0), "");
}

TEST(Progress, CountsWhatEachWorkerDid) {
  Scheduler farm(fixed(10));
  farm.worker_joined(kAda, 0);
  farm.worker_joined(kBob, 0);
  const StageId stage = farm.add_stage(stage_of(25), 0);
  deliver(farm, take(farm, kAda), 2, 2);
  deliver(farm, take(farm, kAda, 2), 3, 5);
  deliver(farm, take(farm, kBob, 5), 1, 6);
  const auto progress = farm.progress(stage);
  ASSERT_EQ(progress.size(), 2u);
  EXPECT_EQ(progress.at(kAda).items, 20u);
  EXPECT_EQ(progress.at(kAda).seconds, 5);
  EXPECT_EQ(progress.at(kAda).batches, 2u);
  EXPECT_EQ(progress.at(kBob).items, 5u);
  EXPECT_TRUE(farm.complete(stage));
}

// -- What an event costs ---------------------------------------------------------------------------------------------

// Steps per event (each step O(log n)) on a farm where every worker is asked once and delivers all it holds, twice.
double steps_per_event(std::uint64_t workers) {
  SchedulerSettings settings;
  settings.first_batch_items = 10;
  Scheduler farm(settings);
  for (WorkerId worker = 1; worker <= workers; ++worker) farm.worker_joined(worker, 0);
  farm.add_stage(stage_of(workers * 20), 0);
  std::uint64_t events = 0;
  const std::uint64_t before = farm.steps();
  Seconds now = 0;
  while (farm.items_done(1) < workers * 20) {
    std::vector<Lease> held;
    for (WorkerId worker = 1; worker <= workers; ++worker) {
      for (;;) {
        ++events;
        const auto lease = farm.next_lease(worker, now);
        if (!lease) break;
        held.push_back(*lease);
      }
    }
    now += 1;
    ++events;
    farm.expire(now);
    for (const Lease& lease : held) {
      ++events;
      const double items_per_second = 10 + static_cast<double>(lease.worker % 10);
      deliver(farm, lease, static_cast<double>(lease.count) / items_per_second, now);
    }
    EXPECT_FALSE(held.empty());
    if (held.empty()) break;
  }
  return static_cast<double>(farm.steps() - before) / static_cast<double>(events);
}

TEST(Cost, OfAnEventDoesNotGrowWithTheFarm) {
  const double small = steps_per_event(100), large = steps_per_event(10'000);
  RecordProperty("steps_per_event_100", std::to_string(small));
  RecordProperty("steps_per_event_10000", std::to_string(large));
  EXPECT_LT(large, 40);
  EXPECT_LT(large, 1.5 * small);
}

}  // namespace
}  // namespace gleaner::coordinator
