#include "worker/stages/splat/radiance.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <vector>

#include "worker/stages/splat/harmonics.h"

namespace gleaner::worker {
namespace {

class Projection {
 public:
  Projection(const HemisphereGrid& grid, std::span<const HemisphereSample> samples, std::uint32_t order)
      : grid_(grid),
        samples_(samples),
        order_(order),
        polar_(harmonic_pairs(order)),
        sums_(std::size_t{harmonic_pairs(order)} * RADIANCE_PAIR_WORDS) {}

  // The integral of L H over the hemisphere: a stratum's sample stands for its solid angle.
  void project() {
    const double solid_angle = 2 * std::numbers::pi / grid_.strata();
    for (const HemisphereSample& sample : samples_) {
      const double sine2 = double{sample.x} * sample.x + double{sample.y} * sample.y;
      const double sine = std::sqrt(sine2);
      hemispherical_harmonics(order_, std::sqrt(std::max(0.0, 1 - sine2)), polar_);
      const double cosine = sine > 0 ? sample.x / sine : 1, across = sine > 0 ? sample.y / sine : 0;
      add(cosine, across, sample.radiance, solid_angle, 0);
    }
  }

  // What walls between strata sweep as the place moves, times the steps of light: Krivanek, Gautron, Bouatouch &
  // Pattanaik 2005, "Improved Radiance Gradient Computation". Without the cosine of irradiance.
  void differentiate() {
    for (std::uint32_t j = 0; j < grid_.polar; ++j) {
      const double upper = 1 - j / static_cast<double>(grid_.polar), lower = upper - 1.0 / grid_.polar;
      if (j > 0) {
        hemispherical_harmonics(order_, upper, polar_);
        const double swept = 2 * std::numbers::pi / grid_.azimuthal * std::sqrt(1 - upper * upper) * upper;
        for (std::uint32_t k = 0; k < grid_.azimuthal; ++k) {
          const double phi = 2 * std::numbers::pi * (k + 0.5) / grid_.azimuthal, c = std::cos(phi), s = std::sin(phi);
          add_wall(c, s, index(j, k), index(j - 1, k), swept * c, swept * s);
        }
      }
      hemispherical_harmonics(order_, (upper + lower) / 2, polar_);
      const double swept = std::acos(lower) - std::acos(upper);
      for (std::uint32_t k = 0; k < grid_.azimuthal; ++k) {
        const double phi = 2 * std::numbers::pi * k / grid_.azimuthal, c = std::cos(phi), s = std::sin(phi);
        add_wall(c, s, index(j, k), index(j, (k + grid_.azimuthal - 1) % grid_.azimuthal), -swept * s, swept * c);
      }
    }
  }

  // No gradient per metre exceeds, in the mean over directions, 4/pi over R_k times the radiance.
  void bound(double radius) {
    for (std::size_t color = 0; color < 3; ++color) {
      double light = 0, change = 0;
      for (std::size_t i = color * 3; i < sums_.size(); i += 9) {
        light += sums_[i] * sums_[i];
        change += sums_[i + 1] * sums_[i + 1] + sums_[i + 2] * sums_[i + 2];
      }
      const double most = 4 / std::numbers::pi / radius * std::sqrt(light), length = std::sqrt(change);
      if (length <= most) continue;
      for (std::size_t i = color * 3; i < sums_.size(); i += 9) {
        sums_[i + 1] *= most / length;
        sums_[i + 2] *= most / length;
      }
    }
  }

  void write(std::span<float> to) const {
    for (std::size_t i = 0; i < sums_.size(); ++i) to[i] = static_cast<float>(sums_[i]);
  }

 private:
  std::size_t index(std::uint32_t j, std::uint32_t k) const { return std::size_t{j} * grid_.azimuthal + k; }

  void add_wall(double cosine, double sine, std::size_t to, std::size_t from, double x, double y) {
    const double nearness = double{std::max(samples_[to].nearness, samples_[from].nearness)};
    if (nearness == 0) return;
    std::array<float, 3> step;
    for (std::size_t c = 0; c < 3; ++c) step[c] = samples_[to].radiance[c] - samples_[from].radiance[c];
    add(cosine, sine, step, x * nearness, 1);
    add(cosine, sine, step, y * nearness, 2);
  }

  // Adds light times `weight` in the direction of polar_ and of this azimuth.
  void add(double cosine, double sine, const std::array<float, 3>& light, double weight, std::size_t part) {
    double c = 1, s = 0;  // of m times the azimuth
    for (std::uint32_t m = 0; m < order_; ++m) {
      for (std::uint32_t l = m; l < order_; ++l) {
        const std::size_t pair = l * (l + 1) / 2 + m;
        double* to = &sums_[pair * RADIANCE_PAIR_WORDS + part];
        for (std::size_t color = 0; color < 3; ++color) {
          const double value = polar_[pair] * weight * double{light[color]};
          to[3 * color] += value * c;
          to[9 + 3 * color] += value * s;
        }
      }
      const double next = c * cosine - s * sine;
      s = s * cosine + c * sine;
      c = next;
    }
  }

  HemisphereGrid grid_;
  std::span<const HemisphereSample> samples_;
  std::uint32_t order_;
  std::vector<double> polar_, sums_;
};

}  // namespace

void make_radiance_record(const SplatPoint& place, const HemisphereGrid& grid,
                          std::span<const HemisphereSample> samples, std::uint32_t order, std::span<float> record) {
  CacheRecord head{};
  head.position = place.position;
  head.normal = place.normal;
  head.radius = place.factor[0];
  head.accuracy = place.factor[1];
  head.level = place.level();
  std::memcpy(record.data(), &head, sizeof head);
  Projection projection(grid, samples, order);
  projection.project();
  projection.differentiate();
  projection.bound(double{head.radius});
  projection.write(record.subspan(CACHE_WORDS));
}

}  // namespace gleaner::worker
