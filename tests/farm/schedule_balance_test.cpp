// Balance: makespan over ideal, in virtual time, so that the bounds hold on any machine.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
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

double over_ideal(Policy& policy, const std::vector<WorkerScript>& workers, std::uint64_t items, const Network& network,
                  int stages) {
  Simulation simulation(policy, workers, network, 1);
  const std::vector<std::vector<ScheduledStage>> waves(static_cast<std::size_t>(stages), {one_stage(items)});
  const Outcome outcome = simulation.run(waves, 1e5);
  EXPECT_TRUE(outcome.complete);
  EXPECT_EQ(outcome.broken, "");
  return outcome.makespan / ideal_makespan(workers, static_cast<double>(items) * stages);
}

// Prints and returns the makespan over the ideal.
double gleaner(const std::string& what, const std::vector<WorkerScript>& workers, std::uint64_t items = kItems,
               const Network& network = {}, int stages = 1) {
  const SchedulerSettings settings;
  const auto policy = gleaners_policy(settings);
  const double ours = over_ideal(*policy, workers, items, network, stages);
  std::printf("%-44s makespan/ideal: gleaner %.4f", what.c_str(), ours);
  return ours;
}

// Checks that neither of the policies that Gleaner is compared with is better. Not where a worker hangs: they would
// wait for ever.
void expect_better_than_simple(double ours, const std::vector<WorkerScript>& workers, std::uint64_t items = kItems,
                               const Network& network = {}) {
  const SchedulerSettings settings;
  const auto even = static_split(workers.size());
  const auto last = last_batch_only(settings.target_batch, settings.first_batch_items);
  const double even_split = over_ideal(*even, workers, items, network, 1);
  const double last_batch = over_ideal(*last, workers, items, network, 1);
  std::printf(", static split %.4f, last batch only %.4f", even_split, last_batch);
  EXPECT_LT(ours, even_split);
  EXPECT_LT(ours, last_batch);
}

// 100 devices, the fastest 40 times the slowest.
std::vector<WorkerScript> mixed_workers(double& items_per_second) {
  std::vector<WorkerScript> workers;
  items_per_second = 0;
  for (int i = 0; i < 100; ++i) {
    workers.push_back({1e4 * std::pow(40.0, i / 99.0)});
    items_per_second += workers.back().items_per_second;
  }
  return workers;
}

class Balance : public testing::Test {
 protected:
  void TearDown() override { std::printf("\n"); }
};

TEST_F(Balance, DevicesOfFourToOne) {
  const std::vector<WorkerScript> workers{{4e5}, {1e5}};
  const double ours = gleaner("4:1 devices, 8 s", workers);
  expect_better_than_simple(ours, workers);
  EXPECT_LT(ours, 1.01);
}

TEST_F(Balance, DevicesOfFourToOneForASecond) {
  const std::vector<WorkerScript> workers{{4e5}, {1e5}};
  const double ours = gleaner("4:1 devices, 1 s", workers, 500'000);
  expect_better_than_simple(ours, workers, 500'000);
  EXPECT_LT(ours, 1.03);
}

TEST_F(Balance, ManyShortStages) {
  // Throughputs are remembered: only the first stage has to find them out.
  const double ours = gleaner("4:1 devices, 20 stages of 0.2 s", {{4e5}, {1e5}}, 100'000, {}, 20);
  EXPECT_LT(ours, 1.09);
}

TEST_F(Balance, ASlowDownInMidStage) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {1e5}, {1e5}};
  workers[0].factors = {{4, 0.1}};
  const double ours = gleaner("1 of 4 slows down 10x in mid-stage", workers);
  expect_better_than_simple(ours, workers);
  EXPECT_LT(ours, 1.02);
}

TEST_F(Balance, ASlowDownShortlyBeforeTheEnd) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {1e5}, {1e5}};
  workers[0].factors = {{9, 0.1}};
  const double ours = gleaner("1 of 4 slows down 10x at 9 s of 10", workers);
  expect_better_than_simple(ours, workers);
  EXPECT_LT(ours, 1.04);
}

TEST_F(Balance, AHangInMidStage) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {1e5}, {1e5}};
  workers[0].factors = {{4, 0}};
  EXPECT_LT(gleaner("1 of 4 hangs in mid-stage", workers), 1.03);
}

TEST_F(Balance, ALateJoiner) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {4e5}};
  workers[2].joins = 5;
  const double ours = gleaner("a 4x faster one joins after 5 s", workers);
  expect_better_than_simple(ours, workers);
  EXPECT_LT(ours, 1.01);
}

TEST_F(Balance, AJoinerShortlyBeforeTheEnd) {
  std::vector<WorkerScript> workers{{1e5}, {1e5}, {4e5}};
  workers[2].joins = 19.5;
  const double ours = gleaner("a 4x faster one joins at 19.5 s of 20", workers);
  expect_better_than_simple(ours, workers);
  EXPECT_LT(ours, 1.01);
}

TEST_F(Balance, AHundredDevices) {
  double rate = 0;
  const std::vector<WorkerScript> workers = mixed_workers(rate);
  const auto items = static_cast<std::uint64_t>(10 * rate);
  const double ours = gleaner("100 devices 40:1, 10 s", workers, items);
  expect_better_than_simple(ours, workers, items);
  EXPECT_LT(ours, 1.01);
}

TEST_F(Balance, AHundredDevicesWithUnevenItems) {
  double rate = 0;
  const std::vector<WorkerScript> workers = mixed_workers(rate);
  const auto items = static_cast<std::uint64_t>(10 * rate);
  Network network;
  network.noise = 0.3;
  const double ours = gleaner("100 devices 40:1, batches +-30 %, 10 s", workers, items, network);
  expect_better_than_simple(ours, workers, items, network);
  EXPECT_LT(ours, 1.02);
}

TEST_F(Balance, FarAway) {
  Network network;
  network.latency = 0.05;
  EXPECT_LT(gleaner("4:1 devices, 50 ms away, 8 s", {{4e5}, {1e5}}, kItems, network), 1.08);
}

}  // namespace
}  // namespace gleaner::farm
