#include "coordinator/plan/trajectory.h"

#include <algorithm>
#include <cstring>

namespace gleaner::coordinator {
namespace {

bool same(const scene::Camera& a, const scene::Camera& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

}  // namespace

std::vector<scene::Camera> trajectory_of(const std::vector<scene::Camera>& frames, std::size_t most) {
  std::vector<scene::Camera> cameras;
  if (std::all_of(frames.begin(), frames.end(), [&](const auto& camera) { return same(camera, frames.front()); }))
    return cameras;
  const std::size_t count = std::min(frames.size(), most);
  for (std::size_t k = 0; k < count; ++k) {
    const scene::Camera& camera = frames[k * (frames.size() - 1) / (count - 1)];
    if (cameras.empty() || !same(cameras.back(), camera)) cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace gleaner::coordinator
