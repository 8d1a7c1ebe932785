#include "coordinator/plan/denoised_film.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

constexpr const char* kColor[] = {"R", "G", "B"};
constexpr const char* kAxis[] = {"X", "Y", "Z"};

const std::vector<float>* values_of(const Film& film, const std::string& name) {
  const Channel* channel = film.find(name);
  return channel ? &channel->values : nullptr;
}

void require_finite(const Film& film, const std::string& layer, const std::string& name) {
  const Channel* channel = film.find(layer);
  if (!channel) return;
  const auto odd = std::ranges::find_if_not(channel->values, [](float value) { return std::isfinite(value); });
  if (odd == channel->values.end()) return;
  const auto pixel = static_cast<std::size_t>(odd - channel->values.begin());
  throw Error::bad_input(
      name,
      "layer " + layer + ", pixel " + std::to_string(pixel % film.width) + "," + std::to_string(pixel / film.width),
      "a finite number", std::to_string(*odd));
}

// Three channels as a plane of the denoiser's, pixel by pixel.
float* interleave(const Film& film, const std::string& layer, const char* const (&names)[3], float* to) {
  for (std::size_t k = 0; k < 3; ++k)
    if (const std::vector<float>* values = values_of(film, layer + names[k]))
      for (std::size_t i = 0; i < values->size(); ++i) to[3 * i + k] = (*values)[i];
  return to + std::size_t{3} * film.width * film.height;
}

// What is left of the picture when the first half's share is taken out.
void put_second_half(const Film& film, const std::string& picture, const float* first, const std::vector<float>& share,
                     float* second) {
  for (std::size_t k = 0; k < 3; ++k) {
    const std::vector<float>& all = *values_of(film, picture + kColor[k]);
    for (std::size_t i = 0; i < all.size(); ++i) {
      const float of_first = first[3 * i + k], rest = 1 - share[i];
      second[3 * i + k] = rest > 0 ? (all[i] - share[i] * of_first) / rest : of_first;
    }
  }
}

}  // namespace

DenoiserInput denoiser_input(const Film& film, const std::string& name) {
  const std::string picture = film.find("noisy.R") ? "noisy." : "";
  for (const char* color : kColor)
    if (!film.find(picture + color))
      throw Error::bad_input(name, "layers", "a picture in layers R, G and B", "no layer " + picture + color);
  for (const char* color : kColor)
    for (const std::string& layer : {picture, std::string("half."), std::string("albedo."), std::string("emission."),
                                     std::string("half.emission.")})
      require_finite(film, layer + color, name);
  for (const char* axis : kAxis) require_finite(film, std::string("normal.") + axis, name);
  require_finite(film, "half.A", name);
  const std::vector<float>* share = values_of(film, "half.A");
  const auto colored = [&](const std::string& layer) {
    return std::ranges::all_of(kColor, [&](const char* color) { return film.find(layer + color); });
  };
  const bool halves = share && colored("half.");
  const bool emission = colored("emission.") && (!halves || colored("half.emission."));
  const std::size_t pixels = std::size_t{film.width} * film.height;
  const std::size_t words = kernels::kDenoiseWords + (emission ? kernels::kDenoiseEmissionWords : 0);
  auto bytes = std::make_shared<scene::Bytes>(pixels * words * sizeof(float));
  auto* const first = reinterpret_cast<float*>(bytes->data());
  float* const second = interleave(film, halves ? "half." : picture, kColor, first);
  if (halves) put_second_half(film, picture, first, *share, second);
  float* to = interleave(film, "albedo.", kColor, second + 3 * pixels);
  to = interleave(film, "normal.", kAxis, to);
  if (halves) std::ranges::copy(*share, to);
  if (emission) {
    float* const seen = to + pixels;
    to = interleave(film, halves ? "half.emission." : "emission.", kColor, seen);
    if (halves) put_second_half(film, "emission.", seen, *share, to);
  }
  return {std::move(bytes), halves, emission};
}

void check_denoised(std::span<const kernels::DenoiseRecord> records, const std::string& where) {
  for (std::size_t i = 0; i < records.size(); ++i)
    if (const kernels::DenoiseRecord& r = records[i]; !std::isfinite(r.color[0] + r.color[1] + r.color[2]) ||
                                                      !(r.squared_error >= 0) || !std::isfinite(r.squared_error))
      throw Error::failed(where + ", item " + std::to_string(i) + ": a colour or an error that is no number");
}

void show_denoised(Film& film, std::span<const kernels::DenoiseRecord> records, bool halves) {
  const std::size_t pixels = std::size_t{film.width} * film.height;
  if (records.size() != pixels)
    throw Error::failed("denoising: " + std::to_string(records.size()) + " records, expected " +
                        std::to_string(pixels));
  check_denoised(records, "denoising");
  const bool before = film.find("noisy.R") != nullptr;
  for (std::size_t k = 0; k < 3; ++k) {
    if (!before) {
      std::vector<float> raw = *values_of(film, kColor[k]);  // a new channel may move those that are there
      film.channel(std::string("noisy.") + kColor[k]).values = std::move(raw);
    }
    std::vector<float>& values = film.channel(kColor[k]).values;
    for (std::size_t i = 0; i < pixels; ++i) values[i] = records[i].color[k];
  }
  if (!halves) return;
  std::vector<float>& error = film.channel("error.Y").values;
  for (std::size_t i = 0; i < pixels; ++i) error[i] = records[i].squared_error;
}

}  // namespace gleaner::coordinator
