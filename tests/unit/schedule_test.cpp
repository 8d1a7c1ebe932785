#include "coordinator/schedule/scheduler.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace gleaner::coordinator
