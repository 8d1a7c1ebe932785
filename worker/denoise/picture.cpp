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
  std::span<const float> first_emission, second_emission;  // empty: none is known
};

Planes planes_of(const DenoiseParameters& p, std::span<const float> values) {
  const std::size_t pixels = std::size_t{p.width} * p.height,
                    words = kernels::kDenoiseWords + (p.emission ? kernels::kDenoiseEmissionWords : 0),
                    floats = words * pixels;
  if (values.size() != floats)
    throw Error::bad_input("denoising", "input film", std::to_string(floats) + " numbers",
                           std::to_string(values.size()));
  const auto odd = std::ranges::find_if_not(values, [](float value) { return std::isfinite(value); });
  if (odd != values.end())
    throw Error::bad_input("denoising", "input film, number " + std::to_string(odd - values.begin()), "a finite number",
                           std::to_string(*odd));
  const auto plane = [&](std::size_t at, std::size_t size) { return values.subspan(at * pixels, size * pixels); };
  return {.first = plane(0, 3),
          .second = plane(3, 3),
          .albedo = plane(6, 3),
          .normal = plane(9, 3),
          .share = plane(12, 1),
          .first_emission = p.emission ? plane(13, 3) : values.first(0),
          .second_emission = p.emission ? plane(16, 3) : values.first(0)};
}

// `factor` times the emission added to a picture.
std::vector<float> with_emission(std::span<const float> picture, std::span<const float> emission, float factor) {
  std::vector<float> values(picture.begin(), picture.end());
  for (std::size_t i = 0; i < emission.size(); ++i) values[i] += factor * emission[i];
  return values;
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
  // Emission that is seen directly has no noise but that of edges, which a denoiser would blur.
  std::vector<std::vector<float>> reflected = {with_emission(planes.first, planes.first_emission, -1)};
  if (p.halves) reflected.push_back(with_emission(planes.second, planes.second_emission, -1));
  std::vector<DenoiserImage> colors;
  for (const std::vector<float>& color : reflected) colors.push_back(image(color));
  std::vector<std::vector<float>> denoised =
      denoiser.denoise(colors, image(planes.albedo), image(planes.normal), quality);
  denoised[0] = with_emission(denoised[0], planes.first_emission, 1);
  if (p.halves) denoised[1] = with_emission(denoised[1], planes.second_emission, 1);
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
