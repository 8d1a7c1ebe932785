#include "coordinator/film/write.h"

#include <png.h>

#include <array>
#include <bit>
#include <cmath>
#include <set>
#include <span>

#include "coordinator/blobs/sha256.h"
#include "coordinator/film/encode_exr.h"
#include "proto/atomic_file.h"
#include "scene/model/error.h"

static_assert(std::endian::native == std::endian::little, "pixels_sha256 takes the values as they lie");

namespace gleaner::coordinator {
namespace {

std::string size_of(const Film& film) { return std::to_string(film.width) + "x" + std::to_string(film.height); }

void require_whole(const Film& film) {
  if (film.width == 0 || film.height == 0) throw Error::failed("film: expected pixels, found " + size_of(film));
  std::set<std::string> names;
  for (const auto& channel : film.channels) {
    if (channel.values.size() != std::size_t{film.width} * film.height)
      throw Error::failed("film: channel " + channel.name + ": expected " + size_of(film) + " values, found " +
                          std::to_string(channel.values.size()));
    if (!names.insert(channel.name).second)
      throw Error::failed("film: channel " + channel.name + " stands there twice");
  }
}

std::array<const float*, 3> rgb(const Film& film) {
  require_whole(film);
  std::array<const float*, 3> planes;
  for (int c = 0; c < 3; ++c) {
    const Channel* channel = film.find(std::string(1, "RGB"[c]));
    if (!channel) throw Error::failed(std::string("film: expected a channel ") + "RGB"[c] + ", found none");
    planes[c] = channel->values.data();
  }
  return planes;
}

std::uint8_t srgb8(double linear) {
  if (!(linear > 0)) return 0;  // accept form: what is not a number is black
  if (linear >= 1) return 255;
  const double encoded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(255 * encoded));
}

}  // namespace

void write_exr(const Film& film, const std::map<std::string, std::string>& metadata, const std::string& path) {
  require_whole(film);
  AtomicFile file(path);
  try {
    encode_exr(film, metadata, file);
  } catch (const Error&) {
    throw;  // it names the file
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    throw Error::failed(path + ": cannot be formed: " + error.what());
  }
  file.commit();
}

namespace {

// Of 3 bytes a pixel.
scene::Bytes png_of(const Film& film, const void* values) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = film.width;
  image.height = film.height;
  image.format = PNG_FORMAT_RGB;
  image.flags = PNG_IMAGE_FLAG_FAST;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(image);
  scene::Bytes bytes(size);
  if (!png_image_write_to_memory(&image, bytes.data(), &size, 0, values, 0, nullptr))
    throw Error::failed("PNG of " + size_of(film) + ": " + image.message);
  bytes.resize(size);
  return bytes;
}

}  // namespace

scene::Bytes encode_png(const Film& film, double exposure_stops) {
  const auto planes = rgb(film);
  const double scale = std::exp2(exposure_stops);
  const std::size_t pixels = std::size_t{film.width} * film.height;
  std::vector<std::uint8_t> values(3 * pixels);
  for (std::size_t i = 0; i < pixels; ++i)
    for (std::size_t c = 0; c < 3; ++c) values[3 * i + c] = srgb8(scale * double{planes[c][i]});
  return png_of(film, values.data());
}

scene::Bytes encode_fast_png(const Film& film, double exposure_stops) {
  return png_of(film, encode_rgb8(film, exposure_stops).data());
}

scene::Bytes encode_rgb8(const Film& film, double exposure_stops) {
  constexpr std::size_t steps = 16384;  // sRGB is steepest at black: 0.2 of a value a step
  static const std::vector<std::uint8_t> table = [] {
    std::vector<std::uint8_t> values(steps + 1);
    for (std::size_t k = 0; k <= steps; ++k) values[k] = srgb8(static_cast<double>(k) / steps);
    return values;
  }();
  const auto planes = rgb(film);
  const auto scale = static_cast<float>(std::exp2(exposure_stops) * steps);
  const std::size_t pixels = std::size_t{film.width} * film.height;
  scene::Bytes bytes(3 * pixels);
  for (std::size_t i = 0; i < pixels; ++i)
    for (std::size_t c = 0; c < 3; ++c) {
      const float x = scale * planes[c][i];
      const std::size_t at = x > 0 ? x < static_cast<float>(steps) ? static_cast<std::size_t>(x + 0.5f) : steps : 0;
      bytes[3 * i + c] = static_cast<std::byte>(table[at]);
    }
  return bytes;
}

void write_png(const Film& film, const std::string& path, double exposure_stops) {
  write_atomically(path, encode_png(film, exposure_stops));
}

std::string pixels_sha256(const Film& film) {
  const auto planes = rgb(film);
  Sha256 hash;
  std::vector<float> row(3 * std::size_t{film.width});
  for (std::size_t y = 0; y < film.height; ++y) {
    for (std::size_t x = 0; x < film.width; ++x)
      for (std::size_t c = 0; c < 3; ++c) row[3 * x + c] = planes[c][y * film.width + x];
    hash.update(std::as_bytes(std::span(row)));
  }
  return hash.hex();
}

}  // namespace gleaner::coordinator
