// Light paths leave VPLs of very unequal flux, and one of little flux costs as much as a bright one. So VPLs are drawn
// again in equal parts: a VPL's expected number of copies is its share of the flux (systematic resampling).

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/order.h"
#include "worker/stages/vpl/host_stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

using kernels::VplResampleFacts;
using kernels::VplResampleParameters;

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
  std::size_t to = 0;
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
    if (to != at) std::copy_n(row, VPL_WORDS, &records[to]);
    to += VPL_WORDS;
  }
  records.resize(to);
  made.rows = std::move(records);
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

// Places of lights, side by side: rows are a hundred bytes apart. Padded with copies of the last light.
struct Places {
  static constexpr std::size_t width = 8;
  std::size_t count = 0;
  std::vector<double> x, y, z;

  explicit Places(const std::vector<float>& rows) : count(rows.size() / VPL_WORDS) {
    for (std::size_t i = 0; i < (count + width - 1) / width * width; ++i) {
      const float* row = &rows[std::min(i, count - 1) * VPL_WORDS];
      x.push_back(row[0]), y.push_back(row[1]), z.push_back(row[2]);
    }
  }

  // Squared distance from light `i` to the nearest light at another place; infinity where there is none.
  double nearest_to(std::size_t i) const {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    const double px = x[i], py = y[i], pz = z[i];
    std::array<double, width> best;
    best.fill(infinity);
    for (std::size_t at = 0; at < x.size(); at += width)
      for (std::size_t k = 0; k < width; ++k) {
        const double dx = px - x[at + k], dy = py - y[at + k], dz = pz - z[at + k];
        const double d2 = dx * dx + dy * dy + dz * dz, other = d2 > 0 ? d2 : infinity;
        best[k] = other < best[k] ? other : best[k];
      }
    return *std::ranges::min_element(best);
  }
};

// Lights a square metre where lights are: from how far a light's nearest neighbour is, of some of the lights. For
// points strewn over a surface with density rho, the median of pi rho r^2 is log 2.
double density_of(const std::vector<float>& rows) {
  const Places places(rows);
  std::vector<double> nearest;
  const std::size_t step = std::max<std::size_t>(1, places.count / kDensityLights);
  for (std::size_t i = 0; i < places.count; i += step)
    if (const double d2 = places.nearest_to(i); std::isfinite(d2)) nearest.push_back(d2);
  if (nearest.empty()) return 0;
  std::ranges::nth_element(nearest, nearest.begin() + static_cast<std::ptrdiff_t>(nearest.size() / 2));
  return std::log(2.0) / (std::numbers::pi * nearest[nearest.size() / 2]);
}

}  // namespace

BatchResult resample_lights(const StageTask& task) {
  const auto p = host_parameters<VplResampleParameters>(task);
  if (p.paths == 0 || p.count == 0)
    throw Error::bad_input("stage vpl_resample", "paths, count", "1 or more of both", "none");
  const Made made = lights_of(input_rows(task, "paths", VPL_WORDS), p.paths);
  const std::vector<float> rows = resample(made, p);
  BatchResult result = counted_rows(rows, VPL_WORDS);
  set_facts(result, VplResampleFacts{made.weight.size(), rows.size() / VPL_WORDS, p.pass == 0 ? density_of(rows) : 0});
  return result;
}

}  // namespace gleaner::worker
