// A stage from the plan's step to its whole records.

#include <new>
#include <span>
#include <utility>

#include "coordinator/blobs/sha256.h"
#include "coordinator/jobs/engine.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

void Farm::Impl::post(const std::shared_ptr<Job>& job, const Step& step, double work_to_come) {
  std::map<ArtifactId, Job::Artifact> artifacts, released;  // destroyed where the mutex is not held
  for (const auto& [id, bytes] : step.artifacts) artifacts[id] = {bytes, blobs.lend(bytes)};
  std::vector<std::shared_ptr<RunningStage>> posted;
  {
    std::lock_guard lock(mutex);
    if (job->cancel || stopping) throw Cancelled{};
    job->artifacts.merge(artifacts);
    for (const StageSpec& spec : step.stages)
      if (auto stage = schedule(job, spec)) posted.push_back(stage);
    for (const ArtifactId& id : step.released)
      if (auto artifact = job->artifacts.extract(id)) released.insert(std::move(artifact));
    job->work_to_come = work_to_come;
    offer_to_all();
    timer_rearm = true;
    timer_wakes.notify_all();
    changed(*job);
  }
  for (const auto& stage : posted) {
    if (stage->streamed()) continue;
    std::shared_ptr<Bytes> records;
    try {
      records = std::make_shared<Bytes>(stage->spec.items * stage->spec.output.record_bytes);
    } catch (const std::bad_alloc&) {
    }
    std::lock_guard lock(mutex);
    stage->failed_to_allocate = !records;
    stage->records = std::move(records);
    if (stage->failed_to_allocate)
      throw Error::failed("stage " + stage->spec.name + ": no memory for " + std::to_string(stage->spec.items) +
                          " records of " + std::to_string(stage->spec.output.record_bytes) + " bytes");
    deliver_if_complete(stage);
    records_ready.notify_all();
  }
}

std::string Farm::Impl::address_of(const StageWork& work, const StageSpec& spec) {
  Sha256 hash;
  const auto add = [&](const std::string& text) {
    const std::string length = std::to_string(text.size()) + ":";
    hash.update(std::as_bytes(std::span(length)));
    hash.update(std::as_bytes(std::span(text)));
  };
  add(work.scene_blob);
  add(work.kind);
  add(std::to_string(spec.items) + " of " + std::to_string(spec.output.record_bytes));
  add(std::string(reinterpret_cast<const char*>(spec.parameters.data()), spec.parameters.size()));
  for (const auto& input : work.inputs) {
    add(input.name);
    add(input.blob);
  }
  return hash.hex();
}

std::shared_ptr<RunningStage> Farm::Impl::schedule(const std::shared_ptr<Job>& job, const StageSpec& spec) {
  const bool streamed = spec.output.placement == Placement::stream;
  if (streamed && spec.output.reusable)
    throw Error::failed("stage " + spec.name + ": records that nobody keeps are not reusable");
  if (spec.output.record_bytes == 0 || (!streamed && spec.items > settings.artifact_bytes / spec.output.record_bytes))
    throw Error::failed("stage " + spec.name + ": " + std::to_string(spec.items) + " records of " +
                        std::to_string(spec.output.record_bytes) + " bytes are more than this coordinator takes (" +
                        std::to_string(settings.artifact_bytes) + " bytes)");
  auto work = std::make_shared<StageWork>();
  work->job = job->id;
  work->stage = spec.name;
  work->kind = spec.kind;
  work->parameters = spec.parameters;
  work->record_bytes = spec.output.record_bytes;
  work->scene_blob = job->request.scene_blob;
  work->bvh_blob = job->request.bvh_blob;
  for (const auto& input : spec.inputs) {
    auto artifact = job->artifacts.find(input.artifact);
    if (artifact == job->artifacts.end())
      throw Error::failed("stage " + spec.name + ": its input " + input.name +
                          " names an artifact that the plan never gave");
    work->inputs.push_back({input.name, artifact->second.blob});
  }
  auto stage = std::make_shared<RunningStage>();
  stage->job = job;
  stage->spec = spec;
  if (spec.output.reusable) {
    stage->address = address_of(*work, spec);
    if (auto records = kept.find(stage->address)) {
      stage->records = std::const_pointer_cast<Bytes>(records);
      stage->delivered = true;
      job->reused.push_back({"stage " + spec.name,
                             "made before, from the same scene, settings and inputs: artifact " + stage->address,
                             spec.items});
      job->finished.push_back(stage);
      job->events.notify_all();
      return nullptr;
    }
  }
  stage->work = std::move(work);
  stage->report.name = spec.name;
  stage->report.kind = spec.kind;
  stage->report.items = spec.items;
  ScheduledStage scheduled{.kind = spec.kind,
                           .items = spec.items,
                           .tile = spec.tile,
                           .solo = spec.solo,
                           .priority = spec.priority,
                           .preferred = {}};
  kinds.insert(spec.kind);
  stage->id = scheduler.add_stage(scheduled, now());
  stage->complete = scheduler.complete(stage->id);
  job->stages.push_back(stage);
  job->work_asked += stage->work_per_item() * static_cast<double>(spec.items);
  active_stages[stage->id] = stage;
  return stage;
}

void Farm::Impl::deliver_if_complete(const std::shared_ptr<RunningStage>& shared) {
  RunningStage& stage = *shared;
  if (stage.delivered || !stage.complete) return;
  if (stage.streamed() ? stage.arrived.given() != stage.spec.items : stage.writers != 0 || !stage.records) return;
  stage.delivered = true;
  if (stage.first_lease < 0) stage.first_lease = stage.last_result = now();
  stage.report.seconds = stage.last_result - stage.first_lease;
  stage.history.clear();
  revoke(scheduler.remove_stage(stage.id));
  active_stages.erase(stage.id);
  if (!stage.address.empty()) kept.put(stage.address, stage.records);
  stage.job->finished.push_back(shared);
  stage.job->events.notify_all();
}

}  // namespace gleaner::coordinator
