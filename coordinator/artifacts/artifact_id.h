#pragma once
// How artifacts are named: a stage's output by what makes it, a plan's own data by its bytes. Graph and farm name them
// through these two functions alone, so that a plan can name an output before its stage has run.

#include <span>
#include <string>

#include "coordinator/plan/stage.h"

namespace gleaner::coordinator {

// SHA-256 over (build of the kernels, the parts of the scene that the stage reads, kind, items, tile, layout,
// parameters, and each input's name, id and extent). Where the records stay, how urgent the stage is and what people
// call it do not change them, and are left out. The inputs' `artifact` must be ids as these functions make them.
ArtifactId artifact_id(const SceneLineage& scene, const StageSpec& stage);

// SHA-256 of the bytes.
ArtifactId data_id(std::span<const std::byte> bytes);

}  // namespace gleaner::coordinator
