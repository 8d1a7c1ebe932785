// Guides and the two halves of the samples are denoised one after the other; then each pixel becomes what its
// neighbourhood says is nearer to the truth: the mean of the two, or the samples as they were.

#include "worker/stages/denoise_stage.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "kernels/denoise_records.h"
#include "scene/model/error.h"
#include "worker/denoise/blend.h"
#include "worker/denoise/denoiser.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::DenoiseFacts;
using kernels::DenoiseParameters;
using kernels::DenoiseRecord;

std::vector<float> read_film(const StageTask& task, std::size_t pixels) {
  const InputRows input(task, "film", sizeof(float));
  const std::size_t floats = kernels::kDenoiseWords * pixels;
  if (input.rows() != floats)
    throw Error::bad_input("stage denoise", "input film", std::to_string(floats) + " numbers",
                           std::to_string(input.rows()));
  std::vector<float> values(floats);
  input.visit(0, input.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&values[first], piece.data(), piece.size());
  });
  const auto odd = std::ranges::find_if_not(values, [](float value) { return std::isfinite(value); });
  if (odd != values.end())
    throw Error::bad_input("stage denoise", "input film, number " + std::to_string(odd - values.begin()),
                           "a finite number", std::to_string(*odd));
  return values;
}

BatchResult result_of(const BlendedPicture& picture, const Denoiser& denoiser) {
  BatchResult result;
  const std::size_t pixels = picture.squared_error.size();
  result.records.resize(pixels * sizeof(DenoiseRecord));
  DenoiseFacts facts{};
  std::snprintf(facts.version, sizeof facts.version, "%s", denoiser.version().c_str());
  std::snprintf(facts.device, sizeof facts.device, "%s", denoiser.device().c_str());
  facts.denoised = picture.denoised;
  for (std::size_t i = 0; i < pixels; ++i) {
    DenoiseRecord record{};
    std::copy_n(&picture.color[3 * i], 3, record.color);
    record.squared_error = picture.squared_error[i];
    std::memcpy(&result.records[i * sizeof record], &record, sizeof record);
    facts.squared_error += record.squared_error;
    facts.mean += (static_cast<double>(record.color[0]) + record.color[1] + record.color[2]) / 3;
  }
  facts.squared_error /= static_cast<double>(pixels);
  facts.mean /= static_cast<double>(pixels);
  result.facts.resize(sizeof facts);
  std::memcpy(result.facts.data(), &facts, sizeof facts);
  return result;
}

}  // namespace

BatchResult run_denoise_stage(const StageRun& run) {
  const double start = seconds_now();
  const auto p = run.parameters<DenoiseParameters>();
  const std::uint64_t pixels = std::uint64_t{p.width} * p.height;
  if (pixels == 0 || pixels > (1u << 28) || p.quality > kernels::kDenoiseHigh)
    throw Error::bad_input("stage denoise", "parameters", "a film of 1 to 2^28 pixels and a quality",
                           std::to_string(p.width) + "x" + std::to_string(p.height));
  run.check_range(pixels);
  const std::vector<float> film = read_film(run.task, pixels);
  const auto plane = [&](std::size_t first, std::size_t size) {
    return std::span(film).subspan(first * pixels, size * pixels);
  };
  const std::span<const float> first = plane(0, 3), second = plane(3, 3);
  const auto image = [&](std::span<const float> values) { return DenoiserImage{p.width, p.height, values}; };

  Denoiser denoiser(run.device.info().cpu ? DenoiserDevice::cpu : DenoiserDevice::fastest);
  const bool clean = p.quality == kernels::kDenoiseHigh;
  std::vector<float> albedo, normal;
  if (clean) {
    albedo = denoiser.prefilter("albedo", image(plane(6, 3)));
    normal = denoiser.prefilter("normal", image(plane(9, 3)));
  }
  const auto denoised = [&](std::span<const float> color) {
    return denoiser.denoise(image(color), image(clean ? std::span<const float>(albedo) : plane(6, 3)),
                            image(clean ? std::span<const float>(normal) : plane(9, 3)), clean,
                            clean ? DenoiseQuality::high : DenoiseQuality::fast);
  };
  const std::vector<float> of_first = denoised(first), of_second = denoised(second);
  BatchResult result =
      result_of(blend({p.width, p.height, first, second, of_first, of_second, plane(12, 1)}), denoiser);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
