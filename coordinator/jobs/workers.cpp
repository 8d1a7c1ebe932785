// Who works: joining and leaving, handing out leases, and the clock's thread.

#include <algorithm>
#include <chrono>
#include <cmath>

#include "coordinator/jobs/engine.h"

namespace gleaner::coordinator {

namespace {

using Clock = std::chrono::steady_clock;

// While stages run: how often idle workers are offered work anew (a copy of a slow lease).
constexpr std::chrono::milliseconds idle_look{100};
// While none do: how often it is asked who lives.
constexpr std::chrono::milliseconds calm_look{1000};
constexpr std::chrono::milliseconds offer_interval{2};
constexpr std::size_t most_names_of_gone = 4096;
constexpr std::size_t most_gone = 100;  // whom people are told of
constexpr Seconds between_costs = 5;    // of running jobs, for the journal

}  // namespace

void Farm::Impl::offer(Worker& worker) {
  // A further frame serves an idle worker better than a second copy of what others do.
  const bool duplicates = !further_frame_comes();
  while (!active_stages.empty()) {
    auto lease = scheduler.next_lease(worker.id, now(), duplicates);
    if (!lease) break;
    auto found = active_stages.find(lease->stage);
    if (found == active_stages.end()) continue;
    RunningStage& stage = *found->second;
    if (stage.first_lease < 0) {
      stage.first_lease = lease->issued;
      remember_progress(stage, lease->issued);
    }
    leases[lease->epoch] = *lease;
    worker.leases.insert(lease->epoch);
    worker.session->lease(*lease, stage.work);
  }
  if (!worker.draining && worker.leases.size() < settings.scheduler.in_flight)
    unserved.insert(worker.id);
  else
    unserved.erase(worker.id);
  note_idle(worker);
}

void Farm::Impl::offer_to_all() {
  for (auto& [id, worker] : workers) offer(worker);
}

void Farm::Impl::offer_to_unserved_soon() {
  if (offers_due || unserved.empty() || active_stages.empty()) return;
  offers_due = true;
  timer_wakes.notify_all();
}

void Farm::Impl::offer_to_unserved() {
  offers_due = false;
  for (const WorkerId id : std::set<WorkerId>(unserved))
    if (auto worker = workers.find(id); worker != workers.end()) offer(worker->second);
}

void Farm::Impl::forget_lease(Epoch epoch) {
  auto found = leases.find(epoch);
  if (found == leases.end()) return;
  if (auto worker = workers.find(found->second.worker); worker != workers.end()) worker->second.leases.erase(epoch);
  leases.erase(found);
}

void Farm::Impl::revoke(const std::vector<Lease>& revoked) {
  for (const Lease& lease : revoked) {
    if (auto worker = workers.find(lease.worker); worker != workers.end()) worker->second.session->revoke(lease);
    forget_lease(lease.epoch);
    if (auto worker = workers.find(lease.worker); worker != workers.end() && !worker->second.draining) {
      unserved.insert(lease.worker);
      note_idle(worker->second);
    }
  }
  if (!revoked.empty()) offer_to_unserved_soon();
}

void Farm::Impl::lose(WorkerId id, const std::string& why) {
  auto found = workers.find(id);
  if (found == workers.end()) return;
  scheduler.worker_lost(id, now());
  settings.log("worker " + found->second.name + " is gone" + (why.empty() ? "" : ": " + why) + "; it held " +
               std::to_string(found->second.leases.size()) + " batches");
  tell_worker(found->second, "left", why);
  for (Epoch epoch : std::set<Epoch>(found->second.leases)) leases.erase(epoch);
  if (!why.empty()) found->second.session->close(why);
  tokens.erase(found->second.hello.token);
  gone_workers.push_front({.name = found->second.name,
                           .device = found->second.hello.device.name,
                           .unix_seconds = unix_now(),
                           .lost = !found->second.draining || !found->second.aside.empty(),
                           .why = why.empty() ? found->second.aside : why});
  if (gone_workers.size() > most_gone) gone_workers.pop_back();
  names_of_gone[id] = found->second.name;
  if (names_of_gone.size() > most_names_of_gone) names_of_gone.erase(names_of_gone.begin());
  workers.erase(found);
  unserved.erase(id);
  lose_parts(id);
  drop_hopeless_rechecks();
  offer_to_unserved_soon();
}

void Farm::Impl::watch_clock() {
  std::unique_lock lock(mutex);
  Clock::time_point offered{}, ticked = Clock::now();
  const auto woken = [&] { return stopping || offers_due || timer_rearm; };
  while (!stopping) {
    if (offers_due) {
      timer_wakes.wait_until(lock, offered + offer_interval, [&] { return stopping; });
      offered = Clock::now();
      offer_to_unserved();
    }
    timer_rearm = false;
    if (active_stages.empty() && workers.empty()) {
      timer_wakes.wait(lock, woken);
      continue;
    }
    // Not woken by every lease: what is due next is never nearer than `idle_look` unless next_expiry() said so. However
    // many offers are made, the clock is looked at in time.
    Clock::time_point due = ticked + (active_stages.empty() ? calm_look : idle_look);
    for (const auto& next : {scheduler.next_expiry(), next_frame_due()})
      if (next)
        due = std::min(due, Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                               std::chrono::duration<double>(std::clamp(*next - now(), 0.001, 1.0))));
    timer_wakes.wait_until(lock, due, woken);
    if (stopping || Clock::now() < due) continue;
    tick();
    ticked = Clock::now();
  }
}

void Farm::Impl::tick() {
  Seconds time = now();
  const std::vector<Lease> expired = scheduler.expire(time);
  totals.batches_expired += expired.size();
  revoke(expired);
  std::vector<WorkerId> silent;
  for (const auto& [id, worker] : workers)
    if (time - worker.heard > settings.silence && worker.waits == 0) silent.push_back(id);
  for (WorkerId id : silent) lose(id, "not heard of for " + std::to_string(static_cast<int>(settings.silence)) + " s");
  offer_to_unserved();
  // A coordinator that dies forgets little of what its frames have cost.
  if (time - costs_written >= between_costs) {
    costs_written = time;
    for (const auto& job : running)
      if (!job->cancel) journal_changed(*job, job->state);
  }
  begin_another_frame();
  if (said_no_thread) start_queued();
}

Farm::Joined Farm::join(const WorkerHello& hello, std::shared_ptr<WorkerSession> session) {
  std::lock_guard lock(impl_->mutex);
  auto taken = [&](const std::string& name) {
    return std::any_of(impl_->workers.begin(), impl_->workers.end(),
                       [&](const auto& entry) { return entry.second.name == name; });
  };
  std::string name = hello.name;
  for (unsigned number = 2; taken(name); ++number) name = hello.name + "-" + std::to_string(number);
  WorkerId id = ++impl_->last_worker;
  Worker worker;
  worker.id = id;
  worker.hello = hello;
  worker.kind = device_kind(hello.device);
  worker.name = name;
  worker.session = std::move(session);
  worker.joined = worker.heard = impl_->now();
  Worker& stored = impl_->workers[id] = std::move(worker);
  if (!hello.token.empty()) impl_->tokens[hello.token] = id;
  impl_->settings.log("worker " + name + " joined: " + hello.device.name + ", " + hello.device.tracer);
  impl_->tell_worker(stored, "joined");
  impl_->scheduler.worker_joined(id, impl_->now());
  stored.session->welcome(name);
  impl_->offer(stored);
  impl_->timer_rearm = true;
  impl_->timer_wakes.notify_all();
  return {id, name};
}

void Farm::leave(WorkerId worker) {
  std::lock_guard lock(impl_->mutex);
  impl_->lose(worker, "");
}

bool Farm::drain(const std::string& name) {
  WorkerId id = 0;
  {
    std::lock_guard lock(impl_->mutex);
    for (const auto& [worker_id, worker] : impl_->workers)
      if (worker.name == name) id = worker_id;
  }
  if (id != 0) drain(id);
  return id != 0;
}

void Farm::drain(WorkerId id) {
  std::lock_guard lock(impl_->mutex);
  auto worker = impl_->workers.find(id);
  if (worker == impl_->workers.end()) return;
  if (!std::exchange(worker->second.draining, true)) impl_->tell_worker(worker->second, "draining");
  impl_->unserved.erase(id);
  impl_->scheduler.worker_draining(id);
  worker->second.session->drain();
  impl_->drop_hopeless_rechecks();
}

void Farm::heard(WorkerId id) {
  std::lock_guard lock(impl_->mutex);
  if (auto worker = impl_->workers.find(id); worker != impl_->workers.end()) worker->second.heard = impl_->now();
}

WorkerStatus Farm::Impl::worker_status(const Worker& worker, Seconds time) const {
  WorkerStatus status{.id = worker.name,
                      .address = worker.hello.address,
                      .device = worker.hello.device,
                      .leases = static_cast<std::uint32_t>(worker.leases.size()),
                      .draining = worker.draining && worker.aside.empty(),
                      .aside = worker.aside,
                      .connected_seconds = time - worker.joined,
                      .silent_seconds = time - worker.heard,
                      .items_per_second = {}};
  if (const auto until = scheduler.quarantined_until(worker.id); until && status.aside.empty())
    status.aside = "failures or leases that ran out; it is asked again in " +
                   std::to_string(static_cast<int>(std::ceil(std::max(0.0, *until - time)))) + " s";
  for (const auto& kind : kinds)
    if (double rate = scheduler.items_per_second(worker.id, kind); rate > 0) status.items_per_second[kind] = rate;
  return status;
}

std::vector<WorkerStatus> Farm::workers() const {
  std::lock_guard lock(impl_->mutex);
  const Seconds time = impl_->now();
  std::vector<WorkerStatus> all;
  for (const auto& [id, worker] : impl_->workers) all.push_back(impl_->worker_status(worker, time));
  return all;
}

}  // namespace gleaner::coordinator
