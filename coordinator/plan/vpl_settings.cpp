#include "coordinator/plan/vpl_settings.h"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>

#include "coordinator/plan/setting.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

VplSettings make_vpl_settings(const FrameSettings& settings) {
  VplSettings vpl;
  const double pixels = static_cast<double>(settings.width) * settings.height;
  vpl.samples = std::min<std::uint32_t>(std::bit_floor(settings.spp), 16);
  // Measured on the Cornell box and on sponza: a second set pays once the paths have some 64 samples a pixel.
  vpl.sets = std::clamp<std::uint32_t>(settings.spp / 64, 1, 64);
  vpl.count = whole_setting(settings, "vpl.count", 16000, 1, 1u << 22);
  vpl.clusters = whole_setting(settings, "vpl.clusters", std::min(1536u, vpl.count), 0, 1u << 20);
  const auto points = static_cast<std::uint32_t>(std::clamp(pixels / 80, 256.0, 20000.0));
  vpl.point_clusters = whole_setting(settings, "vpl.point_clusters", points, 0, 1u << 22);
  vpl.fuzziness = whole_setting(settings, "vpl.fuzziness", 6, 1, MAX_FUZZINESS);
  vpl.sets = whole_setting(settings, "vpl.sets", vpl.sets, 1, 4096);
  vpl.samples = whole_setting(settings, "vpl.samples", vpl.samples, 1, 64);
  if (!std::has_single_bit(vpl.samples))
    throw Error::usage("--set vpl.samples: expected a power of two up to 64, found " + std::to_string(vpl.samples));
  vpl.equal_weights = whole_setting(settings, "vpl.equal_weights", 0, 0, 1) != 0;
  vpl.draw = whole_setting(settings, "vpl.draw", vpl.sets > 1 ? 1 : 0, 0, 1) != 0;
  vpl.compensate = whole_setting(settings, "vpl.compensate", 1, 0, 1) != 0;
  // What a few samples leave of noise, clusters' errors of a tenth of it do not show in.
  vpl.doubt = real_setting(settings, "vpl.doubt", std::clamp(1.6 / settings.spp, 0.02, 0.2), 0, 1);
  // Measured on cornell-box, sponza-dabrovic and white-room: 3 to 10 % of the rays, no error that shows.
  vpl.least = real_setting(settings, "vpl.least", 0.05, 0, 1);
  vpl.clamp = real_setting(settings, "vpl.clamp", 0.05, 0, 1e6);
  const auto is_given = [&](const char* key) { return settings.set.contains(key); };
  if (is_given("vpl.count")) vpl.given.count = vpl.count;
  if (is_given("vpl.clusters")) vpl.given.clusters = vpl.clusters;
  if (is_given("vpl.point_clusters")) vpl.given.point_clusters = vpl.point_clusters;
  if (is_given("vpl.sets")) vpl.given.sets = vpl.sets;
  if (is_given("vpl.doubt")) vpl.given.doubt = vpl.doubt;
  // What a bound takes is an error where nothing gives it back: the pilot knows of none.
  if (is_given("vpl.clamp") || !vpl.compensate) vpl.given.clamp = vpl.clamp;
  vpl.given.draw = is_given("vpl.draw");
  vpl.piloted = !(vpl.given.count && vpl.given.clusters && vpl.given.point_clusters) && settings.way.empty();
  return vpl;
}

}  // namespace gleaner::coordinator
