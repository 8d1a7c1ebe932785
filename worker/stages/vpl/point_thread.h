#pragma once
// Camera paths to the points that virtual point lights are to light (kernels/vpl/points.cl).

#include "kernels/vpl_records.h"
#include "worker/stages/stage.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {

// Throws Error::bad_input for a film, samples, items or a bound that are out of range.
kernels::VplPointParameters read_point_parameters(const StageRun& run);

class PointThread : public HostThread {
 public:
  // `by_point`: an item is a point of the pixel item * stride; else a pixel, with a path for each of its samples, and
  // the points' lobes are kept beside them.
  PointThread(const StageRun& run, const cl::Buffer& parameters, WorkQueue& work, unsigned index, bool by_point);

  // Points as the batch's records.
  void run(BatchResult& result);

 protected:
  // The points of `count` paths; the first is that of the batch's item `first`.
  void find_points(std::uint64_t first, std::uint32_t count);

  std::uint64_t first_item_;
  std::uint32_t capacity_;
  unsigned path_rows_;
  cl::Buffer paths_, points_, lobes_;

 private:
  Kernel camera_rays_, step_;
};

}  // namespace gleaner::worker
