#pragma once
// How far records reach along both tangents of their normals, from second derivatives of irradiance (Schwarzhaupt et
// al. 2012).

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "worker/stages/splat/hessian.h"

namespace gleaner::worker {

// A symmetric matrix of the world: xx, xy, xz, yy, yz, zz.
using WorldMatrix = std::array<double, 6>;
WorldMatrix in_world(const std::array<float, 3>& normal, const TangentMatrix& matrix);
TangentMatrix in_plane(const std::array<float, 3>& normal, const WorldMatrix& matrix);

// R_k along the vector across which it reaches farthest, m, and CACHE_NARROW.
struct RecordShape {
  float radius;
  std::array<float, 2> narrow;
};

// Of half axes, m.
struct ShapeBounds {
  double least, most;
};
// `mean`: the harmonic mean distance, m; `pixel`: a pixel's width there, m.
ShapeBounds shape_bounds(float least_pixels, float most_pixels, float pixel, float mean);

// Of places d the ellipse d.M d = 1, M = `metric` in 1/m^2, with half axes within the bounds.
RecordShape shape_of(const TangentMatrix& metric, const ShapeBounds& bounds);
// The other way: its M, along the normal as along the tangent where it reaches farthest.
WorldMatrix metric_of(const std::array<float, 3>& normal, const RecordShape& shape);

struct ShapeSettings {
  float least_radius = 0, most_radius = 0;  // of R_k, in pixels
};

// Sets how far these places reach, by the Hessians of what was gathered there and about them.
void shape_places(const ShapeSettings& settings, std::span<SplatPlace> places, std::span<const CacheRecord> records);

}  // namespace gleaner::worker
