// Methods' pictures of a mesh in several places are those of as many copies. Both have the same random numbers, so that
// only what rounding and clusters make of them differs. (tests/numerics/instances_test.cpp asks `path` the same.)

#include <cmath>

#include "scene/library/bake.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/radiometry/rendered_frame.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;
constexpr unsigned kSeeds = 30;

class InstancedMethods : public testing::TestWithParam<worker::TraceKind> {
 protected:
  // Rings of 256 triangles in 60 places, every fifth one mirrored.
  Frame frame_of(const std::string& method, bool copies, const Settings& set) const {
    const Scene stack = scene::make_scene("stack", {{"count", "60"}, {"segments", "16"}});
    Frame frame = square_frame(method, copies ? scene::baked(stack) : stack, {}, 24, 16, set);
    frame.trace = GetParam();
    return frame;
  }

  // A channel's mean over the instanced picture's, by that of copies, a value a seed.
  void expect_equal_means(const std::string& method, const std::string& channel, const Settings& set, double noise) {
    Frame instanced = frame_of(method, false, set), copied = frame_of(method, true, set);
    Sample ratio;
    for (unsigned seed = 1; seed <= kSeeds; ++seed) {
      instanced.settings.seed = copied.settings.seed = seed;
      ratio.add(mean_of(render(instanced).film, channel) / mean_of(render(copied).film, channel));
    }
    expect_mean(ratio, 1, method + " " + channel, kFamily, noise);
  }
};

TEST_P(InstancedMethods, AmbientOcclusion) {
  const Film a = render(frame_of("ao", false, {})).film, b = render(frame_of("ao", true, {})).film;
  double squares = 0;
  const auto &one = a.find("G")->values, &other = b.find("G")->values;
  for (std::size_t i = 0; i < one.size(); ++i) squares += (double{one[i]} - other[i]) * (double{one[i]} - other[i]);
  const double error = std::sqrt(squares / static_cast<double>(one.size())) / mean_of(b, "G");
  std::printf("  error %.2g, means %.6f and %.6f\n", error, mean_of(a, "G"), mean_of(b, "G"));
  EXPECT_LT(error, 2e-3);            // a ray that goes elsewhere makes 8e-4; measured: 2e-7
  EXPECT_LT(mean_of(b, "G"), 0.95);  // the rings hide something
}

TEST_P(InstancedMethods, VirtualPointLights) {
  expect_equal_means("vpl", "indirect.G", {{"vpl.count", "4000"}, {"vpl.clusters", "64"}}, 0.02);
}

TEST_P(InstancedMethods, PhotonMaps) {
  expect_equal_means("photon", "indirect.G",
                     {{"photon.count", "20000"}, {"photon.caustics", "0"}, {"photon.gather_rays", "128"}}, 0.004);
}

// Links take copies, each with vertices of its own, so that light finds its way between all places: the mean is that of
// paths among instances.
TEST_P(InstancedMethods, RadianceLinksAmongCopies) {
  Frame links =
      frame_of("links", true, {{"links.vertices", "16000"}, {"links.directions", "64"}, {"links.light_samples", "16"}});
  Frame path = frame_of("path", false, {});
  links.settings.spp = 64;
  path.settings.spp = 512;
  expect_means_meet(means_of(links, "G", 4), means_of(path, "G", 4), "links", 0.006);
  const Rendered made = render(links);
  EXPECT_GT(made.parameters["links"]["vertices"].get<std::size_t>(), 60u * 128) << "copies share vertices";
  EXPECT_GT(mean_of(made.film, "indirect.G"), 0.05 * mean_of(made.film, "G")) << "there is little to carry";
  Frame refused = frame_of("links", false, {});
  EXPECT_THROW(render(refused), Error);
}

std::string tracer_of(const testing::TestParamInfo<worker::TraceKind>& test) {
  return test.param == worker::TraceKind::embree ? "Embree" : "OpenCL";
}
INSTANTIATE_TEST_SUITE_P(Tracer, InstancedMethods,
                         testing::Values(worker::TraceKind::embree, worker::TraceKind::opencl), tracer_of);

}  // namespace
}  // namespace gleaner::test
