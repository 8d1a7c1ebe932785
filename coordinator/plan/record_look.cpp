#include "coordinator/plan/record_look.h"

#include <cmath>

#include "coordinator/plan/cache_noise.h"

namespace gleaner::coordinator {
namespace {

// So many records, of so many rays, tell how noisy all are; not where they would be more than a part of all rays.
constexpr std::uint32_t kRecords = 256, kRays = 64;
constexpr double kMostOfRays = 1.0 / 16;

}  // namespace

std::optional<RecordLook> RecordLook::at(std::uint64_t records, std::uint32_t rays) {
  const double share = double{kRecords} * kRays / (static_cast<double>(records) * rays);
  if (records < kRecords || !(share < kMostOfRays)) return std::nullopt;
  return RecordLook{.records = kRecords, .stride = low(records / kRecords), .strata = strata_of(kRays)};
}

kernels::SplatGatherParameters RecordLook::parameters(kernels::SplatGatherParameters all, std::uint64_t first) const {
  all.records = records;
  all.polar = strata.polar;
  all.azimuthal = strata.azimuthal;
  all.first_place = low(first);
  all.place_stride = stride;
  return all;
}

StageSpec RecordLook::stage(const std::string& name, const char* kind, int priority) const {
  StageSpec spec = PixelCache::gathering(name, kind, priority, records, strata);
  spec.output.placement = Placement::collect;
  return spec;
}

double RecordLook::noise_of(const Graph::Artifact& looked, double albedo, std::uint32_t word) const {
  const double noise = ray_noise(float_view(looked.records()), strata.count(), albedo, word);
  looked.check_facts(noise >= 0 && std::isfinite(noise), "a noise of " + std::to_string(noise));
  return noise;
}

}  // namespace gleaner::coordinator
