#pragma once
// Emission that the camera sees directly. At the edges of a lamp or of a window it is most of a pixel's noise, and no
// denoiser takes that out; camera rays alone do, for next to nothing.

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace gleaner::coordinator {

// Pixels whose emission differs from that of one of their eight neighbours, or the neighbours' from each other's, by
// more than `least`: edges. In their order; where there are more than `most`, those that differ most.
//
// `emission`: radiance, mean over the channels, width * height.
std::vector<std::uint32_t> emission_edges(std::span<const float> emission, std::uint32_t width, std::uint32_t height,
                                          double least, std::size_t most);

}  // namespace gleaner::coordinator
