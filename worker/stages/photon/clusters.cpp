#include "worker/stages/photon/clusters.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/records.h"
#include "worker/stages/splat/scalar.h"

namespace gleaner::worker {
namespace {

// How much farther than its own members a sample is read. More: smoother, and less of what changes fast.
constexpr float kOverlap = 2;
// Members whose normals turn farther from the sample's, or that lie farther away than so many times the others in the
// mean (rms), are strays.
constexpr float kMostTurn = 0.5f, kMostSpread = 3;
constexpr float kLeastTurn = 0.05f;
// A stray's sample: pixels that it reaches, and how far normals may turn.
constexpr float kStrayPixels = 8, kStrayTurn = 0.35f;

class Extents {
 public:
  Extents(const PointScreen& screen, std::span<const SplatPoint> points, std::span<const ClusterMember> members,
          std::vector<ClusterSample>& samples)
      : screen_(screen),
        points_(points),
        members_(members),
        samples_(samples),
        clusters_(samples.size()),
        owners_(std::size_t{screen.columns()} * screen.rows(), GLEANER_NONE) {
    for (const ClusterMember& member : members)
      owners_[std::size_t{member.screen.y} * screen.columns() + member.screen.x] = member.sample;
  }

  // By the members that are like their sample.
  void measure() {
    std::vector<double> squared(clusters_, 0);
    std::vector<std::uint32_t> count(clusters_, 0);
    for (const ClusterMember& member : members_) {
      const PointOffset off = offset(member);
      if (off.hidden || off.turn > kMostTurn) continue;
      squared[member.sample] += double{off.distance} * off.distance;
      ++count[member.sample];
    }
    for (const ClusterMember& member : members_) {
      const PointOffset off = offset(member);
      ClusterSample& sample = samples_[member.sample];
      const double most = kMostSpread * std::sqrt(squared[member.sample] / std::max(1u, count[member.sample]));
      if (off.hidden || off.turn > kMostTurn || off.distance > most) continue;
      sample.spacing = std::max(sample.spacing, off.distance);
      sample.turn = std::max(sample.turn, off.turn);
    }
    for (ClusterSample& sample : samples_) {
      const float pixel = points_[sample.point].footprint * static_cast<float>(screen_.step);
      sample.spacing = std::max(sample.spacing, pixel);
      sample.reach = kOverlap * sample.spacing;
      sample.turn = std::max(kLeastTurn, kOverlap * sample.turn);
    }
  }

  void cover_all() {
    for (std::uint32_t y = 0; y < screen_.height; ++y)
      for (std::uint32_t x = 0; x < screen_.width; ++x) {
        const std::size_t first = screen_.point_of(x, y);
        for (std::size_t i = first; i < first + screen_.samples; ++i)
          if (points_[i].exists() && !by_cluster(i, x / screen_.step, y / screen_.step)) cover_stray(i);
      }
  }

  std::uint64_t strays() const { return samples_.size() - clusters_; }

 private:
  PointOffset offset_of(const ClusterSample& sample, std::size_t point) const {
    const SplatPoint& from = points_[sample.point];
    return point_offset(from.position, from.normal, points_[point]);
  }
  PointOffset offset(const ClusterMember& member) const { return offset_of(samples_[member.sample], member.point); }

  bool covers(const ClusterSample& sample, std::size_t point) const {
    const PointOffset off = offset_of(sample, point);
    return off.distance <= sample.reach && off.turn <= sample.turn && !off.hidden;
  }

  // Whether a cluster that is seen next to the point covers it.
  bool by_cluster(std::size_t point, std::uint32_t column, std::uint32_t row) const {
    const std::uint32_t right = std::min(column + 1, screen_.columns() - 1),
                        below = std::min(row + 1, screen_.rows() - 1);
    const auto covered = [&](std::uint32_t c, std::uint32_t r) {
      const std::uint32_t owner = owners_[std::size_t{r} * screen_.columns() + c];
      return owner != GLEANER_NONE && covers(samples_[owner], point);
    };
    if (covered(column, row)) return true;
    for (std::uint32_t r = row ? row - 1 : 0; r <= below; ++r)
      for (std::uint32_t c = column ? column - 1 : 0; c <= right; ++c)
        if (covered(c, r)) return true;
    return false;
  }

  // The last strays are the nearest on the screen.
  void cover_stray(std::size_t point) {
    for (std::size_t k = samples_.size(); k > clusters_; --k)
      if (covers(samples_[k - 1], point)) return;
    samples_.push_back(stray_sample(static_cast<std::uint32_t>(point), points_[point].footprint));
  }

  PointScreen screen_;
  std::span<const SplatPoint> points_;
  std::span<const ClusterMember> members_;
  std::vector<ClusterSample>& samples_;
  std::size_t clusters_;
  std::vector<std::uint32_t> owners_;  // of the grid's pixels
};

}  // namespace

PointOffset point_offset(const std::array<float, 3>& position, const std::array<float, 3>& m, const SplatPoint& to) {
  const auto& [x, y, z] =
      std::array<float, 3>{to.position[0] - position[0], to.position[1] - position[1], to.position[2] - position[2]};
  const auto& n = to.normal;
  float turned = 0;
  for (std::size_t k = 0; k < 3; ++k) turned += (n[k] - m[k]) * (n[k] - m[k]);
  return {std::sqrt(x * x + y * y + z * z), std::sqrt(turned / 2),
          splat::splat_is_hidden(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], SPLAT_MOST_DEPTH * (1 - SPLAT_SLACK))};
}

ClusterSample stray_sample(std::uint32_t point, float footprint) {
  return {.point = point,
          .reach = kStrayPixels * footprint,
          .turn = kStrayTurn,
          .spacing = kStrayPixels / kOverlap * footprint};
}

BatchResult sample_places(const std::vector<ClusterSample>& samples, std::span<const SplatPoint> points) {
  BatchResult result;
  result.records.resize(samples.size() * sizeof(SplatPoint));
  std::byte* to = result.records.data();
  for (const ClusterSample& sample : samples) {
    SplatPoint row = points[sample.point];
    row.factor = {sample.reach, sample.turn, sample.spacing};
    std::memcpy(to, &row, sizeof row);
    to += sizeof row;
  }
  result.counts = {static_cast<std::uint32_t>(samples.size())};
  return result;
}

float median_reach(const std::vector<CacheRecord>& records) {
  std::vector<float> reaches{1e-6f};
  for (const CacheRecord& record : records) reaches.push_back(record.spare[0]);
  const auto middle = reaches.begin() + static_cast<std::ptrdiff_t>(reaches.size() / 2);
  std::nth_element(reaches.begin(), middle, reaches.end());
  return *middle;
}

std::uint64_t key_of(const GridCell& c) {
  return static_cast<std::uint64_t>(c[0]) * 73856093u ^ static_cast<std::uint64_t>(c[1]) * 19349663u ^
         static_cast<std::uint64_t>(c[2]) * 83492791u;
}

std::uint64_t extend_samples(const PointScreen& screen, std::span<const SplatPoint> points,
                             std::span<const ClusterMember> members, std::vector<ClusterSample>& samples) {
  Extents extents(screen, points, members, samples);
  extents.measure();
  extents.cover_all();
  return extents.strays();
}

}  // namespace gleaner::worker
