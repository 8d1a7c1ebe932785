// Seeded random events against the scheduler; after each one, what it says is compared with a model that only counts.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {
namespace {

struct ModelStage {
  ScheduledStage spec;
  std::vector<int> accepted;  // how often, per item
  bool failed = false;

  std::uint64_t done() const { return static_cast<std::uint64_t>(std::count(accepted.begin(), accepted.end(), 1)); }
};

class Fuzz {
 public:
  explicit Fuzz(std::uint64_t seed) : random_(seed), settings_(make_settings()), farm_(settings_) {}

  // Empty, or the first thing that was wrong.
  std::string run(int events) {
    for (int i = 0; i < events && wrong_.empty(); ++i) {
      step();
      if (wrong_.empty()) check();
    }
    if (wrong_.empty()) finish();
    return wrong_;
  }

  std::map<std::string, int> seen;  // how often each kind of thing happened, so that a run that does nothing is noticed

 private:
  std::uint64_t below(std::uint64_t n) { return random_() % n; }
  bool chance(int percent) { return below(100) < static_cast<std::uint64_t>(percent); }

  SchedulerSettings make_settings() {
    SchedulerSettings settings;
    settings.first_batch_items = 1 + below(20);
    settings.fixed_batch_items = chance(30) ? 1 + below(8) : 0;
    settings.in_flight = 1 + static_cast<unsigned>(below(3));
    settings.lease_floor = 2;
    settings.solo_lease_floor = 5;
    settings.strikes = 1 + static_cast<unsigned>(below(3));
    settings.incarnation = below(3);
    return settings;
  }

  void complain(const std::string& what) {
    if (wrong_.empty()) wrong_ = what;
  }

  void step() {
    switch (below(16)) {
      case 0:
        return add_stage();
      case 1:
        return join(1 + below(6));
      case 2:
        return chance(30) ? drain(1 + below(6)) : lose(1 + below(6));
      case 3:
        now_ += static_cast<double>(below(100)) / 20;
        return expire();
      case 4:
        if (chance(10)) remove_stage();
        return;
      case 5:
        return fail();
      case 6:
        return repeat_old_result();
      case 7:
        return forge();
      case 8:
      case 9:
      case 10:
      case 11:
        now_ += static_cast<double>(below(10)) / 100;
        return deliver();
      default:
        return ask(1 + below(6));
    }
  }

  void add_stage() {
    if (stages_.size() >= 4) return;
    ModelStage stage;
    stage.spec.kind = chance(50) ? "shade" : "trace";
    stage.spec.items = below(80);
    stage.spec.tile = 1 + static_cast<std::uint32_t>(below(6));
    stage.spec.solo = chance(20);
    stage.spec.adjoining = chance(30);
    if (!stage.spec.solo && chance(30))
      stage.spec.near = {{1 + below(8), {{0, stage.spec.items / 3}}},
                         {1 + below(8), {{stage.spec.items / 2, stage.spec.items / 2}}}};
    stage.spec.near_bytes = static_cast<double>(below(1u << 24));
    stage.spec.priority = static_cast<int>(below(3)) - 1;
    if (stage.spec.solo && chance(60)) stage.spec.preferred = {1 + below(8), 1 + below(8)};
    stage.accepted.assign(stage.spec.items, 0);
    stages_.emplace(farm_.add_stage(stage.spec, now_), stage);
  }
  void join(WorkerId worker) {
    lose(worker);
    farm_.worker_joined(worker, now_);
    joined_.insert(worker);
    ++seen["join"];
  }
  void lose(WorkerId worker) {
    farm_.worker_lost(worker, now_);
    joined_.erase(worker);
    draining_.erase(worker);
    std::erase_if(live_, [&](const auto& entry) {
      if (entry.second.worker != worker) return false;
      ++seen["lost with work"];
      return true;
    });
  }
  void drain(WorkerId worker) {
    farm_.worker_draining(worker);
    if (joined_.contains(worker)) draining_.insert(worker);
  }
  void expire() {
    for (const Lease& lease : farm_.expire(now_)) {
      ++seen["expired"];
      if (live_.erase(lease.id) == 0) complain("a lease ran out that was not live");
    }
    if (farm_.next_expiry() && *farm_.next_expiry() <= now_) complain("next_expiry has passed after expire");
  }
  void remove_stage() {
    if (stages_.empty()) return;
    const StageId stage = std::next(stages_.begin(), static_cast<long>(below(stages_.size())))->first;
    std::set<LeaseId> expected, returned;
    for (const auto& [id, lease] : live_) {
      if (lease.stage == stage) expected.insert(id);
    }
    for (const Lease& lease : farm_.remove_stage(stage)) returned.insert(lease.id);
    if (expected != returned) complain("remove_stage did not return the stage's live leases");
    std::erase_if(live_, [&](const auto& entry) { return entry.second.stage == stage; });
    stages_.erase(stage);
    ++seen["removed"];
  }

  void ask(WorkerId worker) {
    const auto lease = farm_.next_lease(worker, now_);
    if (!lease) return;
    ++seen[lease->duplicate ? "duplicate" : "lease"];
    if (!joined_.contains(worker) || draining_.contains(worker))
      return complain("a lease for a worker that takes none");
    if (!ids_.insert(lease->id).second) return complain("a lease's id came twice");
    if (!epochs_.insert(lease->epoch).second) return complain("an epoch came twice");
    if (lease->worker != worker || lease->issued != now_ || !(lease->expires > now_))
      return complain("a lease's fields");
    if (!stages_.contains(lease->stage)) return complain("a lease of a stage that is gone");
    const ModelStage& stage = stages_.at(lease->stage);
    if (stage.failed) return complain("a lease of a stage that failed");
    const std::uint64_t end = lease->first + lease->count;
    if (lease->count == 0 || end > stage.spec.items) return complain("a lease of items that do not exist");
    if (stage.spec.solo && lease->count != stage.spec.items) return complain("a solo stage was cut");
    if (lease->first % stage.spec.tile != 0 || (end % stage.spec.tile != 0 && end != stage.spec.items)) {
      return complain("a tile was cut");
    }
    for (std::uint64_t i = lease->first; i < end; ++i) {
      if (stage.accepted[i] != 0) return complain("an item was leased after it was accepted");
    }
    int twins = 0;
    std::size_t held = 1;
    for (const auto& [id, other] : live_) {
      if (other.worker == worker) ++held;
      if (other.stage != lease->stage || other.first >= end || lease->first >= other.first + other.count) continue;
      if (other.first != lease->first || other.count != lease->count) return complain("two leases overlap in part");
      if (other.worker == worker) return complain("a worker got a copy of its own lease");
      if (stage.spec.solo && now_ - other.issued < settings_.solo_copy_after_unproven)
        return complain("a solo lease was copied too soon");
      ++twins;
    }
    if (twins != (lease->duplicate ? 1 : 0)) return complain("a lease has " + std::to_string(twins) + " twins");
    if (held > settings_.in_flight) return complain("a worker holds too much");
    live_.emplace(lease->id, *lease);
    past_.push_back(*lease);
  }

  Lease any_live() { return std::next(live_.begin(), static_cast<long>(below(live_.size())))->second; }

  void deliver() {
    if (live_.empty()) return;
    const Lease lease = any_live();
    accept(lease, static_cast<double>(below(1000)) / 1000);
  }
  void accept(const Lease& lease, Seconds seconds) {
    const ResultOutcome outcome = farm_.result(lease.worker, lease.id, lease.epoch, seconds, now_);
    live_.erase(lease.id);
    ModelStage& stage = stages_.at(lease.stage);
    if (stage.failed) {
      if (outcome.verdict != Verdict::stage_gone) complain("a result for a failed stage was taken");
      return;
    }
    if (outcome.verdict != Verdict::accepted)
      return complain("a live lease's result: " + std::string(verdict_name(outcome.verdict)));
    ++seen["accepted"];
    for (std::uint64_t i = lease.first; i < lease.first + lease.count; ++i) ++stage.accepted[i];
    std::set<LeaseId> twins, revoked;
    for (const auto& [id, other] : live_) {
      if (other.stage == lease.stage && other.first == lease.first) twins.insert(id);
    }
    for (const Lease& other : outcome.revoke) revoked.insert(other.id);
    if (twins != revoked) complain("revoke does not name the twins");
    for (const LeaseId id : twins) live_.erase(id);
    if (outcome.stage_complete != (stage.done() == stage.spec.items)) complain("stage_complete is wrong");
  }
  void repeat_old_result() {
    if (past_.empty()) return;
    const Lease lease = past_[below(past_.size())];
    if (live_.contains(lease.id)) return;
    const Verdict verdict = farm_.result(lease.worker, lease.id, lease.epoch, 1, now_).verdict;
    ++seen[std::string("late: ") + verdict_name(verdict)];
    const bool gone = !stages_.contains(lease.stage) || stages_.at(lease.stage).failed ||
                      stages_.at(lease.stage).done() == stages_.at(lease.stage).spec.items;
    if ((verdict == Verdict::stage_gone) != gone)
      complain("stage_gone for a stage that is there, or not for one that is gone");
    if (verdict != Verdict::stage_gone && verdict != Verdict::stale && verdict != Verdict::duplicate) {
      complain("a late result: " + std::string(verdict_name(verdict)));
    }
    if (farm_.failed(lease.worker, lease.id, lease.epoch, now_).known) complain("a late failure was taken");
  }
  void forge() {
    if (live_.empty()) return;
    const Lease lease = any_live();
    const WorkerId other = lease.worker + 1 + below(5);
    if (farm_.result(other, lease.id, lease.epoch, 1, now_).verdict != Verdict::wrong_worker)
      complain("another's result was taken");
    if (farm_.result(lease.worker, lease.id, lease.epoch + 1 + below(9), 1, now_).verdict != Verdict::stale)
      complain("a wrong epoch was taken");
    if (farm_.result(lease.worker, lease.id + (1ull << 40), lease.epoch, 1, now_).verdict != Verdict::unknown_lease) {
      complain("a lease that never was, was known");
    }
    if (farm_.failed(other, lease.id, lease.epoch, now_).known) complain("another's failure was taken");
    if (farm_.failed(lease.worker, lease.id, lease.epoch - 1, now_).known)
      complain("a failure of a wrong epoch was taken");
  }
  void fail() {
    if (live_.empty() || !chance(failing_)) return;
    const Lease lease = any_live();
    const FailureOutcome outcome = farm_.failed(lease.worker, lease.id, lease.epoch, now_);
    live_.erase(lease.id);
    if (!outcome.known) complain("a live lease's failure was not known");
    ModelStage& stage = stages_.at(lease.stage);
    if (outcome.stage_failed && stage.failed) complain("a stage failed twice");
    stage.failed = stage.failed || outcome.stage_failed;
    ++seen[outcome.stage_failed ? "stage failed" : "failed"];
  }

  void check() {
    for (const auto& [id, stage] : stages_) {
      if (farm_.items_done(id) != stage.done()) complain("items_done is wrong");
      if (farm_.complete(id) != (stage.done() == stage.spec.items)) complain("complete is wrong");
      for (const int times : stage.accepted) {
        if (times > 1) complain("an item was accepted twice");
      }
      std::set<std::uint64_t> held;
      std::uint64_t held_items = 0;
      for (const auto& [lease_id, lease] : live_) {
        if (lease.stage == id && held.insert(lease.first).second) held_items += lease.count;
      }
      const bool waits = stage.failed || stage.done() + held_items < stage.spec.items;
      // Where all items are held, it may still name a worker that takes too long.
      const std::string why = farm_.why_waiting(id, now_);
      const bool late = why.find("has not answered its batch") != std::string::npos;
      if (waits ? why.empty() || late : !why.empty() && !(late && held_items > 0))
        complain("why_waiting says '" + why + "'");
      std::uint64_t progress = 0;
      for (const auto& [worker, part] : farm_.progress(id)) progress += part.items;
      if (progress != stage.done()) complain("progress does not add up");
    }
  }

  // From whatever state, one good worker brings every stage that did not fail to its end.
  void finish() {
    for (WorkerId worker = 1; worker <= 6; ++worker) {
      if (chance(50)) lose(worker);  // else it keeps its leases and is never heard of again
    }
    const WorkerId good = 100;
    join(good);
    for (int turn = 0; turn < 10'000 && wrong_.empty(); ++turn) {
      const bool all = std::all_of(stages_.begin(), stages_.end(), [&](const auto& entry) {
        return entry.second.failed || farm_.complete(entry.first);
      });
      if (all) return;
      ask(good);
      const auto mine =
          std::find_if(live_.begin(), live_.end(), [&](const auto& e) { return e.second.worker == good; });
      if (mine != live_.end()) {
        const Lease lease = mine->second;
        now_ += 0.01;
        accept(lease, 0.01);
      } else if (farm_.next_expiry()) {
        now_ = std::max(now_, *farm_.next_expiry());
        expire();
      } else {
        // Idle, nothing to wait for: then something must be left that only an event would bring.
        return complain("nothing more happens, but a stage is not complete");
      }
      check();
    }
    complain("the stages did not end");
  }

  std::mt19937_64 random_;
  int failing_ = static_cast<int>(below(100));
  SchedulerSettings settings_;
  Scheduler farm_;
  Seconds now_ = 0;
  std::set<WorkerId> joined_, draining_;
  std::map<StageId, ModelStage> stages_;
  std::map<LeaseId, Lease> live_;
  std::vector<Lease> past_;
  std::set<LeaseId> ids_;
  std::set<Epoch> epochs_;
  std::string wrong_;
};

TEST(Fuzz, EveryItemIsAcceptedExactlyOnceWhateverHappens) {
  std::map<std::string, int> seen;
  for (std::uint64_t seed = 1; seed <= 3000; ++seed) {
    Fuzz fuzz(seed);
    ASSERT_EQ(fuzz.run(200), "") << "seed " << seed;
    for (const auto& [what, times] : fuzz.seen) seen[what] += times;
  }
  for (const char* what : {"join", "lost with work", "expired", "removed", "lease", "duplicate", "accepted", "failed",
                           "stage failed", "late: stale", "late: duplicate", "late: stage gone"}) {
    EXPECT_GE(seen[what], 300) << "'" << what << "' hardly ever happened: these runs prove little about it";
  }
}

}  // namespace
}  // namespace gleaner::coordinator
