#include "coordinator/jobs/overview.h"

#include <algorithm>
#include <iterator>

#include "coordinator/jobs/engine.h"

namespace gleaner::coordinator {

std::optional<GivenBatch> Farm::Impl::batch_of(const Worker& worker, Seconds time) const {
  for (const Epoch epoch : worker.leases) {  // the oldest first
    const auto lease = leases.find(epoch);
    if (lease == leases.end()) continue;
    const auto stage = active_stages.find(lease->second.stage);
    if (stage == active_stages.end()) continue;
    const Frame& frame = *stage->second->frame;
    return GivenBatch{.job = frame.job->showing ? std::string() : frame.job->id,
                      .stage = stage->second->spec.name,
                      .kind = stage->second->spec.kind,
                      .frame = frame_at(frame.job->request, frame.place),
                      .first = lease->second.first,
                      .items = lease->second.count,
                      .seconds = time - lease->second.issued};
  }
  return std::nullopt;
}

void Farm::Impl::add_workers(const OverviewLimits& limits, Seconds time, FarmOverview& overview) const {
  std::vector<const Worker*> idle, working;  // idle: they get nothing
  for (auto at = workers.rbegin(); at != workers.rend(); ++at) {
    const Worker& worker = at->second;
    const bool aside = !worker.aside.empty() || scheduler.quarantined_until(worker.id);
    overview.aside += aside;
    overview.draining += worker.draining && !aside;
    (aside || worker.draining ? idle : working).push_back(&worker);
  }
  overview.workers_connected = workers.size();
  for (const auto* group : {&idle, &working})
    for (const Worker* worker : *group) {
      if (overview.workers.size() == limits.workers) return;
      overview.workers.push_back({worker_status(*worker, time), batch_of(*worker, time), worker->last_batch});
    }
}

void Farm::Impl::add_jobs(const OverviewLimits& limits, Seconds time, FarmOverview& overview) const {
  const auto show = [&](const Job& job) {
    overview.jobs.push_back({coordinator::status_of(job, time, true), job.error});
  };
  const auto show_first = [&](const auto& listed) {
    std::size_t shown = 0;
    for (const auto& job : listed) {
      if (job->showing) continue;
      ++overview.jobs_in[job->state];
      overview.paused += job->paused;
      if (shown++ < limits.jobs) show(*job);
    }
  };
  show_first(running);
  show_first(queue);
  for (const auto& job : ended_jobs) ++overview.jobs_in[job->state];
  const auto ended = std::min(limits.jobs, ended_jobs.size());
  for (std::size_t k = 0; k < ended; ++k) show(*ended_jobs[ended_jobs.size() - 1 - k]);
}

FarmOverview Farm::overview(const OverviewLimits& limits) const {
  FarmOverview overview;
  overview.unix_seconds = unix_now();
  std::lock_guard lock(impl_->mutex);
  const Seconds time = impl_->now();
  impl_->add_workers(limits, time, overview);
  impl_->add_jobs(limits, time, overview);
  const auto gone = static_cast<std::ptrdiff_t>(std::min(limits.gone, impl_->gone_workers.size()));
  overview.gone.assign(impl_->gone_workers.begin(), impl_->gone_workers.begin() + gone);
  overview.events = impl_->event_log.latest(limits.events);
  overview.totals = impl_->totals;
  return overview;
}

}  // namespace gleaner::coordinator
