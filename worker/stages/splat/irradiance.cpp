#include "worker/stages/splat/irradiance.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "worker/stages/splat/tangent_frame.h"

namespace gleaner::worker {
namespace {

using Vec = std::array<double, 3>;
// No gradient per metre exceeds this over R_k, times the irradiance: how fast it can change where all surfaces about
// are as far away as in the mean (the split sphere of Ward, Rubinstein & Clear 1988).
constexpr double kSplitSphere = 4 / std::numbers::pi;

// Radiance as a linear function of the direction, a + b.w, that fits the samples best. What it leaves is small where
// light changes slowly, and so is the noise of what is summed over it.
struct LinearFit {
  double a = 0;
  Vec b{};

  double at(const Vec& w) const { return a + b[0] * w[0] + b[1] * w[1] + b[2] * w[2]; }
};

// Solves the 4 x 4 normal equations by elimination with pivots; false where the samples do not determine them.
bool solve(std::array<std::array<double, 5>, 4>& m) {
  for (std::size_t c = 0; c < 4; ++c) {
    std::size_t pivot = c;
    for (std::size_t r = c + 1; r < 4; ++r)
      if (std::abs(m[r][c]) > std::abs(m[pivot][c])) pivot = r;
    if (!(std::abs(m[pivot][c]) > 1e-9)) return false;
    std::swap(m[c], m[pivot]);
    for (std::size_t r = 0; r < 4; ++r) {
      if (r == c) continue;
      const double factor = m[r][c] / m[c][c];
      for (std::size_t k = c; k < 5; ++k) m[r][k] -= factor * m[c][k];
    }
  }
  for (std::size_t c = 0; c < 4; ++c) m[c][4] /= m[c][c];
  return true;
}

class Gradients {
 public:
  Gradients(const HemisphereGrid& grid, std::span<const HemisphereSample> samples, const TangentFrame& frame)
      : grid_(grid), samples_(samples), frame_(frame), directions_(samples.size()), turns_(2 * grid.azimuthal) {
    for (std::uint32_t half = 0; half < turns_.size(); ++half) {
      const double phi = 2 * std::numbers::pi * (0.5 * half) / grid.azimuthal;
      turns_[half] = {std::cos(phi), std::sin(phi)};
    }
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const double x = samples[i].x, y = samples[i].y;
      directions_[i] = {x, y, std::sqrt(std::max(0.0, 1 - x * x - y * y))};
    }
  }

  double irradiance(std::size_t color) const {
    double sum = 0;
    for (const HemisphereSample& sample : samples_) sum += double{sample.radiance[color]};
    return std::numbers::pi * sum / static_cast<double>(samples_.size());
  }

  // Half the difference between what even and odd strata say, over what they say together, of the mean of the colours.
  // Neighbours of a stratum are of the other kind, so that light that changes slowly makes none.
  double noise() const {
    double sum = 0, difference = 0;
    for (std::uint32_t j = 0; j < grid_.polar; ++j)
      for (std::uint32_t k = 0; k < grid_.azimuthal; ++k) {
        const std::array<float, 3>& light = samples_[index(j, k)].radiance;
        const double all = double{light[0]} + light[1] + light[2];
        sum += all;
        difference += (j + k) % 2 == 0 ? all : -all;
      }
    return sum > 0 ? difference / sum : 0;
  }

  // The derivative by the normal's rotation, the integral of L (n x w) dw: eq. 8 adds (n_k x n) times it. Of the
  // linear part it is known; the rest is summed over the strata, each with its part of the integral of (n x w).
  Vec rotation(std::size_t color) const {
    const LinearFit fit = fit_of(color);
    double x = -2 * std::numbers::pi / 3 * fit.b[1], y = 2 * std::numbers::pi / 3 * fit.b[0];
    const double across = 2 * std::sin(std::numbers::pi / grid_.azimuthal);  // of one azimuthal stratum's unit tangents
    for (std::uint32_t j = 0; j < grid_.polar; ++j) {
      const double theta0 = theta(j), theta1 = theta(j + 1);
      const double height = (theta1 - theta0) / 2 - (std::sin(2 * theta1) - std::sin(2 * theta0)) / 4;  // of sin^2
      for (std::uint32_t k = 0; k < grid_.azimuthal; ++k) {
        const std::size_t i = index(j, k);
        const double left = (double{samples_[i].radiance[color]} - fit.at(directions_[i])) * height * across;
        const Turn& middle = turns_[2 * k + 1];
        x -= left * middle.sine;
        y += left * middle.cosine;
      }
    }
    return frame_.world(x, y);
  }

  // Ward & Heckbert 1992, "Irradiance Gradients": what each wall between two strata sweeps as the place moves, times
  // the difference of their light. A wall is as near as the nearer of its two surfaces.
  Vec translation(std::size_t color) const {
    double x = 0, y = 0;
    for (std::uint32_t j = 0; j < grid_.polar; ++j) {
      const double sin0 = std::sqrt(j / static_cast<double>(grid_.polar)),
                   cos2 = 1 - j / static_cast<double>(grid_.polar);
      const double sine = std::sqrt((j + 0.5) / grid_.polar), cosine = std::sqrt(1 - (j + 0.5) / grid_.polar);
      const double height = std::cos(theta(j)) - std::cos(theta(j + 1));
      for (std::uint32_t k = 0; k < grid_.azimuthal; ++k) {
        const std::size_t i = index(j, k);
        if (j > 0) {
          const Turn& middle = turns_[2 * k + 1];
          const double change = 2 * std::numbers::pi / grid_.azimuthal * sin0 * cos2 * step(color, i, index(j - 1, k));
          x += middle.cosine * change;
          y += middle.sine * change;
        }
        const Turn& edge = turns_[2 * k];
        const double change =
            cosine * height / sine * step(color, i, index(j, (k + grid_.azimuthal - 1) % grid_.azimuthal));
        x -= edge.sine * change;
        y += edge.cosine * change;
      }
    }
    return frame_.world(x, y);
  }

 private:
  struct Turn {
    double cosine = 0, sine = 0;
  };
  std::size_t index(std::uint32_t j, std::uint32_t k) const { return std::size_t{j} * grid_.azimuthal + k; }
  double theta(std::uint32_t ring) const { return std::asin(std::sqrt(ring / static_cast<double>(grid_.polar))); }
  double step(std::size_t color, std::size_t to, std::size_t from) const {
    return (double{samples_[to].radiance[color]} - samples_[from].radiance[color]) *
           std::max(samples_[to].nearness, samples_[from].nearness);
  }

  LinearFit fit_of(std::size_t color) const {
    std::array<std::array<double, 5>, 4> m{};
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      const Vec& w = directions_[i];
      const double row[5] = {1, w[0], w[1], w[2], samples_[i].radiance[color]};
      for (std::size_t r = 0; r < 4; ++r)
        for (std::size_t c = 0; c < 5; ++c) m[r][c] += row[r] * row[c];
    }
    for (auto& row : m)
      for (double& value : row) value /= static_cast<double>(samples_.size());
    LinearFit fit;
    if (solve(m)) fit = {.a = m[0][4], .b = {m[1][4], m[2][4], m[3][4]}};
    return fit;
  }

  HemisphereGrid grid_;
  std::span<const HemisphereSample> samples_;
  const TangentFrame& frame_;
  std::vector<Vec> directions_;
  std::vector<Turn> turns_;  // by halves of an azimuthal stratum
};

}  // namespace

CacheRecord cache_record(const SplatPoint& place, const HemisphereGrid& grid,
                         std::span<const HemisphereSample> samples) {
  CacheRecord record{};
  record.position = place.position;
  record.normal = place.normal;
  record.radius = place.factor[0];
  record.accuracy = place.factor[1];
  record.level = place.level();
  const TangentFrame frame(place.normal);
  const Gradients gradients(grid, samples, frame);
  record.spare[CACHE_NOISE - CACHE_SPARE] = static_cast<float>(gradients.noise());
  for (std::size_t color = 0; color < 3; ++color) {
    const double irradiance = gradients.irradiance(color);
    const Vec rotation = gradients.rotation(color), translation = gradients.translation(color);
    const double length = std::hypot(translation[0], translation[1], translation[2]);
    const double most = kSplitSphere * irradiance / record.radius;
    const double scale = length > most ? most / length : 1;
    record.irradiance[color] = static_cast<float>(irradiance);
    for (std::size_t k = 0; k < 3; ++k) {
      record.rotation[3 * color + k] = static_cast<float>(rotation[k]);
      record.translation[3 * color + k] = static_cast<float>(translation[k] * scale);
    }
  }
  return record;
}

}  // namespace gleaner::worker
