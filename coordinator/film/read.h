#pragma once

#include <map>
#include <string>

#include "coordinator/film/film.h"

namespace gleaner::coordinator {

// The float and half channels of an OpenEXR file's first part, as float; the film covers the data window. Throws
// Error::bad_input naming the file where it is missing, damaged, too large (2^30 values) or has subsampled channels.
Film read_exr(const std::string& path);
// Its text attributes by name; others are left out. Throws as above.
std::map<std::string, std::string> read_exr_texts(const std::string& path);

}  // namespace gleaner::coordinator
