#pragma once
// Between programs and the module that reads and writes images. OpenImageIO brings some 250 libraries, which take a
// fifth of a second to load: a program that looks at no image does without.

#include "scene/images/environment.h"
#include "scene/images/images.h"
#include "scene/images/write.h"

namespace gleaner::scene {

// The module's functions, which have the names and the meanings of those that programs call.
struct ImageModule {
  decltype(&decode_images) decode;
  decltype(&import_environment) environment;
  decltype(&png_bytes) png;
  decltype(&write_exr) exr;
};

inline constexpr const char* kImageModuleSymbol = "gleaner_image_module";

}  // namespace gleaner::scene
