#pragma once
// What a frame's scene is made of, by parts: frames that show a base in different states share what is made of the
// parts in which they do not differ.

#include <string>

#include "coordinator/plan/stage.h"
#include "scene/model/frame_state.h"

namespace gleaner::coordinator {

// Of the scene whose blob is `blob`, in a state.
SceneLineage lineage_of(const std::string& blob, const scene::Scene& base, const scene::FrameState& state);

}  // namespace gleaner::coordinator
