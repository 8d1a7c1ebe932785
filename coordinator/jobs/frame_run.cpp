// A job's thread: one frame after the other, each from its plan's first stages to its film.

#include <algorithm>
#include <chrono>
#include <cstring>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

FrameSettings settings_of(const JobRequest& request, std::uint32_t frame) {
  FrameSettings settings = request.settings;
  if (!request.cameras.empty()) settings.camera = request.cameras[frame - request.first_frame];
  return settings;
}

void Farm::Impl::run_frames(const std::shared_ptr<Job>& job) {
  Film film;
  Seconds begun = job->accepted;
  const std::uint32_t first = job->request.first_frame;
  std::uint32_t rendered = first;
  for (std::uint32_t frame = first; frame <= job->request.last_frame; ++frame) {
    if (frame == first || !same_camera(*job, frame, rendered)) {
      if (frame != first) aim(*job, frame);
      film = render(job, frame);
      rendered = frame;
    } else {
      // Nothing but the camera moves: what was made for the one frame holds for the other.
      reuse(*job, frame, rendered);
    }
    write(*job, frame, film, begun);
    begun = now();
    std::lock_guard lock(mutex);
    ++job->frames_done;
    ++totals.frames_written;
    changed(*job);
  }
}

bool Farm::Impl::same_camera(const Job& job, std::uint32_t a, std::uint32_t b) {
  const scene::Camera first = settings_of(job.request, a).camera, second = settings_of(job.request, b).camera;
  return std::memcmp(&first, &second, sizeof first) == 0;
}

void Farm::Impl::aim(Job& job, std::uint32_t frame) {
  std::shared_ptr<Plan> plan = settings.plan(settings_of(job.request, frame), job.request.scene);
  std::lock_guard plan_lock(job.plan_mutex);
  job.plan = std::move(plan);
  job.drawn = false;
  std::lock_guard lock(mutex);
  job.stages.clear();
  changed(job);
}

FrameReport Farm::Impl::new_report(const Job& job, std::uint32_t frame) const {
  FrameReport report;
  report.scene = job.request.scene_name;
  report.camera = job.request.camera_name;
  report.job = job.id;
  report.frame = frame;
  report.settings = settings_of(job.request, frame);
  report.time_limit = job.request.time_limit;
  return report;
}

Film Farm::Impl::render(const std::shared_ptr<Job>& job, std::uint32_t frame) {
  {
    std::lock_guard lock(mutex);
    job->report = new_report(*job, frame);
  }
  double plan_seconds = 0;
  // The plan's calls are timed: with the stages' seconds they say where a frame's time went.
  auto timed = [&](auto call) {
    std::lock_guard plan_lock(job->plan_mutex);
    Seconds before = now();
    auto value = call(*job->plan);
    plan_seconds += now() - before;
    return value;
  };
  Step step = timed([](Plan& plan) { return plan.next(nullptr); });
  while (!step.done) {
    post(job, step);
    std::optional<FinishedStage> finished = await_stage(*job);
    if (!finished) break;  // the time limit; the plan has made do with what there is
    step = timed([&](Plan& plan) { return plan.next(&*finished); });
  }
  end_frame(*job);
  Film film = timed([](Plan& plan) { return plan.film(); });
  std::lock_guard plan_lock(job->plan_mutex);
  std::lock_guard lock(mutex);
  job->report.skips = job->plan->skips();
  for (Skip& skip : job->reused) job->report.skips.push_back(std::move(skip));
  job->reused.clear();
  job->report.plan_parameters = job->plan->parameters_json();
  job->report.plan_seconds = plan_seconds;
  return film;
}

void Farm::Impl::reuse(Job& job, std::uint32_t frame, std::uint32_t rendered) {
  std::lock_guard lock(mutex);
  FrameReport report = new_report(job, frame);
  report.plan_parameters = job.report.plan_parameters;
  report.devices = job.report.devices;
  report.skips = job.report.skips;
  std::erase_if(report.skips, [](const Skip& skip) { return skip.what == "frame"; });
  report.skips.push_back({"frame", "same scene, camera and settings as frame " + std::to_string(rendered), 1});
  job.report = std::move(report);
}

std::optional<FinishedStage> Farm::Impl::await_stage(Job& job) {
  const double limit = job.request.time_limit;
  bool concludes = limit > 0;
  std::unique_lock lock(mutex);
  for (;;) {
    if (job.cancel || stopping) throw Cancelled{};
    if (!job.failure.empty()) throw Error::failed(job.failure);
    if (!job.finished.empty()) {
      auto stage = job.finished.front();
      job.finished.pop_front();
      return FinishedStage{stage->spec.name, std::exchange(stage->records, nullptr)};
    }
    const double left = job.accepted + limit - now();
    if (concludes && left <= 0) {
      if (conclude(job, lock)) return std::nullopt;
      concludes = false;  // too early for a picture: this stage must be whole, the next one need not
      continue;
    }
    if (!job.undrawn.empty()) {
      UndrawnBatch batch = std::move(job.undrawn.front());
      job.undrawn.pop_front();
      lock.unlock();
      {
        std::lock_guard plan_lock(job.plan_mutex);
        job.plan->preview(batch.stage, batch.first, batch.count, batch.records);
        job.drawn = true;
      }
      lock.lock();
      continue;
    }
    if (concludes)
      job.events.wait_for(lock, std::chrono::duration<double>(left));
    else
      job.events.wait(lock);
  }
}

bool Farm::Impl::conclude(Job& job, std::unique_lock<std::mutex>& lock) {
  std::vector<CutStage> cut;
  std::vector<std::shared_ptr<RunningStage>> stages;
  for (const auto& stage : job.stages)
    if (!stage->delivered) {
      stages.push_back(stage);
      cut.push_back({{stage->spec.name, stage->records}, stage->copied});
    }
  lock.unlock();
  for (CutStage& part : cut)
    std::sort(part.whole.begin(), part.whole.end(),
              [](const ItemRange& a, const ItemRange& b) { return a.first < b.first; });
  bool concluded;
  {
    std::lock_guard plan_lock(job.plan_mutex);
    concluded = job.plan->conclude(cut);
  }
  lock.lock();
  if (!concluded) return false;
  job.report.time_limit_reached = true;
  for (std::size_t i = 0; i < cut.size(); ++i) {
    stages[i]->report.items = 0;  // what the picture is made of
    for (const ItemRange& range : cut[i].whole) stages[i]->report.items += range.count;
  }
  return true;
}

void Farm::Impl::end_frame(Job& job) {
  std::deque<UndrawnBatch> undrawn;
  std::vector<std::shared_ptr<const Bytes>> artifacts;
  std::lock_guard lock(mutex);
  for (const auto& stage : job.stages) {
    if (!stage->delivered) {
      revoke(scheduler.remove_stage(stage->id));
      active_stages.erase(stage->id);
      stage->delivered = true;
    }
    if (stage->last_result >= 0) stage->report.seconds = stage->last_result - stage->first_lease;
    stage->records.reset();
  }
  records_ready.notify_all();
  job.finished.clear();
  job.undrawn.swap(undrawn);
  job.artifacts.swap(artifacts);
  job.artifact_blobs.clear();
  if (job.report.stages.empty())
    for (const auto& stage : job.stages) job.report.stages.push_back(stage->report);
  pump();
}

}  // namespace gleaner::coordinator
