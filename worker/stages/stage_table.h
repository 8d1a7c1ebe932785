#pragma once
// Every kind of stage that a worker can run: one row each.

#include <string_view>
#include <vector>

#include "worker/stages/stage.h"

namespace gleaner::worker {

using StageProgram = BatchResult (*)(const StageRun& run);

struct StageInputRule {
  std::string_view name;
  bool required = true;
  bool own_items = false;  // a batch may be given the records of its own items alone
  bool numbered = false;   // several, of which each has a number behind a dot: "points.0", "points.1", ...
};

// A program that a later stage of the same frame builds.
struct LaterProgram {
  std::string_view file;
  std::string_view options{};
  bool plain = false;       // as StageRun::build_plain()
  bool layout = false;      // the same with DeviceScene::layout_options()
  bool reads_light = true;  // as its stage
};

struct StageKind {
  std::string_view kind;
  StageProgram run;
  std::vector<std::string_view> programs;  // files of kernels that it builds
  std::vector<StageInputRule> inputs;
  std::vector<LaterProgram> later{};  // of a frame's first stage: in the order in which they will be needed
  // Whether its programs read lights or emission. Those of stages that do not are the same whatever shines, so that
  // the coordinator need not tell what shines in the names of what they make (SceneLineage::shining).
  bool reads_light = true;
};

const std::vector<StageKind>& stage_table();

// The task's row. Throws Error::bad_input for a kind that is not in the table, an input that the kind does not read or
// does not read in part, and one that it needs and does not get.
const StageKind& stage_kind_of(const StageTask& task);

}  // namespace gleaner::worker
