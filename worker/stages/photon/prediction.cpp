#include "worker/stages/photon/prediction.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels/records.h"
#include "worker/stages/photon/clusters.h"
#include "worker/stages/splat/scalar.h"
#include "worker/stages/vectors.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// What tells of an error, each in parts of what it is: residuals of records that are left out, how records differ, and
// how light may bend within R. Fitted to the glass ball of the scene library, CornellBox-Sphere and modern-hall.
constexpr double kDeviation = 0.5, kBend = 0.5;
// Of squared reaches: who is left out by one of them has no weight, whichever way distances are rounded.
constexpr float kRounding = 1.0001f;

double squared(double x) { return x * x; }
double without(double value, double noise) { return std::sqrt(std::max(0.0, squared(value) - squared(noise))); }

double sum_of(const std::array<float, 3>& rgb) { return double{rgb[0]} + rgb[1] + rgb[2]; }
std::array<double, 3> sum_of(const std::array<float, 9>& gradients) {
  std::array<double, 3> sum{};
  for (std::size_t k = 0; k < 9; ++k) sum[k % 3] += double{gradients[k]};
  return sum;
}
void add(std::array<double, 3>& sum, const std::array<double, 3>& v, double weight) {
  for (std::size_t k = 0; k < 3; ++k) sum[k] += weight * v[k];
}

// A record is read where 1 / w is below its accuracy: as far as that times its radius.
float reach_of(const CacheRecord& record) { return record.accuracy * record.radius; }

ReachGrid grid_of_read(const std::vector<CacheRecord>& records) {
  std::vector<ReachGrid::Entry> entries;
  entries.reserve(records.size());
  for (const CacheRecord& record : records) entries.push_back({record.position, reach_of(record)});
  return ReachGrid(entries);
}

}  // namespace

ClusterPrediction::ClusterPrediction(const std::vector<CacheRecord>& records, double noise)
    : noise_(noise), records_(smoothed_records(records)), grid_(grid_of_read(records_)), left_out_(records.size()) {
  sums_.reserve(records_.size());
  extents_.reserve(records_.size());
  for (const CacheRecord& record : records_) {
    sums_.push_back({sum_of(record.irradiance), sum_of(record.rotation), sum_of(record.translation)});
    extents_.push_back({record.position, kRounding * reach_of(record) * reach_of(record)});
  }
  std::vector<Read> reads;
  for (std::uint32_t i = 0; i < records.size(); ++i) {
    check_wanted();
    LeftOut& left = left_out_[i];
    left.radius = double{records[i].radius};
    read(records[i].position, records[i].normal, i, reads);
    if (reads.empty()) continue;
    const Said others = said(reads);
    const double irradiance = sum_of(records[i].irradiance);
    left.residual = without(others.irradiance - irradiance, noise_ * irradiance);
    left.distance = others.distance;
  }
}

// As kernels/splat/read.h weighs records.
void ClusterPrediction::read(const std::array<float, 3>& position, const std::array<float, 3>& normal,
                             std::uint32_t all_but, std::vector<Read>& reads) const {
  reads.clear();
  SplatPoint point{};
  point.position = position;
  point.normal = normal;
  double weights = 0;
  grid_.near(position, [&](std::uint32_t i) {
    // A cell lists more records than reach the place.
    const Extent& extent = extents_[i];
    float apart = 0;
    for (std::size_t k = 0; k < 3; ++k)
      apart += (position[k] - extent.position[k]) * (position[k] - extent.position[k]);
    if (apart > extent.squared_reach || i == all_but) return;
    if (std::ranges::any_of(reads, [i](const Read& read) { return read.record == i; })) return;
    const CacheRecord& record = records_[i];
    const PointOffset off = point_offset(record.position, record.normal, point);
    if (off.hidden) return;
    const double error = std::max(double{off.distance} / record.radius + off.turn, double{SPLAT_LEAST_ERROR});
    const double weight = 1 / error - 1 / double{record.accuracy};
    if (!(weight > 0)) return;
    const auto& [x, y, z] = normal;
    const auto& [u, v, w] = record.normal;
    Read read{.record = i, .weight = weight, .distance = double{off.distance}, .to = {}, .turn = {}};
    for (std::size_t k = 0; k < 3; ++k) read.to[k] = double{position[k]} - record.position[k];
    read.turn = {double{v} * z - double{w} * y, double{w} * x - double{u} * z, double{u} * y - double{v} * x};
    reads.push_back(read);
    weights += weight;
  });
  for (Read& read : reads) read.weight /= weights;
}

// As kernels/splat/shade.cl, of the colours' sum.
ClusterPrediction::Said ClusterPrediction::said(std::span<const Read> reads) const {
  std::array<double, 3> rotation{}, translation{};
  for (const Read& read : reads) {
    add(rotation, sums_[read.record].rotation, read.weight);
    add(translation, sums_[read.record].translation, read.weight);
  }
  Said said;
  double squares = 0;
  for (const Read& read : reads) {
    const Sums& sums = sums_[read.record];
    const double own = dot(read.turn, sums.rotation) + dot(read.to, sums.translation);
    const double there = dot(read.turn, rotation) + dot(read.to, translation);
    const double value = sums.irradiance + (own + there) / 2;
    said.irradiance += read.weight * value;
    squares += read.weight * squared(value);
    said.distance += read.weight * read.distance;
  }
  said.deviation = std::sqrt(std::max(0.0, squares - squared(said.irradiance)));
  said.irradiance = std::max(0.0, said.irradiance);
  return said;
}

// A residual is that of a gap as wide as the record's neighbours are away; what light does beyond its gradients grows
// as the distance squared. It may also do what no record has seen: near a surface as much as R tells (Ward, Rubinstein
// & Clear 1988). Where a record is near, all this is little.
Predicted ClusterPrediction::at(const SplatPoint& point, std::vector<Read>& reads) const {
  read(point.position, point.normal, GLEANER_NONE, reads);
  Predicted predicted{.nearest = std::numeric_limits<float>::infinity()};
  if (reads.empty()) return predicted;
  const Said all = said(reads);
  double residual = 0, bend = 0;
  for (const Read& read : reads) {
    const LeftOut& left = left_out_[read.record];
    residual +=
        read.weight * left.residual * (left.distance > 0 ? std::min(1.0, squared(read.distance / left.distance)) : 1.0);
    bend += read.weight * std::min(1.0, squared(read.distance / left.radius));
    predicted.nearest = std::min(predicted.nearest, static_cast<float>(read.distance));
  }
  const double away = all.distance > 0 ? double{predicted.nearest} / all.distance : 0;
  predicted.irradiance = all.irradiance;
  predicted.off = std::hypot(residual, kDeviation * away * without(all.deviation, noise_ * all.irradiance),
                             kBend * away * bend * all.irradiance);
  return predicted;
}

}  // namespace gleaner::worker
