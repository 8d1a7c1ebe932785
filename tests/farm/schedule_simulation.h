#pragma once
// A farm of scripted workers on a virtual clock, around the real scheduler or around a simpler policy to compare with.
// Everything that happens follows from the scripts and the seed.

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <queue>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "coordinator/schedule/scheduler.h"

namespace gleaner::farm {

using coordinator::Lease;
using coordinator::LeaseId;
using coordinator::ResultOutcome;
using coordinator::ScheduledStage;
using coordinator::SchedulerSettings;
using coordinator::Seconds;
using coordinator::StageId;
using coordinator::WorkerId;

// Who decides what a worker does next.
class Policy {
 public:
  virtual ~Policy() = default;
  virtual StageId add_stage(const ScheduledStage& stage, Seconds now) = 0;
  virtual void joined(WorkerId worker, Seconds now) = 0;
  virtual void lost(WorkerId worker, Seconds now) = 0;
  virtual std::optional<Lease> next(WorkerId worker, Seconds now) = 0;
  virtual ResultOutcome result(const Lease& lease, Seconds seconds, Seconds now) = 0;
  virtual void failed(const Lease& lease, Seconds now) = 0;
  virtual std::vector<Lease> expire(Seconds now) = 0;
  virtual std::optional<Seconds> next_expiry() const = 0;
  // What the policy itself believes; empty = as it should be. Asked when all stages are complete.
  virtual std::string audit(StageId stage, std::uint64_t items) const = 0;
};

std::unique_ptr<Policy> gleaners_policy(const SchedulerSettings& settings);
// Each of `workers` gets an equal part at once.
std::unique_ptr<Policy> static_split(std::size_t workers);
// The next batch takes `target` seconds at the rate of the worker's last one (links-2008's rule and nothing else).
std::unique_ptr<Policy> last_batch_only(Seconds target, std::uint64_t first_batch);

struct WorkerScript {
  double items_per_second = 1e5;
  Seconds joins = 0;
  std::vector<std::pair<Seconds, double>> factors = {};  // from that time on, the speed is times so much; 0 = it hangs
  std::optional<Seconds> dies = {};
  Seconds noticed_after = 0.5;  // its connection breaks so long after its death; infinity: it never does
};

struct Network {
  Seconds latency = 0.002;
  Seconds jitter = 0;             // added to the latency, uniform: messages overtake each other
  double loses = 0, doubles = 0;  // probability for each message
  double noise = 0;               // a batch takes up to this part more or less than its script says
  double fails = 0;               // probability that a batch ends in failed()
};

struct Counts {
  std::uint64_t leases = 0, duplicates = 0, expired = 0, events = 0;
  std::uint64_t deaths_with_work = 0, hangs_with_work = 0, slowed_with_work = 0, late_joiners_at_work = 0;
  std::uint64_t lost_messages = 0, doubled_messages = 0, overtaken = 0, failures = 0;
  std::map<coordinator::Verdict, std::uint64_t> verdicts;
};

struct Outcome {
  bool complete = false;
  std::string broken;    // the first invariant that did not hold; empty = all held
  Seconds makespan = 0;  // from the first stage's start to the last accepted result
  Counts counts;
};

class Simulation {
 public:
  Simulation(Policy& policy, std::vector<WorkerScript> workers, Network network, std::uint64_t seed);

  // Runs the stages of each wave at the same time, one wave after the other, until all are complete or the clock
  // reaches `deadline`; then lets every message still on its way arrive, and audits.
  Outcome run(const std::vector<std::vector<ScheduledStage>>& waves, Seconds deadline);

 private:
  struct Running;
  struct Device {
    WorkerScript script;
    std::vector<std::pair<Seconds, double>> speed;  // (from, items per second), in order of time
    bool alive = false, joined = false;
    std::vector<Lease> queue;  // the first one runs
    std::set<LeaseId> holds;   // as the coordinator knows
    std::uint64_t run = 0;     // counts what was started, so that an aborted batch's end is told from a real one
    Seconds last_sent_arrives = 0;
  };
  struct Event {
    Seconds at;
    std::uint64_t order;
    std::function<void()> happen;
    bool operator<(const Event& other) const { return at != other.at ? at > other.at : order > other.order; }
  };

  void at(Seconds when, std::function<void()> happen);
  void send(WorkerId worker, const std::function<void()>& arrive);
  void begin_next(WorkerId worker);
  void finish(WorkerId worker, std::uint64_t run, Seconds began);
  void revoke(const Lease& lease);
  void ask(WorkerId worker);
  void ask_hungry();
  void watch_expiry();
  void add_wave();
  void deliver(const Lease& lease, Seconds seconds);
  Seconds finish_time(const Device& device, Seconds start, double items) const;

  Policy& policy_;
  std::map<WorkerId, Device> devices_;
  Network network_;
  std::mt19937_64 random_;
  std::priority_queue<Event> events_;
  std::uint64_t order_ = 0;
  Seconds now_ = 0;
  bool asking_ = false;
  std::set<WorkerId> hungry_;  // asked in vain
  std::vector<std::vector<ScheduledStage>> waves_;
  std::size_t wave_ = 0;
  std::map<StageId, std::vector<std::uint8_t>> accepted_;  // how often, per item
  std::map<StageId, std::uint64_t> left_;
  std::size_t open_ = 0;
  Seconds watched_ = -1;
  Outcome outcome_;
};

// The makespan if every worker were busy from its joining to the end, at its script's speed.
Seconds ideal_makespan(const std::vector<WorkerScript>& workers, double items);

}  // namespace gleaner::farm
