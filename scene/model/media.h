#pragma once
// Solids that light passes through: who lies in whom, and what a point lies in.

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

// Does any light pass through this material? Metal hides transmission.
bool is_transmissive(const Material& material);
// Does its diffuse layer let light through?
bool transmits_diffusely(const Material& material);
// Is it the surface of a solid that light passes through?
bool is_solid(const Material& material);

// The materials of the scene's solids in order of rank, the lowest first. Where solids overlap, the one of the highest
// rank fills the space (nested dielectrics, Schmidt & Budge 2002). glTF names no priorities: rank falls with the size
// of the box about all triangles of the material, so that what lies within another solid (ice in water, a bubble in
// glass) outranks it. Ties: the later material.
std::vector<std::uint32_t> media_by_rank(const Scene& scene);

// May a point lie in two of them: do the boxes of any two overlap?
bool media_may_overlap(const Scene& scene, const std::vector<std::uint32_t>& by_rank);

// Where a point lies: positions in `by_rank` plus 1, the highest first, once for every solid of that material about
// the point. Counted by winding numbers: exact for closed surfaces, however they are cut into meshes.
class MediumFinder {
 public:
  MediumFinder(std::shared_ptr<const Scene> scene, std::vector<std::uint32_t> by_rank);
  std::vector<std::uint32_t> at(const std::array<double, 3>& point) const;
  // Triangles that at() looks at.
  std::size_t triangles() const;

 private:
  std::shared_ptr<const Scene> scene_;
  std::vector<std::uint32_t> by_rank_;
  std::vector<std::vector<std::uint32_t>> triangles_;  // of each medium
  std::vector<std::array<double, 3>> lower_, upper_;   // of the box about them
};

}  // namespace gleaner::scene
