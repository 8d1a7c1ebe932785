#pragma once
// One host thread whose kernel asks for light samples (kernels/links/light_sample.h): their shadow rays, and the slots
// that they add to.

#include "worker/stages/stage.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {

class ConnectingThread : public HostThread {
 public:
  // `program` includes kernels/transport/shadow_rays.h; a wave asks for `capacity` samples at most.
  ConnectingThread(const StageRun& run, const Program& program, std::uint32_t capacity, WorkQueue& work,
                   unsigned index);

 protected:
  const cl::Buffer& shadows() const { return shadows_; }
  const cl::Buffer& slots() const { return slots_; }  // PLAIN_SLOT_WORDS a sample
  // The first `count` samples, of which the device counter says how many are asked for. Those that arrive are added to
  // their slots.
  void connect(std::uint32_t count);

 private:
  unsigned shadow_rows_;
  bool transparent_;
  std::uint32_t samples_;  // of a wave
  cl::Buffer shadows_, slots_;
  Kernel connect_;
};

}  // namespace gleaner::worker
