#pragma once
// Where light paths begin: an emission guide, made of what a pilot's paths have found. Its cells divide the cube of the
// five numbers that a path begins with, so that it knows nothing of kinds of lights. After Peter & Pietrek 1998
// ("Importance driven construction of photon maps"), by whether paths are of use at all as Hachisuka & Jensen 2011
// ("Robust adaptive photon tracing using photon path visibility").

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "kernels/photon_records.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

// Numbers that a path begins with, each times 65,536: light, u0, u1, d0, d1.
using PathNumbers = std::array<std::uint16_t, GUIDE_NUMBERS>;

// Box [lower, lower + extent) of the unit cube.
struct GuideBox {
  std::array<double, GUIDE_NUMBERS> lower{}, extent{};
  double volume() const;
  GuideBox half(std::size_t axis, bool upper) const;
};

// A tree of such boxes: the children of row k, where it has any, are rows `child` and `child` + 1, halves along `axis`.
// The root is the cube.
struct GuideRow {
  GuideBox box;
  double share = 0;         // of all paths
  std::uint32_t child = 0;  // 0: the row is a cell
  std::size_t axis = 0;
  double density() const { return share / box.volume(); }
};

// `useful`: the pilot's paths that were of use, which were as even as numbers without a guide. A cell's share is in
// proportion to the root of how many of its paths are of use, times its volume, which is where the fewest paths serve
// best; a part of all paths stays even, so that no density is below kGuideEven. Without useful paths there is one cell.
inline constexpr double kGuideEven = 0.25;
std::vector<GuideRow> make_guide(std::vector<PathNumbers> useful);

// As rows of kernels/photon_records.h: GUIDE_...
scene::Bytes guide_bytes(const std::vector<GuideRow>& guide);

// The task's input "emission" on the device, checked; none where the task has none. Throws Error::bad_input.
cl::Buffer guide_table(const StageRun& run, cl::CommandQueue& queue);

}  // namespace gleaner::worker
