#include "cli/frame_options.h"

#include <CLI/CLI.hpp>
#include <array>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <numbers>
#include <optional>

#include "cli/frame_list.h"
#include "coordinator/plan/methods.h"
#include "coordinator/plan/trajectory.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace {

constexpr std::uint32_t default_width = 1280, default_height = 720;  // pixels; what has no size is fitted into it
constexpr double default_fov_degrees = 45;

// The whole of `text` as a number, or none.
template <typename Number>
std::optional<Number> number(std::string_view text) {
  Number value{};
  auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::vector<std::string_view> split(std::string_view text, char at) {
  std::vector<std::string_view> parts;
  for (std::size_t begin = 0;;) {
    std::size_t end = text.find(at, begin);
    parts.push_back(text.substr(begin, end - begin));
    if (end == std::string_view::npos) return parts;
    begin = end + 1;
  }
}

Error malformed(const std::string& option, const std::string& expected, const std::string& found) {
  return Error::usage(option + ": expected " + expected + ", found \"" + found + "\"");
}

void parse_size(const std::string& text, std::uint32_t& width, std::uint32_t& height) {
  auto parts = split(text, 'x');
  auto w = parts.size() == 2 ? number<std::uint32_t>(parts[0]) : std::nullopt;
  auto h = parts.size() == 2 ? number<std::uint32_t>(parts[1]) : std::nullopt;
  if (!w || !h || *w == 0 || *h == 0) throw malformed("--size", "WIDTHxHEIGHT in pixels", text);
  width = *w;
  height = *h;
}

struct LookAt {
  double values[7];  // eye, target, vertical field of view in degrees
};

LookAt parse_look_at(const std::string& text) {
  auto parts = split(text, ',');
  std::vector<double> values;
  for (std::string_view part : parts)
    if (auto value = number<double>(part); value && std::isfinite(*value)) values.push_back(*value);
  if ((parts.size() != 6 && parts.size() != 7) || values.size() != parts.size())
    throw malformed("--look-at", "EX,EY,EZ,TX,TY,TZ[,FOV]: metres, and the vertical field of view in degrees", text);
  double fov = values.size() == 7 ? values[6] : default_fov_degrees;
  if (!(fov > 0 && fov < 180)) throw malformed("--look-at", "a field of view between 0 and 180 degrees", text);
  return {{values[0], values[1], values[2], values[3], values[4], values[5], fov}};
}

// The words are in the file's coordinates, the camera in the scene's.
scene::NamedCamera camera_of(const LookAt& at, const scene::Scene& scene) {
  std::array<float, 6> place;
  for (std::size_t k = 0; k < 6; ++k) place[k] = static_cast<float>(at.values[k] - scene.origin[k % 3]);
  auto camera = scene::look_at({place[0], place[1], place[2]}, {place[3], place[4], place[5]},
                               static_cast<float>(at.values[6]) * std::numbers::pi_v<float> / 180);
  camera.name = "look-at";
  return camera;
}

// Where the camera stands at `part`, 0 to 1, of its trajectory: the words' places follow each other in equal times,
// straight.
LookAt along(const std::vector<LookAt>& trajectory, double part) {
  const double at = part * static_cast<double>(trajectory.size() - 1);
  const std::size_t from = std::min(static_cast<std::size_t>(at), trajectory.size() - 1);
  const std::size_t to = std::min(from + 1, trajectory.size() - 1);
  const double share = at - static_cast<double>(from);
  LookAt result{};
  for (int k = 0; k < 7; ++k)
    result.values[k] = trajectory[from].values[k] + share * (trajectory[to].values[k] - trajectory[from].values[k]);
  return result;
}

std::vector<LookAt> parse_trajectory(const FrameOptions& options) {
  std::vector<LookAt> trajectory;
  for (const std::string& text : options.look_at) trajectory.push_back(parse_look_at(text));
  if (trajectory.size() > 1 && options.frames.empty())
    throw Error::usage("--look-at: several of them are a camera trajectory, and need --frames A-B");
  return trajectory;
}

scene::NamedCamera choose_camera(const FrameOptions& options, const scene::Scene& scene,
                                 std::vector<std::string>& words) {
  if (!options.look_at.empty()) {
    if (!options.camera.empty()) throw Error::usage("--camera and --look-at exclude each other");
    return camera_of(parse_look_at(options.look_at.front()), scene);
  }
  if (!options.camera.empty()) {
    std::string known;
    for (const auto& camera : scene.cameras) {
      if (camera.name == options.camera) return camera;
      known += (known.empty() ? "" : ", ") + camera.name;
    }
    throw Error::bad_input(options.files.scene, "camera \"" + options.camera + "\"",
                           known.empty() ? "no name: the scene has no camera" : "one of " + known);
  }
  if (!scene.cameras.empty()) return scene.cameras.front();
  words.push_back(options.files.scene + ": no camera; using one that frames the scene (--look-at chooses another)");
  return scene::framing_camera(scene);
}

// Makes the camera's picture as wide as the film is.
void fit_to_film(scene::Camera& camera, const coordinator::FrameSettings& settings) {
  camera.half_width = camera.half_height * static_cast<float>(settings.width) / static_cast<float>(settings.height);
}

void settle_size(const FrameOptions& options, const scene::NamedCamera& camera, coordinator::FrameSettings& settings) {
  if (!options.size.empty()) {
    parse_size(options.size, settings.width, settings.height);
  } else if (camera.width > 0 && camera.height > 0) {
    settings.width = camera.width;
    settings.height = camera.height;
  } else {
    settings.width = default_width;
    settings.height = default_height;
    if (camera.aspect > 0) {
      double fitting = double{default_width} / default_height;
      if (camera.aspect < fitting)
        settings.width = std::max(1u, static_cast<std::uint32_t>(std::lround(default_height * double{camera.aspect})));
      else
        settings.height = std::max(1u, static_cast<std::uint32_t>(std::lround(default_width / double{camera.aspect})));
    }
  }
  settings.camera = camera.camera;
  fit_to_film(settings.camera, settings);
}

}  // namespace

void add_frame_options(CLI::App& command, FrameOptions& options) {
  add_import_options(command, options.files);
  command.add_option("--method", options.method, coordinator::method_names())->capture_default_str();
  command.add_option("--size", options.size, "film in pixels, e.g. 1280x720 (default: the camera's)");
  command.add_option("--spp", options.spp, "mean number of samples a pixel")
      ->capture_default_str()
      ->check(CLI::Range(1u, 1u << 24));
  command.add_option("--camera", options.camera, "a camera of the scene (default: its first)");
  command.add_option("--frames", options.frames,
                     "A-B or A-BxSTEP, or several with commas between: frames to render, numbered files");
  command.add_option("--fps", options.fps, "frames a second of animations")
      ->capture_default_str()
      ->check(CLI::Range(1e-6, 1e6));
  command.add_option("--time-offset", options.time_offset, "SECONDS: the first frame's time in animations")
      ->capture_default_str()
      ->check(CLI::Range(-1e9, 1e9));
  command.add_option("--seed", options.seed, "of the random numbers")->capture_default_str();
  command
      .add_option("--target-error", options.target_error,
                  "stop when the RMSE over the mean radiance is below it, e.g. 0.02")
      ->check(CLI::PositiveNumber);
  command
      .add_option("--time-limit", options.time_limit, "seconds after which the frame is finished with what there is")
      ->check(CLI::PositiveNumber);
  command.add_option("--set", options.set, "NAME=VALUE: one of the settings below")
      ->take_all()
      ->allow_extra_args(false);
  command.footer(coordinator::settings_help());
  command
      .add_option("--look-at", options.look_at,
                  "EX,EY,EZ,TX,TY,TZ[,FOV]: eye and target in metres, vertical field of view in degrees; given "
                  "several times, the camera moves past them over --frames")
      ->take_all()
      ->allow_extra_args(false);
  command.add_option("--exposure", options.exposure_stops, "of the PNG, in stops")
      ->capture_default_str()
      ->check(CLI::Range(-100.0, 100.0));
  command.add_flag("--quiet", options.quiet, "no progress, no remarks");
}

LoadedFrame load_frame(const FrameOptions& options) {
  LoadedFrame frame;
  // Words are checked before files are read: a typing error should not cost the time of an import.
  coordinator::FrameSettings& settings = frame.settings;
  settings.method = options.method;
  settings.spp = options.spp;
  settings.seed = options.seed;
  settings.target_error = options.target_error;
  for (const std::string& entry : options.set) {
    auto equals = entry.find('=');
    if (equals == std::string::npos || equals == 0) throw malformed("--set", "NAME=VALUE", entry);
    settings.set[entry.substr(0, equals)] = entry.substr(equals + 1);
  }
  std::vector<std::string> words = coordinator::rename_old_settings(settings.set);
  coordinator::check_set(settings.set);
  if (const auto depth = coordinator::whole_setting(settings, "depth")) settings.depth = *depth;
  settings.set.erase("depth");
  if (!options.size.empty()) parse_size(options.size, settings.width, settings.height);
  frame.numbered = !options.frames.empty();
  if (frame.numbered) frame.frame_numbers = parse_frame_list(options.frames);
  const std::vector<LookAt> trajectory = parse_trajectory(options);

  ImportWords files = options.files;
  files.instances = coordinator::method_of(options.method).takes_instances;
  if (frame.numbered) files.frames = frame.frame_numbers;
  frame.moving = open_scene(files, options.look_at.empty());
  if (frame.moving->moves()) {
    frame.scene = frame.moving->scene_at(frame.moving->is_sequence() ? frame.frame_numbers.first : options.time_offset);
  } else {
    frame.scene = std::move(frame.moving->base());
    frame.moving = nullptr;
  }
  frame.scene_name = printable(std::filesystem::path(options.files.scene).filename().string(), most_name_bytes);
  words.insert(words.end(), frame.scene.warnings.begin(), frame.scene.warnings.end());
  scene::NamedCamera camera = choose_camera(options, frame.scene, words);
  frame.camera_name = camera.name;
  settle_size(options, camera, settings);
  if (trajectory.size() > 1 && !frame.moving)
    for (std::uint32_t f = 0; f < frame.frames(); ++f) {
      const double frames = std::max(1.0, static_cast<double>(frame.frames() - 1));
      scene::Camera moved = camera_of(along(trajectory, static_cast<double>(f) / frames), frame.scene).camera;
      fit_to_film(moved, settings);
      frame.cameras.push_back(moved);
    }
  settings.trajectory = coordinator::trajectory_of(frame.cameras);
  scene::SceneNeeds needs = scene::needs_of(frame.scene);
  if (!needs.punctual_lights && !needs.emissive_triangles && !needs.environment && !needs.unlit)
    words.push_back(options.files.scene + ": no light; the picture will be black (--environment FILE lights a scene)");
  for (const std::string& sentence : scene::lost_light(needs)) words.push_back(options.files.scene + ": " + sentence);
  if (!options.quiet)
    for (const std::string& word : words) std::cerr << "gleaner: " << printable_lines(word) << "\n";
  return frame;
}

scene::Camera look_at_camera(const std::string& words, const scene::Scene& scene,
                             const coordinator::FrameSettings& settings) {
  scene::Camera camera = camera_of(parse_look_at(words), scene).camera;
  fit_to_film(camera, settings);
  return camera;
}

FrameLook look_of(const FrameOptions& options, const LoadedFrame& frame, std::uint32_t number) {
  FrameLook look;
  const double since = static_cast<double>(number) - static_cast<double>(frame.frame_numbers.first);
  look.seconds = frame.moving->is_sequence() ? number : options.time_offset + since / options.fps;
  std::optional<scene::ShownFrame> shown = frame.moving->at(look.seconds);
  // What choose_camera() looks at.
  scene::Scene seen;
  seen.origin = frame.moving->base().origin;
  if (shown && !shown->cameras.empty())
    seen.cameras = std::move(shown->cameras);
  else if (shown)
    seen.cameras = frame.moving->base().cameras;
  else if (frame.moving->is_sequence())
    seen.cameras = frame.moving->base().cameras;
  else if (options.look_at.empty())
    seen.cameras = frame.moving->scene_at(look.seconds).cameras;
  if (shown) look.state = std::move(shown->state);
  if (!options.look_at.empty()) {
    const double frames =
        std::max(1.0, static_cast<double>(frame.frame_numbers.last) - static_cast<double>(frame.frame_numbers.first));
    look.camera = camera_of(along(parse_trajectory(options), since / frames), seen).camera;
  } else {
    FrameOptions same = options;
    same.camera = frame.camera_name;
    std::vector<std::string> unused;
    look.camera = choose_camera(same, seen, unused).camera;
  }
  fit_to_film(look.camera, frame.settings);
  return look;
}

}  // namespace gleaner::cli
