#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>

#include "cli/commands.h"
#include "cli/import_options.h"
#include "scene/model/emission.h"
#include "scene/model/names.h"
#include "scene/model/scene.h"

namespace gleaner::cli {
namespace {

using nlohmann::ordered_json;
using scene::Scene;

struct InfoWords {
  ImportWords files;
  bool json = false;
};

// Where a point of the scene lies in the file's coordinates.
std::array<double, 3> in_file(const Scene& scene, const float* p) {
  return {scene.origin[0] + p[0], scene.origin[1] + p[1], scene.origin[2] + p[2]};
}

// All emissive triangles of a scene; power is what leaves the faces that emit, textures and opacity taken in the mean.
struct Emitters {
  std::uint64_t triangles = 0;
  double area = 0;                // m^2
  std::array<double, 3> power{};  // W: pi * area * radiance
};

Emitters emitters_of(const Scene& scene) {
  Emitters emitters;
  const std::vector<std::array<float, 3>> means = scene::mean_emission(scene);
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const scene::Material& m = scene.materials[scene.triangle_material[t]];
    const std::array<float, 3>& radiance = means[scene.triangle_material[t]];
    if (!(radiance[0] > 0 || radiance[1] > 0 || radiance[2] > 0)) continue;
    double edge[2][3];
    for (int e = 0; e < 2; ++e)
      for (int c = 0; c < 3; ++c)
        edge[e][c] = double(scene.positions[3 * std::size_t(scene.indices[3 * t + e + 1]) + c]) -
                     scene.positions[3 * std::size_t(scene.indices[3 * t]) + c];
    const double area =
        std::hypot(edge[0][1] * edge[1][2] - edge[0][2] * edge[1][1], edge[0][2] * edge[1][0] - edge[0][0] * edge[1][2],
                   edge[0][0] * edge[1][1] - edge[0][1] * edge[1][0]) /
        2;
    if (!(area > 0)) continue;
    ++emitters.triangles;
    emitters.area += area;
    const int faces = m.flags & GLEANER_MATERIAL_DOUBLE_SIDED ? 2 : 1;
    for (int c = 0; c < 3; ++c) emitters.power[c] += std::numbers::pi * area * faces * radiance[c];
  }
  return emitters;
}

// Mean radiance over the sphere of directions: rows weigh by the sine of their angle from the pole.
std::array<double, 3> mean_radiance(const scene::Environment& environment) {
  std::array<double, 3> sum{};
  double weights = 0;
  for (std::uint32_t y = 0; y < environment.height; ++y) {
    const double weight = std::sin(std::numbers::pi * (y + 0.5) / environment.height);
    weights += weight * environment.width;
    for (std::uint32_t x = 0; x < environment.width; ++x)
      for (int c = 0; c < 3; ++c)
        sum[c] += weight * environment.radiance[3 * (std::size_t(y) * environment.width + x) + c];
  }
  for (double& c : sum) c /= weights;
  return sum;
}

std::array<std::size_t, 3> punctual_lights(const Scene& scene) {
  std::array<std::size_t, 3> count{};
  for (const scene::Light& light : scene.lights) ++count[light.type];
  return count;
}

std::ptrdiff_t instanced_meshes(const Scene& scene) {
  return std::ranges::count_if(scene.meshes, [](const scene::Mesh& mesh) { return mesh.instanced; });
}

bool has_light(const scene::SceneNeeds& needs) {
  return needs.emissive_triangles || needs.punctual_lights || needs.environment || needs.unlit;
}

ordered_json json_of(const InfoWords& words, const Scene& scene, double seconds) {
  const scene::SceneNeeds needs = needs_of(scene);
  const scene::Bounds bounds = bounds_of(scene);
  const Emitters emitters = emitters_of(scene);
  const auto punctual = punctual_lights(scene);
  ordered_json cameras = ordered_json::array(), needed = ordered_json::object();
  for (const scene::NamedCamera& camera : scene.cameras)
    cameras.push_back({{"name", camera.name},
                       {"type", camera.camera.type == GLEANER_CAMERA_ORTHOGRAPHIC ? "orthographic" : "perspective"},
                       {"width", camera.width},
                       {"height", camera.height},
                       {"aspect", camera.aspect},
                       {"origin", in_file(scene, camera.camera.origin)},
                       {"forward", camera.camera.forward}});
  for (std::size_t i = 0; i < scene::need_names().size(); ++i)
    needed[scene::need_names()[i]] = (needs.bits() >> i & 1) != 0;
  ordered_json result = {
      {"scene", words.files.scene},
      {"triangles", scene.triangle_count()},
      {"vertices", scene.vertex_count()},
      {"meshes", scene.meshes.size()},
      {"instanced_meshes", instanced_meshes(scene)},
      {"instances", scene.instances.size()},
      {"effective_triangles", scene.effective_triangle_count()},
      {"materials", scene.materials.size()},
      {"textures", scene.textures.size()},
      {"texture_bytes", scene.texels.size() * sizeof scene.texels[0]},
      {"lights",
       {{"emissive_triangles", emitters.triangles},
        {"emissive_area_m2", emitters.area},
        {"emissive_power_w", emitters.power},
        {"point", punctual[GLEANER_LIGHT_POINT]},
        {"spot", punctual[GLEANER_LIGHT_SPOT]},
        {"directional", punctual[GLEANER_LIGHT_DIRECTIONAL]}}},
      {"cameras", cameras},
      {"bounds", {{"lower_m", in_file(scene, bounds.lower.data())}, {"upper_m", in_file(scene, bounds.upper.data())}}},
      {"origin_m", scene.origin},
      {"needs", needed},
      {"warnings", scene.warnings},
      {"import_seconds", seconds}};
  if (!scene.light_units.empty()) result["lights"]["units"] = scene.light_units;
  if (!scene.variants.empty()) result["variants"] = scene.variants;
  for (const scene::AnimationInfo& animation : scene.animations)
    result["animations"].push_back({{"name", animation.name}, {"seconds", animation.seconds}});
  if (!scene.environment.empty())
    result["lights"]["environment"] = {{"width", scene.environment.width},
                                       {"height", scene.environment.height},
                                       {"mean_radiance", mean_radiance(scene.environment)}};
  return result;
}

void print(const InfoWords& words, const Scene& scene, double seconds) {
  const scene::SceneNeeds needs = needs_of(scene);
  const scene::Bounds bounds = bounds_of(scene);
  const Emitters emitters = emitters_of(scene);
  const auto punctual = punctual_lights(scene);
  fmt::print("{}\n", printable(words.files.scene));
  fmt::print("  triangles  {}, {} vertices, {} meshes\n", scene.triangle_count(), scene.vertex_count(),
             scene.meshes.size());
  if (!scene.instances.empty())
    fmt::print("  instances  {} of {} meshes: {} triangles in all places\n", scene.instances.size(),
               instanced_meshes(scene), scene.effective_triangle_count());
  const auto lower = in_file(scene, bounds.lower.data()), upper = in_file(scene, bounds.upper.data());
  fmt::print("  bounds     {:.9g} {:.9g} {:.9g} to {:.9g} {:.9g} {:.9g} m\n", lower[0], lower[1], lower[2], upper[0],
             upper[1], upper[2]);
  if (scene.origin != std::array<double, 3>{})
    fmt::print("  origin     {:.9g} {:.9g} {:.9g} m: what is rendered is relative to it\n", scene.origin[0],
               scene.origin[1], scene.origin[2]);
  fmt::print("  materials  {}\n", scene.materials.size());
  fmt::print("  textures   {}, {:.1f} MB decoded\n", scene.textures.size(), 4e-6 * double(scene.texels.size()));
  fmt::print("  lights     {} emissive triangles", emitters.triangles);
  if (emitters.triangles > 0)
    fmt::print(" of {:.6g} m^2, power {:.6g} {:.6g} {:.6g} W", emitters.area, emitters.power[0], emitters.power[1],
               emitters.power[2]);
  fmt::print("; {} point, {} spot, {} directional", punctual[GLEANER_LIGHT_POINT], punctual[GLEANER_LIGHT_SPOT],
             punctual[GLEANER_LIGHT_DIRECTIONAL]);
  if (!scene.environment.empty()) {
    const auto mean = mean_radiance(scene.environment);
    fmt::print("; environment {}x{}, mean radiance {:.6g} {:.6g} {:.6g} W/(sr m^2)", scene.environment.width,
               scene.environment.height, mean[0], mean[1], mean[2]);
  }
  fmt::print("\n");
  if (!scene.light_units.empty()) fmt::print("  units      lights are {}\n", scene.light_units);
  for (const std::string& variant : scene.variants) fmt::print("  variant    \"{}\"\n", variant);
  for (std::size_t i = 0; i < scene.animations.size(); ++i)
    fmt::print("  animation  {} \"{}\", {:.4g} s\n", i, printable(scene.animations[i].name),
               scene.animations[i].seconds);
  for (const scene::NamedCamera& camera : scene.cameras) {
    fmt::print("  camera     \"{}\"", camera.name);
    if (camera.camera.type == GLEANER_CAMERA_ORTHOGRAPHIC)
      fmt::print(", orthographic, {:.6g} m high", 2 * camera.camera.half_height);
    else
      fmt::print(", vertical field of view {:.4g} degrees",
                 2 * std::atan(camera.camera.half_height) * 180 / std::numbers::pi);
    if (camera.width > 0) fmt::print(", {}x{} pixels", camera.width, camera.height);
    fmt::print("\n");
  }
  std::string present, absent;
  for (std::size_t i = 0; i < scene::need_names().size(); ++i)
    ((needs.bits() >> i & 1) ? present : absent) += " " + scene::need_names()[i];
  fmt::print("  needs     {}\n", present.empty() ? " nothing" : present);
  fmt::print("  lacks     {}\n", absent);
  fmt::print("  imported in {:.3f} s\n", seconds);
  for (const std::string& warning : scene.warnings) fmt::print("  warning: {}\n", printable(warning));
}

int info(const InfoWords& words) {
  const auto start = std::chrono::steady_clock::now();
  Scene scene = read_scene(words.files, true);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (!has_light(needs_of(scene)))
    scene.warnings.push_back("the scene has no light: --environment FILE.exr lights it from all around");
  for (std::string& sentence : scene::lost_light(needs_of(scene))) scene.warnings.push_back(std::move(sentence));
  // Names come from the file as they are; JSON must be UTF-8 all the same.
  if (words.json)
    std::cout << json_of(words, scene, seconds).dump(2, ' ', false, ordered_json::error_handler_t::replace) << '\n';
  else
    print(words, scene, seconds);
  return 0;
}

}  // namespace

void add_info(CLI::App& app, Run& run) {
  auto* command = app.add_subcommand("info", "what a scene holds and what it needs of a renderer");
  auto words = std::make_shared<InfoWords>();
  add_import_options(*command, words->files);
  command->add_flag("--json", words->json, "one JSON object on standard output");
  command->callback([words, &run] { run = [words] { return info(*words); }; });
}

}  // namespace gleaner::cli
