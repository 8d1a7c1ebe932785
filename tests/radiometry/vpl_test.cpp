// Method `vpl` against closed forms, against the path tracer, and in the limits in which its approximations vanish.

#include <cmath>
#include <cstdio>
#include <functional>
#include <numeric>

#include "coordinator/plan/trajectory.h"
#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"
#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"

namespace gleaner::test {
namespace {

using kernels::VisibilityParameters;

constexpr double kFamily = 1e-3;  // chance of a false alarm of one test

Frame frame_of(const std::string& scene, const Settings& parameters, const std::string& camera, std::uint32_t size,
               std::uint32_t spp, const Settings& set) {
  return square_frame("vpl", scene::make_scene(scene, parameters), camera, size, spp, set);
}

// --- Closed forms ---

TEST(Vpl, Furnace) {
  for (const char* albedo : {"0.2", "0.5", "0.8"})
    expect_mean(means_of(frame_of("furnace", {{"albedo", albedo}, {"emission", "0.5"}}, "corner", 24, 16,
                                  {{"vpl.count", "600"}, {"vpl.clusters", "200"}, {"vpl.point_clusters", "64"}}),
                         "G", 6),
                0.5 / (1 - std::atof(albedo)), std::string("box of albedo ") + albedo, sidak(kFamily, 3), 0.01);
}

TEST(Vpl, FurnaceOfSoManyBounces) {
  for (const char* depth : {"1", "2", "3"}) {
    Frame frame =
        frame_of("furnace", {{"albedo", "0.5"}, {"emission", "1"}}, "corner", 24, 16,
                 {{"depth", depth}, {"vpl.count", "600"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}});
    expect_mean(means_of(frame, "G", 6), (1 - std::pow(0.5, std::atof(depth) + 1)) / 0.5,
                std::string("box, depth ") + depth, sidak(kFamily, 3), 0.01);
  }
}

// --- The path tracer ---

struct Meeting {
  const char* scene;
  const char* why;
  const char* camera = "";
};

class VplMeetsPath : public testing::TestWithParam<Meeting> {};

// Every VPL and every point for itself: what is left is noise, so that the picture's mean is the path tracer's, with
// all that VPLs leave to paths.
TEST_P(VplMeetsPath, WithoutClusters) {
  const Meeting& p = GetParam();
  Frame vpl = frame_of(p.scene, {}, p.camera, 24, 16,
                       {{"vpl.count", "400"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}, {"vpl.passes", "2"}});
  Frame path = vpl;
  path.settings.method = "path";
  path.settings.spp = 256;
  auto truth = means_of(path, {"R", "B"}, 6);
  for (const auto& [channel, sample] : means_of(vpl, {"R", "B"}, 10))
    // The truth's own noise is the allowance; three of its standard errors.
    expect_mean(sample, truth[channel].mean, std::string(p.scene) + " " + channel, sidak(kFamily, 20), 0.05,
                3 * truth[channel].standard_error());
}

INSTANTIATE_TEST_SUITE_P(Scenes, VplMeetsPath,
                         testing::Values(Meeting{"cornell-box", "diffuse"},
                                         Meeting{"cornell-mirror", "chains of mirrors"},
                                         Meeting{"cornell-glass", "chains of glass, caustics"},
                                         Meeting{"cornell-glossy", "lobes over layers, bare lobes"},
                                         Meeting{"cornell-textured", "cut-outs, textured lobes, bent normals"},
                                         Meeting{"layered-range", "coats, sheen, grains, films"},
                                         Meeting{"punctual-lights", "point, spot and directional lights"},
                                         Meeting{"emissive-textured", "textured emission"},
                                         Meeting{"thin-walls", "the room that is lit", "bright room"}),
                         [](const auto& test) {
                           std::string name = test.param.scene;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

// Coats that keep the triangles' normals over layers that are bent: their layers are the path tracer's alone.
TEST(Vpl, CoatsOverBentNormalsMeetThePathTracer) {
  Scene coated = scene::make_scene("cornell-textured", {});
  for (auto& material : coated.materials) {
    material.clearcoat = 0.9f;
    material.clearcoat_roughness = 0.4f;
    std::fill(material.sheen_color, material.sheen_color + 3, 0.5f);
    material.sheen_roughness = 0.6f;
  }
  scene::finish_materials(coated);
  Frame vpl = frame_of("cornell-textured", {}, {}, 24, 16,
                       {{"vpl.count", "400"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}, {"vpl.passes", "2"}});
  vpl.scene = std::make_shared<const Scene>(std::move(coated));
  Frame path = vpl;
  path.settings.method = "path";
  path.settings.spp = 256;
  const Sample truth = means_of(path, "G", 6);
  expect_mean(means_of(vpl, "G", 10), truth.mean, "coated box", kFamily / 2, 0.05, 3 * truth.standard_error());
}

// The boxes of cornell-glossy, so rough that VPLs light their lobes and are made by them; one is bare metal.
std::shared_ptr<const Scene> rough_boxes() {
  Scene scene = scene::make_scene("cornell-glossy", {});
  for (auto& material : scene.materials)
    if (material.roughness < 1) material.roughness = material.metallic > 0 ? 0.5f : 0.6f;
  scene::finish_materials(scene);
  return std::make_shared<const Scene>(scene);
}

TEST(Vpl, RoughLobesMeetThePathTracer) {
  Frame vpl = frame_of("cornell-glossy", {}, {}, 24, 16,
                       {{"vpl.count", "400"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}, {"vpl.passes", "2"}});
  vpl.scene = rough_boxes();
  Frame path = vpl;
  path.settings.method = "path";
  path.settings.spp = 256;
  const Rendered made = render(vpl);
  // Carriers and receivers are there.
  const auto traced = made.floats("vpl.trace.0");
  double sent = 0;
  for (std::size_t at = 0; at < traced.size(); at += VPL_WORDS) {
    const float* row = &traced[at];
    sent += row[VPL_SENT];
    // Of the metal's flux the lobe's part (mean_lobe() in kernels/bsdf.h) is all.
    if (!(row[VPL_FLUX] > 0) || std::abs(row[VPL_ALPHA] - 0.25f) > 1e-6) continue;
    double cosine = 0;
    for (std::size_t k = 0; k < 3; ++k) cosine += row[VPL_NORMAL + k] * row[VPL_INCOMING + k];
    const double grazing = std::pow(std::max(1 - cosine, 0.0), 5);
    const double mean = (row[VPL_F0] + (row[VPL_F90] - row[VPL_F0]) * grazing) / 3.14159265358979;
    ASSERT_NEAR(row[VPL_SENT] * mean / row[VPL_FLUX], 1, 1e-3) << "light " << at / VPL_WORDS;
  }
  EXPECT_GT(sent, 0);
  const Sample truth = means_of(path, "G", 6);
  expect_mean(means_of(vpl, "G", 10), truth.mean, "without clusters", kFamily / 2, 0.05, 3 * truth.standard_error());
  // Not the mean alone: the metal box, which no diffuse layer lights.
  const auto metal = [](const Film& film) {
    double sum = 0;
    for (std::uint32_t y = 10; y < 20; ++y)
      for (std::uint32_t x = 6; x < 10; ++x) sum += film.find("indirect.R")->values[24 * y + x];
    return sum / 40;
  };
  Sample boxes;
  double box_truth = 0;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    vpl.settings.seed = path.settings.seed = seed;
    boxes.add(metal(render(vpl).film));
    box_truth += metal(render(path).film) / 40;
  }
  expect_mean(boxes, box_truth, "on the metal box", kFamily / 2, 0.05, 0.01 * box_truth);
}

// Clusters and residual samples light rough lobes as all pairs do.
TEST(Vpl, ClustersLightRoughLobes) {
  const Settings base = {{"vpl.count", "800"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}};
  Frame frame = frame_of("cornell-glossy", {}, {}, 32, 1, base);
  frame.scene = rough_boxes();
  const auto exact = render(frame).floats("vpl.shade.0");
  frame.settings.set["vpl.point_clusters"] = "100";
  frame.settings.set["vpl.residual_threshold"] = "0.0001";
  const auto asked = render(frame).floats("vpl.shade.0");
  frame.settings.set["vpl.clusters"] = "200";
  const auto clustered = render(frame).floats("vpl.shade.0");
  // On the metal box, which no diffuse layer lights, and in all.
  const auto error = [&](const std::vector<float>& shaded, bool box) {
    double square = 0, mean = 0, n = 0;
    for (std::uint32_t i = 0; i < exact.size(); ++i) {
      const std::uint32_t x = i / 3 % 32, y = i / 96;
      if (box && (x < 8 || x >= 13 || y < 14 || y >= 26)) continue;
      square += std::pow(shaded[i] - exact[i], 2);
      mean += exact[i];
      ++n;
    }
    return std::sqrt(square / n) / (mean / n);
  };
  std::printf("  RMSE over the mean: %.4f (box %.4f) with point clusters, %.4f (%.4f) with both\n", error(asked, false),
              error(asked, true), error(clustered, false), error(clustered, true));
  EXPECT_LT(error(asked, false), 0.04);
  EXPECT_LT(error(asked, true), 0.01);
  EXPECT_LT(error(clustered, false), 0.12);
  EXPECT_LT(error(clustered, true), 0.2);
}

TEST(Vpl, DarkRoomsStayDark) {
  // Both dark rooms lie behind a wall of 1 cm.
  for (const char* camera : {"behind the sheet", "behind the box"})
    for (const char* clusters : {"0", "100"}) {
      const Film film =
          render(frame_of("thin-walls", {}, camera, 32, 4,
                          {{"vpl.count", "500"}, {"vpl.clusters", clusters}, {"vpl.point_clusters", clusters}}))
              .film;
      EXPECT_EQ(mean_of(film, "R"), 0) << clusters << " clusters";
    }
}

// --- Limits ---

TEST(Vpl, AsManyClustersAsPointsAreAllPairs) {
  const Settings pairs = {{"vpl.count", "200"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}};
  const Settings clusters = {
      {"vpl.count", "200"}, {"vpl.clusters", "200"}, {"vpl.point_clusters", "1024"}, {"vpl.contribution_cutoff", "0"}};
  for (const char* scene : {"cornell-box", "cornell-glossy", "cornell-glass"}) {
    const Rendered a = render(frame_of(scene, {}, {}, 32, 1, pairs)),
                   b = render(frame_of(scene, {}, {}, 32, 1, clusters));
    const auto x = a.floats("vpl.shade.0"), y = b.floats("vpl.shade.0");
    ASSERT_EQ(x.size(), y.size());
    double sum = 0;
    std::size_t different = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      sum += x[i];
      different += x[i] != y[i];
    }
    EXPECT_GT(sum, 0);
    EXPECT_EQ(different, 0u) << scene << ": of " << x.size() << " numbers";
  }
}

TEST(Vpl, FuzzinessOfOneIsHardClustering) {
  Settings set = {{"vpl.count", "300"}, {"vpl.clusters", "60"}, {"vpl.point_clusters", "40"}, {"vpl.fuzziness", "1"}};
  const Rendered weighted = render(frame_of("cornell-box", {}, {}, 32, 1, set));
  set["vpl.equal_weights"] = "1";
  const Rendered equal = render(frame_of("cornell-box", {}, {}, 32, 1, set));
  EXPECT_EQ(weighted.floats("vpl.shade.0"), equal.floats("vpl.shade.0"));
  set["vpl.fuzziness"] = "6";
  EXPECT_NE(render(frame_of("cornell-box", {}, {}, 32, 1, set)).floats("vpl.shade.0"), equal.floats("vpl.shade.0"));
}

// Residual samples bring points nearer to all pairs.
TEST(Vpl, ResidualSamplesCorrectClusters) {
  const Settings base = {{"vpl.count", "200"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "60"}};
  Settings pairs = base;
  pairs["vpl.point_clusters"] = "0";
  const auto exact = render(frame_of("cornell-box", {}, {}, 32, 1, pairs)).floats("vpl.shade.0");
  std::vector<double> errors;
  for (const char* threshold : {"0", "0.02", "0.001"}) {
    Settings set = base;
    set["vpl.residual_threshold"] = threshold;
    const auto shaded = render(frame_of("cornell-box", {}, {}, 32, 1, set)).floats("vpl.shade.0");
    double square = 0, mean = 0;
    for (std::size_t i = 0; i < exact.size(); ++i) {
      square += (shaded[i] - exact[i]) * (shaded[i] - exact[i]);
      mean += exact[i];
    }
    const auto n = static_cast<double>(exact.size());
    errors.push_back(std::sqrt(square / n) / (mean / n));
    std::printf("  threshold %5s: RMSE over the mean %.4f\n", threshold, errors.back());
  }
  EXPECT_LT(errors[1], errors[0]);
  EXPECT_LT(errors[2], errors[1] / 2);
}

// Lights that could contribute next to nothing to a point cluster are not queried; each is counted, and none is missed.
TEST(Vpl, NegligiblePairsAreNotQueried) {
  const auto shade = [](const char* least, std::uint64_t& little) {
    const Rendered made = render(frame_of("cornell-box", {}, {}, 32, 1,
                                          {{"vpl.count", "960"},
                                           {"vpl.clusters", "0"},
                                           {"vpl.point_clusters", "60"},
                                           {"vpl.residual_threshold", "0"},
                                           {"vpl.contribution_cutoff", least}}));
    VisibilityParameters p;
    const worker::StageTask& task = made.tasks.at("vpl.visibility.0");
    std::memcpy(&p, task.parameters.data(), sizeof p);
    const std::size_t words = p.clusters / 32 + VISIBILITY_COUNTS;
    const auto records = made.floats("vpl.visibility.0");
    little = 0;
    for (std::size_t at = 0; at < records.size(); at += words) {
      std::uint32_t left_out[VISIBILITY_COUNTS];
      std::memcpy(left_out, &records[at + p.clusters / 32], sizeof left_out);
      little += left_out[1];
    }
    return made.floats("vpl.shade.0");
  };
  std::uint64_t none = 0, some = 0;
  const auto all = shade("0", none), fewer = shade("0.1", some);
  EXPECT_EQ(none, 0u);
  EXPECT_GT(some, 960u * 60 / 100);
  double change = 0, sum = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    change += std::abs(fewer[i] - all[i]);
    sum += all[i];
  }
  std::printf("  %llu of %u pairs, %.5f of the light\n", static_cast<unsigned long long>(some), 960u * 60,
              change / sum);
  EXPECT_LT(change / sum, 0.01);
}

// What is near a cluster is lit by all its members: clusters are no spots. Lit by their representatives alone, points
// are 0.099 off.
TEST(Vpl, NearClustersShineFromAllMembers) {
  const Settings pairs = {
      {"vpl.count", "1000"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}, {"vpl.clamp", "0.01"}};
  Settings clustered = pairs;
  clustered["vpl.clusters"] = "100";
  const auto exact = render(frame_of("cornell-box", {}, {}, 32, 1, pairs)).floats("vpl.shade.0");
  const auto shaded = render(frame_of("cornell-box", {}, {}, 32, 1, clustered)).floats("vpl.shade.0");
  double square = 0, mean = 0;
  for (std::size_t i = 0; i < exact.size(); ++i) {
    square += (shaded[i] - exact[i]) * (shaded[i] - exact[i]);
    mean += exact[i];
  }
  const auto n = static_cast<double>(exact.size());
  std::printf("  RMSE over the mean %.4f\n", std::sqrt(square / n) / (mean / n));
  EXPECT_LT(std::sqrt(square / n) / (mean / n), 0.06);
}

// More VPLs: the picture goes to the path tracer's. What clusters and the VPLs' own number leave falls, and what
// clamping takes is given back, so that no bias is left in the mean.
TEST(Vpl, ErrorFallsWithMoreLights) {
  Frame truth = frame_of("cornell-box", {}, {}, 24, 4096, {});
  truth.settings.method = "path";
  const Film reference = render(truth).film;
  std::vector<double> errors;
  for (const char* count : {"64", "256", "1024", "4096"}) {
    double square = 0, values = 0;
    for (std::uint64_t seed : {1, 2, 3, 4}) {
      // Many samples and a wide bound: what is seen is the lights' error, not that of the paths.
      Frame frame = frame_of("cornell-box", {}, {}, 24, 512,
                             {{"vpl.count", count},
                              {"vpl.clusters", "0"},
                              {"vpl.point_clusters", "0"},
                              {"vpl.samples", "64"},
                              {"vpl.clamp", "1"},
                              {"vpl.passes", "1"}});
      frame.settings.seed = seed;
      const Film film = render(frame).film;
      for (const char* channel : {"indirect.R", "indirect.G", "indirect.B"})
        for (std::size_t i = 0; i < film.find(channel)->values.size(); ++i) {
          const double d = film.find(channel)->values[i] - reference.find(channel)->values[i];
          square += d * d;
          ++values;
        }
    }
    errors.push_back(std::sqrt(square / values));
    std::printf("  %5s VPLs: RMSE of the indirect light %.5f\n", count, errors.back());
  }
  for (std::size_t i = 1; i < errors.size(); ++i) EXPECT_LT(errors[i], errors[i - 1]);
  const double order = std::log(errors.front() / errors.back()) / std::log(64.0);
  std::printf("  fitted order %.3f\n", order);
  // Noise of independent lights falls as the root of their number, but the bound goes with their density, and what a
  // light does to the corner of two walls, 1 / h at the distance h, is let in ever closer: MSE as N^-1 times N^1/2.
  EXPECT_GT(order, 0.2);
  EXPECT_LT(order, 0.6);
}

// --- The pilot ---

double squared_difference(const Film& film, const Film& truth, const std::string& prefix) {
  double square = 0, values = 0;
  for (const char* channel : {"R", "G", "B"}) {
    const auto &a = film.find(prefix + channel)->values, &b = truth.find(prefix + channel)->values;
    for (std::size_t i = 0; i < a.size(); ++i) square += (double{a[i]} - b[i]) * (double{a[i]} - b[i]);
    values += static_cast<double>(a.size());
  }
  return square / values;
}

// With nothing set, a target error is met, and the pilot's prediction is near the lights' error.
TEST(Vpl, TargetErrorIsMet) {
  Frame frame = frame_of("cornell-box", {}, {}, 64, 4096, {});
  frame.settings.method = "path";
  const Film truth = render(frame).film;
  const double mean = (mean_of(truth, "R") + mean_of(truth, "G") + mean_of(truth, "B")) / 3;
  frame.settings.method = "vpl";
  frame.settings.spp = 64;
  for (const double target : {0.05, 0.02}) {
    frame.settings.target_error = target;
    int met = 0;
    double worst = 0;
    for (const std::uint64_t seed : {1, 2, 3, 4}) {
      frame.settings.seed = seed;
      const double error = std::sqrt(squared_difference(render(frame).film, truth, "")) / mean;
      worst = std::max(worst, error);
      met += error <= target;
    }
    std::printf("  target %.2f: worst of four %.4f\n", target, worst);
    EXPECT_EQ(met, 4) << "target " << target << ", worst " << worst;
    EXPECT_GT(worst, 0.2 * target) << "by doing many times too much";
  }
}

TEST(Vpl, PredictionIsNearTheLightsError) {
  // The lights' part alone: many samples take the paths' noise away, but for what shows in the truth as well.
  Frame frame = frame_of("cornell-box", {}, {}, 48, 4096, {});
  frame.settings.method = "path";
  const Film truth = render(frame).film;
  frame.settings.method = "vpl";
  frame.settings.spp = 2048;
  const double whole = (mean_of(truth, "R") + mean_of(truth, "G") + mean_of(truth, "B")) / 3;
  double measured = 0, predicted = 0;
  for (const std::uint64_t seed : {1, 2, 3}) {
    frame.settings.seed = seed;
    frame.settings.set = {
        {"vpl.passes", "1"}, {"vpl.clusters", "384"}, {"vpl.count", "4000"}, {"vpl.residual_threshold", "0.2"}};
    const Rendered made = render(frame);
    measured += squared_difference(made.film, truth, "indirect.") / (whole * whole) / 3;
    predicted += std::pow(made.parameters.at("vpl").at("pilot").at("error").get<double>(), 2) / 3;
  }
  std::printf("  RMSE of the indirect light over the picture's mean: predicted %.4f, measured %.4f\n",
              std::sqrt(predicted), std::sqrt(measured));
  EXPECT_GT(predicted, measured / 4);
  EXPECT_LT(predicted, measured * 4);
}

// --- Conservation ---

TEST(Vpl, ClustersCarryTheirMembersLight) {
  const Rendered made =
      render(frame_of("cornell-glossy", {}, {}, 16, 1, {{"vpl.count", "700"}, {"vpl.clusters", "90"}}));
  const auto total = [](const float* rows, std::size_t words, double scale) {
    std::array<double, 3> sum{};
    for (std::size_t at = 0; at < words; at += VPL_WORDS)
      for (std::size_t k = 0; k < 3; ++k) sum[k] += rows[at + VPL_FLUX + k] * scale;
    return sum;
  };
  const auto luminance = [](const std::array<double, 3>& c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; };
  const auto traced = made.floats("vpl.trace.0");
  const auto paths = static_cast<double>(made.specs.at("vpl.trace.0").items);
  const auto held = made.tasks.at("vpl.cluster.0").inputs.at("lights").load();
  const auto& bytes = *held;
  std::vector<float> kept(bytes.size() / 4);
  std::memcpy(kept.data(), bytes.data(), bytes.size());
  const auto records = made.floats("vpl.cluster.0");
  const std::vector<float> clusters(records.begin(), records.begin() + 90 * VPL_WORDS);
  const auto all = total(traced.data(), traced.size(), 1 / paths), drawn = total(kept.data(), kept.size(), 1),
             gathered = total(clusters.data(), clusters.size(), 1);
  // What is drawn again keeps the light's luminance; clusters keep every channel.
  EXPECT_NEAR(luminance(drawn) / luminance(all), 1, 2.0 / 700);
  for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(gathered[k] / drawn[k], 1, 1e-5);
  // Which cluster each light is in stands behind the clusters, and a cluster's sphere and cone hold its members.
  std::vector<float> members(90);
  for (std::size_t i = 0; i < kept.size() / VPL_WORDS; ++i) {
    std::uint32_t cluster = 0;
    std::memcpy(&cluster, &records[90 * VPL_WORDS + i], 4);
    ASSERT_LT(cluster, 90u);
    ++members[cluster];
    const float *light = &kept[i * VPL_WORDS], *row = &clusters[cluster * VPL_WORDS];
    double square = 0, cosine = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      square += std::pow(light[VPL_POSITION + k] - row[VPL_POSITION + k], 2);
      cosine += light[VPL_NORMAL + k] * row[VPL_NORMAL + k];
    }
    EXPECT_LE(std::sqrt(square), row[VPL_RADIUS] * 1.0001 + 1e-7);
    EXPECT_GE(cosine, row[VPL_COS] - 1e-5);
  }
  for (std::size_t k = 0; k < 90; ++k) EXPECT_EQ(members[k], clusters[k * VPL_WORDS + VPL_COUNT]);
}

// However long light paths are, none of what they leave stands for so much that it lights a spot.
TEST(Vpl, NoLightOutshinesTheOthers) {
  const Rendered made = render(frame_of("furnace", {{"albedo", "0.95"}}, {}, 16, 1, {{"vpl.count", "4000"}}));
  const auto held = made.tasks.at("vpl.cluster.0").inputs.at("lights").load();
  const auto& bytes = *held;
  std::vector<float> lights(bytes.size() / 4);
  std::memcpy(lights.data(), bytes.data(), bytes.size());
  double sum = 0, most = 0;
  float deepest = 0;
  for (std::size_t at = 0; at < lights.size(); at += VPL_WORDS) {
    const double flux = lights[at + VPL_FLUX + 1];
    sum += flux;
    most = std::max(most, flux);
    deepest = std::max(deepest, lights[at + VPL_DEPTH]);
  }
  EXPECT_GT(deepest, 30) << "no path was long";
  EXPECT_LT(most, 8 * sum / static_cast<double>(lights.size() / VPL_WORDS));
}

// --- Numbers ---

TEST(Vpl, AnySceneGivesAFinitePicture) {
  for (const char* scene : {"needles", "far", "comb", "hall", "many-lights", "glass-caustic", "glossy-range"}) {
    const Film film = render(frame_of(scene, {}, {}, 16, 4,
                                      {{"vpl.count", "100"}, {"vpl.clusters", "20"}, {"vpl.point_clusters", "20"}}))
                          .film;
    for (const auto& channel : film.channels)
      for (float value : channel.values) ASSERT_TRUE(std::isfinite(value)) << scene << " " << channel.name;
  }
}

TEST(Vpl, NoLightAndNoSurfaceAreBlack) {
  Scene dark = scene::make_scene("cornell-box", {});
  for (auto& material : dark.materials) std::fill(material.emission, material.emission + 3, 0.0f);
  Frame frame = frame_of("cornell-box", {}, {}, 16, 4, {});
  frame.scene = std::make_shared<const Scene>(dark);
  EXPECT_EQ(mean_of(render(frame).film, "R"), 0);
  Scene empty;
  empty.cameras = dark.cameras;
  frame.scene = std::make_shared<const Scene>(empty);
  EXPECT_EQ(mean_of(render(frame).film, "R"), 0);
}

// A scene's size is nothing to the method: its bound of the geometry term goes with the lights' density.
TEST(Vpl, ScaleIsNothing) {
  const auto scaled = [](float scale) {
    Scene scene = scene::make_scene("cornell-box", {});
    for (float& p : scene.positions) p *= scale;
    for (auto& camera : scene.cameras)
      for (float& o : camera.camera.origin) o *= scale;
    Frame frame = frame_of("cornell-box", {}, {}, 24, 4,
                           {{"vpl.count", "300"}, {"vpl.clusters", "60"}, {"vpl.point_clusters", "60"}});
    frame.scene = std::make_shared<const Scene>(scene);
    frame.settings.camera = scene.cameras[0].camera;
    frame.settings.camera.half_width = frame.settings.camera.half_height;
    return render(frame).film;
  };
  const Film one = scaled(1);
  for (float scale : {1.0f / 1024, 1024.0f}) {
    const Film other = scaled(scale);
    double square = 0, mean = 0;
    for (std::size_t i = 0; i < one.find("R")->values.size(); ++i) {
      const double d = one.find("R")->values[i] - other.find("R")->values[i];
      square += d * d;
      mean += one.find("R")->values[i];
    }
    const double n = static_cast<double>(one.find("R")->values.size());
    EXPECT_LT(std::sqrt(square / n) / (mean / n), 0.01) << "times " << scale;
  }
}

// --- A camera trajectory ---

// How much the clusters' error changes from frame to frame: RMS over the mean of the VPLs' light. The error is what
// clusters make of that light, less what it is where every point queries all lights.
double flicker(const std::vector<Frame>& frames) {
  double square = 0, light = 0, values = 0;
  std::vector<float> before;
  for (Frame frame : frames) {
    const std::vector<float> clustered = render(frame).floats("vpl.shade.0");
    frame.settings.set["vpl.point_clusters"] = std::string("0");
    std::vector<float> error = render(frame).floats("vpl.shade.0");
    for (std::size_t i = 0; i < error.size(); ++i) {
      light += error[i];
      error[i] = clustered[i] - error[i];
      if (!before.empty()) square += std::pow(double{error[i]} - before[i], 2);
    }
    values += static_cast<double>(error.size());
    before = error;
  }
  const double changes = values * static_cast<double>(frames.size() - 1) / static_cast<double>(frames.size());
  return std::sqrt(square / changes) / (light / values);
}

std::vector<Frame> move(const char* scene, float step, bool trajectory) {
  std::vector<Frame> frames;
  std::vector<scene::Camera> cameras;
  for (int k = 0; k < 6; ++k) {
    // Clusters' errors as they are, and no VPL's clusters beside.
    frames.push_back(frame_of(scene, {}, {}, 64, 4,
                              {{"vpl.count", "200"},
                               {"vpl.clusters", "0"},
                               {"vpl.point_clusters", "80"},
                               {"vpl.residual_threshold", "0"},
                               {"vpl.compensate", "0"}}));
    frames.back().settings.camera.origin[0] += step * static_cast<float>(k);
    cameras.push_back(frames.back().settings.camera);
  }
  if (trajectory)
    for (Frame& frame : frames) frame.settings.trajectory = coordinator::trajectory_of(cameras);
  return frames;
}

TEST(Vpl, ClustersDoNotFlickerOnATrajectory) {
  for (const char* scene : {"cornell-box", "cornell-glossy"}) {
    const double alone = flicker(move(scene, 1e-3f, false)), together = flicker(move(scene, 1e-3f, true));
    std::printf("  %s: change of the clusters' error over the mean light: %.4f, on a trajectory %.4f\n", scene, alone,
                together);
    // Not by clusters that have no error.
    EXPECT_GT(alone, 0.02) << scene;
    EXPECT_LT(together, alone / 3) << scene;
  }
}

// Batches of any size give the same records, and so do two threads: with mirrors and glass, and with lobes at both
// ends.
TEST(Vpl, RecordsDoNotDependOnBatches) {
  worker::Executor two({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic});
  for (const char* scene : {"cornell-glass", "cornell-textured"}) {
    const Frame frame =
        frame_of(scene, {}, {}, 40, 4, {{"vpl.count", "200"}, {"vpl.clusters", "50"}, {"vpl.point_clusters", "30"}});
    const Rendered whole = render(frame);
    two.load_scene(scene, frame.scene, nullptr);
    for (const char* name : {"vpl.trace.0", "vpl.points", "vpl.visibility.0", "vpl.shade.0"}) {
      const coordinator::StageSpec& spec = whole.specs.at(name);
      const auto& counts = whole.results.at(name).counts;
      const auto record_of = [&](std::uint64_t item) {
        if (!spec.output.counted) return item;
        return std::accumulate(counts.begin(), counts.begin() + static_cast<std::ptrdiff_t>(item), std::uint64_t{0});
      };
      worker::StageTask again = whole.tasks.at(name);
      again.scene = scene;
      const std::uint64_t step = 48;
      for (std::uint64_t first = 0; first < spec.items; first += step * 3) {
        const std::uint64_t count = std::min(step, spec.items - first);
        const auto result = two.run(again, first, count);
        const std::uint64_t begin = record_of(first), end = record_of(first + count);
        ASSERT_EQ(result.records.size(), (end - begin) * spec.output.record_bytes) << name << " from " << first;
        ASSERT_EQ(
            std::memcmp(result.records.data(), whole.results.at(name).records.data() + begin * spec.output.record_bytes,
                        result.records.size()),
            0)
            << scene << ", " << name << " from " << first;
      }
    }
  }
}

}  // namespace
}  // namespace gleaner::test
