#pragma once
// What a plan asks of the farm: stages, what they read, and where their records are to stay. Plain data.

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

using scene::Bytes;

// Names bytes by what makes them: a stage's output by (scene, kind, build of the kernels, parameters, inputs, layout),
// a plan's own data by its bytes. SHA-256, 64 lower-case hexadecimal digits. Equal ids, equal bytes.
using ArtifactId = std::string;

enum class Placement {
  collect,  // the records are sent to the coordinator, and the plan reads them
  retain,   // the parts stay with the workers that made them; the coordinator knows item range -> holders and digest
  stream,   // the records are handed to the plan as they arrive, in item order (Plan::take), and kept by nobody
};

// How an item's records lie in the output.
//
// Fixed stride: item i has exactly one record, at byte i * record_bytes.
// Counted: item i has 0 to most_records records. The records of all items lie one behind the other in item order, and a
// table of counts (one 32-bit count an item) tells where each item's begin.
struct StageOutput {
  std::uint32_t record_bytes = 0;
  bool counted = false;
  std::uint32_t most_records = 1;  // of one item
  Placement placement = Placement::collect;
  // Other frames of the same scene may read it: it is kept by its id, within the caches' bounds, and a stage that would
  // make it again is not run.
  bool reusable = false;
  // Records that reach the coordinator and are 32-bit floats throughout: one that is not a number of sane size shows
  // that its worker is broken.
  bool floats = false;
};

// What of a scene a stage reads beside its inputs. Frames that differ in other parts share what it makes.
enum SceneParts : std::uint8_t {
  kNoScene = 0,
  kGeometry = 1,
  kMaterials = 2,  // how they scatter, without base colours
  kLights = 4,     // that are no surfaces
  kColors = 8,     // base colours of materials, without alpha
  kEmission = 16,  // what materials emit
  kSurfaces = kGeometry | kMaterials | kColors | kEmission,
  kWholeScene = kSurfaces | kLights,
};

// Programs of stages that read light are compiled for the lights there are; those of all others know none
// (worker: StageKind::reads_light)
constexpr bool reads_light(unsigned parts) { return (parts & (kLights | kEmission)) != 0; }

// Which scene a stage reads, where a frame shows a base in a state.
enum class Pose : std::uint8_t {
  shown,    // the frame's
  rest,     // the base at rest: frames share what is made of it
  earlier,  // the base as it was shown before: what was made of it serves until it is made anew
};

// Names a scene, part by part, for the names of what is made of it (artifact_id). Of a scene that is a base in a state:
// its blob, and what the state says otherwise.
struct SceneLineage {
  std::string base;  // id of the scene's blob
  // Digests of what a state says of the parts; empty: they are the base's.
  std::string geometry, materials, lights, colors, emission;
  // How many of its lights and which of its materials shine: programs that read light differ in that.
  std::string shining;
  // Of Pose::earlier, as `geometry`, in which alone it differs; none: nothing of an earlier scene may be used.
  std::optional<std::string> earlier_geometry;

  SceneLineage() = default;
  SceneLineage(std::string blob) : base(std::move(blob)) {}
  SceneLineage(const char* blob) : base(blob) {}
  bool operator==(const SceneLineage&) const = default;

  SceneLineage in(Pose pose) const {
    if (pose == Pose::rest) return base;
    SceneLineage scene = *this;
    if (pose == Pose::earlier) scene.geometry = earlier_geometry.value();
    return scene;
  }

  // Equal for two scenes whose parts are.
  std::string of(unsigned parts) const {
    if (parts == kNoScene) return {};
    std::string name = base;
    const auto add = [&](SceneParts part, const char* word, const std::string& digest) {
      if (parts & part && !digest.empty()) name.append("+").append(word).append(" ").append(digest);
    };
    add(kGeometry, "geometry", geometry);
    add(kMaterials, "materials", materials);
    add(kLights, "lights", lights);
    add(kColors, "colors", colors);
    add(kEmission, "emission", emission);
    if (reads_light(parts) && !shining.empty()) name.append("+shining ").append(shining);
    return name;
  }
};

enum class Extent {
  whole,      // every batch reads all of it
  own_items,  // a batch of items [first, first + count) reads the records of these items alone; the artifact has as
              // many items as the stage
};

struct StageInput {
  std::string name;  // what the stage program calls it
  ArtifactId artifact;
  Extent extent = Extent::whole;
};

struct StageSpec {
  std::string name;  // unique in the frame; people read it
  std::string kind;  // which stage program of the device library runs it
  std::uint64_t items = 0;
  std::uint32_t tile = 1;              // batches begin and end at multiples of it (or at `items`)
  bool solo = false;                   // runs whole on one worker
  unsigned scene_parts = kWholeScene;  // that it reads
  Pose pose = Pose::shown;
  bool denoises = false;  // workers that have a denoiser get it, while there are any
  int priority = 0;       // of the frame's stages that wait, the highest goes first; equal: the oldest
  Bytes parameters{};     // little-endian struct of the kind's header in kernels/
  double work = 0;        // predicted cost of all items, in samples of a path tracer; 0: one an item
  std::vector<StageInput> inputs{};
  StageOutput output;
};

// The words of a number of 64 bits, as stages' parameters have it.
inline std::uint32_t low(std::uint64_t number) { return static_cast<std::uint32_t>(number); }
inline std::uint32_t high(std::uint64_t number) { return static_cast<std::uint32_t>(number >> 32); }

// Names of stages that a method asks for several times.
inline std::string numbered(const std::string& name, std::uint64_t number) {
  return name + "." + std::to_string(number);
}

// Its predicted cost, in samples of a path tracer.
inline double work_of(const StageSpec& stage) { return stage.work > 0 ? stage.work : static_cast<double>(stage.items); }

struct FinishedStage {
  std::string name;
  // Collected: the records in item order (of a counted output without its counts). Retained and streamed: null.
  std::shared_ptr<const Bytes> records;
  std::uint64_t record_count = 0;
  // What a solo stage says of its output to the plan, beside the records: a small struct of the kind's header (at most
  // 64 KiB; counts, densities, predictions). Empty for split stages.
  Bytes facts{};
};

}  // namespace gleaner::coordinator
