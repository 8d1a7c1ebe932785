#pragma once
// The words that say which frame of which scene is wanted: the same for render, submit and explain.

#include <cstdint>
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
  std::string frames;                // A-B; empty: one
  double fps = 24, time_offset = 0;  // a frame's time: time_offset + (frame - A) / fps, s
  std::uint64_t seed = 0;
  double target_error = 0;
  std::string denoise = "off";
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
  std::uint32_t first_frame = 1, last_frame = 1;
  std::vector<scene::Camera> cameras;  // one a frame where the camera moves in a scene that does not; else none
  bool moves = false;                  // the scene has animations, and there are several frames: see load_moved()
};

// Reads the scene and settles camera and size; words for people (on what was assumed) go to standard error unless
// quiet. Throws Error::usage for malformed words, Error::bad_input for what the files say.
LoadedFrame load_frame(const FrameOptions& options);

// The scene of one of the frames and its camera, where the scene moves. The first frame's has been read: it is moved
// out of `frame`, once. Throws as load_frame().
struct MovedScene {
  scene::Scene scene;
  scene::Camera camera;
};
MovedScene load_moved(const FrameOptions& options, LoadedFrame& frame, std::uint32_t number);

}  // namespace gleaner::cli
