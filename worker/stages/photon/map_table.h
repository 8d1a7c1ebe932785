#pragma once
// A photon map (kernels/photon_records.h) on a device.

#include <memory>
#include <string>

#include "kernels/photon_records.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

struct PhotonMapTable {
  cl::Buffer rows;
  std::uint32_t nodes = 0;
  std::size_t size = 0;
  std::size_t bytes() const { return size; }
  // The parameters `NAME` and `NAME_nodes` of a kernel.
  void set_arguments(Kernel& kernel, const std::string& name) const;
};

// The task's input of this name, checked: what kernels look up by it is there. It is kept for other stages that read
// it. Throws Error::bad_input.
std::shared_ptr<const PhotonMapTable> photon_map_table(const StageRun& run, const std::string& input);

// An illumination cut on a device; without blocks: there is none.
struct PhotonCutTable {
  cl::Buffer rows;
  std::uint32_t blocks = 0, most_depth = 0;
  std::size_t size = 0;
  std::size_t bytes() const { return size; }
  // The parameters `cut`, `cut_blocks` and `cut_depth` of a kernel.
  void set_arguments(Kernel& kernel) const;
};

// The task's input "cut", checked, where it has one. Throws Error::bad_input.
PhotonCutTable photon_cut_table(const StageRun& run, std::uint32_t most_depth);

// Throws Error::bad_input for a density estimate that is out of range.
void check_photon_estimate(const StageRun& run, const kernels::PhotonEstimate& estimate);

}  // namespace gleaner::worker
