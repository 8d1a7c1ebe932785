#pragma once
// A frame without a farm: its plan's stages one after another, whole, on one executor of this process.

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "coordinator/artifacts/artifact_id.h"
#include "coordinator/plan/plan.h"
#include "scene/model/error.h"
#include "worker/stages/executor.h"

namespace gleaner::cli {

// Called before each stage; false: go no further.
using BeforeStage = std::function<bool(const coordinator::StageSpec&, const worker::StageTask&)>;
// Called after each stage with what it made.
using AfterStage = std::function<void(const coordinator::StageSpec&, const worker::BatchResult&)>;

// What stages read: a plan's data, and what other stages made.
struct LocalArtifact {
  std::shared_ptr<const scene::Bytes> bytes;
  std::shared_ptr<const std::vector<std::uint64_t>> offsets{};  // counted: as TaskInput's
};
using LocalArtifacts = std::map<coordinator::ArtifactId, LocalArtifact>;

inline worker::StageTask local_task(const coordinator::StageSpec& stage, const std::string& scene,
                                    const LocalArtifacts& artifacts) {
  worker::StageTask task;
  task.kind = stage.kind;
  task.parameters = stage.parameters;
  task.scene = scene;
  for (const coordinator::StageInput& input : stage.inputs) {
    const auto artifact = artifacts.find(input.artifact);
    if (artifact == artifacts.end())
      throw Error::failed("stage " + stage.name + " reads " + input.name + ", which does not exist (any more)");
    worker::TaskInput& to = task.inputs[input.name];
    to = worker::TaskInput(artifact->second.bytes);
    to.artifact = scene + " " + input.artifact;  // the plan's id names no scene
    to.own_items = input.extent == coordinator::Extent::own_items;
    to.offsets = artifact->second.offsets;
  }
  return task;
}

// Where each item's records begin, of a counted output.
inline std::shared_ptr<const std::vector<std::uint64_t>> offsets_of(const std::vector<std::uint32_t>& counts) {
  auto offsets = std::make_shared<std::vector<std::uint64_t>>(1, 0);
  for (const std::uint32_t count : counts) offsets->push_back(offsets->back() + count);
  return offsets;
}

// Stages run in the order in which the plan asks for them. Returns whether the film is whole. `scene` is a name that
// load_scene() was told of; the plan's SceneSummary names no blob.
inline bool run_frame(coordinator::Plan& plan, worker::Executor& executor, const std::string& scene,
                      const BeforeStage& before = {}, const AfterStage& after = {}) {
  using coordinator::Placement;
  LocalArtifacts artifacts;
  std::deque<coordinator::StageSpec> waiting;
  coordinator::Step step = plan.next(nullptr);
  for (;;) {
    for (const auto& [id, bytes] : step.artifacts) artifacts[id] = {bytes};
    for (coordinator::StageSpec& stage : step.stages) waiting.push_back(std::move(stage));
    for (const coordinator::ArtifactId& id : step.released) artifacts.erase(id);
    if (step.done) return true;
    if (step.again) {
      step = plan.next(nullptr);
      continue;
    }
    if (waiting.empty()) throw Error::failed("the plan waits for stages that it did not ask for");
    const coordinator::StageSpec stage = std::move(waiting.front());
    waiting.pop_front();
    const worker::StageTask task = local_task(stage, scene, artifacts);
    if (before && !before(stage, task)) return false;
    worker::BatchResult result = executor.run(task, 0, stage.items);
    if (after) after(stage, result);
    if (stage.output.counted && result.counts.size() != stage.items)
      throw Error::failed("stage " + stage.name + ": counts of " + std::to_string(result.counts.size()) + " items");
    const auto records = std::make_shared<const scene::Bytes>(std::move(result.records));
    coordinator::FinishedStage finished{stage.name, nullptr, records->size() / stage.output.record_bytes,
                                        std::move(result.facts)};
    if (stage.output.placement == Placement::collect) finished.records = records;
    if (stage.output.placement == Placement::stream) plan.take(stage.name, 0, stage.items, *records);
    if (stage.output.placement == Placement::retain)
      artifacts[coordinator::artifact_id({}, stage)] = {records,
                                                        stage.output.counted ? offsets_of(result.counts) : nullptr};
    step = plan.next(&finished);
  }
}

}  // namespace gleaner::cli
