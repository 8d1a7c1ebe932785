#pragma once
// Tests' way to a whole frame of any method: its plan on one executor, with what each stage was asked for and answered.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "kernels/splat_records.h"
#include "scene/model/error.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {

using coordinator::Film;
using Settings = std::map<std::string, std::string>;  // --set

struct Frame {
  std::shared_ptr<const Scene> scene;
  coordinator::FrameSettings settings;
  worker::TraceKind trace = worker::TraceKind::automatic;
};

// A square picture by the camera of that name, else by the scene's first.
inline Frame square_frame(const std::string& method, Scene scene, const std::string& camera, std::uint32_t size,
                          std::uint32_t spp, const Settings& set) {
  Frame frame;
  frame.scene = std::make_shared<const Scene>(std::move(scene));
  frame.settings.method = method;
  frame.settings.width = frame.settings.height = size;
  frame.settings.spp = spp;
  frame.settings.set = set;
  frame.settings.camera = camera_of(*frame.scene, camera);
  frame.settings.camera.half_width = frame.settings.camera.half_height;
  return frame;
}

struct Rendered {
  Film film;
  nlohmann::json parameters;                           // that the plan settled on
  std::map<std::string, worker::BatchResult> results;  // by stage
  std::map<std::string, worker::StageTask> tasks;
  std::map<std::string, coordinator::StageSpec> specs;

  // A stage's records as numbers.
  std::vector<float> floats(const std::string& stage) const {
    const scene::Bytes& records = results.at(stage).records;
    std::vector<float> values(records.size() / 4);
    std::memcpy(values.data(), records.data(), records.size());
    return values;
  }
};

// Of a look at some of the records of a cache, 256 of them: they stand at places that are spread evenly over all.
// `words`: of a row of the places, which begins with the position. Returns how many places there are.
inline std::size_t expect_spread_look(const std::vector<float>& looked, const std::vector<float>& places,
                                      std::size_t words) {
  const std::size_t count = looked.size() / CACHE_WORDS, all = places.size() / words;
  EXPECT_EQ(count, 256u);
  EXPECT_GE(all, 2 * count) << "nothing is left out";
  if (count == 0 || all < count) return all;
  const std::size_t stride = all / count;
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t k = 0; k < 3; ++k)
      EXPECT_EQ(looked[i * CACHE_WORDS + CACHE_POSITION + k], places[i * stride * words + k]) << i;
  return all;
}

// No stage may leave out samples that are not finite.
inline Rendered render(const Frame& frame) {
  worker::Executor& on = executor(frame.trace);
  const std::string id = load(on, frame.scene);
  auto plan = coordinator::make_plan(frame.settings, coordinator::summarize(*frame.scene));
  Rendered made;
  cli::run_frame(
      *plan, on, id,
      [&](const auto& stage, const worker::StageTask& task) {
        made.tasks[stage.name] = task;
        made.specs[stage.name] = stage;
        return true;
      },
      [&](const auto& stage, const worker::BatchResult& result) {
        EXPECT_EQ(result.counters.nonfinite, 0u) << stage.name;
        made.results[stage.name] = result;
      });
  made.film = plan->film();
  made.parameters = nlohmann::json::parse(plan->parameters_json());
  return made;
}

inline double mean_of(const Film& film, const std::string& channel) {
  const auto* found = film.find(channel);
  if (!found) throw Error::failed("no channel " + channel);
  return std::accumulate(found->values.begin(), found->values.end(), 0.0) / static_cast<double>(found->values.size());
}

// How far means over blocks of so many pixels an edge are off, root mean square over the truth's mean, in these
// channels.
inline double block_error(const Film& film, const Film& truth, const std::vector<std::string>& channels,
                          std::uint32_t block) {
  double square = 0, sum = 0, count = 0;
  for (const std::string& channel : channels) {
    const auto &found = film.find(channel)->values, &expected = truth.find(channel)->values;
    for (std::uint32_t y = 0; y < film.height; y += block)
      for (std::uint32_t x = 0; x < film.width; x += block, ++count) {
        double off = 0, light = 0;
        for (std::size_t i = 0; i < std::size_t{block} * block; ++i) {
          const std::size_t at = (y + i / block) * film.width + x + i % block;
          off += double{found[at]} - expected[at];
          light += double{expected[at]};
        }
        square += off * off;
        sum += light;
      }
  }
  return std::sqrt(square / count) / (sum / count);
}

// Of pictures of seeds 1 to `seeds`, by channel.
inline std::map<std::string, Sample> means_of(Frame frame, const std::vector<std::string>& channels, unsigned seeds) {
  std::map<std::string, Sample> samples;
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    frame.settings.seed = seed;
    const Rendered made = render(frame);
    for (const std::string& channel : channels) samples[channel].add(mean_of(made.film, channel));
  }
  return samples;
}

inline Sample means_of(const Frame& frame, const char* channel, unsigned seeds) {
  return means_of(frame, std::vector<std::string>{channel}, seeds)[channel];
}

// Two estimates of one mean, which may differ by so large a share of it beside their noise, and are not too noisy to
// prove anything.
inline void expect_means_meet(const Sample& sample, const Sample& truth, const std::string& what, double share) {
  const double error = std::hypot(truth.standard_error(), sample.standard_error());
  std::printf("  %s: %.5f +- %.5f, reference %.5f +- %.5f\n", what.c_str(), sample.mean, sample.standard_error(),
              truth.mean, truth.standard_error());
  EXPECT_LT(std::abs(sample.mean - truth.mean), 4 * error + share * truth.mean) << what;
  EXPECT_LT(error, 0.01 * truth.mean) << what << ": too noisy to prove anything";
}

}  // namespace gleaner::test
