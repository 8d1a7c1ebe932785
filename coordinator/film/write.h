#pragma once
// The film's way to disk. Every file is written atomically (atomic_file.h): on failure an older file stands untouched
// and Error::failed names the path and the reason. A film whose channels do not have width * height values, or that
// lacks a channel which is needed, is Error::failed as well.

#include <map>
#include <string>

#include "coordinator/film/film.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

// OpenEXR: one part, 32-bit float channels by their names, ZIP, metadata as string attributes.
void write_exr(const Film& film, const std::map<std::string, std::string>& metadata, const std::string& path);

// 8-bit sRGB picture of R, G, B times 2^exposure_stops, clamped to [0, 1]; what is not a number is black.
scene::Bytes encode_png(const Film& film, double exposure_stops);
// The same picture without a file around it: 3 bytes a pixel, row by row from the top; a value may differ by one.
scene::Bytes encode_rgb8(const Film& film, double exposure_stops);
scene::Bytes encode_fast_png(const Film& film, double exposure_stops);  // a PNG of these values
void write_png(const Film& film, const std::string& path, double exposure_stops);

// Hexadecimal SHA-256 of the 32-bit little-endian values R, G, B of each pixel, row by row from the top.
std::string pixels_sha256(const Film& film);

}  // namespace gleaner::coordinator
