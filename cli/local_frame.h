#pragma once
// A frame without a farm: its plan's stages one after another, whole, on one executor of this process.

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "coordinator/plan/plan.h"
#include "scene/model/error.h"
#include "worker/stages/executor.h"

namespace gleaner::cli {

// Called before each stage; false: go no further.
using BeforeStage = std::function<bool(const coordinator::StageSpec&, const worker::StageTask&)>;
// Called after each stage with what it made.
using AfterStage = std::function<void(const coordinator::StageSpec&, const worker::BatchResult&)>;

// Stages run in the order in which the plan asks for them. Returns whether the film is whole. `scene` is a name that
// load_scene() was told of.
inline bool run_frame(coordinator::Plan& plan, worker::Executor& executor, const std::string& scene,
                      const BeforeStage& before = {}, const AfterStage& after = {}) {
  std::map<coordinator::ArtifactId, std::shared_ptr<const scene::Bytes>> artifacts;
  std::deque<coordinator::StageSpec> waiting;
  coordinator::Step step = plan.next(nullptr);
  for (;;) {
    artifacts.merge(step.artifacts);
    for (coordinator::StageSpec& stage : step.stages) waiting.push_back(std::move(stage));
    if (step.done) return true;
    if (waiting.empty()) throw Error::failed("the plan waits for stages that it did not ask for");
    const coordinator::StageSpec stage = std::move(waiting.front());
    waiting.pop_front();
    worker::StageTask task;
    task.kind = stage.kind;
    task.parameters = stage.parameters;
    task.scene = scene;
    for (const coordinator::StageInput& input : stage.inputs) {
      const auto artifact = artifacts.find(input.artifact);
      if (artifact == artifacts.end())
        throw Error::failed("stage " + stage.name + " reads " + input.name + ", which its plan did not provide");
      task.inputs[input.name] = artifact->second;
    }
    if (before && !before(stage, task)) return false;
    worker::BatchResult result = executor.run(task, 0, stage.items);
    if (after) after(stage, result);
    const coordinator::FinishedStage finished{stage.name,
                                              std::make_shared<const scene::Bytes>(std::move(result.records))};
    step = plan.next(&finished);
  }
}

}  // namespace gleaner::cli
