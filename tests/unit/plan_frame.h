#pragma once
// A frame whose worker is arithmetic: every sample is a number drawn from a known distribution, so that the plan's
// promises can be held against the truth.

#include <cmath>
#include <cstring>
#include <functional>
#include <vector>

#include "coordinator/plan/plan.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"

namespace gleaner::coordinator {

// splitmix64's mixing function.
inline std::uint64_t mixed(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15ull;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}
inline double unit(std::uint64_t key) { return static_cast<double>(mixed(key) >> 11) * 0x1p-53 + 0x1p-54; }

// A sample's radiance in one channel, from a uniform number; its mean over [0, 1] is the pixel's truth.
struct Truth {
  std::vector<double> mean;  // a pixel; the channels have 1, 1/2 and 1/4 of it
  std::function<double(std::uint32_t pixel, double u)> sample;
  static constexpr double tint[3] = {1, 0.5, 0.25};
};

struct StageRun {
  StageSpec spec;
  std::vector<kernels::PathItem> items;
};

class PlannedFrame {
 public:
  PlannedFrame(const FrameSettings& settings, const Truth& truth) : truth_(truth), plan_(make_plan(settings, {})) {
    seed_ = mixed(settings.seed);
  }

  // Runs the frame to its end.
  void run() {
    Step step = next(nullptr);
    while (!step.done) {
      FinishedStage finished = finish(step);
      step = next(&finished);
    }
  }

  // The plan's next step that asks for a stage, or ends the frame.
  Step next(const FinishedStage* finished) {
    Step step = plan_->next(finished);
    while (step.again) {
      EXPECT_TRUE(step.stages.empty());
      step = plan_->next(nullptr);
    }
    return step;
  }

  // The records of the one stage that a step asks for.
  FinishedStage finish(const Step& step) {
    StageRun run{step.stages.at(0), {}};
    kernels::PathParameters p;
    std::memcpy(&p, run.spec.parameters.data(), sizeof p);
    const Bytes* list = nullptr;
    if (!run.spec.inputs.empty()) list = step.artifacts.at(run.spec.inputs[0].artifact).get();
    const std::uint32_t pixels = p.width * p.height;
    auto records = std::make_shared<Bytes>(run.spec.items * run.spec.output.record_bytes);
    for (std::uint64_t i = 0; i < run.spec.items; ++i) {
      kernels::PathItem item{static_cast<std::uint32_t>(i % pixels), static_cast<std::uint32_t>(i / pixels)};
      if (list) std::memcpy(&item, list->data() + i * sizeof item, sizeof item);
      run.items.push_back(item);
      const std::uint32_t samples = i + 1 == run.spec.items ? p.last_item_samples : p.samples_per_item;
      samples_ += samples;
      kernels::PathFeatureRecord record{};
      for (std::uint32_t s = 0; s < samples; ++s) {
        const std::uint64_t key = mixed(mixed(seed_ ^ item.pixel) ^ (std::uint64_t{item.chunk} << 16 | s));
        const double value = truth_.sample(item.pixel, unit(key));
        for (int k = 0; k < 3; ++k) {
          record.direct[k] += static_cast<float>(0.75 * value * Truth::tint[k]);
          record.indirect[k] += static_cast<float>(0.25 * value * Truth::tint[k]);
        }
        record.hits += 1;
      }
      std::memcpy(records->data() + i * run.spec.output.record_bytes, &record, run.spec.output.record_bytes);
    }
    runs_.push_back(run);
    return {runs_.back().spec.name, records};
  }

  Plan& plan() { return *plan_; }
  const std::vector<StageRun>& runs() const { return runs_; }
  std::uint64_t samples() const { return samples_; }

 private:
  const Truth& truth_;
  std::unique_ptr<Plan> plan_;
  std::uint64_t seed_ = 0, samples_ = 0;
  std::vector<StageRun> runs_;
};

}  // namespace gleaner::coordinator
