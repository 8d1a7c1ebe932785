#pragma once

#include <map>
#include <string>

#include "coordinator/film/film.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

// The bytes of an OpenEXR file: one part, scan lines, 32-bit float channels by their names, ZIP, metadata as string
// attributes. Each channel must have width * height values.
scene::Bytes encode_exr(const Film& film, const std::map<std::string, std::string>& metadata);

}  // namespace gleaner::coordinator
