#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "scene/import/files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

std::string lower_case_extension(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

}  // namespace

Environment import_environment(const std::string& path) {
  const std::string extension = lower_case_extension(path);
  if (extension != ".exr" && extension != ".hdr")
    throw Error::bad_input(path, "", "an environment whose name ends in .exr or .hdr");
  file_bytes(path, path, "");
  const auto reader = OIIO::ImageInput::create(extension == ".exr" ? "openexr" : "hdr");
  OIIO::ImageSpec spec;
  if (!reader || !reader->open(path, spec))
    throw Error::bad_input(path, "", "an image", reader ? reader->geterror() : OIIO::geterror());
  const int side = int(kMaxEnvironmentSide);
  if (!(spec.width >= 1 && spec.width <= side && spec.height >= 1 && spec.height <= side && spec.depth <= 1))
    throw Error::bad_input(path, "", "1 to " + std::to_string(side) + " pixels a side",
                           std::to_string(spec.width) + "x" + std::to_string(spec.height));
  if (spec.deep) throw Error::bad_input(path, "", "a flat image", "a deep one");
  if (spec.width != spec.full_width || spec.height != spec.full_height)
    throw Error::bad_input(path, "", "pixels for the whole display window", "a crop of it");

  // The channels called R, G, B; a single channel is grey.
  int first = 0;
  if (spec.nchannels >= 3) {
    first = spec.channelindex("R");
    if (first < 0 || spec.channelindex("G") != first + 1 || spec.channelindex("B") != first + 2)
      throw Error::bad_input(path, "channels", "R, G and B", std::to_string(spec.nchannels) + " others");
  } else if (spec.nchannels != 1) {
    throw Error::bad_input(path, "channels", "R, G and B, or one", std::to_string(spec.nchannels));
  }
  const int channels = spec.nchannels == 1 ? 1 : 3;
  Environment environment{std::uint32_t(spec.width), std::uint32_t(spec.height), {}};
  environment.radiance.resize(3 * std::size_t(spec.width) * std::size_t(spec.height));
  if (!reader->read_image(0, 0, first, first + channels, OIIO::TypeDesc::FLOAT, environment.radiance.data(),
                          3 * sizeof(float)))
    throw Error::bad_input(path, "", "an image that can be decoded", reader->geterror());
  for (std::size_t i = 0; i < environment.radiance.size(); i += 3) {
    float* rgb = &environment.radiance[i];
    if (channels == 1) rgb[1] = rgb[2] = rgb[0];
    if (std::all_of(rgb, rgb + 3, [](float x) { return std::isfinite(x) && x >= 0; })) continue;
    const std::size_t pixel = i / 3, width = environment.width;
    throw Error::bad_input(path, "pixel " + std::to_string(pixel % width) + ", " + std::to_string(pixel / width),
                           "finite radiance of at least 0",
                           std::to_string(rgb[0]) + " " + std::to_string(rgb[1]) + " " + std::to_string(rgb[2]));
  }
  return environment;
}

}  // namespace gleaner::scene
