#pragma once
// Second derivatives of irradiance as its place moves along its surface, from light over strata of the hemisphere:
// after Schwarzhaupt, Jensen & Jarosz 2012, "Practical Hessian-Based Error Control for Irradiance Caching".

#include <array>
#include <span>
#include <vector>

#include "worker/stages/splat/irradiance.h"

namespace gleaner::worker {

// By tangents s and t of the normal (basis3()): s s, s t and t t.
using TangentMatrix = std::array<double, 3>;

// They take what the rays met for a mesh of patches of constant light, and sum over its edges. Here a patch is a
// stratum, and a corner is as near as the nearest surface that its strata met, so that an edge between two surfaces
// moves with the one that hides the other.
class IrradianceHessian {
 public:
  explicit IrradianceHessian(const HemisphereGrid& grid);

  // Of the mean of the colours, over their irradiance, 1/m^2; zeros where there is none. `samples`: one a stratum, ring
  // by ring.
  TangentMatrix relative(std::span<const HemisphereSample> samples) const;

 private:
  using Vec = std::array<double, 3>;
  std::size_t index(std::uint32_t ring, std::uint32_t turn) const {
    return std::size_t{ring} * grid_.azimuthal + turn % grid_.azimuthal;
  }
  // Where corners are, m; empty: no ray met anything.
  std::vector<Vec> corners_of(std::span<const HemisphereSample> samples) const;

  HemisphereGrid grid_;
  std::vector<Vec> directions_;  // of the strata's corners, ring by ring, from the normal to the horizon
};

}  // namespace gleaner::worker
