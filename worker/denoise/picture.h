#pragma once
// A picture denoised, with its error: what stage "denoise" and `gleaner denoise` do.

#include <span>
#include <vector>

#include "kernels/denoise_records.h"
#include "worker/denoise/denoiser.h"

namespace gleaner::worker {

struct DenoisedPicture {
  std::vector<kernels::DenoiseRecord> pixels;
  kernels::DenoiseFacts facts{};
};

// `planes`: width * height * kDenoiseWords floats (kernels/denoise_records.h). Throws Error::bad_input for another
// number of them or one that is not finite; Error::failed where the library is not there or fails.
DenoisedPicture denoise_picture(const kernels::DenoiseParameters& parameters, std::span<const float> planes,
                                DenoiserDevice device);
// The same picture as it was sampled, and the error that it has. `why` it is not denoised goes into its facts.
DenoisedPicture sampled_picture(const kernels::DenoiseParameters& parameters, std::span<const float> planes,
                                const std::string& why);

}  // namespace gleaner::worker
