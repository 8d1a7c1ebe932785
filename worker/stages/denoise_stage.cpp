#include "worker/stages/denoise_stage.h"

#include <cstring>
#include <vector>

#include "kernels/denoise_records.h"
#include "scene/model/error.h"
#include "worker/denoise/picture.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::DenoiseParameters;

std::vector<float> read_film(const StageTask& task) {
  const InputRows input(task, "film", sizeof(float));
  std::vector<float> values(input.rows());
  input.visit(0, input.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&values[first], piece.data(), piece.size());
  });
  return values;
}

// A picture that cannot be denoised here is not lost: it stays as it was sampled, and says why.
DenoisedPicture denoise_or_say_why(const DenoiseParameters& p, std::span<const float> film, DenoiserDevice device) {
  try {
    return denoise_picture(p, film, device);
  } catch (const Error& error) {
    return sampled_picture(p, film, error.what());
  }
}

}  // namespace

BatchResult run_denoise_stage(const StageRun& run) {
  const double start = seconds_now();
  const auto p = run.parameters<DenoiseParameters>();
  const std::uint64_t pixels = std::uint64_t{p.width} * p.height;
  if (pixels == 0 || pixels > (1u << 28) || p.quality > kernels::kDenoiseHigh || p.halves > 1)
    throw Error::bad_input("stage denoise", "parameters", "a film of 1 to 2^28 pixels, a quality, and halves or none",
                           std::to_string(p.width) + "x" + std::to_string(p.height) + ", quality " +
                               std::to_string(p.quality) + ", halves " + std::to_string(p.halves));
  run.check_range(pixels);
  const DenoisedPicture picture =
      denoise_or_say_why(p, read_film(run.task), run.device.info().cpu ? DenoiserDevice::cpu : DenoiserDevice::fastest);
  BatchResult result;
  result.records.resize(pixels * sizeof(kernels::DenoiseRecord));
  std::memcpy(result.records.data(), picture.pixels.data(), result.records.size());
  result.facts.resize(sizeof picture.facts);
  std::memcpy(result.facts.data(), &picture.facts, sizeof picture.facts);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
