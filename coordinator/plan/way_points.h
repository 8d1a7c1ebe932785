#pragma once
// A camera's way: the cameras that stand for it, and the points that they see, made into one set that all its frames
// share.

#include <cstdint>
#include <memory>
#include <vector>

#include "scene/model/blob.h"
#include "scene/model/scene.h"

namespace gleaner::coordinator {

inline constexpr std::size_t kMostWayCameras = 32;

// The cameras that stand for a way, of one camera a frame: at most `most` (2 or more), evenly spaced, first and last
// among them, in their order, equal neighbours but once. None where no camera differs from the first.
std::vector<scene::Camera> way_of(const std::vector<scene::Camera>& frames, std::size_t most = kMostWayCameras);

// What stage kind `vpl_points` made for one camera.
struct CameraPoints {
  scene::Camera camera{};
  std::shared_ptr<const scene::Bytes> rows;  // of POINT_WORDS words, spread evenly over the film
};

struct WayPoints {
  scene::Bytes rows;                   // of POINT_WORDS words; those with nothing to shade are left out
  std::uint64_t points = 0;            // rows
  std::uint64_t most_of_a_camera = 0;  // points that one of the cameras sees at most
};

// All cameras' points, no place more densely than by the camera that sees it most densely: of each cell of a grid the
// points of the camera that has most there are kept (of several, of the first), in the cameras' order. A cell is some
// two to four points' spacing wide, which grows with the distance from a perspective camera, and holds normals of one
// dominant direction. Points that are not finite are left out.
WayPoints merge_points(const std::vector<CameraPoints>& cameras);

}  // namespace gleaner::coordinator
