#include "worker/stages/photon/clusters.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/records.h"
#include "worker/stages/photon/reach_grid.h"
#include "worker/stages/splat/scalar.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

// Members whose normals turn farther from the sample's, or that lie farther away than so many times the others in the
// mean (rms), are strays.
constexpr float kMostTurn = 0.5f, kMostSpread = 3;
constexpr float kLeastTurn = 0.05f;
// A member is in a gap where the next surface ahead is nearer than this part of its cluster's spacing, and this part of
// what is ahead of its sample.
constexpr float kGapOfSpacing = 0.5f, kGapOfSample = 0.25f;
// Pixels that a sample in a gap reaches; clusters for one such sample, at least.
constexpr float kGapPixels = 1;
constexpr std::size_t kClustersOfAGap = 4;
// A stray's sample: pixels that it reaches, and how far normals may turn.
constexpr float kStrayPixels = 8, kStrayTurn = 0.35f;

class Extents {
 public:
  Extents(const PointScreen& screen, std::span<const SplatPoint> points, std::span<const ClusterMember> members,
          std::vector<ClusterSample>& samples, std::size_t kept, float most_pixels)
      : screen_(screen),
        points_(points),
        members_(members),
        samples_(samples),
        kept_(kept),
        most_pixels_(most_pixels),
        clusters_(samples.size()),
        kept_grid_(grid_of(std::span(samples).first(kept))),
        owners_(std::size_t{screen.columns()} * screen.rows(), GLEANER_NONE) {
    for (const ClusterMember& member : members)
      owners_[std::size_t{member.screen.y} * screen.columns() + member.screen.x] = member.sample;
  }

  // By the members that are like their sample.
  void measure() {
    std::vector<double> squared(clusters_, 0);
    std::vector<std::uint32_t> count(clusters_, 0);
    for (const ClusterMember& member : members_) {
      if (member.sample < kept_) continue;
      const PointOffset off = offset(member);
      if (off.hidden || off.turn > kMostTurn || off.distance > most_of(samples_[member.sample])) continue;
      squared[member.sample] += double{off.distance} * off.distance;
      ++count[member.sample];
    }
    for (const ClusterMember& member : members_) {
      if (member.sample < kept_) continue;
      const PointOffset off = offset(member);
      ClusterSample& sample = samples_[member.sample];
      const double most = std::min(kMostSpread * std::sqrt(squared[member.sample] / std::max(1u, count[member.sample])),
                                   double{most_of(sample)});
      if (off.hidden || off.turn > kMostTurn || off.distance > most) continue;
      sample.spacing = std::max(sample.spacing, off.distance);
      sample.turn = std::max(sample.turn, off.turn);
    }
    for (ClusterSample& sample : std::span(samples_).subspan(kept_)) {
      const float pixel = sample.at.footprint * static_cast<float>(screen_.step);
      sample.spacing = std::max(sample.spacing, pixel);
      sample.reach = kOverlap * sample.spacing;
      sample.turn = std::max(kLeastTurn, kOverlap * sample.turn);
    }
  }

  // Light does not come into a gap (above a lamp, below a cupboard) as it comes to what lies beside it in the same
  // plane.
  void cover_gaps(const LookAhead& look) {
    std::vector<SplatPoint> places;
    places.reserve(members_.size() + clusters_);
    for (const ClusterMember& member : members_) places.push_back(points_[member.point]);
    for (std::size_t k = 0; k < clusters_; ++k) places.push_back(samples_[k].at);
    const std::vector<float> ahead = look(places);
    std::vector<std::size_t> gaps;
    for (std::size_t i = 0; i < members_.size(); ++i) {
      const ClusterSample& sample = samples_[members_[i].sample];
      if (ahead[i] < kGapOfSpacing * sample.spacing &&
          ahead[i] < kGapOfSample * ahead[members_.size() + members_[i].sample])
        gaps.push_back(i);
    }
    const std::size_t most = std::min(gaps.size(), clusters_ / kClustersOfAGap + 1);
    for (std::size_t k = 0; k < most; ++k) cover_gap(places[gaps[k * gaps.size() / most]]);
  }

  void cover_all() {
    for (std::uint32_t y = 0; y < screen_.height; ++y)
      for (std::uint32_t x = 0; x < screen_.width; ++x) {
        const std::size_t first = screen_.point_of(x, y);
        for (std::size_t i = first; i < first + screen_.samples; ++i)
          if (points_[i].exists() && !by_cluster(points_[i], x / screen_.step, y / screen_.step) &&
              !by_kept(points_[i]))
            cover_stray(points_[i]);
      }
  }

  std::uint64_t strays() const { return samples_.size() - clusters_; }

 private:
  PointOffset offset(const ClusterMember& member) const {
    const SplatPoint& from = samples_[member.sample].at;
    return point_offset(from.position, from.normal, points_[member.point]);
  }

  float most_of(const ClusterSample& sample) const { return most_pixels_ * sample.at.footprint; }

  bool by_kept(const SplatPoint& point) const {
    bool covered = false;
    kept_grid_.near(point.position, [&](std::uint32_t i) { covered = covered || covers(samples_[i], point); });
    return covered;
  }

  // Whether a cluster that is seen next to the point covers it.
  bool by_cluster(const SplatPoint& point, std::uint32_t column, std::uint32_t row) const {
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

  // It reaches hardly more than its pixel: it says nothing of what lies beside the gap.
  void cover_gap(const SplatPoint& point) {
    for (std::size_t k = samples_.size(); k > clusters_; --k)
      if (covers(samples_[k - 1], point)) return;
    const float reach = kGapPixels * static_cast<float>(screen_.step) * point.footprint;
    samples_.push_back({.at = point, .reach = reach, .turn = kStrayTurn, .spacing = reach / kOverlap});
  }

  // The last strays are the nearest on the screen.
  void cover_stray(const SplatPoint& point) {
    for (std::size_t k = samples_.size(); k > clusters_; --k)
      if (covers(samples_[k - 1], point)) return;
    samples_.push_back(stray_sample(point));
  }

  PointScreen screen_;
  std::span<const SplatPoint> points_;
  std::span<const ClusterMember> members_;
  std::vector<ClusterSample>& samples_;
  std::size_t kept_;
  float most_pixels_;
  std::size_t clusters_;
  ReachGrid kept_grid_;
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

ClusterSample stray_sample(const SplatPoint& point) {
  return {.at = point,
          .reach = kStrayPixels * point.footprint,
          .turn = kStrayTurn,
          .spacing = kStrayPixels / kOverlap * point.footprint};
}

bool covers(const ClusterSample& sample, const SplatPoint& point, float part) {
  const PointOffset off = point_offset(sample.at.position, sample.at.normal, point);
  return off.distance <= part * sample.reach && off.turn <= part * sample.turn && !off.hidden;
}

BatchResult sample_places(const std::vector<ClusterSample>& samples) {
  BatchResult result;
  result.records.resize(samples.size() * sizeof(SplatPoint));
  std::byte* to = result.records.data();
  for (const ClusterSample& sample : samples) {
    SplatPoint row = sample.at;
    row.factor = {sample.reach, sample.turn, sample.spacing};
    std::memcpy(to, &row, sizeof row);
    to += sizeof row;
  }
  result.counts = {static_cast<std::uint32_t>(samples.size())};
  return result;
}

RecordExtent record_extent(float mean, float reach, float turn) {
  // Of the reach, and by normals that hardly turn.
  constexpr float least_radius = 0.05f, least_turn = 0.1f;
  const float radius = std::clamp(mean, least_radius * reach, reach / std::max(turn, least_turn));
  return {radius, reach / radius + turn};
}

std::vector<ClusterSample> read_samples(const StageTask& task, const std::string& name) {
  std::vector<ClusterSample> samples;
  if (!task.inputs.contains(name)) return samples;
  const InputRows input(task, name, sizeof(SplatPoint));
  samples.reserve(input.rows());
  input.visit(0, input.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += sizeof(SplatPoint)) {
      ClusterSample sample;
      std::memcpy(&sample.at, piece.data() + at, sizeof sample.at);
      sample.reach = sample.at.factor[0];
      sample.turn = sample.at.factor[1];
      sample.spacing = sample.at.factor[2];
      bool sound = sample.at.exists() && sample.reach > 0 && sample.turn > 0 && sample.spacing >= 0;
      for (std::size_t k = 0; k < 3; ++k)
        sound = sound && std::isfinite(sample.at.position[k]) && std::isfinite(sample.at.normal[k]) &&
                std::isfinite(sample.at.factor[k]);
      if (!sound) input.fail(first + at / sizeof(SplatPoint), "reach", "a place with its extents", "another");
      samples.push_back(sample);
    }
  });
  return samples;
}

std::uint64_t extend_samples(const PointScreen& screen, std::span<const SplatPoint> points,
                             std::span<const ClusterMember> members, std::vector<ClusterSample>& samples,
                             std::size_t kept, float most_pixels, const LookAhead& ahead) {
  Extents extents(screen, points, members, samples, kept, most_pixels);
  extents.measure();
  extents.cover_gaps(ahead);
  extents.cover_all();
  return extents.strays();
}

}  // namespace gleaner::worker
