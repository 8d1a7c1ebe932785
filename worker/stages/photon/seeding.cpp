#include "worker/stages/photon/seeding.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "scene/model/order.h"
#include "worker/stages/k_means.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

constexpr unsigned kLevels = 16;  // of a grid of 2^16 pixels a side

// Points of a quadtree's node follow each other along a Morton curve.
std::uint64_t morton2(std::uint32_t x, std::uint32_t y) {
  std::uint64_t code = 0;
  for (unsigned bit = 0; bit < kLevels; ++bit)
    code |= std::uint64_t{x >> bit & 1} << (2 * bit) | std::uint64_t{y >> bit & 1} << (2 * bit + 1);
  return code;
}

class Quadtree {
 public:
  Quadtree(std::span<const float> data, std::size_t stride, std::span<const ScreenPoint> points, std::uint64_t key)
      : data_(data), stride_(stride), key_(key) {
    points_.reserve(points.size());
    for (const ScreenPoint& point : points) points_.push_back({morton2(point.x, point.y), point.row});
    std::ranges::sort(points_, {}, &Point::code);
  }

  std::vector<std::uint32_t> seeds(std::uint32_t count) {
    deal(0, points_.size(), kLevels, count);
    return std::move(seeds_);
  }

 private:
  struct Point {
    std::uint64_t code;
    std::uint32_t row;
  };

  // Seeds of the node over points [first, last), whose codes agree above bit 2 * level.
  void deal(std::size_t first, std::size_t last, unsigned level, std::size_t count) {
    if (count == 0 || first == last) return;
    check_wanted();
    if (count >= last - first) {
      for (std::size_t i = first; i < last; ++i) seeds_.push_back(points_[i].row);
      return;
    }
    if (count == 1) {
      const double u = scene::unit_hash(key_ ^ points_[first].code * 0x9e3779b97f4a7c15ull ^ level);
      seeds_.push_back(points_[first + static_cast<std::size_t>(u * static_cast<double>(last - first))].row);
      return;
    }
    const std::array<std::size_t, 5> cuts = children_of(first, last, level - 1);
    std::array<double, 4> weights{};
    for (std::size_t c = 0; c < 4; ++c) weights[c] = variation(cuts[c], cuts[c + 1]);
    const auto shares = share_out(count, weights, cuts);
    for (std::size_t c = 0; c < 4; ++c) deal(cuts[c], cuts[c + 1], level - 1, shares[c]);
  }

  std::array<std::size_t, 5> children_of(std::size_t first, std::size_t last, unsigned level) const {
    std::array<std::size_t, 5> cuts{first, first, first, first, last};
    for (std::uint64_t c = 1; c < 4; ++c) {
      const auto begin = points_.begin();
      const auto cut = std::lower_bound(
          begin + static_cast<std::ptrdiff_t>(cuts[c - 1]), begin + static_cast<std::ptrdiff_t>(last), c,
          [level](const Point& p, std::uint64_t child) { return (p.code >> (2 * level) & 3) < child; });
      cuts[c] = static_cast<std::size_t>(cut - begin);
    }
    return cuts;
  }

  const float* datum(std::size_t i) const { return &data_[points_[i].row * stride_]; }

  double variation(std::size_t first, std::size_t last) const {
    if (last - first < 2) return 0;
    std::array<double, 6> sum{};
    for (std::size_t i = first; i < last; ++i)
      for (std::size_t k = 0; k < 6; ++k) sum[k] += double{datum(i)[k]};
    const auto count = static_cast<double>(last - first);
    const double length = std::sqrt(sum[3] * sum[3] + sum[4] * sum[4] + sum[5] * sum[5]);
    std::array<float, 6> mean{};
    for (std::size_t k = 0; k < 6; ++k)
      mean[k] = static_cast<float>(sum[k] / (k < 3 ? count : std::max(length, 1e-12)));
    double error = 0;
    for (std::size_t i = first; i < last; ++i)
      error += std::sqrt(cluster_error2(ClusterMetric::distance_and_normal, datum(i), mean.data()));
    return error;
  }

  // Whole numbers in proportion to the weights, as many as there are points at most; `count` in all.
  static std::array<std::size_t, 4> share_out(std::size_t count, std::array<double, 4> weights,
                                              const std::array<std::size_t, 5>& cuts) {
    std::array<std::size_t, 4> shares{};
    const auto room = [&](std::size_t c) { return cuts[c + 1] - cuts[c] - shares[c]; };
    while (count > 0) {
      double sum = 0;
      for (std::size_t c = 0; c < 4; ++c) sum += room(c) > 0 ? weights[c] : 0;
      if (!(sum > 0)) {
        for (std::size_t c = 0; c < 4; ++c) weights[c] = static_cast<double>(cuts[c + 1] - cuts[c]);
        continue;
      }
      std::array<double, 4> rest{};
      std::size_t given = 0;
      for (std::size_t c = 0; c < 4; ++c) {
        const double exact = room(c) > 0 ? static_cast<double>(count) * weights[c] / sum : 0;
        const std::size_t more = std::min({room(c), count - given, static_cast<std::size_t>(exact)});
        rest[c] = exact - static_cast<double>(more);
        shares[c] += more;
        given += more;
      }
      count -= given;
      // What is left over by rounding goes where most of it is.
      for (std::size_t turn = 0; turn < 4 && count > 0; ++turn) {
        std::size_t most = 4;
        for (std::size_t c = 0; c < 4; ++c)
          if (room(c) > 0 && rest[c] > 0 && rest[c] < 1 && (most == 4 || rest[c] > rest[most])) most = c;
        if (most == 4) break;
        rest[most] = 0;
        ++shares[most];
        --count;
      }
    }
    return shares;
  }

  std::span<const float> data_;
  std::size_t stride_;
  std::uint64_t key_;
  std::vector<Point> points_;
  std::vector<std::uint32_t> seeds_;
};

}  // namespace

std::vector<std::uint32_t> seeds_by_variation(std::span<const float> data, std::size_t stride,
                                              std::span<const ScreenPoint> points, std::uint32_t clusters,
                                              std::uint64_t key) {
  return Quadtree(data, stride, points, key).seeds(clusters);
}

}  // namespace gleaner::worker
