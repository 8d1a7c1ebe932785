#pragma once
// What it took to show another frame of a scene.

#include <cstdint>
#include <vector>

namespace gleaner::worker {

struct MotionReport {
  struct Mesh {
    std::uint32_t mesh = 0;
    bool rebuilt = false;  // else refitted
    double growth = 1;     // SAH cost of the refitted tree over that of the tree as it was built for the scene at rest
    double seconds = 0;
  };
  std::vector<Mesh> meshes;
  double top_level_seconds = 0;
  // Of Executor::load_frame() and DeviceScene::show(), beside what the tracer took:
  double load_seconds = 0;          // where the base was loaded for it: with its BVH at rest
  double pose_seconds = 0;          // vertices, lights and materials
  double table_seconds = 0;         // the kernels' tables
  std::uint64_t written_bytes = 0;  // of them
};

}  // namespace gleaner::worker
