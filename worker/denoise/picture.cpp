// Guides and the two halves of the samples are denoised one after the other; then each pixel becomes what its
// neighbourhood says is nearer to the truth: the mean of the two, or the samples as they were.

#include "worker/denoise/picture.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <string_view>

#include "scene/model/error.h"
#include "worker/denoise/blend.h"

namespace gleaner::worker {
namespace {

using kernels::DenoiseFacts;
using kernels::DenoiseParameters;
using kernels::DenoiseRecord;

struct Planes {
  std::span<const float> first, second, albedo, normal, share;
};

Planes planes_of(const DenoiseParameters& p, std::span<const float> values) {
  const std::size_t pixels = std::size_t{p.width} * p.height, floats = kernels::kDenoiseWords * pixels;
  if (values.size() != floats)
    throw Error::bad_input("denoising", "input film", std::to_string(floats) + " numbers",
                           std::to_string(values.size()));
  const auto odd = std::ranges::find_if_not(values, [](float value) { return std::isfinite(value); });
  if (odd != values.end())
    throw Error::bad_input("denoising", "input film, number " + std::to_string(odd - values.begin()), "a finite number",
                           std::to_string(*odd));
  const auto plane = [&](std::size_t at, std::size_t size) { return values.subspan(at * pixels, size * pixels); };
  return {plane(0, 3), plane(3, 3), plane(6, 3), plane(9, 3), plane(12, 1)};
}

template <std::size_t Size>
void put_word(char (&to)[Size], std::string_view word) {
  std::fill_n(std::copy_n(word.data(), std::min(word.size(), Size - 1), to), 1, '\0');
}

DenoisedPicture picture_of(const BlendedPicture& blended) {
  DenoisedPicture picture;
  const std::size_t pixels = blended.squared_error.size();
  picture.pixels.resize(pixels);
  DenoiseFacts& facts = picture.facts;
  for (std::size_t i = 0; i < pixels; ++i) {
    const float* const color = &blended.color[3 * i];
    picture.pixels[i] = {{color[0], color[1], color[2]}, blended.squared_error[i]};
    facts.mean += (static_cast<double>(color[0]) + color[1] + color[2]) / 3;
    facts.squared_error += blended.squared_error[i];
  }
  facts.mean /= static_cast<double>(pixels);
  facts.squared_error /= static_cast<double>(pixels);
  facts.deviation = blended.deviation;
  facts.denoised = blended.denoised;
  return picture;
}

}  // namespace

DenoisedPicture denoise_picture(const DenoiseParameters& p, std::span<const float> values, DenoiserDevice device) {
  Planes planes = planes_of(p, values);
  const auto image = [&](std::span<const float> of) { return DenoiserImage{p.width, p.height, of}; };
  Denoiser denoiser(device);
  const DenoiseQuality quality = p.quality == kernels::kDenoiseHigh ? DenoiseQuality::high : DenoiseQuality::fast;
  std::vector<float> clean_albedo, clean_normal;
  if (quality == DenoiseQuality::high) {
    clean_albedo = denoiser.prefilter("albedo", image(planes.albedo));
    clean_normal = denoiser.prefilter("normal", image(planes.normal));
    planes.albedo = clean_albedo;
    planes.normal = clean_normal;
  }
  std::vector<DenoiserImage> colors = {image(planes.first)};
  if (p.halves) colors.push_back(image(planes.second));
  std::vector<std::vector<float>> denoised =
      denoiser.denoise(colors, image(planes.albedo), image(planes.normal), quality);
  DenoisedPicture picture;
  if (p.halves) {
    picture =
        picture_of(blend({p.width, p.height, planes.first, planes.second, denoised[0], denoised[1], planes.share}));
  } else {
    BlendedPicture whole{.color = std::move(denoised[0]), .squared_error = std::vector<float>(planes.share.size())};
    whole.denoised = 1;
    picture = picture_of(whole);
  }
  put_word(picture.facts.version, denoiser.version());
  put_word(picture.facts.device, denoiser.device());
  return picture;
}

DenoisedPicture sampled_picture(const DenoiseParameters& p, std::span<const float> values, const std::string& why) {
  const Planes planes = planes_of(p, values);
  const std::span<const float> second = p.halves ? planes.second : planes.first;
  // Halves that stand for what they would be denoised make of both pictures the one that was sampled.
  DenoisedPicture picture =
      picture_of(blend({p.width, p.height, planes.first, second, planes.first, second, planes.share}));
  picture.facts.denoised = 0;
  put_word(picture.facts.why, why);
  return picture;
}

}  // namespace gleaner::worker
