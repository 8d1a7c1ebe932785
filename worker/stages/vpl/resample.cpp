// Light paths leave VPLs of very unequal flux, and one of little flux costs as much as a bright one. So VPLs are drawn
// again in equal parts: a VPL's expected number of copies is its share of the flux (systematic resampling).

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/order.h"
#include "worker/stages/vpl/host_stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

using kernels::VplResampleFacts;
using kernels::VplResampleParameters;

constexpr double kPi = 3.14159265358979;
// Lights whose nearest neighbour is looked for.
constexpr std::size_t kDensityLights = 256;

double luminance(const float* c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }

// All that a light's row says of how bright it is.
void scale_flux(float* row, double by) {
  for (unsigned k = 0; k < 3; ++k) {
    row[VPL_FLUX + k] = static_cast<float>(row[VPL_FLUX + k] * by);
    row[VPL_SENT + k] = static_cast<float>(row[VPL_SENT + k] * by);
  }
}

// What light paths made: rows of some flux, and by which weight each is drawn.
struct Made {
  std::vector<float> rows;
  std::vector<double> weight;
  double total = 0;
};

Made lights_of(std::vector<float> records, double paths) {
  Made made;
  for (std::size_t at = 0; at < records.size(); at += VPL_WORDS) {
    float* row = &records[at];
    scale_flux(row, 1 / paths);
    const double sum = double{row[VPL_FLUX]} + row[VPL_FLUX + 1] + row[VPL_FLUX + 2];
    if (!(sum > 0)) continue;
    if (!std::isfinite(sum))
      throw Error::bad_input("stage vpl_resample", "input paths[" + std::to_string(at / VPL_WORDS) + "]",
                             "a finite flux", std::to_string(sum));
    made.weight.push_back(std::max(luminance(&row[VPL_FLUX]), 1e-3 * sum));
    made.total += made.weight.back();
    made.rows.insert(made.rows.end(), row, row + VPL_WORDS);
  }
  return made;
}

// In [0, 1): the systematic resampling's offset, another one for each pass.
double offset_of(const VplResampleParameters& p) {
  const std::uint64_t seed = (std::uint64_t{p.seed_high} << 32) | p.seed_low;
  return scene::unit_hash(seed + 0x9e3779b97f4a7c15ull * (std::uint64_t{p.pass} + 1));
}

std::vector<float> resample(const Made& made, const VplResampleParameters& p) {
  if (made.weight.size() <= p.count) return made.rows;
  std::vector<float> rows;
  const double part = made.total / p.count;
  double aim = part * offset_of(p), sum = 0;
  for (std::size_t i = 0; i < made.weight.size(); ++i) {
    sum += made.weight[i];
    std::uint32_t times = 0;
    // More copies than there are parts would be rounding's fault.
    while (aim < sum && times < p.count) {
      ++times;
      aim += part;
    }
    if (!times) continue;
    const std::size_t at = rows.size();
    const auto row = made.rows.begin() + static_cast<std::ptrdiff_t>(i * VPL_WORDS);
    rows.insert(rows.end(), row, row + VPL_WORDS);
    scale_flux(&rows[at], times * part / made.weight[i]);
  }
  return rows;
}

// Lights a square metre where lights are: from how far a light's nearest neighbour is, of some of the lights. For
// points strewn over a surface with density rho, the median of pi rho r^2 is log 2.
double density_of(const std::vector<float>& rows) {
  const std::size_t count = rows.size() / VPL_WORDS;
  if (count < 2) return 0;
  std::vector<double> nearest;
  const std::size_t step = std::max<std::size_t>(1, count / kDensityLights);
  for (std::size_t i = 0; i < count; i += step) {
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t j = 0; j < count; ++j) {
      if (i == j) continue;
      double d2 = 0;
      for (unsigned k = 0; k < 3; ++k) {
        const double d = double{rows[i * VPL_WORDS + k]} - rows[j * VPL_WORDS + k];
        d2 += d * d;
      }
      if (d2 > 0) best = std::min(best, d2);
    }
    if (std::isfinite(best)) nearest.push_back(best);
  }
  if (nearest.empty()) return 0;
  std::ranges::nth_element(nearest, nearest.begin() + static_cast<std::ptrdiff_t>(nearest.size() / 2));
  return std::log(2.0) / (kPi * nearest[nearest.size() / 2]);
}

}  // namespace

BatchResult resample_lights(const StageTask& task) {
  const auto p = host_parameters<VplResampleParameters>(task);
  if (p.paths == 0 || p.count == 0)
    throw Error::bad_input("stage vpl_resample", "paths, count", "1 or more of both", "none");
  const Made made = lights_of(input_rows(task, "paths", VPL_WORDS), p.paths);
  const std::vector<float> rows = resample(made, p);
  BatchResult result = counted_rows(rows, VPL_WORDS);
  set_facts(result, VplResampleFacts{made.weight.size(), rows.size() / VPL_WORDS, density_of(rows)});
  return result;
}

}  // namespace gleaner::worker
