#pragma once
// What the method `vpl` was told, and what it settles for itself.

#include <cstdint>
#include <optional>

#include "coordinator/plan/plan.h"

namespace gleaner::coordinator {

struct VplSettings {
  std::uint32_t count = 0;           // VPLs of a set
  std::uint32_t clusters = 0;        // of them; 0: every VPL stands for itself
  std::uint32_t point_clusters = 0;  // 0: every point asks for itself
  std::uint32_t fuzziness = 6;
  bool equal_weights = false;  // eq. 8 instead of eq. 9-10
  bool compensate = true;      // what the clamp takes is given back by paths
  double doubt = 0;   // share of a point's light beyond which it asks for a light itself; for lesser ones by lot
  double least = 0;   // of what lights bring a point cluster in the mean: those that can bring less are not asked
  double clamp = 0;   // bound of the geometry term in units of the VPLs' density; 0: none
  bool draw = false;  // a cluster's representative by lot, not the one in its middle
  std::uint32_t samples = 1;  // of a pixel and set, each of which sees a slice of the lights
  std::uint32_t sets = 1;

  // Of what is above, that which was set. A pilot (coordinator/plan/vpl_pilot.h) chooses the rest, unless the three
  // counts are all set; the values above are then where it begins.
  struct Given {
    std::optional<std::uint32_t> count, clusters, point_clusters, sets;
    std::optional<double> doubt, clamp;
    bool draw = false;
  } given;
  bool piloted = false;
};

// From --set vpl.*, where given, else by the picture's size and --spp. Throws Error::usage.
VplSettings make_vpl_settings(const FrameSettings& settings);

}  // namespace gleaner::coordinator
