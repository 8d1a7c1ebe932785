// The simulated farm: the real scheduler, scripted workers, a virtual clock, seeded trouble. A schedule passes if every
// item was accepted exactly once and each kind of trouble it planned did strike; where one did not, it proves nothing.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "tests/farm/schedule_simulation.h"

namespace gleaner::farm {
namespace {

enum class Judgement { pass, fail, inconclusive };

struct Trouble {
  int kills = 0, hangs = 0, slow = 0, late = 0;  // workers
  Network network;
};

struct Schedule {
  std::vector<WorkerScript> workers;
  std::vector<std::vector<ScheduledStage>> waves;
  Trouble trouble;
};

constexpr Seconds kNever = std::numeric_limits<Seconds>::infinity();

// A frame of some stages on `workers` devices, each stage about `seconds` long without trouble.
Schedule make_schedule(std::uint64_t seed, int workers, Seconds seconds, int waves) {
  std::mt19937_64 random(seed);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(random() >> 11) / 9007199254740992.0;
  };
  Schedule schedule;
  double all = 0;
  for (int i = 0; i < workers; ++i) {
    WorkerScript worker;
    worker.items_per_second = 100 * std::pow(10.0, uniform(0, 1));
    all += worker.items_per_second;
    schedule.workers.push_back(worker);
  }
  for (int i = 0; i < waves; ++i) {
    ScheduledStage stage;
    stage.kind = i % 2 == 0 ? "shade" : "trace";
    stage.items = static_cast<std::uint64_t>(all * seconds * uniform(0.5, 1));
    stage.tile = 1 + static_cast<std::uint32_t>(random() % 9);
    schedule.waves.push_back({stage});
    if (random() % 2 == 0) {  // a solo one beside it
      ScheduledStage solo;
      solo.kind = "cluster";
      solo.items = 100;
      solo.solo = true;
      solo.preferred = {1 + random() % static_cast<std::uint64_t>(workers)};
      schedule.waves.back().push_back(solo);
    }
  }

  // The first worker comes through unharmed: a farm whose last worker dies cannot finish.
  const Seconds span = seconds * waves;
  Trouble& trouble = schedule.trouble;
  for (std::size_t i = 1; i < schedule.workers.size(); ++i) {
    WorkerScript& worker = schedule.workers[i];
    const Seconds when = uniform(0.1, 0.6) * span;
    switch (random() % 10) {
      case 0:
        worker.dies = when;
        // Some connections break at once, some late, some never.
        worker.noticed_after = random() % 3 == 0 ? kNever : uniform(0.01, 5);
        ++trouble.kills;
        break;
      case 1:
        worker.factors = {{when, 0}, {when + uniform(1, 30), 1}};
        ++trouble.hangs;
        break;
      case 2:
        worker.factors = {{when, 0.1}};
        ++trouble.slow;
        break;
      case 3:
        worker.joins = when;
        ++trouble.late;
        break;
      default:
        break;
    }
  }
  trouble.network.latency = uniform(0.0005, 0.01);
  trouble.network.noise = uniform(0, 0.3);
  if (random() % 2 == 0) trouble.network.jitter = uniform(0.01, 0.5);
  if (random() % 2 == 0) trouble.network.loses = uniform(0.001, 0.01);
  if (random() % 2 == 0) trouble.network.doubles = uniform(0.01, 0.1);
  if (random() % 2 == 0) trouble.network.fails = 0.002;
  return schedule;
}

struct Judged {
  Judgement judgement = Judgement::pass;
  std::string why;
  Outcome outcome;
};

Judged judge(std::uint64_t seed, int workers, Seconds seconds, int waves) {
  const Schedule schedule = make_schedule(seed, workers, seconds, waves);
  SchedulerSettings settings;
  settings.first_batch_items = 64;
  settings.solo_lease_floor = 30;
  settings.strikes = 5;
  const auto policy = gleaners_policy(settings);
  Simulation simulation(*policy, schedule.workers, schedule.trouble.network, seed);
  Judged judged;
  judged.outcome = simulation.run(schedule.waves, 1e4);
  const Outcome& outcome = judged.outcome;
  const Counts& counts = outcome.counts;
  if (!outcome.broken.empty() || !outcome.complete) {
    judged.judgement = Judgement::fail;
    judged.why = outcome.broken.empty() ? "not complete when the time was up" : outcome.broken;
    return judged;
  }
  const auto must_strike = [&](const char* what, bool planned, std::uint64_t struck) {
    if (!planned || struck > 0) return;
    judged.judgement = Judgement::inconclusive;
    judged.why += std::string(judged.why.empty() ? "did not happen: " : ", ") + what;
  };
  const Trouble& trouble = schedule.trouble;
  must_strike("a kill of a worker with work", trouble.kills > 0, counts.deaths_with_work);
  must_strike("a hang with work", trouble.hangs > 0, counts.hangs_with_work);
  must_strike("a slow-down with work", trouble.slow > 0, counts.slowed_with_work);
  must_strike("work of a late joiner", trouble.late > 0, counts.late_joiners_at_work);
  must_strike("a lost message", trouble.network.loses > 0, counts.lost_messages);
  must_strike("a doubled message", trouble.network.doubles > 0, counts.doubled_messages);
  must_strike("an overtaken message", trouble.network.jitter > 0, counts.overtaken);
  must_strike("a failed batch", trouble.network.fails > 0, counts.failures);
  return judged;
}

void run_schedules(std::uint64_t first_seed, int schedules, int workers, Seconds seconds, int waves) {
  int tally[3] = {0, 0, 0};
  Counts sum;
  for (int i = 0; i < schedules; ++i) {
    const std::uint64_t seed = first_seed + static_cast<std::uint64_t>(i);
    const Judged judged = judge(seed, workers, seconds, waves);
    ++tally[static_cast<int>(judged.judgement)];
    if (judged.judgement == Judgement::fail) {
      ADD_FAILURE() << "seed " << seed << ", " << workers << " workers: " << judged.why;
    }
    const Counts& counts = judged.outcome.counts;
    sum.leases += counts.leases;
    sum.duplicates += counts.duplicates;
    sum.expired += counts.expired;
    sum.deaths_with_work += counts.deaths_with_work;
    sum.hangs_with_work += counts.hangs_with_work;
    sum.slowed_with_work += counts.slowed_with_work;
    for (const auto& [verdict, times] : counts.verdicts) sum.verdicts[verdict] += times;
  }
  std::printf(
      "%d schedules of %d workers: %d PASS, %d FAIL, %d INCONCLUSIVE; %lu leases (%lu duplicates, %lu ran out or "
      "recalled), %lu kills, %lu hangs, %lu slow-downs; results:",
      schedules, workers, tally[0], tally[1], tally[2], sum.leases, sum.duplicates, sum.expired, sum.deaths_with_work,
      sum.hangs_with_work, sum.slowed_with_work);
  for (const auto& [verdict, times] : sum.verdicts) std::printf(" %lu %s", times, coordinator::verdict_name(verdict));
  std::printf("\n");
  EXPECT_GE(tally[static_cast<int>(Judgement::pass)], (schedules + 1) / 2)
      << "most schedules did not do what they planned";
}

TEST(SimulatedFarm, FewWorkers) { run_schedules(1, 300, 8, 10, 3); }
TEST(SimulatedFarm, AHundredWorkers) { run_schedules(1000, 30, 100, 10, 2); }
TEST(SimulatedFarm, AThousandWorkers) { run_schedules(2000, 5, 1000, 10, 2); }

TEST(SimulatedFarm, IsTheSameForTheSameSeed) {
  for (const std::uint64_t seed : {5u, 6u}) {
    const Judged one = judge(seed, 50, 5, 2), two = judge(seed, 50, 5, 2);
    EXPECT_EQ(one.outcome.makespan, two.outcome.makespan);
    EXPECT_EQ(one.outcome.counts.leases, two.outcome.counts.leases);
    EXPECT_EQ(one.outcome.counts.events, two.outcome.counts.events);
    EXPECT_EQ(one.outcome.counts.verdicts, two.outcome.counts.verdicts);
  }
}

}  // namespace
}  // namespace gleaner::farm
