#pragma once
// Mean distances of places that grow no faster than so much from one to the next: a surface that is near a place is
// near its neighbours too, though their rays may have missed it. Neighbour clamping, after Krivanek et al. 2006,
// "Making Radiance and Irradiance Caching Practical".

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "worker/stages/splat/points.h"

namespace gleaner::worker {

class ClampedMeans {
 public:
  using Vec = std::array<float, 3>;

  // `slope`: how much a mean may grow over a distance of one.
  explicit ClampedMeans(float slope) : slope_(slope) {}

  // What the places so far leave of a mean at this position, m.
  float clamped(const Vec& position, float mean) const;
  // What a place of this mean leaves to all places so far: calls changed(place, mean) where that is less than before.
  void clamp_others(const Vec& position, float mean, const std::function<void(std::uint32_t, float)>& changed);
  // A place with a number of its own. It changes no other one.
  void add(std::uint32_t place, const Vec& position, float mean);

 private:
  struct Member {
    Vec position;
    float mean;
    std::uint32_t place;
  };
  // Places near each other, which are passed over together: members, or all places of two other nodes.
  struct Node {
    PointBox box{};
    float least, most;                // of their means
    std::vector<Member> members{};    // of a leaf
    std::size_t left = 0, right = 0;  // else; the root is nobody's child
  };

  void lower(std::size_t node, const Vec& position, float& mean) const;
  void lower_others(std::size_t node, const Vec& position, float mean,
                    const std::function<void(std::uint32_t, float)>& changed);
  void split(std::size_t full);
  static Node leaf_of(std::vector<Member> members);

  float slope_;
  std::vector<Node> nodes_;  // the root first
};

}  // namespace gleaner::worker
