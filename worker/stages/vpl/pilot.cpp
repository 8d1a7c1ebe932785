// The pilot of method `vpl`: a few points of the picture query a few lights, which gives estimates of the errors that
// numbers of VPLs and of clusters would leave. Runs of neighbours along a curve are taken for clusters of lights,
// points of the same spacing for point clusters; their errors are those of the real clusters within a factor of about
// two
// (`bench/vpl pilot` shows both).

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/order.h"
#include "worker/stages/curve.h"
#include "worker/stages/vpl/host_stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

using kernels::VplPilotFacts;
using kernels::VplPilotParameters;
using Shape = kernels::VplPilotShape;

// Runs along a curve are longer than k-means' clusters: of their radius squared, what the clusters' is.
constexpr float kCompact = 0.35f;
// Of clusters' squared errors, were they never near, what is left at a distance.
constexpr double kFarShare = 0.015;
// Point clusters' squared errors rise with their spacing to this power, about, on the scenes of `bench/vpl pilot`:
// shadows are lost in a few places, which a few points sample badly at each spacing alone.
constexpr double kSpacingPower = 0.4;
// Disputed and other lights count differently when residual samples are drawn (kernels/vpl), and a point in shadow is
// as exact as one that gets so much of what it could.
constexpr double kAgreed = 0.2, kLeastLit = 0.1;
// How steeply a neighbour may rise above a point's plane: SAME_SURFACE of the method's kernels.
constexpr double kSameSurface = 0.25;
// Samples go where the noise is. The squared error therefore falls with the square of the mean deviation, not with the
// mean of squares, which depends on a few pixels at lamps' edges. Fitted on the scenes of `bench/vpl pilot` (3.2
// to 4.3; white-room, whose lobes are noisy far out, 40).
constexpr double kNoiseFitted = 3.6;
constexpr double kPi = 3.14159265358979;

double grey(const float* c) { return (double{c[0]} + c[1] + c[2]) / 3; }

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

// --- Points ---

// Rows of the points that exist.
std::vector<std::uint32_t> existing(const std::vector<float>& points) {
  std::vector<std::uint32_t> rows;
  for (std::size_t i = 0; i < points.size() / POINT_WORDS; ++i)
    if (is_point(&points[i * POINT_WORDS])) rows.push_back(static_cast<std::uint32_t>(i));
  return rows;
}

std::uint32_t pilots_of(std::size_t there) {
  return static_cast<std::uint32_t>(std::min<std::size_t>(Shape::points, there));
}

// The points of `some` that are nearest to point `pilot` on its own surface; GLEANER_NONE where there are fewer.
std::array<std::uint32_t, Shape::neighbours> nearest_points(const std::vector<float>& points, std::uint32_t pilot,
                                                            const std::vector<std::uint32_t>& some) {
  const float* p = &points[std::size_t{pilot} * POINT_WORDS];
  std::array<std::pair<double, std::uint32_t>, Shape::neighbours> best;
  best.fill({std::numeric_limits<double>::infinity(), GLEANER_NONE});
  for (const std::uint32_t i : some) {
    const float* q = &points[std::size_t{i} * POINT_WORDS];
    const double x = double{q[0]} - p[0], y = double{q[1]} - p[1], z = double{q[2]} - p[2];
    const double d2 = x * x + y * y + z * z;
    if (d2 >= best.back().first || i == pilot) continue;
    const float *n = p + POINT_NORMAL, *m = q + POINT_NORMAL;
    if (!(n[0] * m[0] + n[1] * m[1] + n[2] * m[2] > CLUSTER_LEAST_COSINE)) continue;
    const double above = n[0] * x + n[1] * y + n[2] * z;
    if (above * above > kSameSurface * kSameSurface * d2) continue;
    best.back() = {d2, i};
    for (std::size_t at = Shape::neighbours - 1; at > 0 && best[at] < best[at - 1]; --at)
      std::swap(best[at], best[at - 1]);
  }
  std::array<std::uint32_t, Shape::neighbours> rows;
  std::ranges::transform(best, rows.begin(), [](const auto& entry) { return entry.second; });
  return rows;
}

std::vector<float> choose_points(const std::vector<float>& points) {
  std::vector<float> queried;
  const std::vector<std::uint32_t> there = existing(points);
  if (there.empty()) return queried;
  const auto put = [&](std::size_t i) {
    const auto row = points.begin() + static_cast<std::ptrdiff_t>(i * POINT_WORDS);
    queried.insert(queried.end(), row, row + POINT_WORDS);
  };
  std::vector<std::uint32_t> pilots(pilots_of(there.size()));
  for (std::uint32_t k = 0; k < pilots.size(); ++k) {
    pilots[k] = there[random_row(k, k * 3, there.size(), pilots.size())];
    put(pilots[k]);
  }
  std::vector<float> no_point(POINT_WORDS, 0.0f);
  std::memset(&no_point[POINT_TRIANGLE], 0xff, 4);
  for (std::size_t s = 0; s < Shape::spacings; ++s) {
    // One of each so many, at random: rows of the picture would come out as columns.
    const std::size_t spacing = Shape::spacing[s];
    std::vector<std::uint32_t> some;
    for (std::size_t first = 0; first < there.size(); first += spacing) {
      const std::size_t group = std::min(spacing, there.size() - first);
      some.push_back(
          there[first + static_cast<std::size_t>(scene::unit_hash(first * 3 + s + 1) * static_cast<double>(group))]);
    }
    for (const std::uint32_t pilot : pilots)
      for (const std::uint32_t i : nearest_points(points, pilot, some)) {
        if (i == GLEANER_NONE)
          queried.insert(queried.end(), no_point.begin(), no_point.end());
        else
          put(i);
      }
  }
  return queried;
}

// --- Lights ---

// Lights of some flux, along the curve.
struct Lights {
  std::vector<float> x, y, z, nx, ny, nz, gx, gy, gz, flux;
  std::vector<double> sum{0.0};  // of the flux before each of them, and of all
  std::vector<const float*> row;

  std::size_t count() const { return row.size(); }
  // That each of the queried lights represents, W/sr.
  double flux_of_queried() const { return sum.back() / Shape::lights; }
};

std::vector<float> shining(const std::vector<float>& lights) {
  std::vector<float> rows;
  for (std::size_t at = 0; at < lights.size(); at += VPL_WORDS)
    if (grey(&lights[at + VPL_FLUX]) > 0)
      rows.insert(rows.end(), lights.begin() + static_cast<std::ptrdiff_t>(at),
                  lights.begin() + static_cast<std::ptrdiff_t>(at + VPL_WORDS));
  return rows;
}

// `rows` must outlive it.
Lights lights_of(const std::vector<float>& rows) {
  Lights l;
  for (const std::uint32_t i : curve_order(rows, VPL_WORDS, 1024, true)) {
    const float* row = &rows[std::size_t{i} * VPL_WORDS];
    l.row.push_back(row);
    l.x.push_back(row[0]), l.y.push_back(row[1]), l.z.push_back(row[2]);
    const float *n = row + VPL_NORMAL, *g = row + VPL_GEOMETRIC;
    l.nx.push_back(n[0]), l.ny.push_back(n[1]), l.nz.push_back(n[2]);
    l.gx.push_back(g[0]), l.gy.push_back(g[1]), l.gz.push_back(g[2]);
    l.flux.push_back(static_cast<float>(grey(row + VPL_FLUX)));
    l.sum.push_back(l.sum.back() + l.flux.back());
  }
  return l;
}

// At equal steps of flux along the curve.
std::vector<float> choose_lights(const Lights& l) {
  std::vector<float> queried;
  if (l.count() == 0) return queried;
  for (std::size_t i = 0, k = 0; k < Shape::lights; ++k) {
    while (i + 1 < l.count() && l.sum[i + 1] <= (static_cast<double>(k) + 0.5) * l.flux_of_queried()) ++i;
    queried.insert(queried.end(), l.row[i], l.row[i] + VPL_WORDS);
  }
  return queried;
}

// Runs of lights in place of clusters, and the member that represents each run.
struct Level {
  std::vector<std::uint32_t> first, middle;
  std::vector<float> near2;  // nearer than that (squared), all members shine for themselves
  std::vector<double> flux;

  std::size_t runs() const { return middle.size(); }
};

Level make_level(const Lights& l, std::size_t runs) {
  Level level;
  for (std::size_t r = 0; r <= runs; ++r) level.first.push_back(static_cast<std::uint32_t>(r * l.count() / runs));
  for (std::size_t r = 0; r < runs; ++r) {
    const std::uint32_t begin = level.first[r], end = level.first[r + 1];
    double cx = 0, cy = 0, cz = 0;
    for (std::uint32_t i = begin; i < end; ++i) cx += l.x[i], cy += l.y[i], cz += l.z[i];
    const double n = end - begin;
    double nearest = std::numeric_limits<double>::infinity();
    std::uint32_t middle = begin;
    for (std::uint32_t i = begin; i < end; ++i) {
      const double dx = l.x[i] - cx / n, dy = l.y[i] - cy / n, dz = l.z[i] - cz / n, d2 = dx * dx + dy * dy + dz * dz;
      if (d2 < nearest) nearest = d2, middle = i;
    }
    level.middle.push_back(middle);
    float reach2 = 0;
    for (std::uint32_t i = begin; i < end; ++i) {
      const float dx = l.x[i] - l.x[middle], dy = l.y[i] - l.y[middle], dz = l.z[i] - l.z[middle];
      reach2 = std::max(reach2, dx * dx + dy * dy + dz * dz);
    }
    level.near2.push_back(kCompact * NEAR_RADII * NEAR_RADII * reach2);
    level.flux.push_back(l.sum[end] - l.sum[begin]);
  }
  return level;
}

// --- Sums ---

class Pilot {
 public:
  Pilot(const Lights& lights, const std::vector<float>& points, const std::vector<float>& queried_points,
        const std::vector<float>& queried_lights, const VplPilotParameters& parameters)
      : l_(lights), points_(points), queried_(queried_points), queried_lights_(queried_lights) {
    std::copy_n(parameters.bounds, Shape::bounds, bounds_.begin());
    const std::size_t there = existing(points).size();
    coverage_ = static_cast<double>(there) / static_cast<double>(points.size() / POINT_WORDS);
    pilots_ = pilots_of(there);
    for (std::uint32_t k = 0; k < Shape::levels; ++k)
      levels_.push_back(make_level(l_, std::min<std::size_t>(std::size_t{1} << (Shape::first_level + k), l_.count())));
  }

  // `bits`: the answers, a row of words for each queried point.
  VplPilotFacts measure(const std::vector<float>& bits) {
    bits_ = &bits;
    measure_lights();
    measure_mean();
    shadow();
    for (std::size_t s = 0; s < Shape::spacings; ++s) measure_spacing(s);
    pool_spacings();
    return facts_;
  }

 private:
  const float* pilot(std::size_t p) const { return &queried_[p * POINT_WORDS]; }
  double weight(std::size_t p) const {
    const double albedo = grey(pilot(p) + POINT_ALBEDO);
    return albedo * albedo * coverage_ / pilots_;
  }
  const float* light(std::size_t j) const { return &queried_lights_[j * VPL_WORDS]; }
  double middle_bound() const { return bounds_[Shape::bounds / 2]; }
  bool sees(std::size_t row, std::size_t j) const {
    constexpr std::size_t words = Shape::lights / 32 + VISIBILITY_COUNTS;
    std::uint32_t word = 0;
    std::memcpy(&word, &(*bits_)[row * words + j / 32], 4);
    return ((word >> (j % 32)) & 1u) != 0;
  }

  // All that needs no visibility.
  void measure_lights() {
    for (std::uint32_t k = 0; k < Shape::levels; ++k) facts_.looked[k] = static_cast<double>(levels_[k].runs());
    std::vector<float> whole(l_.count()), bounded(l_.count());
    const Level& finest = levels_.back();
    std::vector<double> light(finest.runs()), square(finest.runs());
    for (std::uint32_t p = 0; p < pilots_; ++p) {
      const float *at = pilot(p) + POINT_POSITION, *n = pilot(p) + POINT_NORMAL;
      for (std::size_t i = 0; i < l_.count(); ++i)
        whole[i] =
            geometry(at, n, l_.x[i], l_.y[i], l_.z[i], l_.nx[i], l_.ny[i], l_.nz[i], l_.gx[i], l_.gy[i], l_.gz[i]);
      for (std::size_t k = 0; k < Shape::bounds; ++k) {
        const auto most = static_cast<float>(bounds_[k]);
        for (std::size_t i = 0; i < l_.count(); ++i) bounded[i] = std::min(whole[i], most);
        double all = 0, squares = 0;
        for (std::size_t r = 0; r < finest.runs(); ++r) {
          double l = 0, q = 0;
          for (std::uint32_t i = finest.first[r]; i < finest.first[r + 1]; ++i) {
            const double contribution = double{bounded[i]} * l_.flux[i];
            l += contribution, q += contribution * bounded[i];
          }
          light[r] = l, square[r] = q;
          all += l, squares += q;
        }
        // Lights drawn by their flux have it all between them.
        facts_.per_light[k] += weight(p) * std::max(0.0, l_.sum.back() * squares - all * all);
        if (k == Shape::bounds / 2) measure_runs(p, bounded, light, square);
      }
    }
    scale_to_bounds();
  }

  // Of the finest runs, then of ever coarser ones: their contribution to a point, and the sum of its squares.
  void measure_runs(std::uint32_t p, const std::vector<float>& bounded, std::vector<double>& light,
                    std::vector<double>& square) {
    constexpr std::size_t k = Shape::bounds / 2;
    const float* at = pilot(p) + POINT_POSITION;
    for (std::uint32_t level = Shape::levels; level-- > 0;) {
      const Level& runs = levels_[level];
      if (level + 1 < Shape::levels) merge_runs(level, bounded, light, square);
      double off = 0, variance = 0;
      for (std::size_t r = 0; r < runs.runs(); ++r) {
        const std::uint32_t m = runs.middle[r];
        const float dx = l_.x[m] - at[0], dy = l_.y[m] - at[1], dz = l_.z[m] - at[2];
        if (dx * dx + dy * dy + dz * dz < runs.near2[r])
          facts_.looked[level] += static_cast<double>(runs.first[r + 1] - runs.first[r]) / pilots_;
        off += runs.flux[r] * bounded[m] - light[r];
        variance += std::max(0.0, runs.flux[r] * square[r] - light[r] * light[r]);
      }
      facts_.middle[k][level] += weight(p) * off * off;
      facts_.drawn[k][level] += weight(p) * variance;
    }
  }

  // The next finer level's sums become this level's.
  void merge_runs(std::uint32_t level, const std::vector<float>& bounded, std::vector<double>& light,
                  std::vector<double>& square) const {
    const Level& runs = levels_[level];
    const std::size_t finer = levels_[level + 1].runs();
    // Runs of a level are pairs of the next one's, but where there are too few lights for that.
    if (2 * runs.runs() == finer) {
      for (std::size_t r = 0; r < runs.runs(); ++r) {
        light[r] = light[2 * r] + light[2 * r + 1];
        square[r] = square[2 * r] + square[2 * r + 1];
      }
    } else if (runs.runs() != finer) {
      for (std::size_t r = 0; r < runs.runs(); ++r) {
        light[r] = square[r] = 0;
        for (std::uint32_t i = runs.first[r]; i < runs.first[r + 1]; ++i) {
          light[r] += double{bounded[i]} * l_.flux[i];
          square[r] += double{bounded[i]} * bounded[i] * l_.flux[i];
        }
      }
    }
  }

  // With another bound clusters' errors change as the lights' own.
  void scale_to_bounds() {
    constexpr std::size_t middle = Shape::bounds / 2;
    for (std::size_t k = 0; k < Shape::bounds; ++k) {
      if (k == middle || !(facts_.per_light[middle] > 0)) continue;
      const double ratio = facts_.per_light[k] / facts_.per_light[middle];
      for (std::uint32_t l = 0; l < Shape::levels; ++l) {
        facts_.middle[k][l] = ratio * facts_.middle[middle][l];
        facts_.drawn[k][l] = ratio * facts_.drawn[middle][l];
      }
    }
  }

  // What the picture gets unshadowed, from more points than are queried.
  void measure_mean() {
    const std::size_t rows = points_.size() / POINT_WORDS, looked = std::min<std::size_t>(rows, Shape::mean_points);
    for (std::size_t k = 0; k < looked; ++k) {
      const float* point = &points_[random_row(k, k * 3 + 2, rows, looked) * POINT_WORDS];
      if (!is_point(point)) continue;
      const double albedo = grey(point + POINT_ALBEDO) / static_cast<double>(looked);
      for (std::size_t j = 0; j < Shape::lights; ++j) {
        const double whole = geometry(point, light(j));
        for (std::size_t b = 0; b < Shape::bounds; ++b)
          facts_.mean[b] += albedo * l_.flux_of_queried() * std::min(whole, bounds_[b]);
      }
    }
  }

  // Shadow takes its share of the light, and of what single lights, mostly near ones, are off by.
  void shadow() {
    for (std::size_t k = 0; k < Shape::bounds; ++k) {
      double seen = 0, all = 0, seen_square = 0, all_square = 0;
      for (std::uint32_t p = 0; p < pilots_; ++p) {
        const double albedo = grey(pilot(p) + POINT_ALBEDO);
        for (std::size_t j = 0; j < Shape::lights; ++j) {
          const double g = albedo * std::min(double{geometry(pilot(p), light(j))}, bounds_[k]);
          all += g, all_square += g * g;
          if (sees(p, j)) seen += g, seen_square += g * g;
        }
      }
      facts_.mean[k] *= all > 0 ? seen / all : 0;
      const double kept = all_square > 0 ? seen_square / all_square : 0;
      facts_.per_light[k] *= kept;
      // What clusters are off by is that their members, which shine from their own places where they are near, all
      // count as seen where one of them is: little where nothing blocks them.
      const double disputed = kept * std::max(1 - kept, kFarShare);
      for (double& v : facts_.middle[k]) v *= disputed;
      for (double& v : facts_.drawn[k]) v *= disputed;
    }
  }

  // Neighbours of a spacing in place of point clusters: what each point's interpolated visibility is off by (eq. 9,
  // 10).
  void measure_spacing(std::size_t s) {
    VplPilotFacts::Spacing& here = facts_.spacings[s];
    for (std::uint32_t p = 0; p < pilots_; ++p) {
      const std::size_t first = pilots_ + (s * pilots_ + p) * Shape::neighbours;
      const auto [share, total] = shares(p, first);
      double off = 0, squares = 0, wrong = 0, level = 0, unshadowed = 0, importance = 0;
      for (std::size_t j = 0; j < Shape::lights; ++j) {
        const double contribution =
            l_.flux_of_queried() * std::min(double{geometry(pilot(p), light(j))}, middle_bound());
        double interpolated = 0;
        bool any = false, all = true;
        for (std::size_t f = 0; f < Shape::neighbours; ++f) {
          if (!(share[f] > 0)) continue;
          const bool seen = sees(first + f, j);
          interpolated += seen ? share[f] / total : 0;
          any = any || seen;
          all = all && seen;
        }
        const bool disputed = total > 0 ? any && !all : true;
        if (any && all) interpolated = 1;  // without the shares' rounding
        const double d = (sees(p, j) ? 1 : 0) - interpolated;
        level += contribution * interpolated;
        if (any) unshadowed += contribution;
        importance += contribution * (disputed ? 1 : kAgreed);
        if (!(total > 0)) continue;
        off += contribution * d;
        squares += contribution * contribution * d * d;
        wrong += contribution * d * d / (disputed ? 1 : kAgreed);
      }
      level = std::max(level, kLeastLit * unshadowed);
      // Pairs of different lights give the error that lights have in common.
      here.coherent += weight(p) * (off * off - squares);
      here.single += weight(p) * squares * Shape::lights;
      here.disputed += weight(p) * level * wrong;
      here.queries += level > 0 ? importance / level * coverage_ / pilots_ : 0;
    }
    here.coherent = std::max(here.coherent, 0.0);
  }

  // Inverse distances to a pilot's neighbours, whose rows begin at `first`, and their sum.
  std::pair<std::array<double, Shape::neighbours>, double> shares(std::uint32_t p, std::size_t first) const {
    std::array<double, Shape::neighbours> share{};
    double total = 0;
    for (std::size_t f = 0; f < Shape::neighbours; ++f) {
      const float* q = &queried_[(first + f) * POINT_WORDS];
      if (!is_point(q)) continue;
      double d2 = 0;
      for (unsigned k = 0; k < 3; ++k) d2 += (double{q[k]} - pilot(p)[k]) * (double{q[k]} - pilot(p)[k]);
      share[f] = 1 / std::sqrt(std::max(d2, 1e-30));
      total += share[f];
    }
    return {share, total};
  }

  void pool_spacings() {
    double pooled = 0;
    for (std::size_t s = 0; s < Shape::spacings; ++s)
      pooled += facts_.spacings[s].coherent * std::pow(Shape::spacing[s], -kSpacingPower) / Shape::spacings;
    for (std::size_t s = 0; s < Shape::spacings; ++s)
      facts_.spacings[s].coherent =
          0.5 * (facts_.spacings[s].coherent + pooled * std::pow(Shape::spacing[s], kSpacingPower));
  }

  const Lights& l_;
  const std::vector<float>&points_, &queried_, &queried_lights_;
  const std::vector<float>* bits_ = nullptr;
  std::array<double, Shape::bounds> bounds_{};
  double coverage_ = 0;  // points that exist, of all
  std::uint32_t pilots_ = 0;
  std::vector<Level> levels_;
  VplPilotFacts facts_;
};

// From two chunks of samples in each of some pixels.
VplPilotFacts::Paths measure_paths(const std::vector<float>& rows, std::size_t words) {
  VplPilotFacts::Paths paths;
  const double pairs = static_cast<double>(rows.size() / (2 * words));
  double deviation = 0;
  for (std::size_t at = 0; at + 2 * words <= rows.size(); at += 2 * words) {
    for (unsigned k = 0; k < 3; ++k) {
      const double a = double{rows[at + k]} + rows[at + 3 + k];
      const double b = double{rows[at + words + k]} + rows[at + words + 3 + k];
      paths.mean += (a + b) / (2 * Shape::path_samples * 3 * pairs);
      deviation += std::abs(a - b) / (3 * pairs);
    }
  }
  // Two sums of n samples, of deviation s each, differ by 2 s sqrt(n / pi) on average.
  paths.variance = kNoiseFitted * deviation * deviation * kPi / (4 * Shape::path_samples);
  return paths;
}

}  // namespace

BatchResult choose_pilot_points(const StageTask& task) {
  host_parameters<kernels::VplPilotRowsParameters>(task);
  return counted_rows(choose_points(input_rows(task, "points", POINT_WORDS)), POINT_WORDS);
}

BatchResult choose_pilot_lights(const StageTask& task) {
  host_parameters<kernels::VplPilotRowsParameters>(task);
  const std::vector<float> rows = shining(input_rows(task, "lights", VPL_WORDS));
  return counted_rows(choose_lights(lights_of(rows)), VPL_WORDS);
}

BatchResult measure_pilot(const StageTask& task) {
  const auto p = host_parameters<VplPilotParameters>(task);
  const std::vector<float> rows = shining(input_rows(task, "lights", VPL_WORDS));
  const std::vector<float> points = input_rows(task, "points", POINT_WORDS);
  const std::vector<float> queried_points = input_rows(task, "queried_points", POINT_WORDS);
  const std::vector<float> queried_lights = input_rows(task, "queried_lights", VPL_WORDS);
  const std::vector<float> bits = input_rows(task, "visibility", Shape::lights / 32 + VISIBILITY_COUNTS);
  const std::size_t pilots = pilots_of(existing(points).size());
  const std::size_t expected = pilots * (1 + Shape::spacings * Shape::neighbours);
  if (rows.empty() || pilots == 0 || queried_points.size() != expected * POINT_WORDS ||
      queried_lights.size() != Shape::lights * VPL_WORDS ||
      bits.size() != expected * (Shape::lights / 32 + VISIBILITY_COUNTS))
    throw Error::bad_input("stage vpl_pilot", "inputs",
                           std::to_string(expected) + " queried points, " + std::to_string(Shape::lights) +
                               " queried lights, and what they see of each other",
                           std::to_string(queried_points.size() / POINT_WORDS) + " points, " +
                               std::to_string(queried_lights.size() / VPL_WORDS) + " lights");
  const Lights lights = lights_of(rows);
  VplPilotFacts facts = Pilot(lights, points, queried_points, queried_lights, p).measure(bits);
  const std::size_t path_words = sizeof(kernels::PathRecord) / 4 + 3;
  for (std::size_t k = 0; k < 2; ++k)
    facts.paths[k] = measure_paths(input_rows(task, "paths." + std::to_string(k), path_words), path_words);
  BatchResult result;
  result.counts = {0};
  set_facts(result, facts);
  return result;
}

}  // namespace gleaner::worker
