#pragma once
// PNG, JPEG and their like, decoded to RGBA bytes by OpenImageIO.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "scene/files/warnings.h"

namespace gleaner::scene {

// Where an image comes from: a file, or bytes where `path` is empty. The bytes must outlive the decoding.
struct ImageSource {
  std::string element;  // what names it in the scene's file, for errors
  std::filesystem::path path;
  std::span<const std::byte> bytes;
};

struct DecodedImage {
  std::uint32_t first_texel = 0, width = 0, height = 0;
};

// Decodes all images behind one another into `texels` (RGBA, R lowest, row 0 at the top; grey becomes RGB, a missing
// alpha 255), on all cores. All sizes are checked before memory is taken: at most `most_texels` in all. Throws
// Error::bad_input naming `file` and the first image that cannot be read; says in `warnings` what was reduced to 8
// bits.
std::vector<DecodedImage> decode_images(const std::vector<ImageSource>& sources, const std::string& file,
                                        std::uint64_t most_texels, std::vector<std::uint32_t>& texels,
                                        Warnings& warnings);

}  // namespace gleaner::scene
