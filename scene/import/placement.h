#pragma once
// Where a scene stands. Importers work in double precision and store floats relative to an origin near the scene, so
// that a scene far from its file's origin keeps its precision.

#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "scene/files/warnings.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

using Point3 = std::array<double, 3>;

// A scene that is this many times its size away from the origin loses four of its 24 bits there; nearer ones stay as
// their file has them.
inline constexpr double kFarAway = 16;

// A shape of fewer steps across is visibly rounded.
inline constexpr double kFewSteps = 200;

struct Box {
  Point3 lower{kEmpty, kEmpty, kEmpty}, upper{-kEmpty, -kEmpty, -kEmpty};
  static constexpr double kEmpty = std::numeric_limits<double>::infinity();

  // NaN and infinite coordinates are left out.
  void add(const Point3& p) {
    for (int c = 0; c < 3; ++c) {
      if (!std::isfinite(p[c])) continue;
      if (p[c] < lower[c]) lower[c] = p[c];
      if (p[c] > upper[c]) upper[c] = p[c];
    }
  }
  void enclose(const Box& other) {
    if (other.empty()) return;
    add(other.lower);
    add(other.upper);
  }
  bool empty() const { return !(lower[0] <= upper[0] && lower[1] <= upper[1] && lower[2] <= upper[2]); }
  double extent() const;     // the longest side, 0 where empty
  double magnitude() const;  // the largest coordinate, 0 where empty
};

// The origin for a scene within `bounds`: zero unless the scene lies many times its size away from the file's origin.
Point3 origin_for(const Box& bounds);

// Warns where floats (24 bits) at the distance of `box` from zero are coarse beside its size. `what` says what is
// stored so ("positions in the file").
void warn_of_coarse_floats(const Box& box, const std::string& where, const std::string& what, Warnings& warnings);

// The same for each mesh of a scene, in its own coordinates.
void warn_of_coarse_meshes(const Scene& scene, Warnings& warnings);

}  // namespace gleaner::scene
