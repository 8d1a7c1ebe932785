#pragma once
// Files that people have, turned into scenes.

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/images/environment.h"
#include "scene/model/frame_state.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

// What candela and lux of a file mean: W/sr and W/m^2, or 683 lumens a watt. Automatic: radiometric, unless the file's
// generator is known to write photometric units.
enum class LightUnits { automatic, radiometric, photometric };

// "auto", "radiometric" or "photometric". Throws Error::usage.
LightUnits parse_light_units(const std::string& word);

// The frames FIRST, FIRST + STEP, ... up to LAST, or those of a list.
struct FrameNumbers {
  std::uint32_t first = 1, last = 1, step = 1;
  std::vector<std::uint32_t> list{};  // ascending, from first to last; empty: every step-th
  std::uint64_t count() const { return list.empty() ? std::uint64_t{last - first} / step + 1 : list.size(); }
  std::uint32_t at(std::uint64_t index) const {
    return list.empty() ? static_cast<std::uint32_t>(first + index * step) : list[index];
  }
  // None: the frame is not one of them.
  std::optional<std::uint64_t> place_of(std::uint32_t frame) const {
    if (frame < first || frame > last) return std::nullopt;
    const std::uint64_t place = list.empty()
                                    ? (frame - first) / step
                                    : static_cast<std::uint64_t>(std::ranges::lower_bound(list, frame) - list.begin());
    return at(place) == frame ? std::optional(place) : std::nullopt;
  }
};

struct ImportOptions {
  LightUnits light_units = LightUnits::automatic;
  std::string animation = "all";                       // its name, its number, or all; of a file that has any
  double seconds = 0;                                  // the time at which the animations are seen
  std::optional<FrameNumbers> frames{};                // of a sequence of files
  std::optional<std::array<double, 3>> origin{};       // of the scene, of an OBJ; none: one that fits
  std::string variant;                                 // of KHR_materials_variants; empty: the file's own materials
  std::uint64_t most_texels = std::uint64_t{1} << 30;  // in all images together: 4 GiB
  bool strict = false;                                 // what would be a warning is an error
  bool needs_camera = true;                            // false: somebody else brings one, none is missed
  bool instances = true;                               // false: copies in place of instances
};

// Reads .gltf, .glb, .obj, .ply or .stl by its extension. The result is validated and finished. A file without a camera
// gets one that frames it, and a warning. Throws Error::bad_input naming the file, the element and what was expected.
Scene import_scene(const std::string& path, const ImportOptions& options = {});

// How a base looks in a frame, and who sees it: the base's cameras, where they stand then; none where it has but the
// one that was added.
struct ShownFrame {
  FrameState state;
  std::vector<NamedCamera> cameras;
};

// A file whose scene may move: read once, as a base, of which frames show states. Or a sequence of OBJ files, one a
// frame ("model_####.obj"), for which ImportOptions::frames must say which.
class MovingScene {
 public:
  // Reads as import_scene() does.
  explicit MovingScene(const std::string& path, const ImportOptions& options = {});
  ~MovingScene();
  MovingScene(const MovingScene&) = delete;
  MovingScene& operator=(const MovingScene&) = delete;

  // Whether anything changes with time. The base of a scene that stands still is that scene.
  bool moves() const;
  // A file a frame: the times below are frames' numbers.
  bool is_sequence() const;
  // With a rig of what moves. Its warnings are those of the file. An environment that is put into it lights all frames.
  Scene& base();
  // The state at that time. Nothing where no state of the base looks so (textures that slide, a mesh turned inside out,
  // lights or cameras that come and go): scene_at() makes a scene of its own then. Throws as import_scene().
  std::optional<ShownFrame> at(double seconds);
  // The scene as it is at that time, without a rig.
  Scene scene_at(double seconds);

 private:
  friend Scene import_scene(const std::string& path, const ImportOptions& options);
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::scene
