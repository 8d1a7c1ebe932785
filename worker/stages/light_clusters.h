#pragma once
// The tables from which kernels choose lights (kernels/lights.h).

#include <cstdint>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::worker {

struct LightTables {
  std::vector<float> emitters;  // rows of EMITTER_WORDS, sorted by cluster
  std::vector<float> clusters;  // cluster_slots rows of CLUSTER_WORDS, then one word: the search's first step
  std::vector<std::uint32_t> triangle_emitter;  // triangle -> row of `emitters`, or GLEANER_NONE
  unsigned cluster_slots = 0;  // 1, 4, 8, 16, 32 or 64 (few kernel variants); unused ones have power 0; 0 = no light
  // From which light paths choose their light: EMISSION_HEADER words, then the cumulated share of each row of
  // `emitters` in the scene's light (W), and, last, the environment's. Empty where nothing shines. DeviceScene adds
  // what the lights stand in.
  std::vector<float> emission;
};

// Groups emitters of one kind and as many sides into at most MAX_CLUSTERS clusters, splitting where power times extent
// is largest. Emitters without power are left out: light sampling never asks for them.
// `environment_power`: of the scene's environment.
LightTables make_light_tables(const scene::Scene& scene, double environment_power);

struct EnvironmentTable {
  std::vector<float> rows;  // header, texels, cumulated densities (kernels/scene_layout.h)
  double power = 0;         // the irradiance of one side, as the emitters' powers
};
EnvironmentTable make_environment_table(const scene::Environment& environment);

}  // namespace gleaner::worker
