// Method `photon` with `photon.order`: light on rough lobes by records of incoming radiance at the sample points of
// shading clusters. Means beside the path tracer's are photon_test.cpp's.

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"

namespace gleaner::test {
namespace {

constexpr const char* kIndirect[] = {"indirect.R", "indirect.G", "indirect.B"};

Scene boxes(const char* of_short, const char* of_tall) {
  return scene::make_scene("cornell-glossy", {{"short", of_short}, {"tall", of_tall}});
}
Scene boxes(const char* roughness) { return boxes(roughness, roughness); }

Frame photon_frame(Scene scene, std::uint32_t size, std::uint32_t spp, Settings set) {
  set.insert({{"photon.count", "100000"}, {"photon.caustics", "0"}, {"photon.clusters", "300"}});
  return square_frame("photon", std::move(scene), {}, size, spp, set);
}

Film truth_of(Frame frame, std::uint32_t spp) {
  frame.settings.method = "path";
  frame.settings.set = {};
  frame.settings.seed = 77;
  frame.settings.spp = spp;
  return render(frame).film;
}

double error_of(const Film& film, const Film& truth, std::uint32_t block = 1) {
  return block_error(film, truth, {std::begin(kIndirect), std::end(kIndirect)}, block);
}

// Paths off a rough lobe are the noise of such pictures.
TEST(PhotonLobes, RecordsTakeTheNoiseOff) {
  for (const char* roughness : {"0.5", "0.7"}) {
    Frame frame = photon_frame(boxes(roughness), 48, 8, {{"photon.gather_rays", "384"}});
    const Film truth = truth_of(frame, 1024);
    frame.settings.set["photon.order"] = "0";
    const double by_paths = error_of(render(frame).film, truth);
    for (const char* order : {"4", "10"}) {
      frame.settings.set["photon.order"] = order;
      const Rendered made = render(frame);
      const double error = error_of(made.film, truth);
      std::printf("  roughness %s, order %s: error of the indirect light %.2f %%, by paths %.2f %%\n", roughness, order,
                  100 * error, 100 * by_paths);
      EXPECT_GT(made.parameters.at("photon").at("lobe_places").get<int>(), 30);
      EXPECT_LT(error, 0.6 * by_paths) << roughness << ", " << order;
    }
  }
}

// All light is somebody's and none is two's: rough boxes; of one the lobe is too sharp for the order; one throws
// caustics, which photons or paths find.
TEST(PhotonLobes, RecordsCarryWhatPathsDid) {
  const struct {
    const char *short_box, *tall_box, *caustics;
  } cases[] = {{"0.6", "0.5", "0"}, {"0.7", "0.4", "0"}, {"0.7", "0.2", "50000"}};
  for (const auto& [short_box, tall_box, caustics] : cases) {
    Frame frame = photon_frame(boxes(short_box, tall_box), 24, 32,
                               {{"photon.gather_rays", "384"}, {"photon.caustics", caustics}});
    frame.settings.set["photon.order"] = "0";
    const Sample by_paths = means_of(frame, "indirect.G", 6);
    frame.settings.set["photon.order"] = "4";
    expect_means_meet(means_of(frame, "indirect.G", 6), by_paths,
                      std::string(short_box) + " and " + tall_box + ", caustic photons: " + caustics, 0.004);
  }
}

// A record at every point, of many rays and a high order, is what paths find in the mean.
TEST(PhotonLobes, ARecordAtEveryPointIsWhatPathsFind) {
  Frame frame = photon_frame(boxes("0.6"), 16, 16,
                             {{"photon.clusters", "1000000"}, {"photon.gather_rays", "384"}, {"photon.order", "10"}});
  const Rendered made = render(frame);
  EXPECT_GT(made.parameters.at("photon").at("lobe_places").get<int>(), 16 * 16);
  const Film truth = truth_of(frame, 4096);
  // Pixels differ by the few points of each at edges.
  const double error = error_of(made.film, truth, 4);
  std::printf("  error of the indirect light %.2f %% in 4 x 4 pixels, %.2f %% in one\n", 100 * error,
              100 * error_of(made.film, truth));
  EXPECT_LT(error, 0.02);
  for (const char* channel : kIndirect) EXPECT_NEAR(mean_of(made.film, channel) / mean_of(truth, channel), 1, 0.01);
}

// What harmonics of the order do not hold stays the paths', bit by bit, and costs no stage.
TEST(PhotonLobes, SharperOnesStayThePaths) {
  Frame frame = photon_frame(boxes("0.46"), 16, 4, {{"photon.gather_rays", "96"}});
  const auto pixels = [&](const char* order) {
    frame.settings.set["photon.order"] = order;
    const Rendered made = render(frame);
    EXPECT_EQ(made.specs.contains("photon.lobe_points"), order == std::string("10")) << order;
    return made.film.find("R")->values;
  };
  const auto without = pixels("0");
  EXPECT_EQ(pixels("4"), without);
  EXPECT_NE(pixels("10"), without);
}

TEST(PhotonLobes, WithoutClustersPathsFindAll) {
  Frame frame = photon_frame(boxes("0.7"), 16, 4, {{"photon.clusters", "0"}, {"photon.order", "4"}});
  const auto with = render(frame).film.find("R")->values;
  frame.settings.set["photon.order"] = "0";
  EXPECT_EQ(render(frame).film.find("R")->values, with);
}

}  // namespace
}  // namespace gleaner::test
