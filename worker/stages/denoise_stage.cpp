#include "worker/stages/denoise_stage.h"

#include <cstring>
#include <span>

#include "kernels/denoise_records.h"
#include "scene/model/error.h"
#include "worker/denoise/picture.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

using kernels::DenoiseParameters;

// A picture that cannot be denoised here is not lost: it stays as it was sampled, and says why.
DenoisedPicture denoise_or_say_why(const DenoiseParameters& p, std::span<const float> film, DenoiserDevice device) {
  try {
    return denoise_picture(p, film, device);
  } catch (const Error& error) {
    check_wanted();
    return sampled_picture(p, film, error.what());
  }
}

}  // namespace

BatchResult run_denoise_stage(const StageRun& run) {
  const double start = seconds_now();
  const auto p = run.parameters<DenoiseParameters>();
  const std::uint64_t pixels = std::uint64_t{p.width} * p.height;
  if (pixels == 0 || pixels > (1u << 28) || p.quality > kernels::kDenoiseHigh || p.halves > 1 || p.emission > 1)
    throw Error::bad_input(
        "stage denoise", "parameters", "a film of 1 to 2^28 pixels, a quality, and halves and emission or none",
        std::to_string(p.width) + "x" + std::to_string(p.height) + ", quality " + std::to_string(p.quality) +
            ", halves " + std::to_string(p.halves) + ", emission " + std::to_string(p.emission));
  run.check_range(pixels);
  const DenoisedPicture picture = denoise_or_say_why(
      p, input_rows(run.task, "film", 1), run.device.info().cpu ? DenoiserDevice::cpu : DenoiserDevice::fastest);
  BatchResult result;
  result.records.resize(pixels * sizeof(kernels::DenoiseRecord));
  std::memcpy(result.records.data(), picture.pixels.data(), result.records.size());
  set_facts(result, picture.facts);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
