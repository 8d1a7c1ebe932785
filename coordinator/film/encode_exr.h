#pragma once

#include <map>
#include <string>

#include "coordinator/film/film.h"
#include "proto/atomic_file.h"

namespace gleaner::coordinator {

// Writes the bytes of an OpenEXR file: one part, scan lines, 32-bit float channels by their names, ZIP, metadata as
// string attributes. Each channel must have width * height values. Of the file no more than a few chunks of 16 rows a
// thread are in memory. Throws what `file` throws; it is not committed.
void encode_exr(const Film& film, const std::map<std::string, std::string>& metadata, AtomicFile& file);

}  // namespace gleaner::coordinator
