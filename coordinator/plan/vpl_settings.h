#pragma once
// Settings of method `vpl`, as given or by default.

#include <cstdint>
#include <optional>

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

struct VplSettings {
  std::uint32_t count = 0;           // VPLs of a pass
  std::uint32_t clusters = 0;        // of them; 0: every VPL is its own cluster
  std::uint32_t point_clusters = 0;  // 0: every point traces its own shadow rays
  std::uint32_t fuzziness = 6;
  bool equal_weights = false;  // eq. 8 instead of eq. 9-10
  bool compensate = true;      // what the clamp takes is given back by paths
  // Share of a point's light beyond which it traces a shadow ray of its own to a light; to lesser ones at random.
  double residual_threshold = 0;
  // Share of the lights' mean contribution to a point cluster: lights that can contribute less are not queried.
  double contribution_cutoff = 0;
  double clamp = 0;                    // bound of the geometry term in units of the VPLs' density; 0: none
  bool random_representative = false;  // of a cluster, not the member in its middle
  std::uint32_t samples = 1;           // of a pixel and pass, each of which sees a slice of the lights
  std::uint32_t passes = 1;

  // Of what is above, that which was set. A pilot (coordinator/plan/vpl_pilot.h) chooses the rest, unless the three
  // counts are all set; the values above are then its starting point.
  struct Given {
    std::optional<std::uint32_t> count, clusters, point_clusters, passes;
    std::optional<double> residual_threshold, clamp;
    bool random_representative = false;
  } given;
  bool piloted = false;
};

// The method's rows of the table of settings.
std::vector<Setting> vpl_setting_rules();

// From --set vpl.*, where given, else by the picture's size and --spp. Throws Error::usage.
VplSettings make_vpl_settings(const FrameSettings& settings);

}  // namespace gleaner::coordinator
