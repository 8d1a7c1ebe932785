#pragma once
// Paths that read a photon map behind their first surface (kernels/photon/read.h).

#include "kernels/photon_records.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/photon/map_table.h"

namespace gleaner::worker {

// Throws Error::bad_input for a filter or a spacing (PathParameters::clamp) that such paths cannot have.
void check_photon_gather(const StageRun& run, const kernels::PathParameters& parameters);

class PhotonGatherThread : public PathThread {
 public:
  PhotonGatherThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index,
                     const kernels::PhotonEstimate& estimate, const PhotonMapTable& map, const PhotonCutTable& cut)
      : PathThread(part, workspace, work, index),
        reads_(take("reads", std::size_t{wave_.capacity()} * READ_WORDS * 4)),
        read_(part.device, part.program, "photon_read") {
    shade_.set("reads", reads_);
    part.scene.set_arguments(read_);
    map.set_arguments(read_, "map");
    cut.set_arguments(read_);
    read_.set("reads", reads_)
        .set("neighbours", estimate.neighbours)
        .set("most_radius", estimate.most_radius)
        .set("slots", part.slots)
        .set("slot_count", part.slot_count());
  }

 protected:
  std::uint32_t step(const RayRange& range, std::uint32_t fresh) override {
    const std::uint32_t alive = PathThread::step(range, fresh);
    read_.set("count", range.end());
    HostThread::launch(read_, range.end(), wave_.capacity(), 1);
    return alive;
  }

 private:
  cl::Buffer reads_;
  Kernel read_;
};

}  // namespace gleaner::worker
