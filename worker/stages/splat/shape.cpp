// Stage kind "splat_shape": places whose light was gathered, with what its Hessians say of how far it holds. Solo, on
// the host.

#include "worker/stages/splat/shape.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "scene/model/error.h"
#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/record_grid.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/splat/tangent_frame.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

// A record ends where the second derivative changes its light by this part of a^2: for equal errors that takes two
// thirds of the records that mean distances take (docs/explanation/splat.md).
constexpr double kError = 0.5;
// A Hessian knows what rays met, and light alone: no record reaches farther than so many times the mean distance.
constexpr double kMostGrowth = 2;
// Neighbours whose Hessians count are as far as so many times the reach by mean distances: with 2, a tenth fewer
// records err by a sixth more.
constexpr float kMeanStretch = 1;

// The mean Hessian over records about one, relative to their mean light: one alone is noisy.
class MeanHessians {
 public:
  explicit MeanHessians(std::span<const CacheRecord> records) : records_(records), grid_(records, kMeanStretch) {}

  TangentMatrix at(std::uint32_t i) const {
    const CacheRecord& here = records_[i];
    WorldMatrix sum{};
    double light = 0;
    const auto weight_of = [&](std::uint32_t k) {
      const CacheRecord& record = records_[k];
      return record.level == here.level ? splat::record_weight(record, here.position, here.normal, kMeanStretch) : 0;
    };
    for (const auto& [k, weight] : grid_.near(here.position, weight_of)) {
      const CacheRecord& record = records_[k];
      // 1 at its own place, 0 where its reach ends.
      const double least = 1 / (kMeanStretch * double{record.accuracy}), share = weight / (weight + least);
      const double bright = share * (double{record.irradiance[0]} + record.irradiance[1] + record.irradiance[2]);
      const WorldMatrix matrix = in_world(record.normal, {record.hessian[0], record.hessian[1], record.hessian[2]});
      for (std::size_t c = 0; c < sum.size(); ++c) sum[c] += bright * matrix[c];
      light += bright;
    }
    if (!(light > 0)) return {};
    for (double& value : sum) value /= light;
    return in_plane(here.normal, sum);
  }

 private:
  std::span<const CacheRecord> records_;
  splat::RecordGrid grid_;
};

// Eigenvalues, the greater first, and the first one's vector.
struct Axes {
  double first, second, cosine, sine;
};

Axes axes_of(const TangentMatrix& m) {
  const double mean = (m[0] + m[2]) / 2, half = (m[0] - m[2]) / 2, root = std::hypot(half, m[1]);
  const double angle = std::atan2(m[1], half) / 2;
  return {mean + root, mean - root, std::cos(angle), std::sin(angle)};
}

// The matrix of the eigenvalues' magnitudes.
TangentMatrix magnitude(const TangentMatrix& m) {
  const Axes axes = axes_of(m);
  const double a = std::abs(axes.first), b = std::abs(axes.second), c = axes.cosine, s = axes.sine;
  return {a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c};
}

}  // namespace

WorldMatrix in_world(const std::array<float, 3>& normal, const TangentMatrix& m) {
  const TangentFrame f(normal);
  const auto at = [&](std::size_t i, std::size_t j) {
    return m[0] * f.s[i] * f.s[j] + m[1] * (f.s[i] * f.t[j] + f.t[i] * f.s[j]) + m[2] * f.t[i] * f.t[j];
  };
  return {at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)};
}

TangentMatrix in_plane(const std::array<float, 3>& normal, const WorldMatrix& m) {
  const TangentFrame f(normal);
  const auto product = [&](const TangentFrame::Vec& a, const TangentFrame::Vec& b) {
    return a[0] * (m[0] * b[0] + m[1] * b[1] + m[2] * b[2]) + a[1] * (m[1] * b[0] + m[3] * b[1] + m[4] * b[2]) +
           a[2] * (m[2] * b[0] + m[4] * b[1] + m[5] * b[2]);
  };
  return {product(f.s, f.s), product(f.s, f.t), product(f.t, f.t)};
}

ShapeBounds shape_bounds(float least_pixels, float most_pixels, float pixel, float mean) {
  const double least = double{least_pixels} * pixel;
  return {least, std::max(least, std::min(double{most_pixels} * pixel, kMostGrowth * mean))};
}

RecordShape shape_of(const TangentMatrix& metric, const ShapeBounds& bounds) {
  const Axes axes = axes_of(metric);
  const auto half_axis = [&](double value) {
    return std::clamp(1 / std::sqrt(std::max(value, 1e-30)), bounds.least, bounds.most);
  };
  const double narrow = half_axis(axes.first), wide = half_axis(axes.second);
  const double excess = std::sqrt(std::max(0.0, wide / narrow * (wide / narrow) - 1));
  return {static_cast<float>(wide), {static_cast<float>(excess * axes.cosine), static_cast<float>(excess * axes.sine)}};
}

WorldMatrix metric_of(const std::array<float, 3>& normal, const RecordShape& shape) {
  const TangentFrame::Vec narrow = splat::narrow_of(normal, shape.narrow);
  const double scale = 1 / (double{shape.radius} * shape.radius);
  const auto at = [&](std::size_t i, std::size_t j) { return scale * ((i == j) + narrow[i] * narrow[j]); };
  return {at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)};
}

void shape_places(const ShapeSettings& settings, std::span<SplatPlace> places, std::span<const CacheRecord> records) {
  const MeanHessians hessians(records);
  for (std::uint32_t i = 0; i < places.size(); ++i) {
    SplatPlace& place = places[i];
    // Light is off by E M / 2 d^2 at a distance d: that is kError a^2 E where d is a R.
    TangentMatrix metric = magnitude(hessians.at(i));
    for (double& value : metric) value /= 2 * kError;
    const ShapeBounds bounds =
        shape_bounds(settings.least_radius, settings.most_radius, place.point.footprint, place.point.factor[2]);
    const RecordShape shape = shape_of(metric, bounds);
    place.point.factor[0] = shape.radius;
    place.narrow = shape.narrow;
    place.shaped = 1;
  }
}

BatchResult shape_splat_places(const StageTask& task) {
  const auto p = host_parameters<kernels::SplatShapeParameters>(task);
  if (!(p.least_radius > 0) || !(p.most_radius >= p.least_radius) || !std::isfinite(p.most_radius))
    throw Error::bad_input("stage splat_shape", "radii", "pixels above 0", std::to_string(p.least_radius));
  std::vector<CacheRecord> records;
  append_records(task, "records", records);
  std::vector<SplatPlace> places = places_of(task, records);
  shape_places({.least_radius = p.least_radius, .most_radius = p.most_radius}, places, records);
  BatchResult result;
  result.records.resize(places.size() * sizeof(SplatPlace));
  if (!places.empty()) std::memcpy(result.records.data(), places.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(places.size())};
  return result;
}

}  // namespace gleaner::worker
