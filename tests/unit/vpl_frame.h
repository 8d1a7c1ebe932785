#pragma once
// Frames of method `vpl` whose devices are arithmetic; what runs on workers' hosts is the real thing.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "coordinator/artifacts/artifact_id.h"
#include "coordinator/plan/plan.h"
#include "kernels/cluster_records.h"
#include "kernels/vpl_records.h"
#include "tests/unit/plan_frame.h"
#include "worker/stages/vpl/host_stages.h"

namespace gleaner::coordinator {

inline std::vector<float> floats_of(const Bytes& bytes) {
  std::vector<float> values(bytes.size() / 4);
  if (!bytes.empty()) std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

inline Bytes bytes_of_floats(const std::vector<float>& values) {
  Bytes bytes(values.size() * 4);
  if (!values.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

struct PlannedStage {
  StageSpec spec;
  std::map<std::string, std::shared_ptr<const Bytes>> inputs;
  std::shared_ptr<const Bytes> records;  // its output
  std::size_t facts = 0;                 // bytes of them
};

// The result of a stage on a device: the records of all items and, where they are counted, their counts.
using DeviceStage = std::function<worker::BatchResult(const PlannedStage&)>;

inline worker::BatchResult run_stage(const PlannedStage& stage, const DeviceStage& device) {
  static const std::map<std::string, worker::BatchResult (*)(const worker::StageTask&)> host = {
      {"vpl_resample", worker::resample_lights},         {"vpl_order", worker::order_lights},
      {"vpl_sample_points", worker::sample_points},      {"vpl_merge_points", worker::merge_points},
      {"vpl_skipped", worker::count_skipped_queries},    {"vpl_pilot", worker::measure_pilot},
      {"vpl_pilot_points", worker::choose_pilot_points}, {"vpl_pilot_lights", worker::choose_pilot_lights}};
  const auto program = host.find(stage.spec.kind);
  if (program == host.end()) return device(stage);
  worker::StageTask task;
  task.kind = stage.spec.kind;
  task.parameters = stage.spec.parameters;
  for (const auto& [name, bytes] : stage.inputs) task.inputs[name] = worker::TaskInput(bytes);
  return program->second(task);
}

// Runs a plan to its end. `choose` says which of so many waiting stages is done next.
class RunFrame {
 public:
  RunFrame(std::unique_ptr<Plan> plan, const DeviceStage& device, std::function<std::size_t(std::size_t)> choose)
      : plan_(std::move(plan)), device_(device), choose_(std::move(choose)) {}

  void run() {
    std::deque<StageSpec> waiting;
    Step step = plan_->next(nullptr);
    for (;;) {
      for (const auto& [id, bytes] : step.artifacts) artifacts_[id] = bytes;
      for (StageSpec& stage : step.stages) {
        EXPECT_THAT(step.released, testing::Not(testing::Contains(artifact_id({}, stage)))) << stage.name;
        waiting.push_back(std::move(stage));
      }
      for (const ArtifactId& id : step.released) EXPECT_EQ(artifacts_.erase(id), 1u) << "released before it was made";
      if (step.done) return;
      if (step.again) {
        step = plan_->next(nullptr);
        continue;
      }
      ASSERT_FALSE(waiting.empty()) << "the plan waits for nothing";
      const auto at = waiting.begin() + static_cast<std::ptrdiff_t>(choose_(waiting.size()));
      const StageSpec spec = *at;
      waiting.erase(at);
      step = finish(spec);
    }
  }

  Plan& plan() { return *plan_; }
  std::map<std::string, PlannedStage> stages;

 private:
  Step finish(const StageSpec& spec) {
    PlannedStage stage{spec, {}, nullptr};
    for (const StageInput& input : spec.inputs) stage.inputs[input.name] = artifacts_.at(input.artifact);
    worker::BatchResult result = run_stage(stage, device_);
    stage.records = std::make_shared<const Bytes>(std::move(result.records));
    stage.facts = result.facts.size();
    EXPECT_TRUE(stages.emplace(spec.name, stage).second) << spec.name << " twice";
    EXPECT_EQ(result.counts.size(), spec.output.counted ? spec.items : 0) << spec.name;
    FinishedStage finished{spec.name, nullptr, stage.records->size() / spec.output.record_bytes, result.facts};
    if (spec.output.placement == Placement::collect) finished.records = stage.records;
    if (spec.output.placement == Placement::stream) plan_->take(spec.name, 0, spec.items, *stage.records);
    artifacts_[artifact_id({}, spec)] = stage.records;
    return plan_->next(&finished);
  }

  std::unique_ptr<Plan> plan_;
  const DeviceStage& device_;
  std::function<std::size_t(std::size_t)> choose_;
  std::map<ArtifactId, std::shared_ptr<const Bytes>> artifacts_;
};

// The first lights represent the others.
inline worker::BatchResult first_lights(const PlannedStage& stage) {
  kernels::ClusterParameters p;
  std::memcpy(&p, stage.spec.parameters.data(), sizeof p);
  worker::BatchResult result;
  result.records.resize(stage.spec.items * stage.spec.output.record_bytes);
  const Bytes& lights = *stage.inputs.at("lights");
  const std::size_t clusters = std::size_t{p.clusters} * VPL_WORDS * 4;
  std::memcpy(result.records.data(), lights.data(), std::min(lights.size(), clusters));
  for (std::uint32_t i = 0; i < p.lights; ++i) {
    const std::uint32_t cluster = i % p.clusters;
    std::memcpy(result.records.data() + clusters + std::size_t{i} * 4, &cluster, 4);
  }
  return result;
}

// The first points represent the others; rows without a point have no cluster.
inline worker::BatchResult first_points(const PlannedStage& stage) {
  worker::BatchResult result;
  const Bytes& points = *stage.inputs.at("points");
  constexpr std::size_t row = POINT_WORDS * 4;
  for (std::uint64_t k = 0; k < stage.spec.items; ++k) {
    std::uint32_t triangle = GLEANER_NONE;
    if ((k + 1) * row <= points.size()) std::memcpy(&triangle, &points[k * row + POINT_TRIANGLE * 4], 4);
    result.counts.push_back(triangle != GLEANER_NONE);
    if (triangle != GLEANER_NONE)
      result.records.insert(result.records.end(), points.begin() + static_cast<std::ptrdiff_t>(k * row),
                            points.begin() + static_cast<std::ptrdiff_t>((k + 1) * row));
  }
  return result;
}

}  // namespace gleaner::coordinator
