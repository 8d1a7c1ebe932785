#pragma once
// Does a picture show anything at its exposure?

#include <string>

#include "coordinator/film/film.h"

namespace gleaner::coordinator {

// Where the PNG of R, G, B times 2^exposure_stops is white from end to end, or black: a sentence that says so, and the
// exposure that would show something. Empty where the picture shows something. One pixel in a thousand may differ.
std::string exposure_warning(const Film& film, double exposure_stops);

}  // namespace gleaner::coordinator
