// Method `links` against closed forms, against the path tracer, and in the limits in which its approximations vanish.

#include <bit>
#include <cmath>
#include <cstdio>
#include <functional>
#include <set>

#include "kernels/links_records.h"
#include "kernels/vpl_records.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/radiometry/rendered_frame.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;  // chance of a false alarm of one test

Frame frame_of(Scene scene, const std::string& camera, std::uint32_t size, std::uint32_t spp, const Settings& set) {
  return square_frame("links", std::move(scene), camera, size, spp, set);
}

std::uint32_t word(const worker::BatchResult& result, std::uint64_t at) {
  std::uint32_t value = 0;
  std::memcpy(&value, result.records.data() + at * 4, 4);
  return value;
}

// --- Closed forms ---

TEST(Links, FurnaceOfSoManyBounces) {
  for (const char* depth : {"1", "2", "3", "0"}) {
    const Frame frame = frame_of(
        scene::make_scene("furnace", {{"albedo", "0.5"}, {"emission", "1"}}), "corner", 24, 16,
        {{"depth", depth}, {"links.vertices", "600"}, {"links.directions", "64"}, {"links.light_samples", "64"}});
    const double bounces = std::atof(depth), expected = bounces > 0 ? (1 - std::pow(0.5, bounces + 1)) / 0.5 : 2;
    expect_mean(means_of(frame, "G", 6), expected, std::string("box, depth ") + depth, sidak(kFamily, 4), 0.01,
                bounces > 0 ? 0 : 1e-3 * expected);
  }
}

// Every ray of a closed box meets a wall, so that an element's weights sum to 1; never to more.
TEST(Links, WeightsOfAVertexSumToOneAtMost) {
  for (const char* exact : {"0", "1"})
    for (const char* scene : {"furnace", "cornell-glossy"}) {
      const Rendered made = render(frame_of(scene::make_scene(scene, {}), "", 16, 1,
                                            {{"links.vertices", "500"},
                                             {"links.directions", "256"},
                                             {"links.exact_weights", exact},
                                             {"links.metal", "0"}}));
      const worker::BatchResult& links = made.results.at("links.make");
      std::uint64_t at = 0, whole = 0;
      for (const std::uint32_t words : links.counts) {
        const std::uint64_t n = *exact == '1' ? words / 2 : 2 * std::uint64_t{words} / 3;
        double sum = 0;
        for (std::uint64_t k = 0; k < n; ++k) {
          const std::uint32_t value = word(links, at + n + (*exact == '1' ? k : k / 2));
          sum += *exact == '1' ? std::bit_cast<float>(value) : ((value >> (16 * (k % 2))) & 0xffffu) / 65535.0;
        }
        EXPECT_LE(sum, 1 + 1e-5) << scene;
        whole += sum > 1 - 1e-4;
        at += words;
      }
      EXPECT_EQ(at * 4, links.records.size());
      // The inner sides of the box; of the room, no lobe and no opening takes a share from those far from both.
      if (std::string(scene) == "furnace") {
        EXPECT_EQ(whole, links.counts.size() / 2);
      }
    }
}

// --- The path tracer ---

class LinksMeetPath : public testing::TestWithParam<const char*> {};

// With many vertices and directions the mean is the path tracer's, with all that links leave to paths.
TEST_P(LinksMeetPath, Mean) {
  Frame links = frame_of(scene::make_scene(GetParam(), {}), "", 24, 64,
                         {{"links.vertices", "12000"}, {"links.directions", "64"}, {"links.light_samples", "16"}});
  Frame path = links;
  path.settings.method = "path";
  path.settings.spp = 512;
  auto truths = means_of(path, {"R", "B"}, 4), samples = means_of(links, {"R", "B"}, 4);
  for (const char* channel : {"R", "B"}) {
    const Sample truth = truths[channel], sample = samples[channel];
    const double error = std::hypot(truth.standard_error(), sample.standard_error());
    const double t = std::max(0.0, std::abs(sample.mean - truth.mean) - 0.006 * truth.mean) / error;
    std::printf("  %s %s: %.6f +- %.6f, path %.6f +- %.6f\n", GetParam(), channel, sample.mean, sample.standard_error(),
                truth.mean, truth.standard_error());
    EXPECT_GE(student_p(t, 6), sidak(kFamily, 2)) << GetParam() << " " << channel;
    EXPECT_LT(error, 0.01 * truth.mean) << "too noisy to prove anything";
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, LinksMeetPath,
                         testing::Values("cornell-box", "cornell-mirror", "cornell-glossy", "cornell-textured",
                                         "punctual-lights"),
                         [](const auto& scene) {
                           std::string name = scene.param;
                           std::erase(name, '-');
                           return name;
                         });

// Direct light by light samples alone has the same mean: of a lamp, and of walls that glow.
TEST(Links, LightSamplesAloneMeetPath) {
  for (const char* scene : {"cornell-box", "furnace"}) {
    Frame links = frame_of(scene::make_scene(scene, {}), "", 24, 64,
                           {{"links.vertices", "4000"}, {"links.directions", "64"}, {"links.sample_lights", "1"}});
    Frame both = links;
    both.settings.set["links.sample_lights"] = "0";
    expect_means_meet(means_of(links, "G", 4), means_of(both, "G", 4), scene, 1e-6);
  }
}

// Walls that glow and have a lobe: camera paths go on through chains of diffuse layers, and find at every turn light
// that is the vertices'.
TEST(Links, GlowingGlossyWallsMeetPath) {
  Scene scene = scene::make_scene("furnace", {{"albedo", "0.6"}, {"emission", "1"}});
  for (auto& material : scene.materials) {
    material.specular = 1;
    material.roughness = 0.3f;
  }
  finish_materials(scene);
  Frame links = frame_of(scene, "", 16, 64,
                         {{"links.vertices", "1000"}, {"links.directions", "64"}, {"links.light_samples", "64"}});
  Frame path = links;
  path.settings.method = "path";
  path.settings.spp = 256;
  expect_means_meet(means_of(links, "G", 4), means_of(path, "G", 4), "glossy walls", 0.003);
}

// The Cornell box, whose boxes and back wall are of a material.
Scene box_of(const scene::Material& material) {
  Scene scene = scene::make_scene("cornell-box", {});
  scene.materials.push_back(material);
  scene.material_names.push_back("tested");
  for (const auto& mesh : scene.meshes)
    if (mesh.name.ends_with(" box") || mesh.name == "back wall")
      std::fill_n(scene.triangle_material.begin() + mesh.first_triangle, mesh.triangle_count,
                  static_cast<std::uint32_t>(scene.materials.size() - 1));
  finish_materials(scene);
  return scene;
}

// All but the lamp are seen from their backs: no vertex lies in the open.
Scene seen_from_backs(Scene scene) {
  for (std::size_t t = 0; t < scene.triangle_count(); ++t)
    if (scene.materials[scene.triangle_material[t]].emission[0] == 0)
      std::swap(scene.indices[3 * t + 1], scene.indices[3 * t + 2]);
  return scene;
}

// Vertices of rough metal send light on, of every roughness that they take and of half metal; or leave it to the paths.
TEST(Links, RoughMetalMeetsPath) {
  const auto meets_path = [](const std::string& what, const Scene& scene) {
    Frame links = frame_of(scene, "", 24, 64,
                           {{"links.vertices", "3000"}, {"links.directions", "64"}, {"links.light_samples", "64"}});
    Frame path = links;
    path.settings.method = "path";
    path.settings.spp = 512;
    auto truth = means_of(path, {"R", "B"}, 4);
    for (const char* metal : {"1", "0"}) {
      links.settings.set["links.metal"] = metal;
      for (const auto& [channel, sample] : means_of(links, {"R", "B"}, 4))
        expect_means_meet(sample, truth[channel], what + ", metal " + metal + ", " + channel, 0.006);
    }
    links.settings.set["links.metal"] = "1";
    const Rendered made = render(links);
    EXPECT_GT(made.parameters["links"]["lobe_elements"].get<unsigned>(), 1000u);
    // Of what vertices show a good part came by metal.
    links.settings.set["links.metal"] = "0";
    const std::vector<float> with = made.floats("links.shade"), without = render(links).floats("links.shade");
    EXPECT_GT(std::accumulate(with.begin(), with.end(), 0.0),
              1.03 * std::accumulate(without.begin(), without.end(), 0.0));
  };
  meets_path("roughness 0.5", box_of(scene::metal({0.9, 0.6, 0.3}, 0.5)));
  meets_path("roughness 0.9", box_of(scene::metal({0.9, 0.6, 0.3}, 0.9)));
  scene::Material half = scene::metal({0.9, 0.6, 0.3}, 0.7);
  half.metallic = 0.6f;
  meets_path("half metal", box_of(half));
  meets_path("backs", seen_from_backs(box_of(scene::metal({0.9, 0.6, 0.3}, 0.7))));
}

// Where nothing is rough metal, nothing is asked for: no stage, no other kernels.
TEST(Links, OnlyRoughMetalHasLobes) {
  const auto lobes = [](const scene::Material& material) {
    const Rendered made =
        render(frame_of(box_of(material), "", 16, 1, {{"links.vertices", "300"}, {"links.metal", "1"}}));
    return std::pair{made.specs.contains("links.lobes"), made.parameters["links"]["lobe_elements"].get<unsigned>()};
  };
  EXPECT_EQ(lobes(scene::lambert({0.5, 0.5, 0.5})), std::pair(false, 0u));
  EXPECT_EQ(lobes(scene::dielectric({0.5, 0.5, 0.5}, 0.6)), std::pair(false, 0u));
  EXPECT_EQ(lobes(scene::metal({0.5, 0.5, 0.5}, 0)), std::pair(false, 0u));
  EXPECT_EQ(lobes(scene::metal({0.5, 0.5, 0.5}, 0.3)), std::pair(true, 0u));
  EXPECT_GT(lobes(scene::metal({0.5, 0.5, 0.5}, 0.6)).second, 100u);
}

// --- Limits ---

// Of the light from vertices alone: relative, of pixels below the mean to that. A pixel that shows the lamp has last
// bits of its own.
double largest_difference(const Rendered& a, const Rendered& b) {
  const std::vector<float> x = a.floats("links.shade"), y = b.floats("links.shade");
  const double mean = std::accumulate(x.begin(), x.end(), 0.0) / static_cast<double>(x.size());
  double largest = 0;
  for (std::size_t i = 0; i < x.size(); ++i)
    largest = std::max(largest, std::abs(double{x[i]} - y[i]) / std::max(double{x[i]}, mean));
  return largest;
}

TEST(Links, CompressionChangesNothing) {
  Frame frame = frame_of(scene::make_scene("cornell-box", {}), "", 24, 4,
                         {{"links.vertices", "600"}, {"links.directions", "256"}, {"links.exact_weights", "1"}});
  const Rendered on = render(frame);
  frame.settings.set["links.compress"] = "0";
  const Rendered off = render(frame);
  EXPECT_LT(largest_difference(on, off), 1e-6);
  const double ratio = off.parameters["links"]["bytes"].get<double>() / on.parameters["links"]["bytes"].get<double>();
  std::printf("  compression %.2f\n", ratio);
  EXPECT_GT(ratio, 2.5);
  // 16 bits: a running sum is right to half a unit, so that the error stays far below a thousandth.
  frame.settings.set = {{"links.vertices", "600"}, {"links.directions", "256"}};
  const double rounded = largest_difference(on, render(frame));
  std::printf("  16-bit weights: %.6f at most\n", rounded);
  EXPECT_LT(rounded, 1e-3);
  EXPECT_GT(rounded, 0);
}

// Of the light from vertices alone: root of the mean squared difference, over the mean.
double error_of(const Rendered& made, const Rendered& reference) {
  const std::vector<float> x = made.floats("links.shade"), y = reference.floats("links.shade");
  double squares = 0, sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    squares += (double{x[i]} - y[i]) * (double{x[i]} - y[i]);
    sum += y[i];
  }
  const auto count = static_cast<double>(x.size());
  return std::sqrt(squares / count) / (sum / count);
}

// The error falls as directions and vertices grow. Their limit is the path tracer's light: LinksMeetPath.
TEST(Links, ErrorFallsWithDirectionsAndVertices) {
  Frame frame = frame_of(scene::make_scene("cornell-box", {}), "", 48, 16,
                         {{"links.bounces", "2"}, {"links.light_samples", "64"}, {"links.refine", "0"}});
  const auto with = [&](const char* vertices, const char* directions) {
    frame.settings.set["links.vertices"] = vertices;
    frame.settings.set["links.directions"] = directions;
    return render(frame);
  };
  const Rendered finest = with("16000", "1024");
  const auto falls = [&](const char* what, double step, const std::vector<double>& errors) {
    for (std::size_t k = 1; k < errors.size(); ++k) EXPECT_LT(errors[k], errors[k - 1]) << what;
    const double order =
        std::log(errors.front() / errors.back()) / (static_cast<double>(errors.size() - 1) * std::log(step));
    std::printf("  %s: error %.4f to %.4f, order %.2f\n", what, errors.front(), errors.back(), order);
    return order;
  };
  // Rays of a stratified hemisphere: between those of independent ones and of smooth integrands.
  const double directions = falls("directions 16 to 256", 4,
                                  {error_of(with("16000", "16"), finest), error_of(with("16000", "64"), finest),
                                   error_of(with("16000", "256"), finest)});
  EXPECT_GT(directions, 0.45);
  EXPECT_LT(directions, 1.1);
  // Spacing is the root of the vertices' number: its first power at the edges of shadows, its second where light is
  // smooth.
  const double vertices = falls("vertices 250 to 4000", 4,
                                {error_of(with("250", "1024"), finest), error_of(with("1000", "1024"), finest),
                                 error_of(with("4000", "1024"), finest)});
  EXPECT_GT(vertices, 0.25);
  EXPECT_LT(vertices, 1.1);
}

// Walls of two triangles about a diffuse ball of 9,000.
Scene ball_in_a_box() {
  Scene scene = scene::make_scene("cornell-glass", {});
  for (auto& material : scene.materials)
    if (material.transmission > 0) material = scene::lambert({0.7, 0.7, 0.7});
  finish_materials(scene);
  return scene;
}

// A fine ball does not make the walls about it fine: their corners lie in the dark corners of the room, and between
// these alone the light is too dark.
TEST(Links, LargeWallsBesideFineObjectsAreDivided) {
  Frame frame = frame_of(ball_in_a_box(), "", 48, 16, {});
  const Rendered chosen = render(frame);
  frame.settings.set = {{"links.vertices", "30000"}, {"links.directions", "256"}};
  const Rendered finest = render(frame);
  const std::vector<float> light = chosen.floats("links.shade"), truth = finest.floats("links.shade");
  const double bias =
      std::accumulate(light.begin(), light.end(), 0.0) / std::accumulate(truth.begin(), truth.end(), 0.0) - 1;
  const double error = error_of(chosen, finest);
  const nlohmann::json& links = chosen.parameters["links"];
  std::printf("  %u vertices, %u directions: %+.4f too bright, off by %.4f\n", links["vertices"].get<unsigned>(),
              links["directions"].get<unsigned>(), bias, error);
  EXPECT_LT(std::abs(bias), 0.02);
  EXPECT_LT(error, 0.12);
}

// --- Rays that are not sent ---

// A stage of `made` with other parameters.
worker::BatchResult run_again(const Rendered& made, const std::string& stage,
                              const std::function<void(kernels::LinksParameters&)>& change) {
  worker::StageTask task = made.tasks.at(stage);
  kernels::LinksParameters p{};
  std::memcpy(&p, task.parameters.data(), sizeof p);
  change(p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  return executor(worker::TraceKind::automatic).run(task, 0, p.elements);
}

// What lies behind a wall whose front is in a room sends fewer rays; all others' links are the same to the bit. A room
// that is seen from its walls' backs has nothing hidden.
TEST(Links, HiddenElementsSendFewerRays) {
  const Settings set = {{"links.vertices", "800"}, {"links.directions", "144"}, {"links.refine", "0"}};
  const Rendered made = render(frame_of(scene::make_scene("cornell-box", {}), "", 16, 1, set));
  const worker::BatchResult& fewer = made.results.at("links.make");
  const worker::BatchResult all = run_again(made, "links.make", [](auto& p) { p.hidden_directions = 0; });
  const std::vector<float> probe = made.floats("links.probe");
  const std::size_t elements = all.counts.size();
  std::uint64_t hidden = 0, at = 0, at_all = 0;
  for (std::size_t e = 0; e < elements; ++e) {
    const float *own = &probe[PROBE_WORDS * e], *other = &probe[PROBE_WORDS * (e ^ 1)];
    const bool hides = own[PROBE_BACKS] > 0.5f && other[PROBE_BACKS] <= 0.5f && other[PROBE_HITS] >= 0.25f;
    hidden += hides;
    if (!hides) {
      ASSERT_EQ(fewer.counts[e], all.counts[e]) << e;
      EXPECT_EQ(std::memcmp(&fewer.records[at * 4], &all.records[at_all * 4], std::size_t{4} * all.counts[e]), 0) << e;
    } else {
      EXPECT_LE(fewer.counts[e], 16 * 3 * 3 / 2) << e;
    }
    at += fewer.counts[e], at_all += all.counts[e];
  }
  std::printf("  %llu of %zu elements are hidden\n", static_cast<unsigned long long>(hidden), elements);
  EXPECT_GT(hidden, elements / 20) << "the boxes' inner sides";
  EXPECT_EQ(all.counters.scatter_rays, elements * 144);
  EXPECT_EQ(fewer.counters.scatter_rays, (elements - hidden) * 144 + hidden * 16);

  const Scene backs = seen_from_backs(scene::make_scene("cornell-box", {}));
  const Rendered turned = render(frame_of(backs, "", 16, 1, set));
  const worker::BatchResult& links = turned.results.at("links.make");
  const std::vector<float> sees = turned.floats("links.probe");
  std::uint64_t inside = 0;
  for (std::size_t e = 0; e < links.counts.size(); ++e) inside += sees[PROBE_WORDS * e + PROBE_BACKS] > 0.5f;
  EXPECT_GT(inside, links.counts.size() / 4);
  // But for the boxes' sides within them, whose other sides see no fronts either.
  EXPECT_EQ(links.counters.scatter_rays, links.counts.size() * 144);
}

// Where no triangle is divided nothing is measured: the mesh is the same without these rays.
TEST(Links, OnlyWhatIsDividedIsProbed) {
  Frame frame = frame_of(ball_in_a_box(), "", 48, 16, {});
  const Rendered made = render(frame);
  const std::string stage = "links.coarse_probe";
  const worker::BatchResult all = run_again(made, stage, [](auto& p) { p.divided = 0; });
  const std::uint64_t rays = made.results.at(stage).counters.scatter_rays;
  EXPECT_EQ(all.counters.scatter_rays, made.specs.at(stage).items * 64);
  EXPECT_LT(rays, all.counters.scatter_rays / 2);
  EXPECT_GT(rays, 0u);
  worker::StageTask mesh = made.tasks.at("links.mesh");
  mesh.inputs["probe"] = worker::TaskInput(std::make_shared<scene::Bytes>(all.records));
  EXPECT_TRUE(executor(worker::TraceKind::automatic).run(mesh, 0, 1).records == made.results.at("links.mesh").records);
}

// --- What an audit says, and a target error ---

// The error that the audit tells is that of the vertices' light: against the finest links.
using Counts = std::pair<const char*, const char*>;  // vertices, directions
void expect_audits(const std::string& what, Scene scene, const char* metal, const Counts& most,
                   const std::vector<Counts>& all) {
  Frame frame = frame_of(std::move(scene), "", 48, 16,
                         {{"links.vertices", most.first},
                          {"links.directions", most.second},
                          {"links.light_samples", "64"},
                          {"links.metal", metal}});
  const Rendered finest = render(frame);
  frame.settings.target_error = 0.5;  // what the links are off by is known where one is given
  for (const auto& [vertices, directions] : all) {
    frame.settings.set["links.vertices"] = vertices;
    frame.settings.set["links.directions"] = directions;
    const Rendered made = render(frame);
    const nlohmann::json& links = made.parameters["links"];
    const double truth = error_of(made, finest), told = links["error"], upper = links["error_upper"];
    std::printf("  %s, %s vertices, %s directions: off by %.4f, told %.4f, at most %.4f\n", what.c_str(), vertices,
                directions, truth, told, upper);
    // A pixel in 3 is audited, and most of the error lies in a few.
    EXPECT_GT(told, 0.75 * truth) << what;
    EXPECT_LT(told, 1.3 * truth) << what;
    EXPECT_GT(upper, 0.95 * truth) << what;
  }
}

TEST(Links, AuditsMeetTheTruth) {
  for (const char* scene : {"cornell-box", "cornell-textured"})
    expect_audits(scene, scene::make_scene(scene, {}), "0", {"30000", "576"},
                  {{"500", "64"}, {"1000", "256"}, {"4000", "64"}});
}

TEST(Links, AuditsOfRoughMetalMeetTheTruth) {
  expect_audits("rough metal", box_of(scene::metal({0.9, 0.6, 0.3}, 0.6)), "1", {"12000", "256"},
                {{"500", "64"}, {"1000", "64"}});
}

double error_against(const Film& film, const Film& reference) {
  double squares = 0, sum = 0, count = 0;
  for (const char* channel : {"R", "G", "B"}) {
    const auto& x = film.find(channel)->values;
    const auto& y = reference.find(channel)->values;
    for (std::size_t i = 0; i < x.size(); ++i) {
      squares += std::pow(double{x[i]} - y[i], 2);
      sum += y[i];
    }
    count += static_cast<double>(x.size());
  }
  return std::sqrt(squares / count) / (sum / count);
}

// The picture is no farther from the path tracer's than was asked for, whoever chose the counts. Coarse links leave
// less of the error to the paths.
TEST(Links, TargetErrorsHold) {
  struct Case {
    const char* scene;
    double target;
    Settings coarse;
    double more;  // samples that coarse links take, over those of finer ones
  };
  const Case cases[] = {{"cornell-box", 0.035, {{"links.vertices", "500"}, {"links.directions", "64"}}, 1},
                        {"cornell-textured", 0.04, {{"links.vertices", "100"}, {"links.directions", "16"}}, 1.4}};
  for (const auto& [scene, target, counts, more] : cases) {
    Frame path = frame_of(scene::make_scene(scene, {}), "", 32, 4096, {});
    path.settings.method = "path";
    const Rendered reference = render(path);
    std::uint64_t samples[2];
    for (const bool coarse : {false, true}) {
      Frame frame = path;
      frame.settings.method = "links";
      frame.settings.spp = 64;
      frame.settings.target_error = target;
      if (coarse) frame.settings.set = counts;
      const Rendered made = render(frame);
      samples[coarse] = made.parameters["samples"];
      const nlohmann::json& links = made.parameters["links"];
      const double error = error_against(made.film, reference.film);
      std::printf("  %s: %.4f wanted, %.4f found; %u vertices, %u directions, %.1f samples a pixel\n", scene, target,
                  error, links["vertices"].get<unsigned>(), links["directions"].get<unsigned>(),
                  static_cast<double>(samples[coarse]) / (32 * 32));
      EXPECT_LE(error, target) << scene;
      // Of the picture, not of the vertices' light alone.
      const double mean = (mean_of(made.film, "R") + mean_of(made.film, "G") + mean_of(made.film, "B")) / 3;
      if (!coarse) {
        EXPECT_LT(links["error_upper"].get<double>() * links["mean"].get<double>() / mean, 0.8 * target);
      }
    }
    EXPECT_GE(static_cast<double>(samples[1]), more * static_cast<double>(samples[0])) << scene;
  }
}

// --- Smoothing, and edges ---

// What the mesh of a frame says of each vertex, and a smoothing stage of it whose irradiance is made up.
struct MadeUp {
  explicit MadeUp(const Frame& frame) : made(render(frame)), task(made.tasks.at("links.smooth")) {
    const worker::BatchResult& mesh = made.results.at("links.mesh");
    const std::uint64_t triangles = word(mesh, MESH_TRIANGLES), nodes = word(mesh, MESH_NODES);
    vertices = word(mesh, MESH_VERTICES);
    hanging = word(mesh, MESH_HANGING);
    places_at = MESH_HEADER + MESH_TRIANGLE_WORDS * triangles + nodes + vertices + 1 +
                CORNER_WORDS * std::uint64_t{word(mesh, MESH_CORNERS)} + vertices;
    hanging_at = places_at + PLACE_WORDS * std::uint64_t{vertices};
  }
  float normal(std::uint32_t vertex, unsigned axis) const {
    return std::bit_cast<float>(word(made.results.at("links.mesh"), places_at + PLACE_WORDS * vertex + axis));
  }
  // Irradiance `value(vertex)` on both sides, so noisy, smoothed.
  template <typename Value>
  std::vector<float> smoothed(double degrees, Value value, float noise = 1e30f) {
    kernels::LinksSmoothParameters p{};
    p.elements = 2 * vertices;
    p.least_cosine = degrees > 0 ? static_cast<float>(std::cos(degrees * 3.14159265 / 180)) : 2.0f;
    std::memcpy(task.parameters.data(), &p, sizeof p);
    auto bytes = std::make_shared<scene::Bytes>(std::size_t{2} * vertices * RADIOSITY_WORDS * 4);
    auto* rows = reinterpret_cast<float*>(bytes->data());
    for (std::uint32_t e = 0; e < 2 * vertices; ++e) {
      rows[e * RADIOSITY_WORDS] = value(e / 2);
      rows[e * RADIOSITY_WORDS + RADIOSITY_NOISE] = noise;
    }
    task.inputs["irradiance"] = worker::TaskInput(std::move(bytes));
    const worker::BatchResult result = executor(worker::TraceKind::automatic).run(task, 0, std::uint64_t{2} * vertices);
    std::vector<float> out(2 * vertices);
    for (std::uint32_t e = 0; e < 2 * vertices; ++e)
      out[e] = std::bit_cast<float>(word(result, std::uint64_t{e} * RADIOSITY_WORDS));
    return out;
  }

  Rendered made;
  worker::StageTask task;
  std::uint32_t vertices = 0, hanging = 0;
  std::uint64_t places_at = 0, hanging_at = 0;
};

TEST(Links, SmoothingKeepsFeatureEdges) {
  MadeUp mesh(frame_of(scene::make_scene("cornell-box", {}), "", 16, 1,
                       {{"links.vertices", "800"}, {"links.refine", "0"}, {"links.smooth_angle", "30"}}));
  const auto floors = [&](std::uint32_t v) { return mesh.normal(v, 1) > 0.9f ? 1.0f : 0.0f; };
  const auto waves = [&](std::uint32_t v) { return static_cast<float>(v % 7); };
  const std::vector<float> kept = mesh.smoothed(30, floors), crossed = mesh.smoothed(100, floors);
  const std::vector<float> none = mesh.smoothed(0, waves), smooth = mesh.smoothed(30, waves);
  std::uint32_t across = 0, changed = 0;
  for (std::uint32_t e = 0; e < 2 * mesh.vertices; ++e) {
    EXPECT_FLOAT_EQ(kept[e], floors(e / 2)) << e;
    if (mesh.hanging == 0) {
      EXPECT_EQ(none[e], waves(e / 2)) << e;
    }
    across += crossed[e] != floors(e / 2);
    changed += smooth[e] != waves(e / 2);
  }
  EXPECT_GT(across, 20u);
  EXPECT_GT(changed, mesh.vertices);
}

// No vertex moves by more than its noise; one without noise stays.
TEST(Links, SmoothingIsBoundByNoise) {
  MadeUp mesh(frame_of(scene::make_scene("cornell-box", {}), "", 16, 1,
                       {{"links.vertices", "800"}, {"links.refine", "0"}, {"links.smooth_angle", "30"}}));
  ASSERT_EQ(mesh.hanging, 0u) << "what hangs moves for another reason";
  const auto waves = [&](std::uint32_t v) { return static_cast<float>(v % 7); };
  const std::vector<float> free = mesh.smoothed(30, waves);
  for (const float noise : {0.0f, 0.1f, 1.0f}) {
    const std::vector<float> bound = mesh.smoothed(30, waves, noise);
    std::uint32_t cut = 0, whole = 0;
    for (std::uint32_t e = 0; e < 2 * mesh.vertices; ++e) {
      const float wanted = free[e] - waves(e / 2), moved = bound[e] - waves(e / 2);
      EXPECT_LE(std::abs(moved), noise + 1e-6f) << e;
      EXPECT_NEAR(moved, std::clamp(wanted, -noise, noise), 1e-5f) << e;
      cut += std::abs(wanted) > noise + 1e-4f;
      whole += std::abs(wanted) < noise - 1e-4f;
    }
    EXPECT_GT(cut, 20u) << noise;
    if (noise > 0) {
      EXPECT_GT(whole, 20u) << noise;
    }
    if (noise == 0) {
      EXPECT_EQ(bound, mesh.smoothed(0, waves)) << "nothing moves";
    }
  }
}

// What gathering tells of an element's noise is no less than the difference of other rays' says, in the mean, and not
// many times it: rays are spread evenly, which the noise of independent ones does not know.
TEST(Links, NoiseIsToldOfEachElement) {
  for (const char* directions : {"16", "64", "256"})
    for (const char* exact : {"0", "1"}) {
      Frame frame = frame_of(scene::make_scene("cornell-box", {}), "", 16, 1,
                             {{"links.vertices", "600"},
                              {"links.refine", "0"},
                              {"links.bounces", "1"},
                              {"links.light_samples", "256"},
                              {"links.directions", directions},
                              {"links.exact_weights", exact},
                              {"links.smooth_angle", "30"}});
      const std::vector<float> one = render(frame).floats("links.gather.1");
      frame.settings.seed = 9;
      const std::vector<float> other = render(frame).floats("links.gather.1");
      ASSERT_EQ(one.size(), other.size());
      double told = 0, found = 0;
      for (std::size_t row = 0; row < one.size(); row += RADIOSITY_WORDS) {
        told += std::pow(one[row + RADIOSITY_NOISE], 2);
        double most = 0;
        for (unsigned c = 0; c < 3; ++c) most = std::max(most, std::pow(one[row + c] - other[row + c], 2.0) / 2);
        found += most;
      }
      const double ratio = std::sqrt(told / found);
      std::printf("  %s directions: told over found %.2f\n", directions, ratio);
      EXPECT_GT(ratio, 1);
      EXPECT_LT(ratio, 8);
    }
}

// Where a triangle is divided more than its neighbour, the vertices on their edge show what the neighbour interpolates.
TEST(Links, EdgesHaveNoCracks) {
  MadeUp mesh(frame_of(scene::make_scene("cornell-box", {}), "", 16, 1, {{"links.vertices", "2000"}}));
  ASSERT_GT(mesh.hanging, 20u) << "nothing hangs in this mesh";
  const std::vector<float> shown = mesh.smoothed(0, [](std::uint32_t v) { return static_cast<float>(v % 11); });
  const worker::BatchResult& words = mesh.made.results.at("links.mesh");
  std::uint32_t between = 0;
  for (std::uint32_t h = 0; h < mesh.hanging; ++h) {
    const auto at = [&](unsigned k) { return word(words, mesh.hanging_at + HANGING_WORDS * h + k); };
    const float part = std::bit_cast<float>(at(HANGING_PART));
    EXPECT_GT(part, 0);
    EXPECT_LT(part, 1);
    for (std::uint32_t side = 0; side < 2; ++side) {
      const float a = shown[2 * at(HANGING_FROM) + side], b = shown[2 * at(HANGING_TO) + side];
      const float found = shown[2 * at(HANGING_VERTEX) + side];
      // An end inside of something gives nothing.
      EXPECT_TRUE(std::abs(found - ((1 - part) * a + part * b)) < 1e-5f || found == a || found == b) << h;
      between += std::abs(found - ((1 - part) * a + part * b)) < 1e-5f;
    }
  }
  EXPECT_GT(between, mesh.hanging);
}

// A room whose back wall is two triangles on the left and 2 cells x cells of them on the right, seen closely where they
// meet. A block before it bends the light.
Scene seamed_room(std::uint32_t cells) {
  scene::SceneBuilder b("seamed-room");
  const std::uint32_t white = b.material("white", scene::lambert({0.7, 0.7, 0.7}));
  const std::uint32_t lamp = b.material("lamp", scene::emitter({17, 12, 4}));
  b.mesh("walls");
  b.quad({-1, 0, 1}, {1, 0, 1}, {1, 0, -1}, {-1, 0, -1}, white);
  b.quad({-1, 2, -1}, {1, 2, -1}, {1, 2, 1}, {-1, 2, 1}, white);
  b.quad({-1, 0, 1}, {-1, 0, -1}, {-1, 2, -1}, {-1, 2, 1}, white);
  b.quad({1, 0, -1}, {1, 0, 1}, {1, 2, 1}, {1, 2, -1}, white);
  b.mesh("two triangles");
  b.quad({-1, 0, -1}, {0, 0, -1}, {0, 2, -1}, {-1, 2, -1}, white);
  b.mesh("cells");
  b.grid(cells, cells,
         [&](std::uint32_t i, std::uint32_t j) {
           return scene::Vec{double(i) / cells, 2.0 * j / cells, -1};
         },
         white, {.smooth = false});
  b.mesh("block");
  b.box({0, 0.4, -0.7}, {0.25, 0.4, 0.15}, 0.3, white);
  b.mesh("lamp");
  b.quad({-0.24, 1.99, -0.19}, {0.24, 1.99, -0.19}, {0.24, 1.99, 0.19}, {-0.24, 1.99, 0.19}, lamp);
  b.orthographic_camera("seam", {0, 1.2, 0.5}, {0, 0, -1}, {0, 1, 0}, 0.3, 0.3, 64, 64);
  return b.finish();
}

// Corners of a fine mesh on the edge of a triangle that is divided less: the light is one where they meet. From the
// column of pixels on the one side to that on the other it changes no more than beside them.
TEST(Links, MeshesThatMeetHaveNoCracks) {
  for (const char* vertices : {"0", "2000"}) {
    const Rendered made = render(frame_of(seamed_room(24), "seam", 64, 16,
                                          {{"links.vertices", vertices},
                                           {"links.refine", "0"},
                                           {"links.directions", "64"},
                                           {"links.light_samples", "64"}}));
    const std::vector<float> shown = made.floats("links.shade");
    const auto step = [&](std::size_t column) {
      double squares = 0;
      for (std::size_t row = 0; row < 64; ++row)
        squares += std::pow(shown[3 * (64 * row + column) + 4] - shown[3 * (64 * row + column) + 1], 2);
      return std::sqrt(squares / 64);
    };
    const double across = step(31), beside = std::max(step(30), step(32));
    const double mean = std::accumulate(shown.begin(), shown.end(), 0.0) / static_cast<double>(shown.size());
    std::printf("  %s vertices: across the seam %.4f of the mean, beside it %.4f\n", vertices, across / mean,
                beside / mean);
    EXPECT_LT(across, 1.5 * beside) << vertices;
    EXPECT_GT(word(made.results.at("links.mesh"), MESH_HANGING), 10u);
  }
}

// --- The house ---

void compare_batches(Scene scene, std::vector<const char*> stages) {
  Frame frame = frame_of(std::move(scene), "", 16, 4, {{"links.vertices", "400"}, {"links.metal", "1"}});
  frame.settings.target_error = 0.5;
  const Rendered made = render(frame);
  worker::Executor two({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic});
  two.load_scene("two", frame.scene, nullptr);
  for (const char* name : stages) {
    const coordinator::StageSpec& spec = made.specs.at(name);
    const worker::BatchResult& whole = made.results.at(name);
    worker::StageTask task = made.tasks.at(name);
    task.scene = "two";
    std::size_t at = 0;
    for (std::uint64_t first = 0; first < spec.items;) {
      const std::uint64_t count = std::min<std::uint64_t>(spec.items - first, 6 * spec.tile);
      const worker::BatchResult part = two.run(task, first, count);
      ASSERT_LE(at + part.records.size(), whole.records.size()) << name;
      ASSERT_EQ(std::memcmp(part.records.data(), whole.records.data() + at, part.records.size()), 0)
          << name << ", items from " << first;
      at += part.records.size();
      first += count;
    }
    EXPECT_EQ(at, whole.records.size()) << name;
  }
}

TEST(Links, RecordsDoNotDependOnBatches) {
  compare_batches(
      scene::make_scene("cornell-textured", {}),
      {"links.probe", "links.albedo", "links.make", "links.light", "links.gather.2", "links.audit", "links.shade"});
  compare_batches(box_of(scene::metal({0.9, 0.6, 0.3}, 0.6)),
                  {"links.albedo", "links.make", "links.light", "links.gather.2", "links.audit"});
}

// All bounces on one worker are those of a stage each, to the bit, and end at the same one.
TEST(Links, SoloExchangeIsThatOfStages) {
  for (const char* bounces : {"0", "3"}) {
    Frame frame = frame_of(scene::make_scene("cornell-box", {}), "", 16, 1,
                           {{"links.vertices", "400"}, {"links.bounces", bounces}, {"links.directions", "64"}});
    const Rendered split = render(frame);
    frame.settings.set["links.solo_exchange"] = "1";
    const Rendered solo = render(frame);
    const auto done = split.parameters["links"]["bounces"].get<unsigned>();
    EXPECT_GE(done, 3u);
    EXPECT_EQ(solo.parameters["links"]["bounces"], done);
    EXPECT_EQ(solo.parameters["links"]["left_after_bounces"], split.parameters["links"]["left_after_bounces"]);
    EXPECT_EQ(solo.results.at("links.smooth").records, split.results.at("links.smooth").records);
    EXPECT_EQ(solo.results.at("links.shade").records, split.results.at("links.shade").records);
  }
}

// Bounces to come are told by the last ones: what is shown is that of many bounces, by fewer of them, but where a limit
// says how many there are.
TEST(Links, FewBouncesTellThoseToCome) {
  const auto bounced = [](std::map<std::string, std::string> set) {
    set.merge(std::map<std::string, std::string>{{"links.vertices", "1000"}, {"links.directions", "64"}});
    return render(frame_of(scene::make_scene("cornell-box", {}), "", 16, 1, std::move(set)));
  };
  const auto irradiance = [](const Rendered& rendered) {
    const auto& records = rendered.results.at("links.smooth").records;
    std::vector<float> rows(records.size() / 4);
    std::memcpy(rows.data(), records.data(), records.size());
    return rows;
  };
  const std::vector<float> all = irradiance(bounced({{"links.bounces", "40"}}));
  const auto off = [&](const Rendered& rendered) {
    const std::vector<float> rows = irradiance(rendered);
    double sum = 0, total = 0;
    for (std::size_t at = 0; at < rows.size(); at += RADIOSITY_WORDS)
      for (unsigned c = 0; c < 3; ++c) {
        sum += std::abs(rows[at + RADIOSITY_SENT + c] - all[at + RADIOSITY_SENT + c]);
        total += all[at + RADIOSITY_SENT + c];
      }
    return sum / total;
  };
  for (const char* share : {"0.01", "0.001"}) {
    const Rendered told = bounced({{"links.least_share", share}});
    const auto bounces = told.parameters["links"]["bounces"].get<unsigned>();
    const Rendered limited = bounced({{"links.bounces", std::to_string(bounces)}});
    std::printf("  share %s: %u bounces, off by %.5f, told %.5f, without the tail %.5f\n", share, bounces, off(told),
                told.parameters["links"]["left_after_bounces"].get<double>(), off(limited));
    EXPECT_LT(off(told), 1.5 * std::atof(share));
    EXPECT_GT(off(limited), 3 * off(told));
  }
}

// Frames in which lights and cameras alone differ ask for the same links, and get the same records.
TEST(Links, LinksKnowNoLightAndNoCamera) {
  const Settings set = {{"links.vertices", "600"}};
  Scene scene = scene::make_scene("cornell-box", {});
  const Rendered one = render(frame_of(scene, "", 16, 4, set));
  for (auto& material : scene.materials)
    for (float& e : material.emission) e *= 3;
  Frame moved = frame_of(scene, "", 24, 16, set);
  moved.settings.camera.origin[0] += 0.1f;
  const Rendered other = render(moved);
  for (const char* name :
       {"links.coarse_mesh", "links.coarse_probe", "links.mesh", "links.probe", "links.albedo", "links.make"}) {
    EXPECT_EQ(one.specs.at(name).parameters, other.specs.at(name).parameters) << name;
    EXPECT_EQ(one.results.at(name).records, other.results.at(name).records) << name;
    EXPECT_TRUE(one.specs.at(name).output.reusable) << name;
  }
  EXPECT_NE(one.results.at("links.light").records, other.results.at("links.light").records);
}

// --- Scenes that move ---

// Before all others two triangles behind the back wall, which nothing sees: joined at an edge, or apart by a little, so
// that all other vertices have other numbers.
Scene with_triangles_before(Scene scene, float apart) {
  const auto first = static_cast<std::uint32_t>(scene.positions.size() / 3);
  const scene::Bounds box = scene::bounds_of(scene);
  const float z = box.lower[2] - 1;
  scene.positions.insert(scene.positions.end(), {0, 0, z, 0.1f, 0, z, 0, 0.1f, z,  //
                                                 0.1f + apart, 0, z, 0.1f + apart, 0.1f, z, apart, 0.1f, z});
  if (!scene.normals.empty())
    for (unsigned k = 0; k < 6; ++k) scene.normals.insert(scene.normals.end(), {0, 0, 1});
  if (!scene.uvs.empty()) scene.uvs.resize(scene.uvs.size() + 12);
  const std::uint32_t corners[6] = {first, first + 1, first + 2, first + 3, first + 4, first + 5};
  scene.indices.insert(scene.indices.begin(), corners, corners + 6);
  scene.triangle_material.insert(scene.triangle_material.begin(), 2, 0u);
  for (auto& mesh : scene.meshes) mesh.first_triangle += 2;
  scene.meshes.insert(scene.meshes.begin(), scene::Mesh{.name = "before", .first_triangle = 0, .triangle_count = 2});
  return scene;
}

// A vertex has its random numbers by what it is, not by its place in the list.
TEST(Links, VerticesKeepTheirRotationsInOtherLists) {
  const Settings set = {{"links.vertices", "600"}, {"links.refine", "0"}, {"links.directions", "64"}};
  const Scene box = scene::make_scene("cornell-box", {});
  const Rendered joined = render(frame_of(with_triangles_before(box, 0), "", 24, 4, set));
  const Rendered apart = render(frame_of(with_triangles_before(box, 1e-3f), "", 24, 4, set));
  EXPECT_EQ(word(joined.results.at("links.mesh"), MESH_VERTICES) + 2,
            word(apart.results.at("links.mesh"), MESH_VERTICES));
  EXPECT_EQ(joined.results.at("links.shade").records, apart.results.at("links.shade").records);
  for (const char* stage : {"links.probe", "links.albedo", "links.light", "links.smooth"}) {
    const std::vector<float> one = joined.floats(stage), other = apart.floats(stage);
    const std::size_t row = joined.specs.at(stage).output.record_bytes / 4;
    // Two elements a vertex, four vertices and six.
    EXPECT_TRUE(std::equal(one.begin() + static_cast<std::ptrdiff_t>(8 * row), one.end(),
                           other.begin() + static_cast<std::ptrdiff_t>(12 * row), other.end()))
        << stage;
  }
}

// What irradiance of vertices does over frames beside moving steadily: root mean square of its second differences.
double temporal_deviation(const std::vector<std::vector<float>>& frames) {
  double squares = 0, sum = 0;
  std::size_t count = 0;
  for (std::size_t t = 1; t + 1 < frames.size(); ++t)
    for (std::size_t row = 0; row < frames[t].size(); row += RADIOSITY_WORDS) {
      squares += std::pow(frames[t - 1][row] - 2.0 * frames[t][row] + frames[t + 1][row], 2);
      sum += frames[t][row];
      ++count;
    }
  return std::sqrt(squares / 6 / static_cast<double>(count)) / (sum / static_cast<double>(count));
}

// A block moves: light on the vertices changes less from frame to frame than between other random numbers.
TEST(Links, NothingBoilsWhereAnObjectMoves) {
  const Scene box = scene::make_scene("cornell-box", {});
  const auto block = std::ranges::find_if(box.meshes, [](const auto& mesh) { return mesh.name == "short box"; });
  ASSERT_NE(block, box.meshes.end());
  std::vector<std::vector<float>> kept, independent;
  for (unsigned frame = 0; frame < 6; ++frame) {
    Scene scene = box;
    std::set<std::uint32_t> moved;
    for (std::uint32_t corner = 0; corner < 3 * block->triangle_count; ++corner)
      moved.insert(scene.indices[3 * block->first_triangle + corner]);
    for (const std::uint32_t vertex : moved) scene.positions[3 * vertex] += 0.005f * static_cast<float>(frame);
    // The list changes as well.
    Frame shown = frame_of(with_triangles_before(scene, frame % 2 ? 1e-3f : 0), "", 16, 1,
                           {{"links.vertices", "800"}, {"links.refine", "0"}, {"links.directions", "64"}});
    const auto irradiance = [&] {
      std::vector<float> rows = render(shown).floats("links.smooth");
      rows.erase(rows.begin(), rows.begin() + (frame % 2 ? 12 : 8) * RADIOSITY_WORDS);
      return rows;
    };
    kept.push_back(irradiance());
    shown.settings.seed = 100 + frame;
    independent.push_back(irradiance());
    ASSERT_EQ(kept.back().size(), kept.front().size());
  }
  const double steady = temporal_deviation(kept), boiling = temporal_deviation(independent);
  std::printf("  temporal deviation %.4f of the mean, with independent rotations %.4f: %.2f of it\n", steady, boiling,
              steady / boiling);
  EXPECT_LT(steady, boiling / 3);
}

// One word of a parameter (no input) or an input, changed: the stage refuses it.
void expect_refused(worker::Executor& on, const Rendered& made, const char* stage, const char* input, std::size_t at,
                    std::uint32_t value) {
  worker::StageTask task = made.tasks.at(stage);
  if (input) {
    auto bytes = std::make_shared<scene::Bytes>(*task.inputs.at(input).load());
    std::memcpy(bytes->data() + 4 * at, &value, 4);
    const auto offsets = task.inputs.at(input).offsets;
    task.inputs[input] = worker::TaskInput(std::move(bytes));
    task.inputs[input].offsets = offsets;
    task.inputs[input].own_items = made.tasks.at(stage).inputs.at(input).own_items;
  } else {
    std::memcpy(task.parameters.data() + 4 * at, &value, 4);
  }
  EXPECT_THROW(on.run(task, 0, 2), Error) << stage << ", " << (input ? input : "parameters") << "[" << at << "]";
}

TEST(Links, RefusesWhatIsOutOfRange) {
  Frame frame = frame_of(scene::make_scene("cornell-box", {}), "", 16, 1, {{"links.vertices", "100"}});
  frame.settings.target_error = 0.5;
  const Rendered made = render(frame);
  worker::Executor& on = executor(frame.trace);
  const auto refused = [&](const char* stage, const char* input, std::size_t word_at, std::uint32_t value) {
    expect_refused(on, made, stage, input, word_at, value);
  };
  const std::uint32_t elements = static_cast<std::uint32_t>(made.specs.at("links.make").items);
  refused("links.make", nullptr, 0, elements + 2);
  refused("links.make", nullptr, 1, 100);
  refused("links.light", nullptr, 2, 8);
  for (const unsigned at : {MESH_TRIANGLES, MESH_NODES, MESH_VERTICES, MESH_CORNERS, MESH_HEADER, MESH_HEADER + 1})
    refused("links.make", "mesh", at, 0x7fffffffu);
  const worker::BatchResult& mesh = made.results.at("links.mesh");
  const std::size_t nodes = MESH_HEADER + std::size_t{MESH_TRIANGLE_WORDS} * word(mesh, MESH_TRIANGLES);
  const std::size_t rings = nodes + word(mesh, MESH_NODES), corners = rings + word(mesh, MESH_VERTICES) + 1;
  refused("links.make", "mesh", nodes, elements / 2);
  refused("links.make", "mesh", rings + 1, 0);
  refused("links.make", "mesh", corners + CORNER_TRIANGLE, word(mesh, MESH_TRIANGLES));
  refused("links.make", "mesh", corners + CORNER_PLACE, CORNER_KINDS << 24);
  // The first link of an element, which is read with 15 others, and the last.
  std::uint32_t at = 0, most = 0;
  for (const std::uint32_t words : {made.results.at("links.make").counts[0], made.results.at("links.make").counts[1]}) {
    const std::uint32_t links = 2 * words / 3;
    for (const std::uint32_t link : {0u, links - 1})
      if (links) refused("links.gather.1", "links", at + link, elements);
    at += words;
    most = std::max(most, links);
  }
  EXPECT_GT(most % 16, 0u);
  EXPECT_GT(most, 16u);
  refused("links.audit", nullptr, 1, 100);
  refused("links.audit", "points", POINT_TRIANGLE, word(mesh, MESH_TRIANGLES));
  refused("links.audit_points", nullptr, offsetof(kernels::VplPointParameters, points) / 4, 3);
  refused("links.smooth", "mesh", MESH_HANGING, 0x7fffffffu);
}

TEST(Links, RefusesLobesThatAreNone) {
  Frame frame = frame_of(box_of(scene::metal({0.9, 0.6, 0.3}, 0.6)), "", 16, 1,
                         {{"links.vertices", "100"}, {"links.metal", "1"}});
  const Rendered made = render(frame);
  worker::Executor& on = executor(frame.trace);
  const auto plain = static_cast<std::uint32_t>(made.specs.at("links.probe").items);
  const std::uint32_t lobes = made.parameters["links"]["lobe_elements"].get<std::uint32_t>() / LOBE_BINS;
  ASSERT_GT(lobes, 10u);
  for (const char* stage : {"links.albedo", "links.make", "links.light"}) {
    expect_refused(on, made, stage, "lobes", 0, lobes);
    expect_refused(on, made, stage, "lobes", plain, plain);
    expect_refused(on, made, stage, nullptr, 0, plain);
  }
  expect_refused(on, made, "links.gather.1", nullptr, 3, 0);
  expect_refused(on, made, "links.gather.1", nullptr, 3, plain + 1);
}

}  // namespace
}  // namespace gleaner::test
