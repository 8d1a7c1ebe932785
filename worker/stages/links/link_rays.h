#pragma once
// One host thread's rays of elements (kernels/links/rays.h).

#include "worker/stages/links/mesh.h"
#include "worker/stages/links/waves.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {

// What a batch's threads share.
struct LinkRayBatch {
  const StageRun& run;
  kernels::LinksParameters p;
  MeshTables tables;
  LobeTables lobes;
  Program program;     // includes kernels/links/rays.h
  cl::Buffer sides{};  // element_sides(); where nobody reads them, any buffer
  cl::Buffer parameters{};
};

class LinkRayThread : public HostThread {
 public:
  LinkRayThread(const LinkRayBatch& batch, WorkQueue& work, unsigned index);

 protected:
  std::uint32_t rays() const { return capacity_ * directions_; }  // of a wave
  // Traces the rays of `count` elements, of which the first is the batch's `first`. Returns how many they are.
  std::uint32_t trace(std::uint64_t first, std::uint32_t count);

  std::uint64_t first_item_;
  std::uint32_t directions_, capacity_;  // elements of a wave
  cl::Buffer hits_;

 private:
  Kernel make_rays_;
};

}  // namespace gleaner::worker
