// A frame's thread: from the plan's first stages to the film and its files.

#include <malloc.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>

#include "coordinator/artifacts/scene_lineage.h"
#include "coordinator/film/exposure.h"
#include "coordinator/jobs/engine.h"
#include "coordinator/plan/denoise_plan.h"
#include "scene/model/error.h"
#include "scene/model/frame_state.h"

namespace gleaner::coordinator {

namespace {

constexpr std::uint64_t large_plan = std::uint64_t{256} << 20;  // bytes, as predicted
constexpr std::size_t most_warnings = 8;                        // of a job's frames, in its status
constexpr std::uint64_t most_drawn = std::uint64_t{4} << 20;    // bytes of records that a preview takes at a time

}  // namespace

template <typename Call>
auto Farm::Impl::compute(Frame& frame, const Call& call) {
  struct Computing {
    Impl& farm;
    Frame& frame;
    ~Computing() {
      std::lock_guard lock(farm.mutex);
      frame.computing = false;
    }
  };
  const auto stop_if_cancelled = [&] {
    std::lock_guard lock(mutex);
    if (frame.job->cancel || stopping) throw Cancelled{};
    frame.computing = true;
  };
  stop_if_cancelled();
  Computing computing{*this, frame};
  std::lock_guard plan_lock(frame.plan_mutex);
  if constexpr (std::is_void_v<decltype(call())>) {
    call();
    stop_if_cancelled();
  } else {
    auto value = call();
    stop_if_cancelled();
    return value;
  }
}

void Farm::Impl::render_and_write(const std::shared_ptr<Frame>& frame) {
  Job& job = *frame->job;
  if (job.restored) recall(*frame);
  const std::uint32_t rendered = frame_at(job.request, frame->place);
  Film film = render_trusted(frame);
  if (job.showing)
    give_picture(*frame, std::move(film));
  else
    write(*frame, film);
  std::unique_lock lock(mutex);
  while (frame_over(*frame, "")) {
    lock.unlock();
    // Neither scene nor camera moves: what was made for the one frame holds for the other.
    reuse(*frame, rendered);
    write(*frame, film);
    lock.lock();
  }
}

Film Farm::Impl::render_trusted(const std::shared_ptr<Frame>& frame) {
  for (;;) {
    aim(*frame);
    try {
      return render(frame);
    } catch (const Distrusted&) {
    } catch (const Error&) {
      // A plan may choke on what a liar made.
      std::lock_guard lock(mutex);
      if (!frame->distrusted) throw;
    }
    start_over(*frame);
  }
}

SceneSummary Farm::Impl::summary_of(const Frame& frame) {
  if (frame.job->showing) return frame.job->showing->shown;
  const FrameScene& shown = frame.scene;
  if (shown.state_blob.empty()) return shown.summary;
  Job& job = *frame.job;
  const auto fetch = [&](const std::string& id) {
    Blob blob = blobs.get(id);
    if (!blob) throw Error::failed("blob " + id + " has gone");
    return blob;
  };
  std::shared_ptr<const scene::Scene> base;
  {
    std::lock_guard lock(job.base_mutex);
    if (job.base_blob != shown.scene_blob) {
      job.base = nullptr;  // before the next one takes its memory
      job.base =
          std::make_shared<const scene::Scene>(scene::parse_scene(*fetch(shown.scene_blob), job.request.scene_name));
      job.base_blob = shown.scene_blob;
    }
    base = job.base;
  }
  const std::string origin = job.request.scene_name + ", frame " + std::to_string(frame_at(job.request, frame.place));
  const scene::FrameState state = scene::parse_frame_state(*fetch(shown.state_blob), origin);
  SceneSummary summary = summarize(scene::posed(*base, state, origin));
  summary.rest_bounds = shown.summary.bounds;
  summary.lineage = lineage_of(shown.scene_blob, *base, state);
  return summary;
}

std::unique_ptr<Plan> Farm::Impl::plan_for(const Frame& frame, const SceneSummary& summary) const {
  const auto& showing = frame.job->showing;
  if (showing && showing->given)
    return std::make_unique<DenoisePlan>(frame.settings, summary, std::make_unique<GivenPicture>(*showing->given));
  return settings.plan(frame.settings, summary);
}

void Farm::Impl::aim(Frame& frame) {
  compute(frame, [&] {
    frame.plan.reset();  // before the next one takes its memory
    const SceneSummary summary = summary_of(frame);
    frame.lineage = summary.lineage;
    frame.plan = plan_for(frame, summary);
    frame.drawn = false;
  });
  std::lock_guard lock(mutex);
  frame.stages.clear();
  changed(*frame.job);
}

FrameReport Farm::Impl::new_report(const Frame& frame) const {
  const Job& job = *frame.job;
  FrameReport report;
  report.scene = job.request.scene_name;
  report.camera = job.request.camera_name;
  report.job = job.id;
  report.frame = frame_at(job.request, frame.place);
  report.settings = frame.settings;
  report.time_limit = job.request.time_limit;
  return report;
}

Film Farm::Impl::render(const std::shared_ptr<Frame>& frame) {
  {
    std::lock_guard lock(mutex);
    frame->report = new_report(*frame);
  }
  double plan_seconds = 0;
  // The plan's calls are timed: with the stages' seconds they say where a frame's time went.
  auto timed = [&](auto call) {
    return compute(*frame, [&] {
      const auto before = std::chrono::steady_clock::now();
      auto value = call(*frame->plan);
      plan_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - before).count();
      return value;
    });
  };
  // What is still to come is predicted anew after each stage.
  double to_come = 0;
  const auto next_step = [&](const FinishedStage* finished) {
    const std::optional<double> allowed = allowed_work(*frame);
    return timed([&](Plan& plan) {
      if (allowed) plan.allow(*allowed);
      Step step = plan.next(finished);
      to_come = plan.predicted_work();
      return step;
    });
  };
  Step step = next_step(nullptr);
  while (!step.done) {
    post(frame, step, to_come);
    if (step.again) {
      step = next_step(nullptr);
      continue;
    }
    std::optional<FinishedStage> finished = await_stage(*frame);
    if (!finished) {  // the time limit; the plan has made do with what there is
      step = timed([](Plan& plan) { return plan.after_conclude(); });
      to_come = 0;
      continue;
    }
    // What the threads that received the stage's results have freed, glibc keeps in their arenas.
    if (frame->memory > large_plan) ::malloc_trim(0);
    step = next_step(&*finished);
  }
  await_rechecks(*frame);
  end_frame(*frame);
  const bool only_picture = frame->job->request.settings.only_picture;
  Film film = timed([&](Plan& plan) { return only_picture ? plan.take_picture() : plan.take_film(); });
  std::lock_guard plan_lock(frame->plan_mutex);
  std::lock_guard lock(mutex);
  frame->drawn = false;  // the plan has given its picture away
  frame->report.skips = frame->plan->skips();
  for (Skip& skip : frame->reused) frame->report.skips.push_back(std::move(skip));
  frame->reused.clear();
  frame->report.plan_parameters = frame->plan->parameters_json();
  frame->report.warnings = frame->plan->warnings();
  if (std::string warning = exposure_warning(film, frame->job->request.exposure_stops); !warning.empty())
    frame->report.warnings.push_back(std::move(warning));
  warn(*frame);
  frame->report.plan_seconds = plan_seconds;
  return film;
}

void Farm::Impl::warn(Frame& frame) {
  Job& job = *frame.job;
  for (const std::string& warning : frame.report.warnings) {
    const std::string words =
        frames_of(job.request) > 1 ? "frame " + std::to_string(frame.report.frame) + ": " + warning : warning;
    settings.log("job " + job.id + ": " + words);
    if (job.warnings.size() < most_warnings) job.warnings.push_back(words);
  }
}

void Farm::Impl::reuse(Frame& frame, std::uint32_t rendered) {
  std::lock_guard lock(mutex);
  FrameReport report = new_report(frame);
  report.plan_parameters = frame.report.plan_parameters;
  report.devices = frame.report.devices;
  report.warnings = frame.report.warnings;
  report.skips = frame.report.skips;
  std::erase_if(report.skips, [](const Skip& skip) { return skip.what == "frame"; });
  report.skips.push_back({"frame", "same scene, camera and settings as frame " + std::to_string(rendered), 1});
  frame.report = std::move(report);
}

std::optional<double> Farm::Impl::allowed_work(const Frame& frame) {
  const double limit = frame.job->request.time_limit;
  if (limit <= 0) return std::nullopt;
  std::lock_guard lock(mutex);
  const double pace = frame.progress.pace();
  if (pace <= 0) return std::numeric_limits<double>::infinity();
  return pace * std::max(0.0, frame.begun + limit - now());
}

std::optional<FinishedStage> Farm::Impl::await_stage(Frame& frame) {
  const double limit = frame.job->request.time_limit;
  bool concludes = limit > 0 && !frame.report.time_limit_reached;
  std::unique_lock lock(mutex);
  for (;;) {
    if (frame.job->cancel || stopping) throw Cancelled{};
    if (!frame.failure.empty()) throw Error::failed(frame.failure);
    if (frame.distrusted) throw Distrusted{};
    if (start_what_follows_no_more(frame, lock)) continue;
    if (!frame.finished.empty()) {
      auto stage = frame.finished.front();
      frame.finished.pop_front();
      return FinishedStage{stage->spec.name, std::exchange(stage->records, nullptr), stage->record_count, stage->facts};
    }
    const double left = frame.begun + limit - now();
    const bool limited = concludes && !frame.job->paused;
    if (limited && left <= 0) {
      take_what_arrived(frame, lock);
      if (!frame.finished.empty() || frame.job->cancel || stopping || !frame.failure.empty()) continue;
      if (conclude(frame, lock)) return std::nullopt;
      concludes = false;  // too early for a picture: this stage must be whole, the next one need not
      continue;
    }
    if (stream(frame, lock) || draw(frame, lock)) continue;
    if (limited)
      frame.events.wait_for(lock, std::chrono::duration<double>(left));
    else
      frame.events.wait(lock);
  }
}

bool Farm::Impl::stream(Frame& frame, std::unique_lock<std::mutex>& lock) {
  for (const auto& stage : frame.stages)
    if (!stage->delivered && stage->arrived.ready()) {
      take_next(frame, stage, lock);
      return true;
    }
  return false;
}

void Farm::Impl::take_next(Frame& frame, std::shared_ptr<RunningStage> stage, std::unique_lock<std::mutex>& lock) {
  ArrivedRecords::Batch batch = *stage->arrived.next();
  lock.unlock();
  if (batch.read) batch.records = batch.read();
  compute(frame, [&] {
    frame.plan->take(stage->spec.name, batch.first, batch.count, batch.records);
    frame.drawn = true;
  });
  lock.lock();
  records_ready.notify_all();
  deliver_if_complete(stage);
}

void Farm::Impl::take_what_arrived(Frame& frame, std::unique_lock<std::mutex>& lock) {
  std::vector<std::pair<std::shared_ptr<RunningStage>, std::uint64_t>> ends;
  for (const auto& stage : frame.stages) ends.emplace_back(stage, stage->arrived.ready_end());
  for (const auto& [stage, end] : ends)
    while (!stage->delivered && !frame.job->cancel && !stopping && stage->arrived.given() < end)
      take_next(frame, stage, lock);
}

bool Farm::Impl::draw(Frame& frame, std::unique_lock<std::mutex>& lock) {
  if (frame.undrawn.empty()) return false;
  UndrawnItems& next = frame.undrawn.front();
  const std::shared_ptr<RunningStage> stage = next.stage;
  const std::uint64_t stride = stage->spec.output.record_bytes, first = next.first;
  const std::uint64_t count = std::min(next.count, std::max<std::uint64_t>(1, most_drawn / stride));
  next.first += count;
  next.count -= count;
  if (next.count == 0) frame.undrawn.pop_front();
  const std::shared_ptr<const Bytes> all = stage->records;
  if (!all) return true;  // the plan has the stage, and draws it no more
  lock.unlock();
  const auto begin = all->begin() + static_cast<std::ptrdiff_t>(first * stride);
  const Bytes records(begin, begin + static_cast<std::ptrdiff_t>(count * stride));
  compute(frame, [&] {
    frame.plan->preview(stage->spec.name, first, count, records);
    frame.drawn = true;
  });
  lock.lock();
  return true;
}

bool Farm::Impl::conclude(Frame& frame, std::unique_lock<std::mutex>& lock) {
  std::vector<CutStage> cut;
  std::vector<std::shared_ptr<RunningStage>> stages;
  for (const auto& stage : frame.stages)
    if (!stage->delivered && !stage->computes_again) {
      stages.push_back(stage);
      cut.push_back({{stage->spec.name, stage->records}, stage->copied});
      if (stage->arrived.given() > 0) cut.back().whole = {{0, stage->arrived.given()}};
    }
  lock.unlock();
  for (CutStage& part : cut)
    std::sort(part.whole.begin(), part.whole.end(),
              [](const ItemRange& a, const ItemRange& b) { return a.first < b.first; });
  const bool concluded = compute(frame, [&] { return frame.plan->conclude(cut); });
  lock.lock();
  if (!concluded) return false;
  frame.report.time_limit_reached = true;
  for (std::size_t i = 0; i < cut.size(); ++i) {
    stages[i]->report.items = 0;  // what the picture is made of
    for (const ItemRange& range : cut[i].whole) stages[i]->report.items += range.count;
    // Nobody waits for it any more, and what the picture still wants needs its workers.
    revoke(scheduler.remove_stage(stages[i]->id));
    active_stages.erase(stages[i]->id);
    stages[i]->delivered = true;
    release_followers(*stages[i]);
  }
  frame.finished.clear();
  return true;
}

JobRemains Farm::Impl::withdraw(Frame& frame) {
  JobRemains remains;
  for (const auto& stage : frame.stages) {
    if (!stage->delivered) {
      if (stage->computes_again) end_again(stage);
      revoke(scheduler.remove_stage(stage->id));
      active_stages.erase(stage->id);
      stage->delivered = true;
    }
    release_followers(*stage);
    if (stage->last_result >= 0) stage->report.seconds = stage->last_result - stage->first_lease;
    remains.records.push_back(std::exchange(stage->records, nullptr));
    remains.arrived.push_back(std::exchange(stage->arrived, {}));
    remains.counted.push_back(std::exchange(stage->counted, {}));
  }
  while (!frame.rechecks.empty()) end_recheck(std::shared_ptr<RunningStage>(frame.rechecks.back()));
  records_ready.notify_all();
  for (const auto& stage : frame.finished) remains.stages.push_back(stage);
  frame.finished.clear();
  frame.to_start.clear();
  frame.undrawn.swap(remains.undrawn);
  frame.data.swap(remains.data);
  frame.outputs.clear();
  release_all_retained(frame);
  settle_retained();  // what this frame computed again, others may need
  if (frame.report.stages.empty())
    for (const auto& stage : frame.stages) frame.report.stages.push_back(stage->report);
  offer_to_unserved_soon();
  return remains;
}

void Farm::Impl::end_frame(Frame& frame) {
  JobRemains remains;  // destroyed last
  std::lock_guard lock(mutex);
  remains = withdraw(frame);
}

}  // namespace gleaner::coordinator
