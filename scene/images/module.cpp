// The module's side: its functions are those of the files beside this one.

#include "scene/images/module.h"

extern "C" const gleaner::scene::ImageModule gleaner_image_module;
const gleaner::scene::ImageModule gleaner_image_module = {gleaner::scene::decode_images,
                                                          gleaner::scene::import_environment, gleaner::scene::png_bytes,
                                                          gleaner::scene::write_exr};
