#pragma once
// A camera trajectory: the cameras that stand for it. What a plan makes for all frames of a trajectory is made for
// these.

#include <vector>

#include "scene/model/scene.h"

namespace gleaner::coordinator {

inline constexpr std::size_t kMostTrajectoryCameras = 32;

// The cameras that stand for a trajectory, of one camera a frame: at most `most` (2 or more), evenly spaced, first and
// last among them, in their order, equal neighbours but once. None where no camera differs from the first.
std::vector<scene::Camera> trajectory_of(const std::vector<scene::Camera>& frames,
                                         std::size_t most = kMostTrajectoryCameras);

}  // namespace gleaner::coordinator
