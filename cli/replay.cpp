// `gleaner replay`: one item of one stage again, on a device of this machine: what a failure's message asks for.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstring>
#include <memory>
#include <optional>

#include "cli/commands.h"
#include "cli/frame_options.h"
#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "scene/bvh/build.h"
#include "scene/model/error.h"
#include "worker/stages/executor.h"

namespace gleaner::cli {
namespace {

struct ReplayWords {
  FrameOptions frame;
  std::string stage, trace = "auto";
  std::uint64_t item = 0;
  std::optional<std::uint32_t> number;  // of --frames; none: the first
  int device = -1;
};

int replay(const ReplayWords& words) {
  LoadedFrame frame = load_frame(words.frame);
  const std::uint32_t number = words.number.value_or(frame.frame_numbers.first);
  const auto place = frame.frame_numbers.place_of(number);
  if (!place)
    throw Error::usage("--frame: expected one of --frames " + words.frame.frames + ", found " + std::to_string(number));
  if (!frame.cameras.empty()) frame.settings.camera = frame.cameras[*place];
  if (frame.moving) {
    const FrameLook look = look_of(words.frame, frame, number);
    frame.scene = frame.moving->scene_at(look.seconds);
    frame.settings.camera = look.camera;
  }
  worker::Executor executor({.device = words.device, .threads = 0, .trace = worker::parse_trace_kind(words.trace)});
  auto scene = std::make_shared<const scene::Scene>(std::move(frame.scene));
  auto plan = coordinator::make_plan(frame.settings, coordinator::summarize(*scene));
  std::shared_ptr<const scene::Bvh> bvh;
  if (executor.needs_bvh()) bvh = std::make_shared<const scene::Bvh>(scene::build_bvh(*scene));
  executor.load_scene("scene", scene, bvh);

  // Stages before it are run whole: what they leave decides what the item is.
  std::string seen;
  const bool whole = run_frame(*plan, executor, "scene", [&](const auto& stage, const worker::StageTask& task) {
    seen += (seen.empty() ? "" : ", ") + stage.name;
    if (stage.name != words.stage) return true;
    if (words.item >= stage.items)
      throw Error::usage("--item: stage " + stage.name + " has " + std::to_string(stage.items) + " items, found " +
                         std::to_string(words.item));
    const std::uint64_t first = stage.solo ? 0 : words.item / stage.tile * stage.tile;
    const std::uint64_t count = stage.solo ? stage.items : std::min<std::uint64_t>(stage.tile, stage.items - first);
    const worker::BatchResult result = executor.run(task, first, count);
    fmt::print("scene {}, stage {}, item {}, seed {}, device {}, tracer {}\n", frame.scene_name, stage.name, words.item,
               frame.settings.seed, executor.info().name, executor.info().tracer);
    const std::byte* record = result.records.data() + (words.item - first) * stage.output.record_bytes;
    for (std::uint32_t at = 0; at + 4 <= stage.output.record_bytes; at += 4) {
      float value;
      std::uint32_t bits;
      std::memcpy(&value, record + at, 4);
      std::memcpy(&bits, record + at, 4);
      fmt::print("  word {:2}  {:#010x}  {:.9g}\n", at / 4, bits, value);
    }
    fmt::print("  samples that were not finite in its tile: {}\n", result.counters.nonfinite);
    return false;
  });
  if (!whole) return 0;
  throw Error::usage("--stage: no stage \"" + words.stage + "\"; the frame's stages are " + seen);
}

}  // namespace

void add_replay(CLI::App& app, Run& run) {
  auto* command = app.add_subcommand("replay", "run one item of one stage again and print its record");
  auto words = std::make_shared<ReplayWords>();
  add_frame_options(*command, words->frame);
  command->add_option("--stage", words->stage, "the stage's name, e.g. path.0")->required();
  command->add_option("--item", words->item, "the item's number in the stage")->required();
  command->add_option("--frame", words->number, "which of --frames (default: the first)");
  command->add_option("--device", words->device, "see gleaner devices (default: the first GPU, else the first device)");
  command->add_option("--trace", words->trace, "auto, embree or opencl")->capture_default_str();
  command->callback([words, &run] { run = [words] { return replay(*words); }; });
}

}  // namespace gleaner::cli
