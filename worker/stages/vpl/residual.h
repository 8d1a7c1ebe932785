#pragma once
// Residual samples of one host thread: lights that points query themselves, so that their light does not depend on
// their clusters alone (kernels/vpl/residual.cl).

#include "worker/stages/vpl/shade_tables.h"
#include "worker/stages/vpl/visibility_queries.h"

namespace gleaner::worker {

// A shading batch, as its host threads read it.
struct ShadeBatch {
  const StageRun& run;
  kernels::VplPointParameters p;
  std::shared_ptr<const ShadeTables> tables;
  cl::Buffer parameters{};

  // The variant of programs that know how many clusters a point belongs to.
  std::string fuzziness() const { return " -D FUZZINESS=" + std::to_string(p.point_clusters ? p.fuzziness : 1); }
};

// What shading holds of a wave's points, by row.
struct ShadedPoints {
  cl::Buffer points{}, lobes{};
  cl::Buffer rows{}, weights{};  // of the point clusters that each belongs to
  cl::Buffer level{};            // of its light
  cl::Buffer radiance{}, sampled{};
};

class ResidualSamples {
 public:
  // `capacity`: points of a wave at most.
  ResidualSamples(const ShadeBatch& batch, const ShadedPoints& shaded, cl::CommandQueue& queue, RayQueries& queries,
                  std::uint32_t capacity, const TakeBuffer& take);

  // Selects lights for `paths` points, queries them and corrects the points' radiance. Returns the rays traced.
  std::uint64_t correct(std::uint32_t paths);

 private:
  void set_arguments(const ShadeBatch& batch, const ShadedPoints& shaded);

  const Device& device_;
  cl::CommandQueue& queue_;
  std::uint32_t capacity_, most_;
  Program program_;
  VisibilityAnswers answers_;
  Kernel select_, make_rays_, apply_;
  cl::Buffer selected_, terms_, spacings_, counts_, firsts_, places_, bits_;
};

}  // namespace gleaner::worker
