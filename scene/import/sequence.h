#pragma once
// A file a frame: the runs of '#' in its name stand for the frame's number ("model_####.obj").

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "scene/import/import.h"
#include "scene/model/frame_state.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

// The file of that frame: the number with zeros before it, as long as the run of '#' at least.
std::string file_of_frame(const std::string& pattern, std::uint32_t frame);
// No file has the name itself, and it has a '#'.
bool is_sequence(const std::string& path);

// Frames that show one mesh at other places are states of a base, whose rig has a morph target for each of them: the
// frame's positions and normals, whole, so that they are the file's to the bit. Others are scenes of their own.
class Sequence {
 public:
  // Throws Error::bad_input, naming the file, unless there is one for each of the frames.
  Sequence(const std::string& pattern, const FrameNumbers& frames);

  std::string file_of(std::uint32_t frame) const { return file_of_frame(pattern_, frame); }
  // Makes the base a rig, where all files have the topology and the materials of the first one and the rig would not be
  // larger than kMostRigBytes. `first`: the first one's scene as it was read; `read`: reads a file with that origin.
  void make_rig(Scene& base, const Scene& first, const std::function<Scene(const std::string& file)>& read);
  // Nothing: the frame is a scene of its own. Throws Error::usage for a frame that is none of the sequence's.
  std::optional<FrameState> state_of(std::uint32_t frame) const;

  static constexpr std::uint64_t kMostRigBytes = std::uint64_t{1} << 30;
  static constexpr std::uint64_t kMostTargets = 4096;  // a state has a weight for each

 private:
  std::string pattern_;
  FrameNumbers frames_;
  bool rigged_ = false;
};

}  // namespace gleaner::scene
