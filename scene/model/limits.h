#pragma once
// What a scene may hold at most. Importers check these before they take memory; validate() checks them again.

#include <cstddef>
#include <cstdint>

namespace gleaner::scene {

inline constexpr std::size_t kMaxTriangles = std::size_t(1) << 27;  // a leaf of the BVH names a slot in 27 bits
// Of a leaf of the BVH: build_bvh() makes no deeper tree. The OpenCL tracer keeps a stack of as many entries a ray.
inline constexpr std::uint32_t kMaxBvhDepth = 64;
inline constexpr std::size_t kMaxVertices = 3 * kMaxTriangles;
inline constexpr std::size_t kMaxTexels = std::size_t(0xffffffffu);  // a texture names its first in 32 bits
inline constexpr std::uint32_t kMaxTextureSide = 65536;
inline constexpr std::uint32_t kMaxEnvironmentSide = 16384;
// Squared areas of triangles stay below the largest float.
inline constexpr float kMaxCoordinate = 1e9f;
inline constexpr float kMaxCameraCoordinate = 8e9f;         // far enough off to see the largest scene whole
inline constexpr std::uint32_t kMostPoseValues = 1u << 22;  // matrices, and morph weights, of a frame's state
inline constexpr double kMostPoseNumber = 1e30;             // of matrices and morph weights
inline constexpr double kUnitTolerance = 1e-3;              // of a unit vector's squared length
inline constexpr std::size_t kMaxInstances = std::size_t(1) << 22;
inline constexpr double kMaxInstanceScale = 1e6;    // of what a transform enlarges, or shrinks by
inline constexpr double kMaxInstanceStretch = 1e3;  // see refused_transform() in instances.h

}  // namespace gleaner::scene
