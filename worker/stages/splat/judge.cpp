#include "worker/stages/splat/judge.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>

#include "scene/model/error.h"
#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

// Points of each pixel that is looked at.
constexpr std::uint32_t kAskedSamples = 4;

using splat::Color;

// What records say of a place together.
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
    for (const CacheRecord& record : records_) {
      const double weight = splat::record_weight(record, p, n);
      if (!(weight > 0)) continue;
      const Color light = splat::record_light(record, p, n), noise = splat::record_noise(record);
      for (std::size_t c = 0; c < 3; ++c) {
        const double shown = std::max(light[c], 0.0);
        sum.light[c] += weight * shown;
        sum.noise[c] += weight * noise[c];
        squares[c] += weight * shown * shown;
        noises[c] += weight * noise[c] * noise[c];
        weighed[c] += weight * weight * noise[c] * noise[c];
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
  const auto p = host_parameters<kernels::SplatJudgeParameters>(task);
  if (p.samples == 0 || p.samples > SPLAT_MOST_SAMPLES)
    throw Error::bad_input("stage splat_judge", "samples", "1 to 16", std::to_string(p.samples));
  std::vector<CacheRecord> records;
  append_records(task, "cache", records);
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
  set_facts(result, facts);
  return result;
}

}  // namespace gleaner::worker
