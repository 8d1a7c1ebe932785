// A stage from the plan's step to its whole records.

#include <new>
#include <span>
#include <utility>

#include "coordinator/blobs/sha256.h"
#include "coordinator/jobs/engine.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

void Farm::Impl::post(const std::shared_ptr<Job>& job, const Step& step) {
  std::map<ArtifactId, std::string> ids;
  for (const auto& [id, artifact] : step.artifacts) ids[id] = blobs.lend(artifact);
  std::vector<std::shared_ptr<RunningStage>> posted;
  {
    std::lock_guard lock(mutex);
    if (job->cancel || stopping) throw Cancelled{};
    for (const auto& [id, artifact] : step.artifacts) job->artifacts.push_back(artifact);
    job->artifact_blobs.insert(ids.begin(), ids.end());
    for (const StageSpec& spec : step.stages)
      if (auto stage = schedule(job, spec)) posted.push_back(stage);
    pump();
    changed(*job);
  }
  timer_wakes.notify_all();
  for (const auto& stage : posted) {
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
  if (spec.output.record_bytes == 0 || spec.items > settings.artifact_bytes / spec.output.record_bytes)
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
    auto blob = job->artifact_blobs.find(input.artifact);
    if (blob == job->artifact_blobs.end())
      throw Error::failed("stage " + spec.name + ": its input " + input.name +
                          " names an artifact that the plan never gave");
    work->inputs.push_back({input.name, blob->second});
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
  active_stages[stage->id] = stage;
  return stage;
}

void Farm::Impl::deliver_if_complete(const std::shared_ptr<RunningStage>& shared) {
  RunningStage& stage = *shared;
  if (!stage.complete || stage.writers != 0 || !stage.records || stage.delivered) return;
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
