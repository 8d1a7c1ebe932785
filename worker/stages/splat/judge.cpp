#include "worker/stages/splat/judge.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>

#include "scene/model/error.h"
#include "worker/stages/splat/scalar.h"
#include "worker/stages/splat/stages.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

// Points of each pixel that is looked at.
constexpr std::uint32_t kAskedSamples = 4;

using Color = std::array<double, 3>;

// What records say of a place, by eq. 1 and 8, as kernels/splat/shade.cl has it.
struct Reading {
  Color light{};   // irradiance
  Color noise{};   // of it: half the difference between halves of the records' rays
  Color spread{};  // variance of what each record says, without that of their noise, which no two share
};

class Reader {
 public:
  explicit Reader(std::span<const CacheRecord> records) : records_(records) {}

  // None: no record covers the place.
  std::optional<Reading> read(const std::array<float, 3>& p, const std::array<float, 3>& n) const {
    Reading sum;
    Color squares{}, noises{}, weighed{};
    double weights = 0;
    for (std::size_t k = 0; k < records_.size(); ++k) {
      const CacheRecord& r = records_[k];
      const float x = p[0] - r.position[0], y = p[1] - r.position[1], z = p[2] - r.position[2];
      const float reach = r.accuracy * r.radius * (1 + SPLAT_SLACK);
      if (!(x * x + y * y + z * z <= reach * reach)) continue;
      const std::array<float, 3>& m = r.normal;
      const float error = splat::splat_error(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], r.radius);
      if (error > r.accuracy * (1 + SPLAT_SLACK) ||
          splat::splat_is_hidden(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], SPLAT_MOST_DEPTH))
        continue;
      const float least = 1 / r.accuracy;
      const double weight = std::max(1 / error - least, SPLAT_SLACK * least);
      const std::array<double, 3> turn = {double{m[1]} * n[2] - double{m[2]} * n[1],
                                          double{m[2]} * n[0] - double{m[0]} * n[2],
                                          double{m[0]} * n[1] - double{m[1]} * n[0]};
      for (std::size_t c = 0; c < 3; ++c) {
        const auto along = [c](const std::array<float, 9>& gradient, double a, double b, double d) {
          return a * gradient[3 * c] + b * gradient[3 * c + 1] + d * gradient[3 * c + 2];
        };
        const double light =
            r.irradiance[c] + along(r.rotation, turn[0], turn[1], turn[2]) + along(r.translation, x, y, z);
        const double shown = std::max(light, 0.0), noise = double{r.noise()} * r.irradiance[c];
        sum.light[c] += weight * shown;
        sum.noise[c] += weight * noise;
        squares[c] += weight * shown * shown;
        noises[c] += weight * noise * noise;
        weighed[c] += weight * weight * noise * noise;
      }
      weights += weight;
    }
    if (!(weights > 0)) return std::nullopt;
    for (std::size_t c = 0; c < 3; ++c) {
      sum.light[c] /= weights;
      sum.noise[c] /= weights;
      sum.spread[c] =
          (squares[c] - noises[c]) / weights - sum.light[c] * sum.light[c] + weighed[c] / (weights * weights);
    }
    return sum;
  }

 private:
  std::span<const CacheRecord> records_;
};

}  // namespace

kernels::SplatJudgeFacts judge_cache(std::span<const SplatPoint> points, std::uint32_t samples,
                                     std::span<const CacheRecord> records) {
  const Reader reader(records);
  kernels::SplatJudgeFacts facts;
  for (std::size_t first = 0; first + samples <= points.size(); first += samples) {
    Color light{}, square{}, noise{}, spread{};
    for (std::size_t i = first; i < first + samples; ++i) {
      if (!points[i].exists()) continue;
      const std::optional<Reading> reading = reader.read(points[i].position, points[i].normal);
      if (!reading) continue;
      for (std::size_t c = 0; c < 3; ++c) {
        const double shown = points[i].factor[c] * reading->light[c];
        light[c] += shown / samples;
        square[c] += shown * shown / samples;
        noise[c] += points[i].factor[c] * reading->noise[c] / samples;
        spread[c] += points[i].factor[c] * points[i].factor[c] * reading->spread[c] / samples;
      }
    }
    for (std::size_t c = 0; c < 3; ++c) {
      facts.mean += light[c] / 3;
      facts.square += light[c] * light[c] / 3;
      facts.noise += noise[c] * noise[c] / 3;
      facts.spread += spread[c] / 3;
      if (samples > 1) facts.sampling += std::max(0.0, square[c] - light[c] * light[c]) / (3.0 * (samples - 1));
    }
    ++facts.pixels;
  }
  const double pixels = std::max<double>(1, static_cast<double>(facts.pixels));
  facts.mean /= pixels;
  facts.square /= pixels;
  facts.noise /= pixels;
  facts.sampling /= pixels;
  facts.spread = std::max(0.0, facts.spread / pixels);
  return facts;
}

BatchResult judge_splat_cache(const StageTask& task) {
  kernels::SplatJudgeParameters p;
  if (task.parameters.size() != sizeof p)
    throw Error::bad_input("stage splat_judge", "parameters", std::to_string(sizeof p) + " bytes",
                           std::to_string(task.parameters.size()));
  std::memcpy(&p, task.parameters.data(), sizeof p);
  if (p.samples == 0 || p.samples > SPLAT_MOST_SAMPLES)
    throw Error::bad_input("stage splat_judge", "samples", "1 to 16", std::to_string(p.samples));
  const InputRows cache(task, "cache", sizeof(CacheRecord));
  std::vector<CacheRecord> records(cache.rows());
  cache.visit(0, cache.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&records[first], piece.data(), piece.size());
  });
  const InputRows input(task, "points", sizeof(SplatPoint));
  const std::uint64_t pixels = input.rows() / p.samples, looked_at = std::min<std::uint64_t>(pixels, p.pixels);
  const std::uint32_t samples = std::min(p.samples, kAskedSamples);
  std::vector<SplatPoint> points(looked_at * samples);
  for (std::uint64_t k = 0; k < looked_at; ++k) {
    const std::uint64_t first = (2 * k + 1) * pixels / (2 * looked_at) * p.samples;
    input.visit(first, samples, [&](std::uint64_t row, std::span<const std::byte> piece) {
      std::memcpy(&points[k * samples + (row - first)], piece.data(), piece.size());
    });
  }
  kernels::SplatJudgeFacts facts = judge_cache(points, samples, records);
  facts.sampling *= static_cast<double>(samples) / p.samples;
  BatchResult result;
  result.counts = {0};
  result.facts.resize(sizeof facts);
  std::memcpy(result.facts.data(), &facts, sizeof facts);
  return result;
}

}  // namespace gleaner::worker
