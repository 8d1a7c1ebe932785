// Lat-long environments. What published files get wrong is mended with a word: pixels that lossy compression left
// negative, suns that overflowed, windows that do not cover the picture.

#include "scene/images/environment.h"

#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>

#include "scene/files/files.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

constexpr float kLargestHalf = 65504;
// Sums over a picture of such pixels stay finite.
constexpr float kMostRadiance = 1e30f;

std::string lower_case_extension(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

// Where red, green and blue are among the channels; a single channel is grey.
struct Channels {
  int red = -1, green = -1, blue = -1;
  bool named = true;
};

Channels channels_of(const OIIO::ImageSpec& spec, const std::string& path) {
  if (spec.nchannels == 1 || (spec.nchannels == 2 && spec.channelindex("Y") >= 0)) {
    const int grey = std::max(spec.channelindex("Y"), 0);
    return {grey, grey, grey};
  }
  Channels channels{spec.channelindex("R"), spec.channelindex("G"), spec.channelindex("B")};
  if (channels.red >= 0 && channels.green >= 0 && channels.blue >= 0) return channels;
  // "ViewLayer.Combined.R": the first layer that has all three.
  for (int c = 0; c < spec.nchannels; ++c) {
    const std::string& name = spec.channelnames[static_cast<std::size_t>(c)];
    if (!name.ends_with(".R")) continue;
    const std::string layer = name.substr(0, name.size() - 1);
    channels = {c, spec.channelindex(layer + "G"), spec.channelindex(layer + "B"), false};
    if (channels.green >= 0 && channels.blue >= 0) return channels;
  }
  throw Error::bad_input(path, "channels", "R, G and B, or one", std::to_string(spec.nchannels) + " others");
}

// Deflate and run lengths never say more than 1032 bytes with one (DWA's coefficients may).
void check_promise(const OIIO::ImageSpec& spec, std::uint64_t bytes, const std::string& path) {
  constexpr std::uint64_t most = 1032;
  const std::uint64_t promised = std::uint64_t(spec.width) * std::uint64_t(spec.height) * spec.pixel_bytes(true);
  if (!std::string(spec.get_string_attribute("compression")).starts_with("dwa") && promised > most * bytes)
    throw Error::bad_input(
        path, "", "a file of as many bytes as its pixels take",
        std::to_string(bytes) + " for " + std::to_string(spec.width) + "x" + std::to_string(spec.height));
}

void check_size(const OIIO::ImageSpec& spec, const std::string& path) {
  const int side = int(kMaxEnvironmentSide);
  for (const auto& [width, height] : {std::pair(spec.width, spec.height), std::pair(spec.full_width, spec.full_height)})
    if (!(width >= 1 && width <= side && height >= 1 && height <= side))
      throw Error::bad_input(path, "", "1 to " + std::to_string(side) + " pixels a side",
                             std::to_string(width) + "x" + std::to_string(height));
  if (spec.depth > 1) throw Error::bad_input(path, "", "a flat image", "a volume");
  if (spec.deep) throw Error::bad_input(path, "", "a flat image", "a deep one");
}

// Counts what was mended.
struct Mended {
  std::size_t negative = 0, infinite = 0, not_numbers = 0;
};

void mend(float (&rgb)[3], Mended& mended) {
  bool negative = false, infinite = false, not_number = false;
  for (float& c : rgb) {
    if (std::isnan(c)) {
      not_number = true;
      c = 0;
    } else if (c < 0) {
      negative = true;
      c = 0;
    } else if (c > kMostRadiance) {
      infinite = infinite || std::isinf(c);
      c = std::isinf(c) ? kLargestHalf : kMostRadiance;
    }
  }
  mended.negative += negative;
  mended.infinite += infinite;
  mended.not_numbers += not_number;
}

void warn_of(const Mended& mended, std::size_t pixels, const std::string& path, std::vector<std::string>& warnings) {
  std::string parts;
  const auto add = [&](std::size_t count, const char* what) {
    if (count) parts += (parts.empty() ? "" : ", ") + std::to_string(count) + what;
  };
  add(mended.negative, " negative (taken as 0)");
  add(mended.not_numbers, " not numbers (taken as 0)");
  add(mended.infinite, " infinite (taken as 65504)");
  if (!parts.empty()) warnings.push_back(path + ": pixels of " + std::to_string(pixels) + ": " + parts);
}

// Turns the picture about +y by a shift of its columns, in which what lies between two of them is shared out.
void rotate(Environment& environment, double degrees) {
  const auto width = static_cast<std::size_t>(environment.width);
  double columns = std::fmod(degrees / 360, 1.0) * static_cast<double>(width);
  if (columns < 0) columns += static_cast<double>(width);
  double whole = std::floor(columns), part = columns - whole;
  if (part < 1e-4 || part > 1 - 1e-4) {
    whole = std::round(columns);
    part = 0;
  }
  const std::size_t shift = static_cast<std::size_t>(whole) % width;
  if (shift == 0 && part == 0) return;
  std::vector<float> row(3 * width);
  for (std::size_t y = 0; y < environment.height; ++y) {
    float* pixels = &environment.radiance[3 * width * y];
    std::copy(pixels, pixels + 3 * width, row.begin());
    for (std::size_t x = 0; x < width; ++x)
      for (std::size_t c = 0; c < 3; ++c) {
        const double a = row[3 * ((x + shift) % width) + c], b = row[3 * ((x + shift + 1) % width) + c];
        pixels[3 * x + c] = static_cast<float>(part == 0 ? a : (1 - part) * a + part * b);
      }
  }
}

}  // namespace

Environment import_environment(const std::string& path, const EnvironmentOptions& options,
                               std::vector<std::string>* warnings) {
  if (!std::isfinite(options.rotation_degrees))
    throw Error::usage("--environment-rotation: expected a finite number of degrees");
  if (!(options.strength >= 0 && options.strength <= 1e9))
    throw Error::usage("--environment-strength: expected a factor from 0 to 1e9");
  const std::string extension = lower_case_extension(path);
  if (extension != ".exr" && extension != ".hdr")
    throw Error::bad_input(path, "", "an environment whose name ends in .exr or .hdr");
  const std::uint64_t bytes = file_bytes(path, path, "");
  const auto reader = OIIO::ImageInput::create(extension == ".exr" ? "openexr" : "hdr");
  OIIO::ImageSpec spec;
  if (!reader || !reader->open(path, spec))
    throw Error::bad_input(path, "", "an image", reader ? reader->geterror() : OIIO::geterror());
  check_size(spec, path);
  check_promise(spec, bytes, path);
  const Channels channels = channels_of(spec, path);
  std::vector<std::string> said;
  if (!channels.named)
    said.push_back(path + ": no channels R, G and B: " + spec.channelnames[static_cast<std::size_t>(channels.red)] +
                   " and its like are taken");

  const int first = std::min({channels.red, channels.green, channels.blue});
  const int last = std::max({channels.red, channels.green, channels.blue});
  const auto stride = static_cast<std::size_t>(last - first + 1);
  if (stride > 64) throw Error::bad_input(path, "channels", "R, G and B near one another", "others between them");
  const auto width = static_cast<std::size_t>(spec.width), height = static_cast<std::size_t>(spec.height);
  std::vector<float> pixels(stride * width * height);
  if (!reader->read_image(0, 0, first, last + 1, OIIO::TypeDesc::FLOAT, pixels.data()))
    throw Error::bad_input(path, "", "an image that can be decoded", reader->geterror());

  Environment environment{std::uint32_t(spec.full_width), std::uint32_t(spec.full_height), {}};
  environment.radiance.resize(3 * std::size_t(spec.full_width) * std::size_t(spec.full_height));
  Mended mended;
  for (std::size_t y = 0; y < height; ++y)
    for (std::size_t x = 0; x < width; ++x) {
      const std::int64_t u = std::int64_t(x) + spec.x - spec.full_x, v = std::int64_t(y) + spec.y - spec.full_y;
      if (u < 0 || v < 0 || u >= spec.full_width || v >= spec.full_height) continue;
      const float* from = &pixels[stride * (y * width + x)];
      float rgb[3] = {from[channels.red - first], from[channels.green - first], from[channels.blue - first]};
      mend(rgb, mended);
      float* to = &environment.radiance[3 * (std::size_t(v) * environment.width + std::size_t(u))];
      for (int c = 0; c < 3; ++c)
        to[c] = static_cast<float>(std::min(rgb[c] * options.strength, double{kMostRadiance}));
    }
  warn_of(mended, width * height, path, said);
  if (spec.width != spec.full_width || spec.height != spec.full_height || spec.x != spec.full_x ||
      spec.y != spec.full_y)
    said.push_back(path + ": a data window of " + std::to_string(width) + "x" + std::to_string(height) +
                   " in a picture of " + std::to_string(spec.full_width) + "x" + std::to_string(spec.full_height) +
                   ": what it leaves out is black");
  rotate(environment, options.rotation_degrees);
  if (warnings) warnings->insert(warnings->end(), said.begin(), said.end());
  return environment;
}

}  // namespace gleaner::scene
