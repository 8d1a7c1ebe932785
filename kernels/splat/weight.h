// Where a record counts, and how much (Gautron et al. 2005, eq. 2 to 4). Compiled by OpenCL C, for lanes of points, and
// by C++, for one (worker/stages/splat/scalar.h): who chooses records and who reads them must agree.
#ifndef GLEANER_KERNELS_SPLAT_WEIGHT_H
#define GLEANER_KERNELS_SPLAT_WEIGHT_H

#include "kernels/splat_records.h"

// A point that lies deeper than this part of its distance below a record's surface gets nothing from it: what the
// record sees may be hidden from there (Ward, Rubinstein & Clear 1988). Surfaces that curve need the margin.
#define SPLAT_MOST_DEPTH 0.05f
// 1 / w at the record's own place.
#define SPLAT_LEAST_ERROR 1e-6f
// Host and device round differently: a point is covered by a stricter measure than it is read by.
#define SPLAT_SLACK 1e-3f
// Rays that tell how far a surface is clear rise by so much of their length: they pass steps, and what a curved surface
// does itself.
#define SPLAT_CLEAR_SLOPE 0.25f

// 1 / w of eq. 2. (x, y, z): from the record to the point; (nx, ny, nz): the point's normal, (mx, my, mz): the
// record's. 1 - n.m is half of |n - m|^2, which does not cancel. `across`: how much farther the point counts as along
// the axis of a record that reaches less far there, the product of (x, y, z) and that (CACHE_NARROW), m; 0: it reaches
// equally far along both tangents.
FN vf splat_error(vf x, vf y, vf z, vf nx, vf ny, vf nz, vf mx, vf my, vf mz, vf radius, vf across) {
  vf away = sqrt(x * x + y * y + z * z + across * across) / radius;
  vf dx = nx - mx, dy = ny - my, dz = nz - mz;
  return max_f(away + sqrt((dx * dx + dy * dy + dz * dz) * 0.5f), (vf)SPLAT_LEAST_ERROR);
}

// Of a place (x, y) in a record's tangent plane: which of SPLAT_DIRECTIONS directions about the diamond |x| + |y| = 1
// it lies in, from 0 to SPLAT_DIRECTIONS, and how far away, by |x| + |y|.
FN vf splat_direction(vf x, vf y, vf* away) {
  *away = max_f(fabs(x) + fabs(y), (vf)1e-30f);
  vf part = x / *away;
  return (float)(SPLAT_DIRECTIONS / 4u) * pick((vf)3.0f + part, (vf)1.0f - part, y >= (vf)0.0f);
}

// Whether anything stands within `reach` of a record, m. `least`: its CACHE_LEAST_CLEAR. |x| + |y| is at most sqrt(2)
// times the distance.
FN int splat_stands_near(float least, float reach) { return least * reach * 1.4143f > 1.0f; }

// Whether the point is below the record's surface, as both normals see it, by more than `depth` of its distance.
FN vi splat_is_hidden(vf x, vf y, vf z, vf nx, vf ny, vf nz, vf mx, vf my, vf mz, float depth) {
  vf height = (x * (nx + mx) + y * (ny + my) + z * (nz + mz)) * 0.5f;
  return height < (vf)-depth * sqrt(x * x + y * y + z * z);
}

#endif
