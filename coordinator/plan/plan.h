#pragma once
// A frame's plan: a small state machine that turns finished stages into the next ones. Pure: no clock, no sockets, no
// threads.

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "coordinator/film/film.h"
#include "coordinator/plan/stage.h"
#include "scene/model/scene.h"

namespace gleaner::coordinator {

struct ItemRange {
  std::uint64_t first = 0, count = 0;
};

// A stage that the frame will not wait for. Of its records only those of the items in `whole` (in order, apart from
// each other) are there, and none where `whole` is empty (the pointer may be null then). Of a streamed stage they have
// gone through Plan::take().
struct CutStage {
  FinishedStage stage;
  std::vector<ItemRange> whole;
};

struct Step {
  std::vector<StageSpec> stages;                                 // to run now (in any order, at the same time)
  std::map<ArtifactId, std::shared_ptr<const Bytes>> artifacts;  // data of the plan's own that those stages read
  // Artifacts of the frame that no stage of it will read any more: their memory may go (reusable ones stay cached).
  std::vector<ArtifactId> released{};
  // The plan has more to ask for once the memory of `released` is free: next(nullptr) is called at once.
  bool again = false;
  bool done = false;  // the film is whole
};

struct Skip {
  std::string what, why;
  std::uint64_t count = 0;
};

enum class Denoise { off, fast, high };
// "off", "fast" or "high"; throws Error::usage for another word.
Denoise parse_denoise(const std::string& word);
const char* word_of(Denoise denoise);

struct FrameSettings {
  std::string method = "path";
  std::uint32_t width = 0, height = 0;  // pixels
  std::uint32_t spp = 64;
  std::uint32_t depth = 0;  // most scatterings on a light's way, 0 = until Russian roulette ends it
  std::uint64_t seed = 0;
  scene::Camera camera{};  // aspect already that of the film
  // Cameras that stand for the trajectory on which `camera` is one place (trajectory_of()): what a plan makes for all
  // frames of the trajectory is made for these. Empty: a single camera.
  std::vector<scene::Camera> trajectory;
  // Cameras of the pictures of one scene that somebody looks at, in their order; the last one is `camera`. What a plan
  // made for those before may serve this one. Empty: the picture stands alone.
  std::vector<scene::Camera> looks{};
  double target_error = 0;  // 0 = none
  Denoise denoise = Denoise::off;
  std::map<std::string, std::string> set;  // --set KEY=VALUE
  bool limited = false;                    // a time limit may end the frame before all is done
  bool only_picture = false;               // nobody asks for layers beside R G B
  // Of `spp`, what the time limit is predicted to leave time for; 0: all.
  std::uint32_t fitting_spp = 0;

  // Samples of a pixel that the frame is planned for. There may be more in the end, never more than `spp`.
  std::uint32_t planned_spp() const { return fitting_spp ? fitting_spp : spp; }
  // The same for what a method makes beside the samples. What other pictures share is made for `spp`, for it must not
  // depend on how fast the farm was.
  std::uint32_t method_spp() const { return trajectory.empty() && looks.empty() ? planned_spp() : spp; }
};

class Plan {
 public:
  virtual ~Plan() = default;
  // The first call gets null, as does one that a step asked for (Step::again); others get the stage that finished.
  // Called once per finished stage.
  virtual Step next(const FinishedStage* finished) = 0;
  // Records of a streamed stage (Placement::stream): items [first, first + count), in item order without gaps.
  virtual void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
    static_cast<void>(stage), static_cast<void>(first), static_cast<void>(count), static_cast<void>(records);
  }
  // Work of the stages that next() will still ask for, as StageSpec::work counts it; a rough prediction from what is
  // known by now. Progress and the time left rest on it.
  virtual double predicted_work() const { return 0; }
  // Of a frame with a time limit, before each next(): how much work, as StageSpec::work counts it, the farm is
  // predicted to do in what is left of the limit. Infinity: its pace is not known yet. What a plan still chooses may
  // follow it.
  virtual void allow(double work) { static_cast<void>(work); }
  // What the accepted records so far say, for the live preview: adds the batch's records to `film`'s RGB.
  // Any order of batches; null film layers are made on first use. Not called for streamed stages, whose records the
  // plan has.
  virtual void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) = 0;
  // `guides`: with layers albedo.* and normal.* where there are some, as a denoiser reads them.
  virtual Film preview_film(bool guides = false) const = 0;
  // The time is up. `cut` are the stages that were asked for and have not finished. True: film() holds what there is.
  // False: that is no picture yet, one of them must be finished; nothing has changed.
  virtual bool conclude(const std::vector<CutStage>& cut) {
    static_cast<void>(cut);
    return false;
  }
  // Mean squared error that all samples of the picture share, as predicted: what no comparison of them can tell.
  virtual double shared_squared_error() const { return 0; }
  // After conclude() said yes: what the picture still wants, however late it is; little, and nothing for most plans.
  virtual Step after_conclude() {
    Step step;
    step.done = true;
    return step;
  }
  // After `done`, or after conclude() said yes: the layers.
  virtual Film film() const = 0;
  // The same for who needs the plan no more: it may give its memory to the film. Afterwards only skips(), warnings()
  // and parameters_json() may be called.
  virtual Film take_film() { return film(); }
  // The layers R G B of that alone, or more of them.
  virtual Film take_picture() { return take_film(); }
  virtual std::vector<Skip> skips() const = 0;
  // What people must know of the picture, one sentence each: a target that was not reached, for instance.
  virtual std::vector<std::string> warnings() const { return {}; }
  // Parameters that the method settled on, as they stand in the report (JSON object text).
  virtual std::string parameters_json() const = 0;
  // What people read in `gleaner explain`: one line a stage, as predicted.
  virtual std::vector<std::string> outline() const = 0;
};

// What a plan may know of the scene without holding it.
struct SceneSummary {
  scene::SceneNeeds needs;
  std::uint64_t triangles = 0, emissive_triangles = 0, lights = 0;
  float roughest_lobe = 0;  // alpha, of any opaque surface's lobe, before textures make it less; 0: there is none
  scene::Bounds bounds;
  scene::Bounds rest_bounds;                      // of the base at rest; where there is no state, the same
  std::uint32_t matrices = 0, morph_weights = 0;  // that a state of it has, where it is a base
  SceneLineage lineage{};                         // names what is made of it (artifact_id); the farm fills it in
};
SceneSummary summarize(const scene::Scene& scene);

// Throws Error::usage for an unknown method, an unknown or malformed --set key, or a film of no or too many pixels
// (2^28). Takes no memory that grows with the film.
void check_settings(const FrameSettings& settings, const SceneSummary& scene);
// Bytes that a plan of these settings takes at most, its film and the frame's files included; as predicted from the
// settings. They must be such as check_settings() takes.
std::uint64_t predicted_memory(const FrameSettings& settings, const SceneSummary& scene);
// Throws as check_settings() does.
std::unique_ptr<Plan> make_plan(const FrameSettings& settings, const SceneSummary& scene);

}  // namespace gleaner::coordinator
