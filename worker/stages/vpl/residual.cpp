#include "worker/stages/vpl/residual.h"

#include <algorithm>

#include "kernels/path_layout.h"
#include "worker/stages/vpl/waves.h"

namespace gleaner::worker {

ResidualSamples::ResidualSamples(const ShadeBatch& batch, const ShadedPoints& shaded, cl::CommandQueue& queue,
                                 RayQueries& queries, std::uint32_t capacity, const TakeBuffer& take)
    : device_(batch.run.device),
      queue_(queue),
      capacity_(capacity),
      most_((capacity + RAY_BLOCK) * MAX_RESIDUAL_SAMPLES),
      program_(batch.run.build("residual.cl", batch.fuzziness())),
      answers_(device_, program_, queue, queries,
               take("rays", std::size_t{ray_capacity(device_)} * VISIBILITY_ROWS * 4)),
      select_(device_, program_, "vpl_residual_select"),
      make_rays_(device_, program_, "vpl_residual_rays"),
      apply_(device_, program_, "vpl_residual_apply"),
      selected_(take("residual.selected", (std::size_t{most_} + 1) * 4)),
      terms_(take("residual.terms", (std::size_t{most_} + 1) * 12)),
      spacings_(take("residual.spacings", std::size_t{capacity + RAY_BLOCK} * 4)),
      counts_(take("residual.counts", std::size_t{capacity + RAY_BLOCK} * 4)),
      firsts_(take("residual.firsts", std::size_t{capacity + RAY_BLOCK} * 4)),
      places_(take("residual.places", std::size_t{most_} * 4)),
      bits_(take("residual.bits", most_ / 8)) {
  set_arguments(batch, shaded);
}

void ResidualSamples::set_arguments(const ShadeBatch& batch, const ShadedPoints& shaded) {
  const ShadeTables& tables = *batch.tables;
  select_.set("parameters", batch.parameters)
      .set("points", shaded.points)
      .set("lights", tables.lights)
      .set("boxes", tables.boxes)
      .set("width", tables.width)
      .set("slices", batch.p.samples)
      .set("bits", tables.bits)
      .set("row_words", tables.row_words)
      .set("rows", shaded.rows)
      .set("weights", shaded.weights)
      .set("level", shaded.level)
      .set("selected", selected_)
      .set("behind", most_)
      .set("counts", counts_)
      .set("spacings", spacings_);
  batch.run.scene.set_arguments(make_rays_);
  make_rays_.set("parameters", batch.parameters)
      .set("points", shaded.points)
      .set("lights", tables.lights)
      .set("places", places_)
      .set("selected", selected_)
      .set("spacings", spacings_)
      .set("rays", answers_.rays())
      .set("terms", terms_)
      .set("lobes", shaded.lobes);
  apply_.set("firsts", firsts_)
      .set("counts", counts_)
      .set("selected", selected_)
      .set("terms", terms_)
      .set("answers", bits_)
      .set("lights", tables.lights)
      .set("clusters", batch.p.clusters)
      .set("bits", tables.bits)
      .set("row_words", tables.row_words)
      .set("rows", shaded.rows)
      .set("weights", shaded.weights)
      .set("radiance", shaded.radiance)
      .set("sampled", shaded.sampled);
}

std::uint64_t ResidualSamples::correct(std::uint32_t paths) {
  select_.set("count", paths);
  select_.launch(queue_, {.work = paths, .capacity = capacity_, .per_item = device_.lanes()});
  std::vector<std::uint32_t> counts(paths), firsts(paths), places;
  queue_.enqueueReadBuffer(counts_, CL_TRUE, 0, std::size_t{paths} * 4, counts.data());
  for (std::uint32_t i = 0; i < paths; ++i) {
    firsts[i] = static_cast<std::uint32_t>(places.size());
    for (std::uint32_t k = 0; k < counts[i]; ++k) places.push_back(i * MAX_RESIDUAL_SAMPLES + k);
  }
  if (places.empty()) return 0;
  queue_.enqueueWriteBuffer(firsts_, CL_TRUE, 0, firsts.size() * 4, firsts.data());
  queue_.enqueueWriteBuffer(places_, CL_TRUE, 0, places.size() * 4, places.data());
  const std::uint32_t capacity = ray_capacity(device_);
  for (std::size_t base = 0; base < places.size(); base += capacity) {
    const auto count = static_cast<std::uint32_t>(std::min<std::size_t>(capacity, places.size() - base));
    make_rays_.set("base", static_cast<cl_uint>(base)).set("count", count);
    make_rays_.launch(queue_, {.work = count, .capacity = capacity, .per_item = device_.lanes()});
    // One by one: which rays are neighbours depends on the batch.
    answers_.answer(single_rays(VISIBILITY_ROWS, count), count, base, bits_);
  }
  apply_.set("count", paths);
  apply_.launch(queue_, {.work = paths, .capacity = capacity_});
  queue_.finish();
  return places.size();
}

}  // namespace gleaner::worker
