#pragma once
// The words that say which frame of which scene is wanted: the same for render, submit and explain.

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "cli/import_options.h"
#include "coordinator/plan/plan.h"
#include "scene/model/scene.h"

namespace CLI {
class App;
}

namespace gleaner::cli {

struct FrameOptions {
  ImportWords files;
  std::string method = "path";
  std::string size;  // WxH; empty: the camera's own
  std::uint32_t spp = 64;
  std::string camera;                // name; empty: the first
  std::string frames;                // as parse_frame_list() takes them; empty: one
  double fps = 24, time_offset = 0;  // a frame's time: time_offset + (frame - A) / fps, s
  std::uint64_t seed = 0;
  double target_error = 0;
  double time_limit = 0;             // seconds
  std::vector<std::string> set;      // KEY=VALUE
  std::vector<std::string> look_at;  // EX,EY,EZ,TX,TY,TZ[,FOV]; several: a camera trajectory over the frames
  double exposure_stops = 0;
  bool quiet = false;
};

void add_frame_options(CLI::App& command, FrameOptions& options);

struct LoadedFrame {
  scene::Scene scene;
  std::string scene_name;  // the file's name
  std::string camera_name;
  coordinator::FrameSettings settings;
  bool numbered = false;  // --frames was given
  scene::FrameNumbers frame_numbers;
  std::vector<scene::Camera> cameras;  // one a frame where the camera moves in a scene that does not; else none
  // Where the scene moves: the file, whose frames look_of() shows. `scene` is the first one as it looks.
  std::shared_ptr<scene::MovingScene> moving;
  std::uint32_t frames() const { return static_cast<std::uint32_t>(frame_numbers.count()); }
  std::uint32_t number(std::uint32_t index) const { return frame_numbers.at(index); }
};

// Reads the scene and settles camera and size; words for people (on what was assumed) go to standard error unless
// quiet. Throws Error::usage for malformed words, Error::bad_input for what the files say.
LoadedFrame load_frame(const FrameOptions& options);

// The camera of --look-at's words, as wide as the film is. Throws Error::usage for malformed ones.
scene::Camera look_at_camera(const std::string& words, const scene::Scene& scene,
                             const coordinator::FrameSettings& settings);

// One of the frames of a scene that moves.
struct FrameLook {
  // Of the file's base. None: no state of it looks so, and the file's scene_at(seconds) is the frame's scene.
  std::optional<scene::FrameState> state;
  double seconds = 0;
  scene::Camera camera{};
};
// Throws as load_frame().
FrameLook look_of(const FrameOptions& options, const LoadedFrame& frame, std::uint32_t number);

}  // namespace gleaner::cli
