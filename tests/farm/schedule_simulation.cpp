#include "tests/farm/schedule_simulation.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gleaner::farm {

using coordinator::Scheduler;
using coordinator::Verdict;

namespace {

constexpr std::size_t kInFlight = 2;  // as the scheduler's settings have it
constexpr Seconds kLookAround = 0.002;
constexpr Seconds kNever = std::numeric_limits<Seconds>::infinity();

class GleanersPolicy : public Policy {
 public:
  explicit GleanersPolicy(const SchedulerSettings& settings) : scheduler_(settings) {}
  StageId add_stage(const ScheduledStage& stage, Seconds now) override { return scheduler_.add_stage(stage, now); }
  void joined(WorkerId worker, Seconds now) override { scheduler_.worker_joined(worker, now); }
  void lost(WorkerId worker, Seconds now) override { scheduler_.worker_lost(worker, now); }
  std::optional<Lease> next(WorkerId worker, Seconds now) override { return scheduler_.next_lease(worker, now); }
  ResultOutcome result(const Lease& lease, Seconds seconds, Seconds now) override {
    return scheduler_.result(lease.worker, lease.id, lease.epoch, seconds, now);
  }
  void failed(const Lease& lease, Seconds now) override { scheduler_.failed(lease.worker, lease.id, lease.epoch, now); }
  std::vector<Lease> expire(Seconds now) override { return scheduler_.expire(now); }
  std::optional<Seconds> next_expiry() const override { return scheduler_.next_expiry(); }
  std::string audit(StageId stage, std::uint64_t items) const override {
    if (!scheduler_.complete(stage)) return "the scheduler holds the stage for incomplete";
    if (scheduler_.items_done(stage) != items) return "items_done is not the stage's items";
    std::uint64_t sum = 0;
    for (const auto& [worker, progress] : scheduler_.progress(stage)) sum += progress.items;
    return sum == items ? "" : "the workers' progress adds up to " + std::to_string(sum);
  }

 private:
  Scheduler scheduler_;
};

// For comparison only: one stage, workers that never die, no leases that run out.
class SimplePolicy : public Policy {
 public:
  StageId add_stage(const ScheduledStage& stage, Seconds) override {
    items_ = left_ = stage.items;
    return 1;
  }
  void joined(WorkerId, Seconds) override {}
  void lost(WorkerId, Seconds) override {}
  void failed(const Lease&, Seconds) override {}
  std::vector<Lease> expire(Seconds) override { return {}; }
  std::optional<Seconds> next_expiry() const override { return std::nullopt; }
  std::string audit(StageId, std::uint64_t items) const override {
    return done_ == items ? "" : "not all items are done";
  }

  std::optional<Lease> next(WorkerId worker, Seconds now) override {
    if (held_[worker] >= leases_at_once() || left_ == 0) return std::nullopt;
    const std::uint64_t count = std::min(left_, batch(worker));
    if (count == 0) return std::nullopt;
    ++held_[worker];
    Lease lease{++leases_, leases_, 1, worker, items_ - left_, count, now, kNever, false};
    left_ -= count;
    return lease;
  }
  ResultOutcome result(const Lease& lease, Seconds seconds, Seconds) override {
    --held_[lease.worker];
    done_ += lease.count;
    measured(lease, seconds);
    ResultOutcome outcome;
    outcome.verdict = Verdict::accepted;
    outcome.stage_complete = done_ == items_;
    return outcome;
  }

 protected:
  virtual std::uint64_t batch(WorkerId worker) = 0;
  virtual unsigned leases_at_once() const { return 2; }
  virtual void measured(const Lease&, Seconds) {}
  std::uint64_t items_ = 0;

 private:
  std::uint64_t left_ = 0, done_ = 0;
  LeaseId leases_ = 0;
  std::map<WorkerId, unsigned> held_;
};

class StaticSplit : public SimplePolicy {
 public:
  explicit StaticSplit(std::size_t workers) : workers_(workers) {}

 private:
  std::uint64_t batch(WorkerId worker) override {
    return served_.insert(worker).second ? (items_ + workers_ - 1) / workers_ : 0;
  }
  std::size_t workers_;
  std::set<WorkerId> served_;
};

class LastBatchOnly : public SimplePolicy {
 public:
  LastBatchOnly(Seconds target, std::uint64_t first) : target_(target), first_(first) {}

 private:
  std::uint64_t batch(WorkerId worker) override {
    const auto at = rate_.find(worker);
    if (at == rate_.end()) return first_;
    return std::max<std::uint64_t>(1, static_cast<std::uint64_t>(target_ * at->second));
  }
  void measured(const Lease& lease, Seconds seconds) override {
    if (seconds > 0) rate_[lease.worker] = static_cast<double>(lease.count) / seconds;
  }
  Seconds target_;
  std::uint64_t first_;
  std::map<WorkerId, double> rate_;
};

std::vector<std::pair<Seconds, double>> speed_profile(const WorkerScript& script) {
  std::vector<std::pair<Seconds, double>> profile{{0, script.items_per_second}};
  for (const auto& [from, factor] : script.factors) profile.emplace_back(from, script.items_per_second * factor);
  std::sort(profile.begin(), profile.end());
  return profile;
}

}  // namespace

std::unique_ptr<Policy> gleaners_policy(const SchedulerSettings& settings) {
  return std::make_unique<GleanersPolicy>(settings);
}
std::unique_ptr<Policy> static_split(std::size_t workers) { return std::make_unique<StaticSplit>(workers); }
std::unique_ptr<Policy> last_batch_only(Seconds target, std::uint64_t first_batch) {
  return std::make_unique<LastBatchOnly>(target, first_batch);
}

Simulation::Simulation(Policy& policy, std::vector<WorkerScript> workers, Network network, std::uint64_t seed)
    : policy_(policy), network_(network), random_(seed) {
  WorkerId id = 1;
  for (WorkerScript& script : workers) {
    Device device;
    device.speed = speed_profile(script);
    device.script = std::move(script);
    devices_.emplace(id++, std::move(device));
  }
}

void Simulation::at(Seconds when, std::function<void()> happen) {
  if (when < kNever) events_.push({when, order_++, std::move(happen)});
}

// A message between coordinator and worker, either way.
void Simulation::send(WorkerId worker, const std::function<void()>& arrive) {
  std::uniform_real_distribution<double> any(0, 1);
  int copies = 1;
  if (any(random_) < network_.loses) {
    ++outcome_.counts.lost_messages;
    copies = 0;
  } else if (any(random_) < network_.doubles) {
    ++outcome_.counts.doubled_messages;
    copies = 2;
  }
  Device& device = devices_.at(worker);
  for (int i = 0; i < copies; ++i) {
    const Seconds when = now_ + network_.latency + network_.jitter * any(random_);
    if (when < device.last_sent_arrives) ++outcome_.counts.overtaken;
    device.last_sent_arrives = std::max(device.last_sent_arrives, when);
    at(when, arrive);
  }
}

Seconds Simulation::finish_time(const Device& device, Seconds start, double items) const {
  Seconds at = start;
  for (std::size_t i = 0; i < device.speed.size(); ++i) {
    const Seconds end = i + 1 < device.speed.size() ? device.speed[i + 1].first : kNever;
    if (end <= at) continue;
    const double speed = device.speed[i].second;
    if (speed > 0 && at + items / speed <= end) return at + items / speed;
    items -= speed > 0 ? speed * (end - at) : 0;
    at = end;
  }
  return kNever;
}

void Simulation::begin_next(WorkerId worker) {
  Device& device = devices_.at(worker);
  if (!device.alive || device.queue.empty()) return;
  const std::uint64_t run = ++device.run;
  std::uniform_real_distribution<double> off(-network_.noise, network_.noise);
  const double work = static_cast<double>(device.queue.front().count) * (1 + off(random_));
  const Seconds began = now_;
  if (device.script.joins > 0) ++outcome_.counts.late_joiners_at_work;
  at(finish_time(device, began, work), [this, worker, run, began] { finish(worker, run, began); });
}

void Simulation::finish(WorkerId worker, std::uint64_t run, Seconds began) {
  Device& device = devices_.at(worker);
  if (!device.alive || device.run != run || device.queue.empty()) return;
  const Lease lease = device.queue.front();
  device.queue.erase(device.queue.begin());
  if (std::uniform_real_distribution<double>(0, 1)(random_) < network_.fails) {
    ++outcome_.counts.failures;
    send(worker, [this, lease] {
      policy_.failed(lease, now_);
      devices_.at(lease.worker).holds.erase(lease.id);
      ask(lease.worker);
      ask_hungry();
    });
  } else {
    const Seconds seconds = now_ - began;
    send(worker, [this, lease, seconds] { deliver(lease, seconds); });
  }
  begin_next(worker);
}

void Simulation::deliver(const Lease& lease, Seconds seconds) {
  const ResultOutcome result = policy_.result(lease, seconds, now_);
  ++outcome_.counts.verdicts[result.verdict];
  devices_.at(lease.worker).holds.erase(lease.id);
  if (result.verdict == Verdict::accepted) {
    outcome_.makespan = now_;
    std::vector<std::uint8_t>& items = accepted_.at(lease.stage);
    for (std::uint64_t i = lease.first; i < lease.first + lease.count; ++i) {
      if (i >= items.size() || items[i]++ > 0) {
        if (outcome_.broken.empty()) {
          outcome_.broken = "item " + std::to_string(i) + " of stage " + std::to_string(lease.stage) +
                            (i >= items.size() ? " does not exist" : " was accepted twice");
        }
        break;
      }
    }
    left_.at(lease.stage) -= lease.count;
    if (result.stage_complete != (left_.at(lease.stage) == 0) && outcome_.broken.empty()) {
      outcome_.broken = "stage_complete is " + std::to_string(result.stage_complete) + " with " +
                        std::to_string(left_.at(lease.stage)) + " items left";
    }
    if (result.stage_complete && --open_ == 0) add_wave();
  }
  for (const Lease& twin : result.revoke) revoke(twin);
  ask(lease.worker);
  ask_hungry();
}

void Simulation::revoke(const Lease& lease) {
  devices_.at(lease.worker).holds.erase(lease.id);
  hungry_.insert(lease.worker);
  send(lease.worker, [this, lease] {
    Device& device = devices_.at(lease.worker);
    const auto same = [&](const Lease& other) { return other.id == lease.id; };
    const auto at = std::find_if(device.queue.begin(), device.queue.end(), same);
    if (at == device.queue.end()) return;
    const bool ran = at == device.queue.begin();
    device.queue.erase(at);
    if (ran) begin_next(lease.worker);
  });
}

void Simulation::ask(WorkerId worker) {
  Device& asked = devices_.at(worker);
  if (!asked.joined) return;
  while (const auto lease = policy_.next(worker, now_)) {
    asked.holds.insert(lease->id);
    ++outcome_.counts.leases;
    outcome_.counts.duplicates += lease->duplicate;
    send(worker, [this, worker, lease = *lease] {
      Device& device = devices_.at(worker);
      if (!device.alive) return;
      const auto same = [&](const Lease& other) { return other.id == lease.id; };
      if (std::any_of(device.queue.begin(), device.queue.end(), same)) return;
      device.queue.push_back(lease);
      if (device.queue.size() == 1) begin_next(worker);
    });
  }
  // One that holds enough asks again when it has done something.
  if (asked.holds.size() < kInFlight) hungry_.insert(worker);
}

// Those who were asked in vain are asked again soon after anything happened, not after each of a thousand results.
void Simulation::ask_hungry() {
  watch_expiry();
  if (asking_) return;
  asking_ = true;
  at(now_ + kLookAround, [this] {
    asking_ = false;
    std::set<WorkerId> before;
    before.swap(hungry_);
    for (const WorkerId worker : before) ask(worker);
    watch_expiry();
  });
}

void Simulation::watch_expiry() {
  const auto next = policy_.next_expiry();
  if (!next || *next == watched_) return;
  watched_ = *next;
  at(std::max(now_, *next), [this] {
    watched_ = -1;
    const std::vector<Lease> expired = policy_.expire(now_);
    outcome_.counts.expired += expired.size();
    for (const Lease& lease : expired) revoke(lease);
    ask_hungry();
  });
}

void Simulation::add_wave() {
  if (wave_ == waves_.size()) return;
  for (const ScheduledStage& stage : waves_[wave_]) {
    const StageId id = policy_.add_stage(stage, now_);
    accepted_[id].assign(stage.items, 0);
    left_[id] = stage.items;
    ++open_;
  }
  ++wave_;
}

Outcome Simulation::run(const std::vector<std::vector<ScheduledStage>>& waves, Seconds deadline) {
  waves_ = waves;
  add_wave();
  for (auto& [id, device] : devices_) {
    const WorkerId worker = id;
    at(device.script.joins, [this, worker] {
      Device& d = devices_.at(worker);
      d.alive = d.joined = true;
      policy_.joined(worker, now_);
      ask(worker);
      ask_hungry();
    });
    for (const auto& [from, factor] : device.script.factors) {
      at(from, [this, worker, hangs = factor == 0] {
        if (devices_.at(worker).queue.empty()) return;
        ++(hangs ? outcome_.counts.hangs_with_work : outcome_.counts.slowed_with_work);
      });
    }
    if (!device.script.dies) continue;
    at(*device.script.dies, [this, worker] {
      Device& d = devices_.at(worker);
      if (d.alive && !d.queue.empty()) ++outcome_.counts.deaths_with_work;
      d.alive = false;
      d.queue.clear();
    });
    at(*device.script.dies + device.script.noticed_after, [this, worker] {
      devices_.at(worker).joined = false;
      devices_.at(worker).holds.clear();
      policy_.lost(worker, now_);
      ask_hungry();
    });
  }

  while (!events_.empty() && events_.top().at <= deadline) {
    const Event event = events_.top();
    events_.pop();
    now_ = event.at;
    ++outcome_.counts.events;
    event.happen();
  }
  outcome_.complete = open_ == 0 && wave_ == waves_.size();
  for (const auto& [stage, items] : accepted_) {
    if (!outcome_.complete || !outcome_.broken.empty()) break;
    const auto missing = std::find(items.begin(), items.end(), 0);
    if (missing != items.end())
      outcome_.broken = "item " + std::to_string(missing - items.begin()) + " was never accepted";
    if (outcome_.broken.empty()) outcome_.broken = policy_.audit(stage, items.size());
  }
  return outcome_;
}

Seconds ideal_makespan(const std::vector<WorkerScript>& workers, double items) {
  const auto done_by = [&](Seconds end) {
    double done = 0;
    for (const WorkerScript& worker : workers) {
      const auto profile = speed_profile(worker);
      for (std::size_t i = 0; i < profile.size(); ++i) {
        const Seconds from = std::max(profile[i].first, worker.joins);
        const Seconds to = std::min(end, i + 1 < profile.size() ? profile[i + 1].first : kNever);
        if (to > from) done += profile[i].second * (to - from);
      }
    }
    return done;
  };
  Seconds low = 0, high = 1;
  while (done_by(high) < items) high *= 2;
  for (int i = 0; i < 100; ++i) {
    const Seconds middle = (low + high) / 2;
    (done_by(middle) < items ? low : high) = middle;
  }
  return high;
}

}  // namespace gleaner::farm
