// Records of denoising, which runs on a worker's host. Never compiled for a device.
#ifndef GLEANER_KERNELS_DENOISE_RECORDS_H
#define GLEANER_KERNELS_DENOISE_RECORDS_H

#include "kernels/records.h"

namespace gleaner::kernels {

// Solo stage kind "denoise". An item is a pixel. Its input "film" holds planes one behind the other, of width * height
// pixels each: radiance of the first half of the samples (RGB a pixel), of the second half (RGB), albedo (RGB), normal
// (XYZ), and the first half's share of the samples (one float). Where emission that the camera sees directly is known
// apart, that of each half follows (RGB, RGB): it is taken out before and put back after. Where the samples have no
// halves, the first plane is the picture, the first one of emission likewise, and the second ones and the share are not
// read.
constexpr gl_uint kDenoiseWords = 13, kDenoiseEmissionWords = 6;  // floats a pixel

constexpr gl_uint kDenoiseFast = 0, kDenoiseHigh = 1;

struct DenoiseParameters {
  gl_uint width, height;  // pixels
  gl_uint quality;        // kDenoiseFast or kDenoiseHigh
  gl_uint halves;         // whether the samples have halves; else 0, and no error is known
  gl_uint emission;       // whether there are planes of emission
  gl_uint reserved[3];
};
GLEANER_SIZE(DenoiseParameters, 32);

struct DenoiseRecord {
  gl_float color[3];       // radiance
  gl_float squared_error;  // that `color` is expected to have, mean over the channels, smoothed over neighbours; or 0
};
GLEANER_SIZE(DenoiseRecord, 16);

// What the plan is told.
struct DenoiseFacts {
  char version[16];      // of the library, ends with 0; empty: the picture is not denoised
  char device[16];       // that it ran on: "CPU", "CUDA", ...
  char why[256];         // it is not denoised; ends with 0
  double squared_error;  // mean over pixels and channels
  double deviation;      // standard deviation of that estimate
  double mean;           // radiance, mean over pixels and channels
  double denoised;       // share of the picture that is denoised, the rest is as it was sampled
};
GLEANER_SIZE(DenoiseFacts, 320);

}  // namespace gleaner::kernels

#endif
