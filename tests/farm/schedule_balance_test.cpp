// Balance: makespan over ideal, in virtual time, so that the bounds hold on any machine.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "tests/farm/schedule_simulation.h"

namespace gleaner::farm {
namespace {

constexpr std::uint64_t kItems = 4'000'000;

ScheduledStage one_stage(std::uint64_t items) {
  ScheduledStage stage;
  stage.kind = "shade";
  stage.items = items;
  stage.tile = 64;
  return stage;
}

struct Balance {
  double gleaner, even_split, last_batch;  // makespan over ideal
};

double over_ideal(Policy& policy, const std::vector<WorkerScript>& workers, std::uint64_t items, Network network) {
  Simulation simulation(policy, workers, network, 1);
  const Outcome outcome = simulation.run({{one_stage(items)}}, 1e5);
  if (!outcome.complete) return 1.0 / 0.0;
  EXPECT_TRUE(outcome.complete);
  EXPECT_EQ(outcome.broken, "");
  return outcome.makespan / ideal_makespan(workers, static_cast<double>(items));
}

Balance balance(const std::string& what, const std::vector<WorkerScript>& workers, std::uint64_t items = kItems,
                Network network = {}) {
  const SchedulerSettings settings;
  const auto ours = gleaners_policy(settings);
  const auto even = static_split(workers.size());
  const auto last = last_batch_only(settings.target_batch, settings.first_batch_items);
  const Balance result{over_ideal(*ours, workers, items, network), over_ideal(*even, workers, items, network),
                       over_ideal(*last, workers, items, network)};
  std::printf("%-34s makespan/ideal: gleaner %.4f, static split %.4f, last batch only %.4f\n", what.c_str(),
              result.gleaner, result.even_split, result.last_batch);
  return result;
}

TEST(Balance, Explore) {
  balance("4:1 devices", {{4e5}, {1e5}});
  balance("4:1 devices, 1 s", {{4e5}, {1e5}}, 500'000);
  balance("4:1 devices, 0.2 s", {{4e5}, {1e5}}, 100'000);
  {
    std::vector<WorkerScript> workers{{1e5}, {1e5}, {1e5}, {1e5}};
    workers[0].factors = {{4.0, 0.1}};
    balance("one of 4 slows 10x in mid-stage", workers);
    workers[0].factors = {{9.0, 0.1}};
    balance("one of 4 slows 10x at 9 of 10", workers);
    workers[0].factors = {{9.8, 0.1}};
    balance("one of 4 slows 10x at 9.8 of 10", workers);
    workers[0].factors = {{4.0, 0.5}};
    balance("one of 4 slows 2x at 4 of 10", workers);
    workers[0].factors = {{4.0, 0.3}};
    balance("one of 4 slows 3.3x at 4 of 10", workers);
    workers[0].factors = {{4.0, 0.0}};
    balance("one of 4 hangs at 4 of 10", workers);
    workers[0].factors = {{4.0, 0.1}, {6.0, 1.0}};
    balance("one of 4 slow from 4 to 6", workers);
    workers[0].factors = {{0, 0.1}, {4.0, 1.0}};
    balance("one of 4 speeds up 10x at 4", workers);
  }
  {
    std::vector<WorkerScript> workers{{1e5}, {1e5}, {4e5}};
    workers[2].joins = 5;
    balance("4x joins at 5", workers);
    workers[2].joins = 15;
    balance("4x joins at 15 of 20", workers);
    workers[2].joins = 19.5;
    balance("4x joins at 19.5 of 20", workers);
  }
  std::vector<WorkerScript> mixed;
  std::mt19937_64 random(7);
  double sum = 0;
  for (int i = 0; i < 100; ++i) {
    mixed.push_back({1e4 * std::pow(40.0, static_cast<double>(random() >> 11) / 9007199254740992.0)});
    sum += mixed.back().items_per_second;
  }
  balance("100 workers 40:1, 10 s", mixed, static_cast<std::uint64_t>(10 * sum));
  balance("100 workers 40:1, 2 s", mixed, static_cast<std::uint64_t>(2 * sum));
  Network noisy;
  noisy.noise = 0.3;
  balance("100 workers 40:1, 10 s, noise 30%", mixed, static_cast<std::uint64_t>(10 * sum), noisy);
  balance("4:1 devices, noise 30%", {{4e5}, {1e5}}, kItems, noisy);
  Network far;
  far.latency = 0.05;
  balance("4:1 devices, 50 ms away", {{4e5}, {1e5}}, kItems, far);
}

TEST(Balance, DevicesOfFourToOne) {
  const Balance b = balance("4:1 devices", {{4e5}, {1e5}});
  EXPECT_LT(b.gleaner, 1.02);
}

TEST(Balance, ASlowDownInMidStage) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {1e5}, {1e5}};
  workers[0].factors = {{4.0, 0.1}};
  const Balance b = balance("one of 4 slows 10x in mid-stage", workers);
  EXPECT_LT(b.gleaner, 1.05);
}

TEST(Balance, ALateJoiner) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {4e5}};
  workers[2].joins = 5;
  const Balance b = balance("a 4x faster one joins late", workers);
  EXPECT_LT(b.gleaner, 1.05);
}

}  // namespace
}  // namespace gleaner::farm
