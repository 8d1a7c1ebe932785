#pragma once
// The words of --frames.

#include <string>

#include "scene/import/import.h"

namespace gleaner::cli {

// FIRST, FIRST-LAST or FIRST-LASTxSTEP, or several of them with commas between, in any order; a frame that is named
// twice is one. Throws Error::usage, for more frames than a job may have too.
scene::FrameNumbers parse_frame_list(const std::string& text);

}  // namespace gleaner::cli
