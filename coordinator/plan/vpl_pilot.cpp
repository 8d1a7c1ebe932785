#include "coordinator/plan/vpl_pilot.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "kernels/cluster_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "scene/model/order.h"

namespace gleaner::coordinator {
namespace {

// Fitted by `bench/vpl pilot` on its four scenes: squares as measured over squares of the stand-ins. VPLs are not drawn
// independently: a light path leaves several, of its colour. What is asked by lot is asked at equal steps, not
// independently.
constexpr double kLightsFitted = 3.6, kMiddleFitted = 1.0, kDrawnFitted = 1.6, kPointsFitted = 1.0, kLotFitted = 0.45;
// Runs along a curve are longer than k-means' clusters: of their radius squared, what the clusters' is.
constexpr float kCompact = 0.35f;
// Of clusters' squared errors, were they never near, what is left at a distance.
constexpr double kFarShare = 0.015;
// Point clusters' squared errors rise with their spacing to this power, about, on the same scenes: where shadows are
// lost is a matter of a few places, which a few points tell badly at each spacing alone.
constexpr double kSpacingPower = 0.4;
// Disputed and other lights count differently to vpl_residual_select() in kernels/vpl/residual.cl, and a point in
// shadow is as exact as one that gets so much of what it could.
constexpr double kAgreed = 0.2, kLeastLit = 0.1;
// How steeply a neighbour may rise above a point's plane: SAME_SURFACE of kernels/vpl/gather.cl.
constexpr double kSameSurface = 0.25;

// What VPLs leave is smooth, seen for longer than noise of the same strength, and foreseen less surely than it.
constexpr double kVplWeight = 3;

// Work, in samples of paths (0.1 us on two cores); measured on the Cornell boxes and on sponza.
constexpr double kPairWork = 0.15;    // a point cluster asks a light
constexpr double kShadeWork = 0.003;  // a pixel and a light
constexpr double kSampleWork = 0.9;   // a pixel's sample of the VPLs' light
constexpr double kDoubtWork = 0.3;    // a light that a point asks itself
constexpr double kLightWork = 27;     // a VPL is drawn and clustered, on one worker
constexpr double kPointWork = 8;      // so is a point

double grey(const float* c) { return (double{c[0]} + c[1] + c[2]) / 3; }

std::uint32_t word_of(const float* row, unsigned word) {
  std::uint32_t value = 0;
  std::memcpy(&value, row + word, 4);
  return value;
}

// The order that k-means begins with (worker/stages/cluster_stage.cpp): side by side, within a side place by place.
std::vector<std::uint32_t> curve_order(const std::vector<float>& rows) {
  const std::size_t count = rows.size() / VPL_WORDS;
  std::array<double, 3> lower{1e300, 1e300, 1e300}, upper{-1e300, -1e300, -1e300};
  for (std::size_t i = 0; i < count; ++i)
    for (unsigned k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], double{rows[i * VPL_WORDS + k]});
      upper[k] = std::max(upper[k], double{rows[i * VPL_WORDS + k]});
    }
  double edge = 1e-30;
  for (unsigned k = 0; k < 3; ++k) edge = std::max(edge, upper[k] - lower[k]);
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(count);
  for (std::size_t i = 0; i < count; ++i) {
    const float* row = &rows[i * VPL_WORDS];
    std::uint64_t axis = 0;
    for (unsigned k = 1; k < 3; ++k)
      if (std::abs(row[VPL_NORMAL + k]) > std::abs(row[VPL_NORMAL + axis])) axis = k;
    std::array<std::uint32_t, 3> cell{};
    for (unsigned k = 0; k < 3; ++k)
      cell[k] = static_cast<std::uint32_t>(std::min(1023.0, (row[k] - lower[k]) / edge * 1024));
    keys[i] = {(2 * axis + (row[VPL_NORMAL + axis] < 0 ? 1 : 0)) << 32 | scene::morton(cell),
               static_cast<std::uint32_t>(i)};
  }
  std::sort(keys.begin(), keys.end());
  std::vector<std::uint32_t> order(count);
  for (std::size_t i = 0; i < count; ++i) order[i] = keys[i].second;
  return order;
}

// Eq. 4 without its bound; 0 for what faces away.
inline float geometry(const float* p, const float* n, float qx, float qy, float qz, float nx, float ny, float nz,
                      float gx, float gy, float gz) {
  const float x = qx - p[0], y = qy - p[1], z = qz - p[2];
  const float d2 = x * x + y * y + z * z;
  const float at_point = n[0] * x + n[1] * y + n[2] * z;
  const float side = -(nx * x + ny * y + nz * z);
  const float cosine = std::abs(gx * x + gy * y + gz * z);
  // Lights in the point's own place have no direction.
  const float g = at_point * cosine / std::max(d2 * d2, 1e-30f);
  return std::min(at_point, side) > 0 ? g : 0.0f;
}

float geometry(const float* point, const float* light) {
  const float *n = light + VPL_NORMAL, *g = light + VPL_GEOMETRIC;
  return geometry(point + POINT_POSITION, point + POINT_NORMAL, light[0], light[1], light[2], n[0], n[1], n[2], g[0],
                  g[1], g[2]);
}

// Between values at rising x, both in proportion; beyond the ends the last ones' slope.
double between(double x0, double y0, double x1, double y1, double x) {
  if (!(y0 > 0) || !(y1 > 0)) return std::max(0.0, x < std::sqrt(x0 * x1) ? y0 : y1);
  return y0 * std::pow(y1 / y0, std::log(x / x0) / std::log(x1 / x0));
}

}  // namespace

VplPilot::VplPilot(const std::vector<float>& lights, const std::vector<float>& points, std::vector<double> bounds)
    : bounds_(std::move(bounds)) {
  std::vector<float> shining;
  for (std::size_t at = 0; at < lights.size(); at += VPL_WORDS)
    if (grey(&lights[at + VPL_FLUX]) > 0)
      shining.insert(shining.end(), lights.begin() + static_cast<std::ptrdiff_t>(at),
                     lights.begin() + static_cast<std::ptrdiff_t>(at + VPL_WORDS));
  if (shining.empty()) return;
  choose_points(points);
  if (empty()) return;
  measure_lights(shining);
  measure_mean(points);
}

void VplPilot::choose_points(const std::vector<float>& points) {
  const std::size_t rows = points.size() / POINT_WORDS;
  const auto row = [&](std::size_t i) { return &points[i * POINT_WORDS]; };
  std::vector<std::uint32_t> there;
  for (std::size_t i = 0; i < rows; ++i)
    if (word_of(row(i), POINT_TRIANGLE) != GLEANER_NONE) there.push_back(static_cast<std::uint32_t>(i));
  if (there.empty()) return;
  coverage_ = static_cast<double>(there.size()) / static_cast<double>(rows);
  pilots_ = static_cast<std::uint32_t>(std::min<std::size_t>(kPoints, there.size()));
  std::vector<std::uint32_t> pilots(pilots_);
  const auto put = [&](std::size_t i) { asked_points_.insert(asked_points_.end(), row(i), row(i) + POINT_WORDS); };
  for (std::uint32_t k = 0; k < pilots_; ++k) {
    // One of each part of the picture, by lot: at equal steps they would stand in a column.
    const double place = (k + scene::unit_hash(k * 3)) * static_cast<double>(there.size()) / pilots_;
    pilots[k] = there[std::min(there.size() - 1, static_cast<std::size_t>(place))];
    put(pilots[k]);
  }
  std::vector<float> nobody(POINT_WORDS, 0.0f);
  std::memset(&nobody[POINT_TRIANGLE], 0xff, 4);
  for (std::size_t s = 0; s < kSpacings.size(); ++s) {
    // One of each so many, by lot: rows of the picture would come out as columns.
    std::vector<std::uint32_t> some;
    for (std::size_t first = 0; first < there.size(); first += kSpacings[s]) {
      const std::size_t group = std::min<std::size_t>(kSpacings[s], there.size() - first);
      some.push_back(
          there[first + static_cast<std::size_t>(scene::unit_hash(first * 3 + s + 1) * static_cast<double>(group))]);
    }
    for (std::uint32_t k = 0; k < pilots_; ++k) {
      const float* p = row(pilots[k]);
      std::array<std::pair<double, std::uint32_t>, kNeighbours> best;
      best.fill({std::numeric_limits<double>::infinity(), GLEANER_NONE});
      for (const std::uint32_t i : some) {
        const float* q = row(i);
        const double x = double{q[0]} - p[0], y = double{q[1]} - p[1], z = double{q[2]} - p[2];
        const double d2 = x * x + y * y + z * z;
        if (d2 >= best.back().first || i == pilots[k]) continue;
        const float *n = p + POINT_NORMAL, *m = q + POINT_NORMAL;
        if (!(n[0] * m[0] + n[1] * m[1] + n[2] * m[2] > CLUSTER_LEAST_COSINE)) continue;
        const double above = n[0] * x + n[1] * y + n[2] * z;
        if (above * above > kSameSurface * kSameSurface * d2) continue;
        best.back() = {d2, i};
        for (std::size_t at = kNeighbours - 1; at > 0 && best[at] < best[at - 1]; --at)
          std::swap(best[at], best[at - 1]);
      }
      for (const auto& [d2, i] : best) {
        if (i == GLEANER_NONE)
          asked_points_.insert(asked_points_.end(), nobody.begin(), nobody.end());
        else
          put(i);
      }
    }
  }
}

// All that needs no visibility.
void VplPilot::measure_lights(const std::vector<float>& lights) {
  const std::vector<std::uint32_t> order = curve_order(lights);
  const std::size_t count = order.size();
  std::vector<float> x(count), y(count), z(count), flux(count);
  std::vector<float> nx(count), ny(count), nz(count), gx(count), gy(count), gz(count);
  std::vector<double> sum(count + 1, 0.0);
  for (std::size_t i = 0; i < count; ++i) {
    const float* row = &lights[order[i] * VPL_WORDS];
    x[i] = row[0], y[i] = row[1], z[i] = row[2];
    nx[i] = row[VPL_NORMAL], ny[i] = row[VPL_NORMAL + 1], nz[i] = row[VPL_NORMAL + 2];
    gx[i] = row[VPL_GEOMETRIC], gy[i] = row[VPL_GEOMETRIC + 1], gz[i] = row[VPL_GEOMETRIC + 2];
    flux[i] = static_cast<float>(grey(row + VPL_FLUX));
    sum[i + 1] = sum[i] + flux[i];
  }
  // Equal steps of flux along the curve.
  flux_ = sum[count] / kLights;
  for (std::size_t i = 0, k = 0; k < kLights; ++k) {
    while (i + 1 < count && sum[i + 1] <= (static_cast<double>(k) + 0.5) * flux_) ++i;
    const float* row = &lights[order[i] * VPL_WORDS];
    asked_lights_.insert(asked_lights_.end(), row, row + VPL_WORDS);
  }
  // Runs of each level, and which member stands for a run.
  struct Level {
    std::vector<std::uint32_t> first, middle;
    std::vector<float> near2;  // nearer than that (squared), all members shine for themselves
  };
  std::vector<Level> levels(kLevels);
  for (std::uint32_t l = 0; l < kLevels; ++l) {
    const std::size_t runs = std::min<std::size_t>(std::size_t{1} << (kFirstLevel + l), count);
    for (std::size_t r = 0; r <= runs; ++r) levels[l].first.push_back(static_cast<std::uint32_t>(r * count / runs));
    for (std::size_t r = 0; r < runs; ++r) {
      const std::uint32_t begin = levels[l].first[r], end = levels[l].first[r + 1];
      double cx = 0, cy = 0, cz = 0;
      for (std::uint32_t i = begin; i < end; ++i) cx += x[i], cy += y[i], cz += z[i];
      const double n = end - begin;
      double nearest = std::numeric_limits<double>::infinity();
      std::uint32_t middle = begin;
      for (std::uint32_t i = begin; i < end; ++i) {
        const double dx = x[i] - cx / n, dy = y[i] - cy / n, dz = z[i] - cz / n, d2 = dx * dx + dy * dy + dz * dz;
        if (d2 < nearest) nearest = d2, middle = i;
      }
      levels[l].middle.push_back(middle);
      float reach2 = 0;
      for (std::uint32_t i = begin; i < end; ++i) {
        const float dx = x[i] - x[middle], dy = y[i] - y[middle], dz = z[i] - z[middle];
        reach2 = std::max(reach2, dx * dx + dy * dy + dz * dz);
      }
      levels[l].near2.push_back(kCompact * NEAR_RADII * NEAR_RADII * reach2);
    }
  }
  per_light_.assign(bounds_.size(), 0.0);
  middle_.assign(bounds_.size(), {});
  drawn_.assign(bounds_.size(), {});
  for (std::uint32_t l = 0; l < kLevels; ++l) looked_[l] = static_cast<double>(levels[l].middle.size());
  const std::size_t middle_bound = bounds_.size() / 2;
  std::vector<float> whole(count), bounded(count);
  // Of the finest runs, then of ever coarser ones: what they bring, and what their members' squares would.
  const std::size_t finest = levels.back().middle.size();
  std::vector<double> light(finest), square(finest);
  std::vector<std::vector<double>> has(kLevels);
  for (std::uint32_t l = 0; l < kLevels; ++l)
    for (std::size_t r = 0; r < levels[l].middle.size(); ++r)
      has[l].push_back(sum[levels[l].first[r + 1]] - sum[levels[l].first[r]]);
  for (std::uint32_t p = 0; p < pilots_; ++p) {
    const float* point = &asked_points_[p * POINT_WORDS];
    const double albedo = grey(point + POINT_ALBEDO), weight = albedo * albedo * coverage_ / pilots_;
    const float *at = point + POINT_POSITION, *n = point + POINT_NORMAL;
    for (std::size_t i = 0; i < count; ++i)
      whole[i] = geometry(at, n, x[i], y[i], z[i], nx[i], ny[i], nz[i], gx[i], gy[i], gz[i]);
    for (std::size_t k = 0; k < bounds_.size(); ++k) {
      const auto most = static_cast<float>(bounds_[k]);
      for (std::size_t i = 0; i < count; ++i) bounded[i] = std::min(whole[i], most);
      double all = 0, squares = 0;
      for (std::size_t r = 0; r < finest; ++r) {
        double l = 0, q = 0;
        for (std::uint32_t i = levels.back().first[r]; i < levels.back().first[r + 1]; ++i) {
          const double brought = double{bounded[i]} * flux[i];
          l += brought, q += brought * bounded[i];
        }
        light[r] = l, square[r] = q;
        all += l, squares += q;
      }
      // Lights drawn by their flux have it all between them.
      per_light_[k] += weight * std::max(0.0, sum[count] * squares - all * all);
      if (k != middle_bound) continue;
      for (std::uint32_t l = kLevels; l-- > 0;) {
        const Level& level = levels[l];
        const std::size_t runs = level.middle.size();
        // Runs of a level are pairs of the next one's, but where there are too few lights for that.
        if (l + 1 < kLevels && 2 * runs == levels[l + 1].middle.size())
          for (std::size_t r = 0; r < runs; ++r) {
            light[r] = light[2 * r] + light[2 * r + 1];
            square[r] = square[2 * r] + square[2 * r + 1];
          }
        else if (l + 1 < kLevels && runs != levels[l + 1].middle.size())
          for (std::size_t r = 0; r < runs; ++r) {
            light[r] = square[r] = 0;
            for (std::uint32_t i = level.first[r]; i < level.first[r + 1]; ++i) {
              light[r] += double{bounded[i]} * flux[i];
              square[r] += double{bounded[i]} * bounded[i] * flux[i];
            }
          }
        double off = 0, variance = 0;
        for (std::size_t r = 0; r < runs; ++r) {
          const std::uint32_t m = level.middle[r];
          const float dx = x[m] - at[0], dy = y[m] - at[1], dz = z[m] - at[2];
          if (dx * dx + dy * dy + dz * dz < level.near2[r])
            looked_[l] += static_cast<double>(level.first[r + 1] - level.first[r]) / pilots_;
          off += has[l][r] * bounded[level.middle[r]] - light[r];
          variance += std::max(0.0, has[l][r] * square[r] - light[r] * light[r]);
        }
        middle_[k][l] += weight * off * off;
        drawn_[k][l] += weight * variance;
      }
    }
  }
  // With another bound they change as the lights' own.
  for (std::size_t k = 0; k < bounds_.size(); ++k) {
    if (k == middle_bound || !(per_light_[middle_bound] > 0)) continue;
    const double ratio = per_light_[k] / per_light_[middle_bound];
    for (std::uint32_t l = 0; l < kLevels; ++l) {
      middle_[k][l] = ratio * middle_[middle_bound][l];
      drawn_[k][l] = ratio * drawn_[middle_bound][l];
    }
  }
}

// What the picture gets unshadowed, from more points than are asked.
void VplPilot::measure_mean(const std::vector<float>& points) {
  const std::size_t rows = points.size() / POINT_WORDS, looked = std::min<std::size_t>(rows, kMeanPoints);
  mean_.assign(bounds_.size(), 0.0);
  for (std::size_t k = 0; k < looked; ++k) {
    const double place = (static_cast<double>(k) + scene::unit_hash(k * 3 + 2)) * static_cast<double>(rows) /
                         static_cast<double>(looked);
    const float* point = &points[std::min(rows - 1, static_cast<std::size_t>(place)) * POINT_WORDS];
    if (word_of(point, POINT_TRIANGLE) == GLEANER_NONE) continue;
    const double albedo = grey(point + POINT_ALBEDO) / static_cast<double>(looked);
    for (std::size_t j = 0; j < kLights; ++j) {
      const double whole = geometry(point, &asked_lights_[j * VPL_WORDS]);
      for (std::size_t b = 0; b < bounds_.size(); ++b) mean_[b] += albedo * flux_ * std::min(whole, bounds_[b]);
    }
  }
}

void VplPilot::answer(const Bytes& records) {
  constexpr std::size_t row_bytes = (kLights / 32 + VISIBILITY_COUNTS) * 4;
  const std::size_t rows = asked_points_.size() / POINT_WORDS;
  if (records.size() != rows * row_bytes)
    throw Error::failed("plan vpl: vpl.pilot has " + std::to_string(records.size()) + " bytes, expected " +
                        std::to_string(rows * row_bytes));
  const auto sees = [&](std::size_t row, std::size_t light) {
    std::uint32_t word = 0;
    std::memcpy(&word, records.data() + row * row_bytes + light / 32 * 4, 4);
    return (word >> (light % 32)) & 1u;
  };
  // Shadow takes its share of the light, and of what single lights, mostly near ones, are off by.
  for (std::size_t k = 0; k < bounds_.size(); ++k) {
    double seen = 0, all = 0, seen_square = 0, all_square = 0;
    for (std::uint32_t p = 0; p < pilots_; ++p) {
      const float* point = &asked_points_[p * POINT_WORDS];
      const double albedo = grey(point + POINT_ALBEDO);
      for (std::size_t j = 0; j < kLights; ++j) {
        const double g = albedo * std::min(double{geometry(point, &asked_lights_[j * VPL_WORDS])}, bounds_[k]);
        all += g, all_square += g * g;
        if (sees(p, j)) seen += g, seen_square += g * g;
      }
    }
    mean_[k] *= all > 0 ? seen / all : 0;
    const double kept = all_square > 0 ? seen_square / all_square : 0;
    per_light_[k] *= kept;
    // What clusters are off by is that their members, which shine from their own places where they are near, all count
    // as seen where one of them is: little where nothing stands in the way.
    const double disputed = kept * std::max(1 - kept, kFarShare);
    for (double& v : middle_[k]) v *= disputed;
    for (double& v : drawn_[k]) v *= disputed;
  }
  const double most = bounds_[bounds_.size() / 2];
  for (std::size_t s = 0; s < kSpacings.size(); ++s) {
    Spacing& here = spacings_[s];
    for (std::uint32_t p = 0; p < pilots_; ++p) {
      const float* point = &asked_points_[p * POINT_WORDS];
      const double albedo = grey(point + POINT_ALBEDO), weight = albedo * albedo * coverage_ / pilots_;
      const std::size_t first = pilots_ + (s * pilots_ + p) * kNeighbours;
      std::array<double, kNeighbours> share{};
      double total = 0;
      for (std::size_t f = 0; f < kNeighbours; ++f) {
        const float* q = &asked_points_[(first + f) * POINT_WORDS];
        if (word_of(q, POINT_TRIANGLE) == GLEANER_NONE) continue;
        double d2 = 0;
        for (unsigned k = 0; k < 3; ++k) d2 += (double{q[k]} - point[k]) * (double{q[k]} - point[k]);
        share[f] = 1 / std::sqrt(std::max(d2, 1e-30));
        total += share[f];
      }
      double off = 0, squares = 0, wrong = 0, level = 0, unshadowed = 0, stake = 0;
      for (std::size_t j = 0; j < kLights; ++j) {
        const double brought = flux_ * std::min(double{geometry(point, &asked_lights_[j * VPL_WORDS])}, most);
        double told = 0;
        bool any = false, all = true;
        for (std::size_t f = 0; f < kNeighbours; ++f) {
          if (!(share[f] > 0)) continue;
          const bool seen = sees(first + f, j) != 0;
          told += seen ? share[f] / total : 0;
          any = any || seen;
          all = all && seen;
        }
        const bool disputed = total > 0 ? any && !all : true;
        if (any && all) told = 1;  // without the shares' rounding
        const double d = (sees(p, j) ? 1 : 0) - told;
        level += brought * told;
        if (any) unshadowed += brought;
        stake += brought * (disputed ? 1 : kAgreed);
        if (!(total > 0)) continue;
        off += brought * d;
        squares += brought * brought * d * d;
        wrong += brought * d * d / (disputed ? 1 : kAgreed);
      }
      level = std::max(level, kLeastLit * unshadowed);
      // Pairs of different lights tell what lights have in common.
      here.coherent += weight * (off * off - squares);
      here.single += weight * squares * kLights;
      here.disputed += weight * level * wrong;
      here.asked += level > 0 ? stake / level * coverage_ / pilots_ : 0;
    }
    here.coherent = std::max(here.coherent, 0.0);
  }
  double pooled = 0;
  for (std::size_t s = 0; s < kSpacings.size(); ++s)
    pooled += spacings_[s].coherent * std::pow(kSpacings[s], -kSpacingPower) / kSpacings.size();
  for (std::size_t s = 0; s < kSpacings.size(); ++s)
    spacings_[s].coherent = 0.5 * (spacings_[s].coherent + pooled * std::pow(kSpacings[s], kSpacingPower));
}

std::size_t VplPilot::nearest_bound(double bound) const {
  std::size_t best = 0;
  for (std::size_t k = 1; k < bounds_.size(); ++k)
    if (bound * bound > bounds_[k - 1] * bounds_[k]) best = k;
  return best;
}

double VplPilot::clusters_error(std::size_t k, double clusters, bool drawn) const {
  const auto& table = drawn ? drawn_[k] : middle_[k];
  const double level = std::clamp(std::log2(clusters) - kFirstLevel, 0.0, kLevels - 1.0);
  const auto low = std::min<std::size_t>(static_cast<std::size_t>(level), kLevels - 2);
  const double x0 = std::exp2(static_cast<double>(low)), x = clusters / std::exp2(kFirstLevel);
  return (drawn ? kDrawnFitted : kMiddleFitted) * between(x0, table[low], 2 * x0, table[low + 1], x);
}

double VplPilot::looked_at(double clusters) const {
  const double level = std::clamp(std::log2(clusters) - kFirstLevel, 0.0, kLevels - 1.0);
  const auto low = std::min<std::size_t>(static_cast<std::size_t>(level), kLevels - 2);
  const double x0 = std::exp2(static_cast<double>(low)), x = clusters / std::exp2(kFirstLevel);
  return between(x0, looked_[low], 2 * x0, looked_[low + 1], x);
}

VplPilot::Spacing VplPilot::at(double spacing) const {
  std::size_t low = 0;
  while (low + 2 < kSpacings.size() && spacing > kSpacings[low + 1]) ++low;
  const double x0 = kSpacings[low], x1 = kSpacings[low + 1];
  const Spacing &a = spacings_[low], &b = spacings_[low + 1];
  return {between(x0, a.coherent, x1, b.coherent, spacing), between(x0, a.single, x1, b.single, spacing),
          between(x0, a.disputed, x1, b.disputed, spacing), between(x0, a.asked, x1, b.asked, spacing)};
}

VplPilot::Split VplPilot::points_error(double spacing, double lights, double doubt) const {
  const Spacing s = at(spacing);
  const double off = kPointsFitted * (s.coherent + s.single / lights), noise = kLotFitted * doubt * s.disputed;
  if (!(doubt > 0)) return {off, 0};
  if (!(off + noise > 0)) return {};
  // What was measured is taken off in the proportion in which it stands out of its noise.
  const double taken = off / (off + noise);
  return {off * (1 - taken) * (1 - taken), noise * taken * taken};
}

double VplPilot::asked(double spacing, double doubt) const {
  return doubt > 0 ? std::min(at(spacing).asked / doubt, double{MAX_RESIDUAL_SAMPLES}) : 0;
}

VplForecast forecast_vpl(const VplPilot& pilot, const std::vector<PathForecast>& paths, const VplWish& wish,
                         const VplCounts& counts) {
  VplForecast f;
  f.counts = counts;
  // No more lights are drawn than there are.
  const double lights = std::min(counts.count, wish.made);
  const double clusters = counts.clusters ? std::min<double>(counts.clusters, lights) : lights;
  const double sets = counts.sets;
  f.lights = kLightsFitted * pilot.lights_error(counts.bound, lights) / sets;
  if (clusters < lights) {
    // Where every light is a cluster of its own, none is off.
    const bool drawn = counts.sets > 1;
    f.clusters = pilot.clusters_error(counts.bound, clusters, drawn) * (1 - clusters / lights) / (drawn ? sets : 1);
  }
  double asked = clusters;
  if (counts.point_clusters) {
    const double spacing = wish.points / counts.point_clusters;
    const VplPilot::Split split = pilot.points_error(spacing, clusters, counts.doubt);
    f.points = split.common + split.by_lot / sets;
    asked = pilot.asked(spacing, counts.doubt);
  }
  f.vpl_mean = pilot.mean(counts.bound);
  f.mean = f.vpl_mean + paths[counts.bound].mean;
  const double work =
      sets * (lights * kLightWork * (clusters < lights ? 1 : 0.2) + counts.point_clusters * clusters * kPairWork +
              wish.pixels * ((clusters < lights ? pilot.looked_at(clusters) : lights) * kShadeWork +
                             wish.samples * kSampleWork + asked * kDoubtWork)) +
      8 * kPointWork * counts.point_clusters;
  f.spp = wish.spp;
  const double variance = paths[counts.bound].variance;
  if (wish.target > 0) {
    // What the VPLs may not use is for samples to reach; a quarter is kept for them whatever the VPLs do.
    const double all = wish.target * wish.target * f.mean * f.mean;
    const double left = std::max(all - kVplCaution * f.vpl(), 0.25 * all);
    f.spp = left > 0 ? std::max(32.0, variance / left) : 32.0;
  }
  f.paths = variance / f.spp;
  f.cost = work + wish.pixels * f.spp;
  return f;
}

VplForecast choose_vpl(const VplPilot& pilot, const std::vector<PathForecast>& paths, const VplWish& wish) {
  const auto grid = [](const std::optional<std::uint32_t>& fixed, std::vector<double> values, double least,
                       double most) {
    std::vector<std::uint32_t> list;
    if (fixed) return std::vector<std::uint32_t>{*fixed};
    for (const double v : values)
      if (v >= least && v <= most) list.push_back(static_cast<std::uint32_t>(v));
    if (list.empty()) list.push_back(static_cast<std::uint32_t>(std::max(1.0, std::min(most, values.front()))));
    return list;
  };
  std::vector<double> clusters, points;
  for (double c = 256; c <= 8192; c *= 2) {
    clusters.push_back(c);
    clusters.push_back(1.5 * c);
  }
  for (const double factor : {0.125, 0.25, 0.5, 1.0, 2.0}) points.push_back(wish.usual_point_clusters * factor);
  const double most_sets = wish.target > 0 ? 64 : std::max(1.0, wish.spp / 16);
  const auto counts = grid(wish.count, {4000, 8000, 16000, 24000}, 1, wish.made);
  const auto many = grid(wish.sets, {1, 2, 4, 8, 16, 32, 64}, 1, most_sets);
  const auto spaced = grid(wish.point_clusters, points, 64, 1e9);
  std::vector<double> doubts{wish.doubt ? *wish.doubt : 0.02};
  for (const double doubt : {0.05, 0.1, 0.2})
    if (!wish.doubt && doubt <= wish.most_doubt) doubts.push_back(doubt);
  VplForecast best;
  double least = std::numeric_limits<double>::infinity();
  for (const std::uint32_t count : counts)
    for (const std::uint32_t c : grid(wish.clusters, clusters, 1, count / 2))
      for (std::size_t bound = 0; bound < pilot.bounds().size(); ++bound) {
        if (wish.clamp && bound != pilot.nearest_bound(*wish.clamp > 0 ? *wish.clamp : 1e300)) continue;
        for (const std::uint32_t p : spaced)
          for (const double doubt : doubts)
            for (const std::uint32_t sets : many) {
              const VplForecast f = forecast_vpl(pilot, paths, wish, {count, c, p, sets, doubt, bound});
              double value = f.cost;
              if (wish.target > 0) {
                // Where nothing meets the wish, the nearest to it.
                const double all = wish.target * wish.target * f.mean * f.mean;
                const double over = (kVplCaution * f.vpl() + f.paths) / all;
                if (over > 1.0001) value *= 1e6 * over * over;
              } else {
                // Samples' variance falls as one over their number: that is what a sample more of all pixels is worth.
                value = kVplWeight * f.vpl() + f.paths + f.paths / (wish.pixels * wish.spp) * f.cost;
              }
              if (best.counts.count && !(value < least)) continue;
              least = value;
              best = f;
            }
      }
  return best;
}

}  // namespace gleaner::coordinator
