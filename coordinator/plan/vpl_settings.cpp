#include "coordinator/plan/vpl_settings.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "kernels/vpl_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

std::vector<Setting> vpl_setting_rules() {
  using enum SettingType;
  return {
      {"vpl.count", whole, 1, 1u << 22, "chosen*", "VPLs of a pass"},
      {"vpl.clusters", whole, 0, 1u << 20, "chosen*", "clusters of a pass's VPLs; 0: every VPL is its own cluster"},
      {"vpl.point_clusters", whole, 0, 1u << 22, "chosen*",
       "clusters of shaded points (on a camera trajectory: for what one of its cameras sees); 0: every point traces "
       "its own shadow rays"},
      {"vpl.fuzziness", whole, 1, MAX_FUZZINESS, "6", "point clusters whose visibility a point interpolates"},
      {"vpl.equal_weights", flag, 0, 1, "0", "1: these clusters have equal weights, instead of by their distance"},
      {"vpl.passes", whole, 1, 4096, "chosen*; else `--spp` / 64, at least 1",
       "independent passes, each with VPLs of its own; their mean is the picture", "vpl.sets"},
      {"vpl.samples", whole, 1, 64, "16, at most `--spp`",
       "samples of a pixel in each pass, a power of two; each sees a slice of the VPL clusters"},
      {"vpl.clamp", real, 0, 1e6, "chosen*; else 0.05",
       "bound of the geometry term, in units of the VPLs' density (VPLs a square metre); 0: none"},
      {"vpl.residual_threshold", real, 0, 1,
       "chosen*; 0.02 where all three counts are set; else 1.6 / `--spp`, 0.02 to 0.2",
       "a point traces a shadow ray of its own to a VPL that would contribute more than this share of its light, and "
       "to "
       "lesser ones at random; 0: to none, and points near no cluster to all",
       "vpl.doubt"},
      {"vpl.contribution_cutoff", real, 0, 1, "0.05",
       "no visibility query for a VPL that can contribute less to a point cluster than this share of what a VPL would "
       "contribute on "
       "average if nothing blocked it; 0: all are queried",
       "vpl.least"},
      {"vpl.random_representative", flag, 0, 1, "1 with several passes, else 0",
       "1: the VPL that represents a cluster is chosen at random, so that the mean over passes has no bias of "
       "clusters; "
       "0: the one in its middle",
       "vpl.draw"},
      {"vpl.compensate", flag, 0, 1, "1", "0: what the bound takes is lost, not traced by paths"},
  };
}

VplSettings make_vpl_settings(const FrameSettings& settings) {
  VplSettings vpl;
  const auto whole = [&](const char* name, std::uint32_t usual) {
    return whole_setting(settings, name).value_or(usual);
  };
  const auto real = [&](const char* name, double usual) { return real_setting(settings, name).value_or(usual); };
  const auto flag = [&](const char* name, bool usual) { return flag_setting(settings, name).value_or(usual); };
  const double pixels = static_cast<double>(settings.width) * settings.height;
  vpl.samples = std::min<std::uint32_t>(std::bit_floor(settings.method_spp()), 16);
  // Measured on the Cornell box and on sponza: a second pass pays once the paths have some 64 samples a pixel.
  vpl.passes = whole("vpl.passes", std::clamp<std::uint32_t>(settings.method_spp() / 64, 1, 64));
  vpl.count = whole("vpl.count", 16000);
  vpl.clusters = whole("vpl.clusters", std::min(1536u, vpl.count));
  vpl.point_clusters = whole("vpl.point_clusters", static_cast<std::uint32_t>(std::clamp(pixels / 80, 256.0, 20000.0)));
  vpl.fuzziness = whole("vpl.fuzziness", 6);
  vpl.samples = whole("vpl.samples", vpl.samples);
  if (!std::has_single_bit(vpl.samples))
    throw Error::usage("--set vpl.samples: expected a power of two up to 64, found " + std::to_string(vpl.samples));
  vpl.equal_weights = flag("vpl.equal_weights", false);
  vpl.random_representative = flag("vpl.random_representative", vpl.passes > 1);
  vpl.compensate = flag("vpl.compensate", true);
  const bool counts_given = settings.set.contains("vpl.count") && settings.set.contains("vpl.clusters") &&
                            settings.set.contains("vpl.point_clusters");
  // What a few samples leave of noise, clusters' errors of a tenth of it do not show in. Who sets all counts is after
  // their error: on white-room 0.02 brings it below 8 % of the mean with the counts of the paper, 0.1 leaves 13 %.
  vpl.residual_threshold =
      real("vpl.residual_threshold", counts_given ? 0.02 : std::clamp(1.6 / settings.method_spp(), 0.02, 0.2));
  // Measured on cornell-box, sponza-dabrovic and white-room: 3 to 10 % of the rays, no error that shows.
  vpl.contribution_cutoff = real("vpl.contribution_cutoff", 0.05);
  vpl.clamp = real("vpl.clamp", 0.05);
  vpl.given = {.count = whole_setting(settings, "vpl.count"),
               .clusters = whole_setting(settings, "vpl.clusters"),
               .point_clusters = whole_setting(settings, "vpl.point_clusters"),
               .passes = whole_setting(settings, "vpl.passes"),
               .residual_threshold = real_setting(settings, "vpl.residual_threshold"),
               .clamp = real_setting(settings, "vpl.clamp"),
               .random_representative = settings.set.contains("vpl.random_representative")};
  // What a bound takes is an error where nothing gives it back: the pilot knows of none.
  if (!vpl.compensate) vpl.given.clamp = vpl.clamp;
  vpl.piloted = !counts_given && settings.trajectory.empty();
  return vpl;
}

}  // namespace gleaner::coordinator
