#pragma once
// Paths that move in step, in two buffers that take turns: a kernel reads the paths of one and packs those that go on
// to the front of the other (compaction); new paths fill the room behind them.

#include "kernels/rays.h"
#include "worker/device/opencl.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {

class PathWave {
 public:
  // Room for `capacity` paths of `rows` rows, and one block more: lanes that ended write behind the wave.
  static std::size_t bytes(std::uint32_t capacity, unsigned rows) {
    return (std::size_t{capacity} / RAY_BLOCK + 1) * RAY_BLOCK * rows * 4;
  }

  PathWave(cl::Buffer first, cl::Buffer second, std::uint32_t capacity, unsigned rows)
      : buffers_{std::move(first), std::move(second)}, capacity_(capacity), rows_(rows) {}

  std::uint32_t capacity() const { return capacity_; }
  std::uint32_t survivors() const { return survivors_; }
  // Where new paths begin: a whole block of 16 neighbours each.
  std::uint32_t fresh_base() const { return (survivors_ + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK; }
  std::uint32_t room() const { return capacity_ - fresh_base(); }

  cl::Buffer& paths() { return buffers_[current_]; }
  cl::Buffer& next_paths() { return buffers_[1 - current_]; }
  // The wave's rays, with `fresh` new ones as packets. Survivors stand in no order.
  RayRange rays(std::uint32_t fresh) const {
    return {.rows = rows_, .incoherent = survivors_, .coherent_base = fresh_base(), .coherent_count = fresh};
  }
  // The other buffer holds `survivors` paths now.
  void advance(std::uint32_t survivors) {
    survivors_ = survivors;
    current_ = 1 - current_;
  }

 private:
  cl::Buffer buffers_[2];
  std::uint32_t capacity_;
  unsigned rows_;
  std::uint32_t survivors_ = 0;
  int current_ = 0;
};

}  // namespace gleaner::worker
