// A job's thread: one frame after the other, each from its plan's first stages to its film.

#include <malloc.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <type_traits>
#include <utility>

#include "coordinator/artifacts/scene_lineage.h"
#include "coordinator/film/exposure.h"
#include "coordinator/jobs/engine.h"
#include "scene/model/error.h"
#include "scene/model/frame_state.h"

namespace gleaner::coordinator {

namespace {

constexpr std::uint64_t large_plan = std::uint64_t{256} << 20;  // bytes, as predicted
constexpr std::size_t most_warnings = 8;                        // of a job's frames, in its status
constexpr std::uint64_t most_drawn = std::uint64_t{4} << 20;    // bytes of records that a preview takes at a time

}  // namespace

FrameSettings settings_of(const JobRequest& request, std::uint32_t frame) {
  FrameSettings settings = request.settings;
  if (!request.cameras.empty()) settings.camera = request.cameras[(frame - request.first_frame) / request.frame_step];
  return settings;
}

template <typename Call>
auto Farm::Impl::compute(Job& job, const Call& call) {
  struct Computing {
    Impl& farm;
    Job& job;
    ~Computing() {
      std::lock_guard lock(farm.mutex);
      job.computing = false;
    }
  };
  const auto stop_if_cancelled = [&] {
    std::lock_guard lock(mutex);
    if (job.cancel || stopping) throw Cancelled{};
    job.computing = true;
  };
  stop_if_cancelled();
  Computing computing{*this, job};
  std::lock_guard plan_lock(job.plan_mutex);
  if constexpr (std::is_void_v<decltype(call())>) {
    call();
    stop_if_cancelled();
  } else {
    auto value = call();
    stop_if_cancelled();
    return value;
  }
}

void Farm::Impl::run_frames(const std::shared_ptr<Job>& job) {
  if (job->restored) recall(*job);
  Film film;
  Seconds begun = job->accepted;
  const std::uint64_t frames = frames_of(job->request);
  std::uint32_t rendered = job->request.first_frame;
  const std::uint64_t done_before = job->frames_done;  // by a coordinator before this one
  for (std::uint64_t done = done_before; done < frames; ++done) {
    const std::uint32_t frame = frame_at(job->request, done);
    {
      std::lock_guard lock(mutex);
      job->frame_begun = now();
      job->work_asked = job->work_done = job->work_to_come = 0;
      job->progress = FrameProgress(job->frame_begun);
    }
    if (done == done_before || !same_picture(*job, frame, rendered)) {
      film = {};  // before the next plan takes its memory
      film = render_trusted(job, frame);
      rendered = frame;
    } else {
      // Neither scene nor camera moves: what was made for the one frame holds for the other.
      reuse(*job, frame, rendered);
    }
    write(*job, frame, film, begun);
    begun = now();
    std::lock_guard lock(mutex);
    ++job->frames_done;
    job->progress = FrameProgress(begun);  // of the next one
    ++totals.frames_written;
    journal_changed(*job, JobState::queued);
    forget_records(job->id, records_of(job->id, frame));
    job->held.clear();
    job->remembered.clear();
    for (const WorkerId maker : std::exchange(job->makers, {})) ++job->frames_with[maker];
    changed(*job);
  }
}

Film Farm::Impl::render_trusted(const std::shared_ptr<Job>& job, std::uint32_t frame) {
  for (;;) {
    aim(*job, frame);
    try {
      return render(job, frame);
    } catch (const Distrusted&) {
    } catch (const Error&) {
      // A plan may choke on what a liar made.
      std::lock_guard lock(mutex);
      if (!job->distrusted) throw;
    }
    start_over(*job);
  }
}

bool Farm::Impl::same_picture(const Job& job, std::uint32_t a, std::uint32_t b) {
  if (blobs_of(scene_of(job.request, a)) != blobs_of(scene_of(job.request, b))) return false;
  const scene::Camera first = settings_of(job.request, a).camera, second = settings_of(job.request, b).camera;
  return std::memcmp(&first, &second, sizeof first) == 0;
}

SceneSummary Farm::Impl::summary_of(Job& job, std::uint32_t frame) {
  const FrameScene& shown = scene_of(job.request, frame);
  if (shown.state_blob.empty()) return shown.summary;
  const auto fetch = [&](const std::string& id) {
    Blob blob = blobs.get(id);
    if (!blob) throw Error::failed("blob " + id + " has gone");
    return blob;
  };
  if (job.base_blob != shown.scene_blob) {
    job.base = nullptr;  // before the next one takes its memory
    job.base =
        std::make_shared<const scene::Scene>(scene::parse_scene(*fetch(shown.scene_blob), job.request.scene_name));
    job.base_blob = shown.scene_blob;
  }
  const std::string origin = job.request.scene_name + ", frame " + std::to_string(frame);
  const scene::FrameState state = scene::parse_frame_state(*fetch(shown.state_blob), origin);
  SceneSummary summary = summarize(scene::posed(*job.base, state, origin));
  summary.lineage = lineage_of(shown.scene_blob, *job.base, state);
  return summary;
}

void Farm::Impl::aim(Job& job, std::uint32_t frame) {
  const FrameSettings frame_settings = settings_of(job.request, frame);
  compute(job, [&] {
    job.plan.reset();  // before the next one takes its memory
    const SceneSummary summary = summary_of(job, frame);
    job.lineage = summary.lineage;
    job.plan = settings.plan(frame_settings, summary);
    job.drawn = false;
  });
  std::lock_guard lock(mutex);
  job.scene = scene_of(job.request, frame);
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
    return compute(*job, [&] {
      const auto before = std::chrono::steady_clock::now();
      auto value = call(*job->plan);
      plan_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - before).count();
      return value;
    });
  };
  // What is still to come is predicted anew after each stage.
  double to_come = 0;
  const auto next_step = [&](const FinishedStage* finished) {
    return timed([&](Plan& plan) {
      Step step = plan.next(finished);
      to_come = plan.predicted_work();
      return step;
    });
  };
  Step step = next_step(nullptr);
  while (!step.done) {
    post(job, step, to_come);
    if (step.again) {
      step = next_step(nullptr);
      continue;
    }
    std::optional<FinishedStage> finished = await_stage(*job);
    if (!finished) break;  // the time limit; the plan has made do with what there is
    // What the threads that received the stage's results have freed, glibc keeps in their arenas.
    if (job->memory > large_plan) ::malloc_trim(0);
    step = next_step(&*finished);
  }
  await_rechecks(*job);
  end_frame(*job);
  Film film = timed([](Plan& plan) { return plan.take_film(); });
  std::lock_guard plan_lock(job->plan_mutex);
  std::lock_guard lock(mutex);
  job->drawn = false;  // the plan has given its picture away
  job->report.skips = job->plan->skips();
  for (Skip& skip : job->reused) job->report.skips.push_back(std::move(skip));
  job->reused.clear();
  job->report.plan_parameters = job->plan->parameters_json();
  job->report.warnings = job->plan->warnings();
  if (std::string warning = exposure_warning(film, job->request.exposure_stops); !warning.empty())
    job->report.warnings.push_back(std::move(warning));
  warn(*job, frame);
  job->report.plan_seconds = plan_seconds;
  return film;
}

void Farm::Impl::warn(Job& job, std::uint32_t frame) {
  for (const std::string& warning : job.report.warnings) {
    const std::string words = frames_of(job.request) > 1 ? "frame " + std::to_string(frame) + ": " + warning : warning;
    settings.log("job " + job.id + ": " + words);
    if (job.warnings.size() < most_warnings) job.warnings.push_back(words);
  }
}

void Farm::Impl::reuse(Job& job, std::uint32_t frame, std::uint32_t rendered) {
  std::lock_guard lock(mutex);
  FrameReport report = new_report(job, frame);
  report.plan_parameters = job.report.plan_parameters;
  report.devices = job.report.devices;
  report.warnings = job.report.warnings;
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
    if (job.distrusted) throw Distrusted{};
    if (!job.finished.empty()) {
      auto stage = job.finished.front();
      job.finished.pop_front();
      return FinishedStage{stage->spec.name, std::exchange(stage->records, nullptr), stage->record_count, stage->facts};
    }
    const double left = job.frame_begun + limit - now();
    if (concludes && left <= 0) {
      take_what_arrived(job, lock);
      if (!job.finished.empty() || job.cancel || stopping || !job.failure.empty()) continue;
      if (conclude(job, lock)) return std::nullopt;
      concludes = false;  // too early for a picture: this stage must be whole, the next one need not
      continue;
    }
    if (stream(job, lock) || draw(job, lock)) continue;
    if (concludes)
      job.events.wait_for(lock, std::chrono::duration<double>(left));
    else
      job.events.wait(lock);
  }
}

bool Farm::Impl::stream(Job& job, std::unique_lock<std::mutex>& lock) {
  for (const auto& stage : job.stages)
    if (!stage->delivered && stage->arrived.ready()) {
      take_next(job, stage, lock);
      return true;
    }
  return false;
}

void Farm::Impl::take_next(Job& job, std::shared_ptr<RunningStage> stage, std::unique_lock<std::mutex>& lock) {
  ArrivedRecords::Batch batch = *stage->arrived.next();
  lock.unlock();
  if (batch.read) batch.records = batch.read();
  compute(job, [&] {
    job.plan->take(stage->spec.name, batch.first, batch.count, batch.records);
    job.drawn = true;
  });
  lock.lock();
  records_ready.notify_all();
  deliver_if_complete(stage);
}

void Farm::Impl::take_what_arrived(Job& job, std::unique_lock<std::mutex>& lock) {
  std::vector<std::pair<std::shared_ptr<RunningStage>, std::uint64_t>> ends;
  for (const auto& stage : job.stages) ends.emplace_back(stage, stage->arrived.ready_end());
  for (const auto& [stage, end] : ends)
    while (!stage->delivered && !job.cancel && !stopping && stage->arrived.given() < end) take_next(job, stage, lock);
}

bool Farm::Impl::draw(Job& job, std::unique_lock<std::mutex>& lock) {
  if (job.undrawn.empty()) return false;
  UndrawnItems& next = job.undrawn.front();
  const std::shared_ptr<RunningStage> stage = next.stage;
  const std::uint64_t stride = stage->spec.output.record_bytes, first = next.first;
  const std::uint64_t count = std::min(next.count, std::max<std::uint64_t>(1, most_drawn / stride));
  next.first += count;
  next.count -= count;
  if (next.count == 0) job.undrawn.pop_front();
  const std::shared_ptr<const Bytes> all = stage->records;
  if (!all) return true;  // the plan has the stage, and draws it no more
  lock.unlock();
  const auto begin = all->begin() + static_cast<std::ptrdiff_t>(first * stride);
  const Bytes records(begin, begin + static_cast<std::ptrdiff_t>(count * stride));
  compute(job, [&] {
    job.plan->preview(stage->spec.name, first, count, records);
    job.drawn = true;
  });
  lock.lock();
  return true;
}

bool Farm::Impl::conclude(Job& job, std::unique_lock<std::mutex>& lock) {
  std::vector<CutStage> cut;
  std::vector<std::shared_ptr<RunningStage>> stages;
  for (const auto& stage : job.stages)
    if (!stage->delivered && !stage->computes_again) {
      stages.push_back(stage);
      cut.push_back({{stage->spec.name, stage->records}, stage->copied});
      if (stage->arrived.given() > 0) cut.back().whole = {{0, stage->arrived.given()}};
    }
  lock.unlock();
  for (CutStage& part : cut)
    std::sort(part.whole.begin(), part.whole.end(),
              [](const ItemRange& a, const ItemRange& b) { return a.first < b.first; });
  const bool concluded = compute(job, [&] { return job.plan->conclude(cut); });
  lock.lock();
  if (!concluded) return false;
  job.report.time_limit_reached = true;
  for (std::size_t i = 0; i < cut.size(); ++i) {
    stages[i]->report.items = 0;  // what the picture is made of
    for (const ItemRange& range : cut[i].whole) stages[i]->report.items += range.count;
  }
  return true;
}

JobRemains Farm::Impl::withdraw(Job& job) {
  JobRemains remains;
  for (const auto& stage : job.stages) {
    if (!stage->delivered) {
      if (stage->computes_again) end_again(stage);
      revoke(scheduler.remove_stage(stage->id));
      active_stages.erase(stage->id);
      stage->delivered = true;
    }
    if (stage->last_result >= 0) stage->report.seconds = stage->last_result - stage->first_lease;
    remains.records.push_back(std::exchange(stage->records, nullptr));
    remains.arrived.push_back(std::exchange(stage->arrived, {}));
    remains.counted.push_back(std::exchange(stage->counted, {}));
  }
  while (!job.rechecks.empty()) end_recheck(std::shared_ptr<RunningStage>(job.rechecks.back()));
  records_ready.notify_all();
  for (const auto& stage : job.finished) remains.stages.push_back(stage);
  job.finished.clear();
  job.undrawn.swap(remains.undrawn);
  job.data.swap(remains.data);
  job.outputs.clear();
  release_all_retained(job);
  settle_retained();  // what this frame computed again, others may need
  if (job.report.stages.empty())
    for (const auto& stage : job.stages) job.report.stages.push_back(stage->report);
  offer_to_unserved_soon();
  return remains;
}

void Farm::Impl::end_frame(Job& job) {
  JobRemains remains;  // destroyed last
  std::lock_guard lock(mutex);
  remains = withdraw(job);
}

}  // namespace gleaner::coordinator
