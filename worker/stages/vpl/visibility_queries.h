#pragma once
// Visibility queries of one host thread: rays between points and lights, answered as bits.

#include <optional>

#include "worker/stages/stage.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {

// Traces rays that some kernel wrote and packs their answers.
class VisibilityAnswers {
 public:
  // `program`: any that includes kernels/transport/visibility.h. `rays`: room for ray_capacity() of them.
  VisibilityAnswers(const Device& device, const Program& program, cl::CommandQueue& queue, RayQueries& queries,
                    cl::Buffer rays);

  const cl::Buffer& rays() const { return rays_; }
  // `range`'s `count` rays; bit k of `bits`, from bit `first` (a multiple of 32) on, is whether ray k arrives.
  void answer(const RayRange& range, std::uint32_t count, std::uint64_t first, const cl::Buffer& bits);

 private:
  const Device& device_;
  cl::CommandQueue& queue_;
  RayQueries& queries_;
  cl::Buffer rays_;
  Kernel pack_;
};

// Points, some at a time, query rows of lights (kernels/vpl/visibility.cl).
class VisibilityQueries {
 public:
  // Each point queries `width` lights, of one of `slices` slices.
  VisibilityQueries(const StageRun& run, cl::CommandQueue& queue, RayQueries& queries, cl::Buffer rays,
                    cl::Buffer counters, const cl::Buffer& lights, std::uint32_t width, std::uint32_t slices);

  struct Query {
    const cl::Buffer& points;
    const cl::Buffer* chosen;  // rows of `points`; null: point_base and the rows behind it
    std::uint32_t point_base = 0;
    std::uint32_t rows = 0;      // points that query
    const cl::Buffer& cutoff;    // a float a row: what a light must be able to contribute
    float clamp = 0;             // bound of the geometry term
    const cl::Buffer& bits;      // answers: width / 32 words a row
    const cl::Buffer& left_out;  // answers: VISIBILITY_COUNTS words a row: pairs that were not queried
  };
  // Returns how many rays were traced.
  std::uint64_t run(const Query& query);

 private:
  const Device& device_;
  cl::CommandQueue& queue_;
  std::uint32_t width_;
  cl::Buffer counters_;
  Kernel make_rays_;
  VisibilityAnswers answers_;
};

}  // namespace gleaner::worker
