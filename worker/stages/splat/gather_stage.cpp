// Stage kinds "splat_gather" and "splat_lobe_gather": the light that arrives at records (kernels/splat/gather.cl,
// lobe_gather.cl).

#include "scene/model/error.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/splat/hessian.h"
#include "worker/stages/splat/radiance.h"
#include "worker/stages/splat/record_gather.h"
#include "worker/stages/splat/stages.h"

namespace gleaner::worker {
namespace {

BatchResult gather(const StageRun& run, const kernels::SplatGatherParameters& p, const char* file,
                   const RecordMaker& maker) {
  check_record_parameters(run, p);
  if (p.samples.filter != PATH_CLASS_IRRADIANCE)
    throw Error::bad_input(run.where(), "filter", std::to_string(PATH_CLASS_IRRADIANCE),
                           std::to_string(p.samples.filter));
  return gather_records(
      run, p, run.build(file),
      [&](const PlaceTable& places, const SamplePart& part, WorkQueue& work, unsigned index) {
        return std::make_unique<RecordThread<PathThread>>(places, part, run.workspace, work, index);
      },
      maker);
}

}  // namespace

void check_splat_order(const StageRun& run, std::uint32_t order) {
  if (order == 0 || order > SPLAT_MOST_ORDER)
    throw Error::bad_input(run.where(), "order", "1 to " + std::to_string(SPLAT_MOST_ORDER), std::to_string(order));
}

BatchResult run_splat_gather_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::SplatGatherParameters>();
  if (!p.hessian) return gather(run, p, "gather.cl", record_maker<SplatPlace>(cache_record));
  check_record_parameters(run, p);
  const IrradianceHessian hessian({p.polar, p.azimuthal});
  return gather(run, p, "gather.cl", record_maker<SplatPlace>([&](const auto& place, const auto& grid, auto samples) {
                  CacheRecord record = cache_record(place, grid, samples);
                  const TangentMatrix bends = hessian.relative(samples);
                  for (std::size_t k = 0; k < bends.size(); ++k) record.hessian[k] = static_cast<float>(bends[k]);
                  return record;
                }));
}

BatchResult run_splat_lobe_gather_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::SplatLobeGatherParameters>();
  check_splat_order(run, p.order);
  const std::size_t words = RADIANCE_WORDS(p.order);
  return gather(run, p.records, "lobe_gather.cl",
                {words * 4, sizeof(SplatPlace), [&](const auto& place, const auto& grid, auto samples, std::byte* to) {
                   make_radiance_record(place, grid, samples, p.order, {reinterpret_cast<float*>(to), words});
                 }});
}

}  // namespace gleaner::worker
