// From a mesh's own space to the world, by the rows of instances (kernels/scene_layout.h). `place`: the first line of a
// row. Row 0, of what stands in the world as it is, changes no bit.
#ifndef GLEANER_KERNELS_INSTANCES_H
#define GLEANER_KERNELS_INSTANCES_H

#include "kernels/scene_layout.h"
#include "kernels/vec3.h"

// The row of an instance, GLEANER_NONE: of the world as it is.
FN vu instance_row(vu instance) { return (instance + 1u) * INSTANCE_WORDS; }

// A vector by the matrix that begins at `m`.
FN v3 turn3(const vf* m, v3 a) {
  return make3(fma(m[0], a.x, fma(m[1], a.y, m[2] * a.z)), fma(m[3], a.x, fma(m[4], a.y, m[5] * a.z)),
               fma(m[6], a.x, fma(m[7], a.y, m[8] * a.z)));
}
FN v3 place_vector(const vf* place, v3 a) { return turn3(place + INSTANCE_LINEAR, a); }
FN v3 place_point(const vf* place, v3 p) {
  const vf* m = place + INSTANCE_LINEAR;
  v3 t = words3(place, INSTANCE_TRANSLATION);
  return make3(fma(m[0], p.x, fma(m[1], p.y, fma(m[2], p.z, t.x))), fma(m[3], p.x, fma(m[4], p.y, fma(m[5], p.z, t.y))),
               fma(m[6], p.x, fma(m[7], p.y, fma(m[8], p.z, t.z))));
}

// By how much each component of a placed point may be off the plane of its triangle, of edges e1 and e2 in the mesh's
// own space, as a query sees it: surface_point()'s bound as the transform turns it, and what the transform adds.
FN v3 placed_error(const vf* place, v3 e1, v3 e2, v3 p) {
  const vf unit = (vf)5.9604645e-8f;  // 2^-24
  vf size[9];
  for (uint k = 0; k < 9u; ++k) size[k] = fabs(place[INSTANCE_LINEAR + k]);
  v3 edges = turn3(size, make3(fabs(e1.x) + fabs(e2.x), fabs(e1.y) + fabs(e2.y), fabs(e1.z) + fabs(e2.z)));
  v3 more = words3(place, INSTANCE_ERROR);
  return make3(fma(unit, fma(edges.x, (vf)16.0f, fabs(p.x)), more.x),
               fma(unit, fma(edges.y, (vf)16.0f, fabs(p.y)), more.y),
               fma(unit, fma(edges.z, (vf)16.0f, fabs(p.z)), more.z));
}

#endif
