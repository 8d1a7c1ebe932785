#pragma once
// Image files that we write.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace gleaner::scene {

// A PNG of `width` x `height` texels as decode_images() gives them: RGBA bytes, R lowest, alpha not multiplied in.
// Throws Error::failed with OpenImageIO's words.
std::vector<unsigned char> png_bytes(std::uint32_t width, std::uint32_t height, std::span<const std::uint32_t> texels);

// A 32-bit EXR of `width` x `height` pixels of R, G and B, rows from the top. Throws Error::failed with OpenImageIO's
// words, without the path.
void write_exr(const std::string& path, std::uint32_t width, std::uint32_t height, std::span<const float> rgb);

}  // namespace gleaner::scene
