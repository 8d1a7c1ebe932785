#pragma once
// What shading points by virtual point lights reads, made once for all batches of a stage.

#include "kernels/vpl_records.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

struct ShadeTables {
  cl::Buffer lights{};                  // the lights and, behind them, their clusters' members
  cl::Buffer boxes{};                   // LIGHT_BOX_WORDS for each 32 lights
  cl::Buffer grid{}, cells{}, seeds{};  // the point clusters, by place (worker/stages/cluster_grid.h)
  cl::Buffer bits{};                    // which lights each point cluster sees
  std::uint32_t width = 0;              // lights of a slice
  std::uint32_t row_words = 0;          // of a point cluster's bits

  std::size_t bytes() const;
};

// Throws Error::bad_input for inputs that are missing, of another size, or name what is not there.
ShadeTables make_shade_tables(const StageRun& run, const kernels::VplPointParameters& parameters);

}  // namespace gleaner::worker
