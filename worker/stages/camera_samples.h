#pragma once
// Stages whose items are chunks of a pixel's samples (kernels/path_records.h): camera rays in waves, shadow rays, and
// the sums that are an item's record. A method's stage adds what happens where the rays end.

#include <array>
#include <functional>
#include <memory>
#include <string>

#include "kernels/path_layout.h"
#include "kernels/path_records.h"
#include "worker/stages/stage.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {

// Throws Error::bad_input for parameters that are out of range, and for a batch that is not of the stage. `classes`: of
// light, PATH_CLASS_..., that the stage's filter may leave out.
void check_sample_parameters(const StageRun& run, const kernels::PathParameters& parameters,
                             std::uint32_t classes = PATH_CLASSES);

// Items that run together, and the buffers that their host threads share.
struct SamplePart {
  const Device& device;
  DeviceScene& scene;
  Program program;
  Program camera{};                // of kernels/camera_samples.cl; not used where there is a generator
  std::array<cl_uint, 2> media{};  // that camera rays begin in
  cl::Buffer parameters{}, items{}, slots{}, features{};
  bool listed = false;
  std::uint64_t first_item = 0;
  std::uint32_t item_count = 0, paths = 0;
  // The kernel that makes paths `first_path` to `first_path + count` at `base` of `paths`; empty: camera_generate. A
  // thread sets what other parameters it has.
  std::string generator{};
  std::uint32_t slot_count() const { return (paths + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK; }
};

// One host thread's wave of paths, from the camera to their ends.
class SampleThread : public HostThread {
 public:
  SampleThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index);
  virtual ~SampleThread() = default;

  void run(BatchResult&);

 protected:
  // The paths of the wave are at the end of their rays, `fresh` of them come from the camera. Adds what they find to
  // their slots, and moves those that go on to wave_.next_paths(). Returns how many these are.
  virtual std::uint32_t step(const RayRange& range, std::uint32_t fresh) = 0;

  // What every kernel gets that looks at the wave's hits: the scene, the stage's parameters, slot_count, counters.
  void set_arguments(Kernel& kernel);
  void launch(Kernel& kernel, std::uint32_t rays) { HostThread::launch(kernel, rays, wave_.capacity()); }
  // The wave of this turn: survivors, fresh_base, fresh_count, paths.
  void set_wave(Kernel& kernel, std::uint32_t fresh);
  // Traces the shadow rays, which stand where their paths stood, and adds what arrives to the paths' slots.
  void connect(RayRange range);

  const SamplePart& part_;
  PathWave wave_;
  cl::Buffer shadows_;
  Kernel generate_;

 private:
  void set_camera_arguments();
  std::uint32_t generate();
  void pass(std::uint32_t rays);

  unsigned shadow_rows_;
  bool transparent_;
  Kernel connect_;
};

// Makes the state of a host thread.
using MakeSampleThread =
    std::function<std::unique_ptr<SampleThread>(const SamplePart& part, WorkQueue& work, unsigned index)>;

// Runs a batch. `parameters` have been checked; `program` includes kernels/transport/shadow_rays.h.
BatchResult run_samples(const StageRun& run, const kernels::PathParameters& parameters, const Program& program,
                        const MakeSampleThread& make);

}  // namespace gleaner::worker
