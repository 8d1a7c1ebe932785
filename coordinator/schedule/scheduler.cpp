#include "coordinator/schedule/scheduler.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>
#include <tuple>
#include <unordered_map>

#include "coordinator/schedule/adjoining.h"
#include "coordinator/schedule/item_pool.h"
#include "coordinator/schedule/throughput.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

// A batch takes at most this part of a worker's fair share of what is left, so that errors of the estimates can still
// be made good by later, smaller batches (Hummel, Schonberg, Flynn: Factoring, 1992).
constexpr double kShareAtOnce = 0.5;

// How many leases an idle worker compares before it gives up finding one that it would finish sooner.
constexpr int kDuplicateCandidates = 4;

// A worker that is quarantined again and again waits twice as long each time, but at most so many times the first wait.
constexpr double kLongestAside = 32;

// A batch that runs so many times as long as expected makes its worker a straggler: what waits behind it goes to
// others.
constexpr double kLate = 3;

// How late a batch is, in seconds, before people are told.
constexpr Seconds kLateForPeople = 2;

// Leases are numbered from here on in the run of the coordinator that `incarnation` counts.
constexpr unsigned kIncarnationShift = 32;

using Kind = unsigned;

enum class Standing { none, running, waiting };  // of a lease among those that an idle worker may run as well

struct LiveLease {
  Lease lease;
  bool cut_short = false;  // smaller than the worker's throughput asked for
  Seconds planned = 0;     // when it should be finished, as estimated when the worker's leases last changed
  Standing standing = Standing::none;
  Seconds listed = 0;  // its place in the list of candidates
};

// What remains of a lease that ended: enough to say why its late result is dropped.
struct EndedLease {
  WorkerId worker = 0;
  Epoch epoch = 0;
  Kind kind = 0;
  std::uint64_t count = 0;
  bool cut_short = false;
  bool accepted = false;  // the items are in: by this lease or by its twin
};

// Items that are handed out: to one worker, or to two.
struct HeldRange {
  std::uint64_t count = 0;
  FailureHistory failures;
  std::array<LeaseId, 2> leases{};  // 0 = none

  bool twice() const { return leases[0] != 0 && leases[1] != 0; }
  bool free() const { return leases[0] == 0 && leases[1] == 0; }
};

enum class StageState { open, complete, failed };

using Place = std::tuple<unsigned, int, StageId>;  // (rank, priority negated, id)

using Candidates = std::set<std::pair<Seconds, LeaseId>>;  // by planned finish

struct Stage {
  StageId id = 0;
  ScheduledStage spec;
  Kind kind = 0;
  StageState state = StageState::open;
  Seconds preferred_until = 0;  // solo: until then the preferred workers alone are served
  bool paused = false;
  std::uint64_t wanted_items = 0;  // all, or those of spec.only
  // Into each worker's spans of spec.near: those before it have no free items. A cursor, so that an offer costs O(log
  // n).
  mutable std::map<WorkerId, std::size_t> near_cursor;
  std::map<std::uint64_t, std::pair<std::uint64_t, WorkerId>> holders;  // the same by first item: count, worker
  ItemPool pool;
  Adjoining adjoining;
  std::map<std::uint64_t, HeldRange> held;  // by first item
  std::uint64_t held_items = 0, done_items = 0;
  Candidates running, waiting;  // leases held once
  std::vector<LeaseId> ended;
  std::map<WorkerId, WorkerProgress> progress;
};

Place place_of(const Stage& stage) { return {stage.spec.rank, -stage.spec.priority, stage.id}; }

struct Worker {
  WorkerId id = 0;
  bool draining = false;
  bool proven = false;  // it has answered something
  bool quarantined = false;
  Seconds quarantined_until = 0;
  std::vector<LeaseId> in_flight;       // the first one runs, the others wait
  Seconds in_flight_since = 0;          // when the first one began to run
  bool straggles = false;               // the first one takes far longer than it should
  std::optional<Seconds> straggler_at;  // when that would be so, while something waits behind it
  unsigned failures_in_row = 0, expiries_in_row = 0;
  std::map<Kind, Throughput> throughput;

  bool serves() const { return !draining && !quarantined; }
};

// What the workers that serve can do together, per kind of stage.
struct KindTotals {
  double items_per_second = 0;  // of those whose throughput is known
  std::uint64_t known = 0;
};

enum class TimerKind { lease, straggler, quarantine, preferred };
using Timer = std::tuple<Seconds, TimerKind, std::uint64_t>;

// Why a worker gets none of a stage's unleased items.
// The first ones hold for every stage.
enum class Refusal {
  none,
  drains,
  quarantined,
  runs_solo,
  straggler,
  full,
  failed_it,
  others_preferred,
  others_hold_inputs,
  not_measured,
  has_its_share
};

struct Offer {
  Refusal why_not = Refusal::none;
  Piece piece;
  std::uint64_t count = 0;
  bool cut_short = false;
  bool adjoining = false;  // the piece begins where the worker goes on

  Offer& refuse(Refusal why) {
    why_not = why;
    return *this;
  }
};

enum class LeaseEnd { items_accepted, taken_back };

}  // namespace

const char* verdict_name(Verdict verdict) {
  switch (verdict) {
    case Verdict::accepted:
      return "accepted";
    case Verdict::duplicate:
      return "duplicate";
    case Verdict::stale:
      return "stale";
    case Verdict::unknown_lease:
      return "unknown lease";
    case Verdict::wrong_worker:
      return "wrong worker";
    case Verdict::stage_gone:
      return "stage gone";
  }
  return "no verdict";
}

struct Scheduler::Impl {
  explicit Impl(const SchedulerSettings& s)
      : settings(s),
        first_lease((s.incarnation << kIncarnationShift) + 1),
        next_lease_id(first_lease),
        next_epoch(first_lease) {}

  SchedulerSettings settings;
  const LeaseId first_lease;
  LeaseId next_lease_id;
  Epoch next_epoch;
  StageId next_stage = 1;
  std::map<StageId, Stage> stages;
  std::set<Place> order;  // open stages: most urgent first
  std::map<WorkerId, Worker> workers;
  std::unordered_map<LeaseId, LiveLease> live;
  std::unordered_map<LeaseId, EndedLease> ended;
  std::set<Timer> timers;
  std::map<std::string, Kind> kinds;
  std::vector<KindTotals> totals;
  std::uint64_t joined = 0, draining = 0, serving = 0, idle = 0;  // idle: serves and holds nothing
  std::uint64_t proven = 0;                                       // of those that serve
  Seconds latest = -std::numeric_limits<double>::infinity();      // the last clock value seen
  mutable std::uint64_t steps = 0;

  // Every event's time passes here: a clock that jumps back stands still instead.
  Seconds clock(Seconds now) { return latest = std::max(latest, now); }

  // -- Who serves ----------------------------------------------------------------------------------------------------

  // Every change of a worker's standing or leases is bracketed by these two, which keep the sums over workers.
  void leave_sums(const Worker& worker) {
    if (worker.draining) --draining;
    if (!worker.serves()) return;
    --serving;
    if (worker.proven) --proven;
    if (worker.in_flight.empty()) --idle;
    for (const auto& [kind, throughput] : worker.throughput) {
      ++steps;
      if (!throughput.known()) continue;
      KindTotals& total = totals[kind];
      --total.known;
      // Sums of what comes and goes would keep rounding errors for ever; with nobody left the sum is known.
      total.items_per_second = total.known == 0 ? 0 : total.items_per_second - throughput.items_per_second();
    }
  }
  void enter_sums(const Worker& worker) {
    if (worker.draining) ++draining;
    if (!worker.serves()) return;
    ++serving;
    if (worker.proven) ++proven;
    if (worker.in_flight.empty()) ++idle;
    for (const auto& [kind, throughput] : worker.throughput) {
      ++steps;
      if (!throughput.known()) continue;
      ++totals[kind].known;
      totals[kind].items_per_second += throughput.items_per_second();
    }
  }

  // May get leases: when nobody serves, those that were quarantined are better than nobody.
  bool usable(const Worker& worker) const { return !worker.draining && (!worker.quarantined || serving == 0); }
  std::uint64_t usable_workers() const { return serving > 0 ? serving : joined - draining; }

  // A range goes to a worker that has not failed it, or to any where all have.
  bool may_run(const Worker& worker, const FailureHistory& failures) const {
    if (!failures.by(worker.id)) return true;
    std::uint64_t failed_it = 0;
    for (const WorkerId id : failures.workers) {
      ++steps;
      const auto at = workers.find(id);
      if (at != workers.end() && usable(at->second)) ++failed_it;
    }
    return failed_it >= usable_workers();
  }

  void quarantine(Worker& worker, unsigned times, Seconds now) {
    const double wait = std::min(std::ldexp(1.0, static_cast<int>(std::min(times, 30u)) - 1), kLongestAside);
    leave_sums(worker);
    if (worker.quarantined) timers.erase({worker.quarantined_until, TimerKind::quarantine, worker.id});
    worker.quarantined = true;
    worker.quarantined_until = now + settings.lease_floor * wait;
    timers.insert({worker.quarantined_until, TimerKind::quarantine, worker.id});
    enter_sums(worker);
    ++steps;
  }
  // It has answered. Who never did may hold what it gets for ever, with every sign of life.
  void prove(Worker& worker) {
    if (worker.proven) return;
    leave_sums(worker);
    worker.proven = true;
    enter_sums(worker);
  }
  void take_back_in(Worker& worker) {
    if (!worker.quarantined) return;
    leave_sums(worker);
    timers.erase({worker.quarantined_until, TimerKind::quarantine, worker.id});
    worker.quarantined = false;
    enter_sums(worker);
    ++steps;
  }

  // -- What workers can do -------------------------------------------------------------------------------------------

  Kind kind_of(const std::string& name) {
    const auto [at, fresh] = kinds.emplace(name, static_cast<Kind>(totals.size()));
    if (fresh) totals.emplace_back();
    return at->second;
  }

  double mean_throughput(Kind kind) const {
    const KindTotals& total = totals[kind];
    return total.known == 0 ? 0 : total.items_per_second / static_cast<double>(total.known);
  }

  // Items per second; of a worker that was not measured, what the others do on average; 0 = nobody knows.
  double expected_throughput(const Worker& worker, Kind kind) const {
    const auto at = worker.throughput.find(kind);
    return at != worker.throughput.end() && at->second.known() ? at->second.items_per_second() : mean_throughput(kind);
  }

  // The worker's part of what all that serve can do, in (0, 1].
  double share(const Worker& worker, Kind kind) const {
    const double mine = expected_throughput(worker, kind);
    const auto unknown = static_cast<double>(usable_workers() - std::min(usable_workers(), totals[kind].known));
    const double all = totals[kind].items_per_second + unknown * mean_throughput(kind);
    if (!(mine > 0) || !(all > 0)) return 1.0 / static_cast<double>(std::max<std::uint64_t>(1, usable_workers()));
    return std::min(1.0, mine / all);
  }

  template <typename Change>
  void learn(Worker& worker, Kind kind, const Change& change) {
    Throughput& throughput = worker.throughput[kind];
    const double before = throughput.items_per_second();
    change(throughput);
    ++steps;
    if (!worker.serves() || !throughput.known()) return;
    if (!(before > 0)) ++totals[kind].known;
    totals[kind].items_per_second += throughput.items_per_second() - before;
  }

  // -- What a worker holds -------------------------------------------------------------------------------------------

  Seconds expected_seconds(const Worker& worker, const Stage& stage, std::uint64_t count) const {
    const double throughput = expected_throughput(worker, stage.kind);
    return throughput > 0 ? static_cast<double>(count) / throughput : 0;
  }

  // Whether the item reads what the worker does not hold.
  bool must_fetch(const Stage& stage, WorkerId worker, std::uint64_t item) const {
    if (stage.spec.near.empty()) return false;
    const auto spans = stage.spec.near.find(worker);
    if (spans == stage.spec.near.end()) return true;
    ++steps;
    const auto after = std::upper_bound(spans->second.begin(), spans->second.end(), item,
                                        [](std::uint64_t at, const ItemSpan& span) { return at < span.first; });
    return after == spans->second.begin() || item >= (after - 1)->first + (after - 1)->count;
  }

  Seconds fetch_seconds_an_item(const Stage& stage) const {
    return stage.spec.near_bytes / settings.fetch_bytes_per_second;
  }

  // Until the worker has what items from `first` on read, beyond what it holds.
  Seconds fetch_seconds(const Worker& worker, const Stage& stage, std::uint64_t first, std::uint64_t count) const {
    if (!must_fetch(stage, worker.id, first)) return 0;
    return settings.fetch_latency + fetch_seconds_an_item(stage) * static_cast<double>(count);
  }

  // With what has to be fetched for it; 0 = nobody knows.
  Seconds expected_lease_seconds(const Worker& worker, const Stage& stage, std::uint64_t first,
                                 std::uint64_t count) const {
    const Seconds runs = expected_seconds(worker, stage, count);
    return runs > 0 ? runs + fetch_seconds(worker, stage, first, count) : 0;
  }

  Seconds lease_length(const Stage& stage, Seconds expected) const {
    return std::max(stage.spec.solo ? settings.solo_lease_floor : settings.lease_floor,
                    settings.lease_factor * expected);
  }

  // share() of items from `first` on: less where each has to be fetched.
  double share_of(const Worker& worker, const Stage& stage, std::uint64_t first) const {
    const double all = share(worker, stage.kind);
    if (!must_fetch(stage, worker.id, first)) return all;
    return all / (1 + expected_throughput(worker, stage.kind) * fetch_seconds_an_item(stage));
  }

  // Brings the estimates of the worker's leases up to date, and their places among the candidates for duplication.
  void replan(Worker& worker) {
    Seconds at = worker.in_flight_since;
    for (const LeaseId id : worker.in_flight) {
      ++steps;
      LiveLease& lease = live.at(id);
      Stage& stage = stages.at(lease.lease.stage);
      const Seconds duration = expected_lease_seconds(worker, stage, lease.lease.first, lease.lease.count);
      at += duration > 0 ? duration : settings.target_batch;
      lease.planned = at;
      list_candidate(stage, lease, id == worker.in_flight.front());
    }
    watch_lateness(worker);
  }

  void watch_lateness(Worker& worker) {
    if (worker.straggler_at) timers.erase({*worker.straggler_at, TimerKind::straggler, worker.id});
    worker.straggler_at.reset();
    if (worker.in_flight.size() < 2 || worker.straggles) return;
    const LiveLease& first = live.at(worker.in_flight.front());
    const Seconds expected = first.planned - worker.in_flight_since;
    // Short batches are late by little: what it costs to wait is a batch at most.
    worker.straggler_at = worker.in_flight_since + std::max(kLate * expected, expected + settings.target_batch);
    timers.insert({*worker.straggler_at, TimerKind::straggler, worker.id});
    ++steps;
  }

  void unlist(Stage& stage, LiveLease& lease) {
    if (lease.standing == Standing::none) return;
    (lease.standing == Standing::running ? stage.running : stage.waiting).erase({lease.listed, lease.lease.id});
    lease.standing = Standing::none;
  }

  void list_candidate(Stage& stage, LiveLease& lease, bool runs) {
    ++steps;
    unlist(stage, lease);
    if (stage.state != StageState::open || stage.held.at(lease.lease.first).twice()) return;
    lease.standing = runs ? Standing::running : Standing::waiting;
    lease.listed = lease.planned;
    (runs ? stage.running : stage.waiting).insert({lease.listed, lease.lease.id});
  }

  void set_expiry(LiveLease& lease, Seconds expires) {
    ++steps;
    timers.erase({lease.lease.expires, TimerKind::lease, lease.lease.id});
    lease.lease.expires = expires;
    timers.insert({expires, TimerKind::lease, lease.lease.id});
  }

  Lease issue(Worker& worker, Stage& stage, std::uint64_t first, std::uint64_t count, bool cut_short, bool duplicate,
              Seconds now) {
    LiveLease lease;
    lease.cut_short = cut_short;
    lease.lease = {next_lease_id++, next_epoch++, stage.id, worker.id, first, count, now, now, duplicate};
    const LeaseId id = lease.lease.id;
    live.emplace(id, lease);

    HeldRange& range = stage.held.at(first);
    for (const LeaseId other : range.leases) {
      if (other != 0) unlist(stage, live.at(other));
    }
    range.leases[range.leases[0] == 0 ? 0 : 1] = id;

    leave_sums(worker);
    if (worker.in_flight.empty()) worker.in_flight_since = now;
    worker.in_flight.push_back(id);
    enter_sums(worker);
    replan(worker);

    LiveLease& placed = live.at(id);
    const bool known = expected_throughput(worker, stage.kind) > 0;
    set_expiry(placed, now + lease_length(stage, known ? placed.planned - now : 0));
    return placed.lease;
  }

  // Takes the lease out of everything but its range's items; `delivered`: the worker itself said that it is over.
  void end_lease(LeaseId id, LeaseEnd how, bool delivered, Seconds now) {
    const LiveLease lease = live.at(id);
    Stage& stage = stages.at(lease.lease.stage);
    unlist(stage, live.at(id));
    timers.erase({lease.lease.expires, TimerKind::lease, id});
    live.erase(id);
    if (stage.state == StageState::open) {
      const bool accepted = how != LeaseEnd::taken_back;
      ended.emplace(id, EndedLease{lease.lease.worker, lease.lease.epoch, stage.kind, lease.lease.count,
                                   lease.cut_short, accepted});
      stage.ended.push_back(id);
    }
    steps += 3;

    if (const auto range = stage.held.find(lease.lease.first); range != stage.held.end()) {
      for (LeaseId& slot : range->second.leases) {
        if (slot == id) slot = 0;
      }
    }

    Worker& worker = workers.at(lease.lease.worker);
    const bool ran = worker.in_flight.front() == id;
    leave_sums(worker);
    std::erase(worker.in_flight, id);
    enter_sums(worker);
    if (ran) {
      worker.in_flight_since = now;
      worker.straggles = false;
    }
    // The next one's time begins now, but only if the worker shows signs of life.
    if (ran && delivered && !worker.in_flight.empty()) {
      LiveLease& next = live.at(worker.in_flight.front());
      const Stage& next_stage_of = stages.at(next.lease.stage);
      const Seconds expected = expected_lease_seconds(worker, next_stage_of, next.lease.first, next.lease.count);
      set_expiry(next, std::max(next.lease.expires, now + lease_length(next_stage_of, expected)));
    }
    replan(worker);
  }

  // The worker is a straggler: what waits for it is cut anew for the others.
  void recall_waiting(Worker& worker, Seconds now, std::vector<Lease>& recalled) {
    worker.straggler_at.reset();
    if (usable_workers() < 2) {
      // Nobody else could have it: look again when it took twice as long.
      worker.straggler_at = now + (now - worker.in_flight_since);
      timers.insert({*worker.straggler_at, TimerKind::straggler, worker.id});
      return;
    }
    worker.straggles = true;
    const Lease running = live.at(worker.in_flight.front()).lease;
    learn(worker, stages.at(running.stage).kind,
          [&](Throughput& t) { t.overran(running.count, now - worker.in_flight_since, settings); });
    while (worker.in_flight.size() > 1) {
      const Lease lease = live.at(worker.in_flight.back()).lease;
      end_lease(lease.id, LeaseEnd::taken_back, false, now);
      give_back(stages.at(lease.stage), lease.first);
      recalled.push_back(lease);
    }
    replan(worker);
  }

  // After a lease on the range ended without a result: the items go back, unless another worker still has them.
  void give_back(Stage& stage, std::uint64_t first) {
    const auto at = stage.held.find(first);
    HeldRange& range = at->second;
    ++steps;
    if (!range.free()) {
      LiveLease& other = live.at(range.leases[0] != 0 ? range.leases[0] : range.leases[1]);
      list_candidate(stage, other, workers.at(other.lease.worker).in_flight.front() == other.lease.id);
      return;
    }
    stage.held_items -= range.count;
    stage.near_cursor.clear();
    stage.pool.put({first, range.count, std::move(range.failures)});
    stage.held.erase(at);
  }

  void close(Stage& stage, StageState state) {
    stage.state = state;
    order.erase(place_of(stage));
    if (stage.spec.solo) timers.erase({stage.preferred_until, TimerKind::preferred, stage.id});
    for (Candidates* list : {&stage.running, &stage.waiting}) {
      for (const auto& [planned, id] : *list) live.at(id).standing = Standing::none;
      list->clear();
    }
    for (const LeaseId id : stage.ended) ended.erase(id);
    stage.ended.clear();
  }

  // -- Handing out ---------------------------------------------------------------------------------------------------

  bool holds_solo(const Worker& worker) const {
    return std::any_of(worker.in_flight.begin(), worker.in_flight.end(),
                       [&](LeaseId id) { return stages.at(live.at(id).lease.stage).spec.solo; });
  }

  // Others that should have the solo stage rather than the worker.
  bool preferred_may_come(const Worker& worker, const Stage& stage, const FailureHistory& failures, Seconds now) const {
    if (now >= stage.preferred_until) return false;
    // A mute worker would hold the whole frame.
    if (!worker.proven && proven > 0) return true;
    return std::any_of(stage.spec.preferred.begin(), stage.spec.preferred.end(), [&](WorkerId id) {
      ++steps;
      const auto at = workers.find(id);
      return at != workers.end() && usable(at->second) && !failures.by(id);
    });
  }

  static bool prefers(const Stage& stage, WorkerId worker) {
    return std::find(stage.spec.preferred.begin(), stage.spec.preferred.end(), worker) != stage.spec.preferred.end();
  }

  std::uint64_t round_to_tiles(double items, const Stage& stage, const Piece& piece) const {
    const double tile = stage.spec.tile;
    // Compared as doubles first: an estimate may exceed what an integer holds.
    if (items >= static_cast<double>(piece.count)) return piece.count;
    const auto tiles = static_cast<std::uint64_t>(std::max(1.0, std::floor(items / tile)));
    return std::min<std::uint64_t>(tiles * stage.spec.tile, piece.count);
  }

  std::uint64_t items_in_flight(const Worker& worker, StageId stage) const {
    std::uint64_t items = 0;
    for (const LeaseId id : worker.in_flight) {
      ++steps;
      if (live.at(id).lease.stage == stage) items += live.at(id).lease.count;
    }
    return items;
  }

  // Free items of whose inputs the worker holds its share; none: count is 0.
  Piece near_piece(const Stage& stage, WorkerId worker) const {
    const auto spans = stage.spec.near.find(worker);
    if (spans == stage.spec.near.end()) return {};
    for (std::size_t& at = stage.near_cursor[worker]; at < spans->second.size(); ++at) {
      ++steps;
      const ItemSpan& span = spans->second[at];
      if (Piece piece = stage.pool.within(span.first, span.count, stage.spec.tile); piece.count > 0) return piece;
    }
    return {};
  }

  // Who holds the inputs of the items' first one will be done with all of the stage before the worker would be with
  // these.
  bool left_to_holder(const Worker& worker, const Stage& stage, std::uint64_t first, std::uint64_t count,
                      Seconds now) const {
    auto span = stage.holders.upper_bound(first);
    ++steps;
    if (span == stage.holders.begin() || !must_fetch(stage, worker.id, first)) return false;
    --span;
    const auto& [held, id] = span->second;
    if (first >= span->first + held) return false;
    const auto holder = workers.find(id);
    if (holder == workers.end() || !usable(holder->second) || holder->second.straggles || holds_solo(holder->second))
      return false;
    // Who is at work will ask again, or its lease runs out; who is not may never be heard of.
    if (holder->second.in_flight.empty()) return false;
    const Seconds all = expected_seconds(holder->second, stage, stage.pool.items());
    const Seconds free =
        std::max(when_free(holder->second, now), expected_finish(live.at(holder->second.in_flight.front()), now));
    const Seconds mine = when_free(worker, now) + expected_lease_seconds(worker, stage, first, count);
    return all > 0 && free + all < mine;
  }

  // What of the stage the worker would get now, or why it gets nothing.
  Offer offer(const Worker& worker, const Stage& stage, Seconds now) const {
    Offer out;
    if (worker.draining) return out.refuse(Refusal::drains);
    if (!usable(worker)) return out.refuse(Refusal::quarantined);
    // Nobody knows how long a solo stage takes: whatever waited behind it would be late.
    if (holds_solo(worker)) return out.refuse(Refusal::runs_solo);
    if (worker.straggles && usable_workers() > 1) return out.refuse(Refusal::straggler);
    if (worker.in_flight.size() >= settings.in_flight) return out.refuse(Refusal::full);

    out.piece = stage.pool.front([&](const FailureHistory& f) { return may_run(worker, f); }, steps);
    if (out.piece.count == 0) return out.refuse(Refusal::failed_it);
    if (out.piece.failures.clean()) {
      if (const Piece near = near_piece(stage, worker.id); near.count > 0)
        out.piece = near;
      else
        out.adjoining = stage.spec.adjoining;
    }
    if (stage.spec.solo) {
      out.count = out.piece.count;
      if (prefers(stage, worker.id)) return out;
      if (preferred_may_come(worker, stage, out.piece.failures, now)) return out.refuse(Refusal::others_preferred);
      // Whoever is idle begins at once; here it would wait.
      if (idle > 0 && !worker.in_flight.empty()) return out.refuse(Refusal::has_its_share);
      return out;
    }
    const auto cut = [&](double items) {
      if (out.adjoining) out.piece = stage.adjoining.offer(stage.pool, worker.id, stage.spec.tile, items);
      out.count = round_to_tiles(items, stage, out.piece);
    };
    if (settings.fixed_batch_items > 0) {
      cut(static_cast<double>(settings.fixed_batch_items));
      return out;
    }

    if (stage.spec.at_once) {
      cut(0);
      return out;
    }
    const std::uint64_t held_items = items_in_flight(worker, stage.id);
    const auto known = worker.throughput.find(stage.kind);
    const Throughput throughput = known == worker.throughput.end() ? Throughput{} : known->second;
    // The first measure decides how much this worker should get: do not give more before it is in.
    if (!throughput.known() && held_items > 0) return out.refuse(Refusal::not_measured);

    const double part = share_of(worker, stage, out.piece.first);
    const double target = throughput.target_items(settings);
    const double fair = kShareAtOnce * part * static_cast<double>(stage.pool.items());
    double wanted = std::max(std::min(target, fair), std::min(target, throughput.smallest_items(settings)));
    if (stage.spec.most_items > 0) wanted = std::min(wanted, static_cast<double>(stage.spec.most_items));
    cut(wanted);
    if (left_to_holder(worker, stage, out.piece.first, out.count, now)) return out.refuse(Refusal::others_hold_inputs);
    out.cut_short = static_cast<double>(out.count) + stage.spec.tile <= target;

    // A waiting lease beyond the fair share of all that is left would be missed by a worker that idles sooner.
    const double all_left = static_cast<double>(stage.pool.items() + stage.held_items);
    if (!worker.in_flight.empty() && usable_workers() > 1 &&
        static_cast<double>(held_items + out.count) > part * all_left) {
      return out.refuse(Refusal::has_its_share);
    }
    return out;
  }

  // The worker gets no more items of any stage.
  void ends_here(WorkerId worker) {
    for (const Place& place : order) stages.at(std::get<StageId>(place)).adjoining.forget(worker);
  }

  Lease hand_out(Worker& worker, Stage& stage, const Offer& what, Seconds now) {
    stage.pool.take(what.piece.first, what.count);
    if (what.adjoining) stage.adjoining.gave(worker.id, what.piece.first + what.count);
    stage.held.emplace(what.piece.first, HeldRange{what.count, what.piece.failures, {}});
    stage.held_items += what.count;
    steps += 2;
    return issue(worker, stage, what.piece.first, what.count, what.cut_short, false, now);
  }

  // When a lease should be finished, seen from `now`. One that is overdue is expected to take as long again as it took.
  Seconds expected_finish(const LiveLease& lease, Seconds now) const {
    if (lease.planned >= now) return lease.planned;
    return now + (now - std::min(now, workers.at(lease.lease.worker).in_flight_since));
  }

  Seconds when_free(const Worker& worker, Seconds now) const {
    return worker.in_flight.empty() ? now : std::max(now, live.at(worker.in_flight.back()).planned);
  }

  // The most overdue lease, if it would outlast all the rest of the stage and so would its second copy if it began any
  // later: the longest work must not begin last.
  std::optional<Lease> speculate(Worker& worker, Stage& stage, Seconds now) {
    if (stage.running.empty() || stage.running.begin()->first >= now) return std::nullopt;
    const LiveLease& slow = live.at(stage.running.begin()->second);
    const double all = totals[stage.kind].items_per_second;
    if (!(all > 0)) return std::nullopt;
    const Seconds end = now + static_cast<double>(stage.pool.items() + stage.held_items) / all;
    const Seconds mine =
        when_free(worker, now) + expected_lease_seconds(worker, stage, slow.lease.first, slow.lease.count);
    if (mine < end || expected_finish(slow, now) <= end) return std::nullopt;
    return duplicate_this(worker, stage, slow.lease.id, now);
  }

  std::optional<Lease> duplicate(Worker& worker, Stage& stage, Seconds now) {
    // What waits comes before what runs: it has cost nothing yet.
    for (const Candidates* list : {&stage.waiting, &stage.running}) {
      // The most overdue, then the latest of those that keep their time.
      int looked = 0;
      for (auto at = list->begin(); at != list->end() && at->first < now && looked < kDuplicateCandidates;
           ++at, ++looked) {
        if (auto lease = duplicate_this(worker, stage, at->second, now)) return lease;
      }
      looked = 0;
      for (auto at = list->rbegin(); at != list->rend() && at->first >= now && looked < kDuplicateCandidates;
           ++at, ++looked) {
        if (auto lease = duplicate_this(worker, stage, at->second, now)) return lease;
      }
    }
    return std::nullopt;
  }

  std::optional<Lease> duplicate_this(Worker& worker, Stage& stage, LeaseId id, Seconds now) {
    ++steps;
    const LiveLease& slow = live.at(id);
    const std::uint64_t first = slow.lease.first, count = slow.lease.count;
    if (slow.lease.worker == worker.id || stage.held.at(first).failures.by(worker.id)) return std::nullopt;
    // Two mute workers with the same items would hold them for a whole lease.
    if (!worker.proven && proven > 0 && !workers.at(slow.lease.worker).proven) return std::nullopt;
    // A solo stage's inputs are large and its duration is anybody's guess: a second copy must wait until it is likely
    // that the first one never ends.
    if (stage.spec.solo) {
      const Worker& other = workers.at(slow.lease.worker);
      const Seconds patience = other.proven ? settings.solo_copy_after : settings.solo_copy_after_unproven;
      if (other.in_flight.front() != id ||
          now - other.in_flight_since < std::max(patience, kLate * expected_seconds(other, stage, count)))
        return std::nullopt;
    }
    if (expected_finish(slow, now) <= when_free(worker, now) + expected_lease_seconds(worker, stage, first, count))
      return std::nullopt;
    return issue(worker, stage, first, count, true, true, now);
  }

  // -- For a person --------------------------------------------------------------------------------------------------

  // The batch of the stage that is latest, where one takes far longer than expected; else empty.
  std::string describe_late(const Stage& stage, Seconds now, const Names& names) const {
    Seconds longest = 0, expected = 0;
    WorkerId who = 0;
    for (const auto& [first, range] : stage.held)
      for (const LeaseId id : range.leases) {
        if (id == 0) continue;
        const LiveLease& lease = live.at(id);
        const Worker& worker = workers.at(lease.lease.worker);
        const Seconds took = now - worker.in_flight_since, should = lease.planned - worker.in_flight_since;
        if (worker.in_flight.front() != id || took < std::max(kLate * should, should + kLateForPeople)) continue;
        if (took <= longest) continue;
        longest = took;
        expected = should;
        who = worker.id;
      }
    if (longest == 0) return {};
    const auto seconds = [](Seconds value) { return std::to_string(std::llround(std::max(1.0, value))) + " s"; };
    return "worker " + names.worker(who) + " has not answered its batch for " + seconds(longest) + ", expected " +
           seconds(expected) + " at most";
  }

  // "worker 7 drains", "workers 7, 8 drain", "both workers drain", "all 9 workers drain", "9 of 12 workers drain".
  std::string describe(const std::vector<WorkerId>& who, const std::string& one, const std::string& many,
                       const Names& names) const {
    if (who.size() == 1) return "worker " + names.worker(who[0]) + " " + one;
    if (who.size() == joined && joined == 2) return "both workers " + many;
    if (who.size() == joined) return "all " + std::to_string(who.size()) + " workers " + many;
    if (who.size() > 3) return std::to_string(who.size()) + " of " + std::to_string(joined) + " workers " + many;
    std::string ids;
    for (const WorkerId id : who) ids += (ids.empty() ? "" : ", ") + names.worker(id);
    return "workers " + ids + " " + many;
  }

  std::string describe_quarantined(const std::vector<WorkerId>& who, const Names& names) const {
    if (who.size() > 1) return describe(who, "", "are quarantined after failures or leases that ran out", names);
    const Worker& worker = workers.at(who.front());
    const bool failures = worker.failures_in_row >= settings.strikes;
    return describe(who,
                    failures ? "is quarantined after " + std::to_string(worker.failures_in_row) + " failures"
                             : std::string("is quarantined after a lease ran out"),
                    "", names);
  }
};

Scheduler::Scheduler(const SchedulerSettings& settings) : impl_(std::make_unique<Impl>(settings)) {}
Scheduler::~Scheduler() = default;

StageId Scheduler::add_stage(const ScheduledStage& spec, Seconds now) {
  if (spec.tile == 0) throw Error::failed("stage of kind " + spec.kind + ": tile: expected at least 1, found 0");
  Impl& m = *impl_;
  now = m.clock(now);
  const StageId id = m.next_stage++;
  Stage& stage = m.stages[id];
  stage.id = id;
  stage.spec = spec;
  stage.kind = m.kind_of(spec.kind);
  const std::vector<ItemSpan> all = {{0, spec.items}};
  for (const ItemSpan& span : spec.only.empty() ? all : spec.only) {
    stage.pool.put({span.first, span.count, FailureHistory{0, spec.avoid}});
    stage.wanted_items += span.count;
  }
  if (stage.wanted_items == 0) {
    stage.state = StageState::complete;
    return id;
  }
  m.order.insert(place_of(stage));
  for (const auto& [worker, spans] : spec.near)
    for (const ItemSpan& span : spans) stage.holders.emplace(span.first, std::pair(span.count, worker));
  if (spec.solo) {
    // Workers that are at work ask again within a batch's time, or two where one waits.
    stage.preferred_until = now + 2 * m.settings.target_batch;
    if (!spec.preferred.empty()) m.timers.insert({stage.preferred_until, TimerKind::preferred, id});
  }
  ++m.steps;
  return id;
}

std::vector<Lease> Scheduler::remove_stage(StageId id) {
  Impl& m = *impl_;
  const auto at = m.stages.find(id);
  if (at == m.stages.end()) return {};
  std::vector<Lease> leases;
  for (const auto& [first, range] : at->second.held) {
    for (const LeaseId lease : range.leases) {
      if (lease != 0) leases.push_back(m.live.at(lease).lease);
    }
  }
  for (const Lease& lease : leases) m.end_lease(lease.id, LeaseEnd::taken_back, false, m.latest);
  m.close(at->second, StageState::complete);
  m.stages.erase(at);
  return leases;
}

void Scheduler::worker_joined(WorkerId id, Seconds now) {
  worker_lost(id, now);
  Worker& worker = impl_->workers[id];
  worker.id = id;
  ++impl_->joined;
  impl_->enter_sums(worker);
}

void Scheduler::worker_lost(WorkerId id, Seconds now) {
  Impl& m = *impl_;
  now = m.clock(now);
  const auto at = m.workers.find(id);
  if (at == m.workers.end()) return;
  Worker& worker = at->second;
  while (!worker.in_flight.empty()) {
    const Lease lease = m.live.at(worker.in_flight.back()).lease;
    m.end_lease(lease.id, LeaseEnd::taken_back, false, now);
    m.give_back(m.stages.at(lease.stage), lease.first);
  }
  m.leave_sums(worker);
  m.ends_here(id);
  if (worker.quarantined) m.timers.erase({worker.quarantined_until, TimerKind::quarantine, id});
  --m.joined;
  m.workers.erase(at);
}

void Scheduler::worker_draining(WorkerId id) {
  const auto at = impl_->workers.find(id);
  if (at == impl_->workers.end()) return;
  impl_->leave_sums(at->second);
  at->second.draining = true;
  impl_->ends_here(id);
  impl_->enter_sums(at->second);
}

std::optional<Lease> Scheduler::next_lease(WorkerId id, Seconds now, bool duplicates) {
  Impl& m = *impl_;
  now = m.clock(now);
  const auto at = m.workers.find(id);
  ++m.steps;
  if (at == m.workers.end()) return std::nullopt;
  Worker& worker = at->second;
  for (const auto& [rank, priority, stage_id] : m.order) {
    ++m.steps;
    Stage& stage = m.stages.at(stage_id);
    if (stage.pool.items() == 0 || stage.paused) continue;
    const Offer offer = m.offer(worker, stage, now);
    if (offer.why_not == Refusal::none) {
      if (auto lease = m.speculate(worker, stage, now)) return lease;
      return m.hand_out(worker, stage, offer, now);
    }
    if (offer.why_not <= Refusal::full) return std::nullopt;  // whatever the stage
  }
  if (!m.usable(worker)) return std::nullopt;
  if (!worker.in_flight.empty() || !duplicates) return std::nullopt;
  for (const auto& [rank, priority, stage_id] : m.order) {
    ++m.steps;
    Stage& stage = m.stages.at(stage_id);
    if (stage.paused) continue;
    if (auto lease = m.duplicate(worker, stage, now)) return lease;
  }
  return std::nullopt;
}

ResultOutcome Scheduler::result(WorkerId id, LeaseId lease_id, Epoch epoch, Seconds seconds, Seconds now) {
  Impl& m = *impl_;
  now = m.clock(now);
  ++m.steps;
  ResultOutcome outcome;
  const auto at = m.live.find(lease_id);
  if (at == m.live.end()) {
    if (lease_id < m.first_lease || lease_id >= m.next_lease_id) return outcome;
    const auto ended = m.ended.find(lease_id);
    if (ended == m.ended.end()) {
      outcome.verdict = Verdict::stage_gone;
      return outcome;
    }
    const EndedLease& past = ended->second;
    outcome.verdict = past.worker != id     ? Verdict::wrong_worker
                      : past.epoch != epoch ? Verdict::stale
                      : past.accepted       ? Verdict::duplicate
                                            : Verdict::stale;
    // Late work is dropped, but it shows that the worker lives, and how fast it is.
    const auto who = m.workers.find(id);
    if (past.worker == id && past.epoch == epoch && who != m.workers.end()) {
      if (!past.accepted) {
        m.learn(who->second, past.kind,
                [&](Throughput& t) { t.measured(past.count, seconds, past.cut_short, m.settings); });
        m.replan(who->second);
      }
      who->second.expiries_in_row = 0;
      m.prove(who->second);
      if (who->second.failures_in_row < m.settings.strikes) m.take_back_in(who->second);
    }
    return outcome;
  }

  const Lease lease = at->second.lease;
  const bool cut_short = at->second.cut_short;
  if (lease.worker != id) {
    outcome.verdict = Verdict::wrong_worker;
    return outcome;
  }
  if (lease.epoch != epoch) {
    outcome.verdict = Verdict::stale;
    return outcome;
  }
  Stage& stage = m.stages.at(lease.stage);
  Worker& worker = m.workers.at(id);
  worker.expiries_in_row = worker.failures_in_row = 0;
  m.prove(worker);
  m.take_back_in(worker);
  m.learn(worker, stage.kind, [&](Throughput& t) { t.measured(lease.count, seconds, cut_short, m.settings); });
  if (stage.state != StageState::open) {
    m.end_lease(lease_id, LeaseEnd::taken_back, true, now);
    m.give_back(stage, lease.first);
    outcome.verdict = Verdict::stage_gone;
    return outcome;
  }

  outcome.verdict = Verdict::accepted;
  for (const LeaseId twin : stage.held.at(lease.first).leases) {
    if (twin == 0 || twin == lease_id) continue;
    outcome.revoke.push_back(m.live.at(twin).lease);
    m.end_lease(twin, LeaseEnd::items_accepted, false, now);
  }
  m.end_lease(lease_id, LeaseEnd::items_accepted, true, now);
  stage.held.erase(lease.first);
  stage.held_items -= lease.count;
  stage.done_items += lease.count;
  WorkerProgress& progress = stage.progress[id];
  progress.items += lease.count;
  if (seconds >= 0 && std::isfinite(seconds)) progress.seconds += seconds;
  ++progress.batches;
  if (stage.done_items == stage.wanted_items) {
    m.close(stage, StageState::complete);
    outcome.stage_complete = true;
  }
  return outcome;
}

void Scheduler::set_rank(StageId id, unsigned rank) {
  Impl& m = *impl_;
  const auto at = m.stages.find(id);
  if (at == m.stages.end() || at->second.spec.rank == rank) return;
  const bool listed = m.order.erase(place_of(at->second)) > 0;
  at->second.spec.rank = rank;
  if (listed) m.order.insert(place_of(at->second));
  ++m.steps;
}

void Scheduler::pause(StageId id) {
  if (const auto at = impl_->stages.find(id); at != impl_->stages.end()) at->second.paused = true;
}

void Scheduler::resume(StageId id) {
  if (const auto at = impl_->stages.find(id); at != impl_->stages.end()) at->second.paused = false;
}

FailureOutcome Scheduler::failed(WorkerId id, LeaseId lease_id, Epoch epoch, Seconds now, bool blameless) {
  Impl& m = *impl_;
  now = m.clock(now);
  ++m.steps;
  const auto at = m.live.find(lease_id);
  if (at == m.live.end() || at->second.lease.worker != id || at->second.lease.epoch != epoch) return {};
  const Lease lease = at->second.lease;
  Stage& stage = m.stages.at(lease.stage);
  if (blameless) {
    m.end_lease(lease_id, LeaseEnd::taken_back, true, now);
    m.give_back(stage, lease.first);
    return {true, false};
  }
  FailureHistory& failures = stage.held.at(lease.first).failures;
  failures.add(id);
  const bool stage_failed = stage.state == StageState::open && failures.strikes >= m.settings.strikes;

  m.end_lease(lease_id, LeaseEnd::taken_back, true, now);
  m.give_back(stage, lease.first);
  Worker& worker = m.workers.at(id);
  worker.expiries_in_row = 0;
  if (++worker.failures_in_row >= m.settings.strikes) {
    m.quarantine(worker, worker.failures_in_row - m.settings.strikes + 1, now);
  } else {
    m.take_back_in(worker);
  }
  if (stage_failed) m.close(stage, StageState::failed);
  return {true, stage_failed};
}

std::vector<Lease> Scheduler::expire(Seconds now) {
  Impl& m = *impl_;
  now = m.clock(now);
  std::vector<Lease> out;
  while (!m.timers.empty() && std::get<0>(*m.timers.begin()) <= now) {
    ++m.steps;
    const auto [time, kind, id] = *m.timers.begin();
    m.timers.erase(m.timers.begin());
    if (kind == TimerKind::preferred) continue;
    if (kind == TimerKind::quarantine) {
      m.take_back_in(m.workers.at(id));
      continue;
    }
    if (kind == TimerKind::straggler) {
      m.recall_waiting(m.workers.at(id), now, out);
      continue;
    }
    const Lease lease = m.live.at(id).lease;
    Stage& stage = m.stages.at(lease.stage);
    Worker& worker = m.workers.at(lease.worker);
    if (worker.in_flight.front() == id) {
      m.learn(worker, stage.kind,
              [&](Throughput& t) { t.overran(lease.count, now - worker.in_flight_since, m.settings); });
    }
    m.end_lease(id, LeaseEnd::taken_back, false, now);
    m.give_back(stage, lease.first);
    m.quarantine(worker, ++worker.expiries_in_row, now);
    out.push_back(lease);
  }
  return out;
}

std::optional<Seconds> Scheduler::next_expiry() const {
  if (impl_->timers.empty()) return std::nullopt;
  return std::get<0>(*impl_->timers.begin());
}

bool Scheduler::complete(StageId id) const {
  const auto at = impl_->stages.find(id);
  return at != impl_->stages.end() && at->second.done_items == at->second.wanted_items;
}

std::uint64_t Scheduler::items_done(StageId id) const {
  const auto at = impl_->stages.find(id);
  return at == impl_->stages.end() ? 0 : at->second.done_items;
}

std::optional<Seconds> Scheduler::quarantined_until(WorkerId id) const {
  const auto worker = impl_->workers.find(id);
  if (worker == impl_->workers.end() || !worker->second.quarantined) return std::nullopt;
  return worker->second.quarantined_until;
}

double Scheduler::items_per_second(WorkerId id, const std::string& kind) const {
  const auto worker = impl_->workers.find(id);
  const auto number = impl_->kinds.find(kind);
  if (worker == impl_->workers.end() || number == impl_->kinds.end()) return 0;
  const auto at = worker->second.throughput.find(number->second);
  return at == worker->second.throughput.end() ? 0 : at->second.items_per_second();
}

bool Scheduler::proven(WorkerId id) const {
  const auto worker = impl_->workers.find(id);
  return worker != impl_->workers.end() && worker->second.proven;
}

std::map<WorkerId, WorkerProgress> Scheduler::progress(StageId id) const {
  const auto at = impl_->stages.find(id);
  return at == impl_->stages.end() ? std::map<WorkerId, WorkerProgress>{} : at->second.progress;
}

std::string Scheduler::why_waiting(StageId id, Seconds now) const {
  const auto number = [](std::uint64_t value) { return std::to_string(value); };
  return why_waiting(id, now, {number, number});
}

std::string Scheduler::why_waiting(StageId id, Seconds now, const Names& names) const {
  const Impl& m = *impl_;
  const auto at = m.stages.find(id);
  if (at == m.stages.end() || at->second.state == StageState::complete) return {};
  const Stage& stage = at->second;
  if (stage.state == StageState::failed)
    return "the same items failed " + std::to_string(m.settings.strikes) + " times";
  if (stage.pool.items() == 0) return m.describe_late(stage, now, names);
  if (stage.paused) return "it waits for inputs that are computed again";
  if (m.joined == 0) return "no worker is connected";

  for (const auto& [rank, priority, other] : m.order) {
    if (other == id) break;
    if (m.stages.at(other).pool.items() == 0 || m.stages.at(other).paused) continue;
    return "stage " + names.stage(other) + " goes first: " +
           (rank < stage.spec.rank            ? "it is of an earlier frame"
            : -priority > stage.spec.priority ? "its priority is higher"
                                              : "it is older");
  }

  std::map<Refusal, std::vector<WorkerId>> refused;
  for (const auto& [worker_id, worker] : m.workers) refused[m.offer(worker, stage, now).why_not].push_back(worker_id);
  if (refused.contains(Refusal::none)) {
    return m.describe(refused[Refusal::none], "can take a batch and was", "can take a batch and were", names) +
           " not asked since";
  }
  const std::string leases = std::to_string(m.settings.in_flight) + (m.settings.in_flight == 1 ? " lease" : " leases");
  std::string line;
  for (const auto& [why, who] : refused) {
    line += line.empty() ? "" : "; ";
    switch (why) {
      case Refusal::none:
        break;
      case Refusal::drains:
        line += m.describe(who, "drains", "drain", names);
        break;
      case Refusal::quarantined:
        line += m.describe_quarantined(who, names);
        break;
      case Refusal::runs_solo:
        line += m.describe(who, "runs a solo stage", "run solo stages", names);
        break;
      case Refusal::straggler:
        line += m.describe(who, "is late with its batch", "are late with their batches", names);
        break;
      case Refusal::full:
        line += m.describe(who, "holds " + leases, "hold " + leases + " each", names);
        break;
      case Refusal::failed_it:
        line += m.describe(who, "failed these items", "failed these items", names);
        break;
      case Refusal::others_preferred:
        line += "it is kept for " +
                (stage.spec.preferred.empty()
                     ? "a worker that has answered before"
                     : m.describe(stage.spec.preferred, "which holds its inputs", "which hold its inputs", names));
        break;
      case Refusal::others_hold_inputs:
        line += "it is kept for the workers that hold its inputs, which will soon be done";
        break;
      case Refusal::not_measured:
        line += m.describe(who, "runs its first batch of " + stage.spec.kind,
                           "run their first batches of " + stage.spec.kind, names);
        break;
      case Refusal::has_its_share:
        line += m.describe(who, "holds its share of what is left", "hold their shares of what is left", names);
        break;
    }
  }
  return line;
}

std::uint64_t Scheduler::steps() const { return impl_->steps; }

}  // namespace gleaner::coordinator
