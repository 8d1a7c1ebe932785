// How much surface the photons of a density estimate lie on.
#ifndef GLEANER_KERNELS_PHOTON_AREA_H
#define GLEANER_KERNELS_PHOTON_AREA_H

#include "kernels/photon/map.h"

// Fewer photons tell too little of their spread.
#define AREA_LEAST_PHOTONS 8.0f
// Least area over the disc's; fitted to the means of the references of four scenes.
#define AREA_LEAST_SHARE 0.2f
// Squared distance of a place from the photons' mean, in their standard deviations: farther away they lie elsewhere, as
// light does that ends beside the place, and the disc is dark for the rest. At the edge of half a disc it is 2.6, in
// the corner of a quarter 4.4. Fitted as well.
#define AREA_MOST_AWAY2 5.0f
#define AREA_PI 3.14159265f

// Moments of photons' places in the surface's plane, each photon by one over the area that it shines on: as much as it
// says of the place.
typedef struct {
  v3 across, along;  // axes
  vf count, weight, inner, x, y, xx, xy, yy;
} PhotonSpread;

FN PhotonSpread photon_spread(const MapPlace* p) {
  PhotonSpread s;
  float ax, ay, az, length;
  // The axis that is farther from the normal, less its part along it.
  if (fabs(p->nx) < 0.6f) {
    ax = 1.0f - p->nx * p->nx, ay = -p->nx * p->ny, az = -p->nx * p->nz;
  } else {
    ax = -p->ny * p->nx, ay = 1.0f - p->ny * p->ny, az = -p->ny * p->nz;
  }
  length = rsqrt(ax * ax + ay * ay + az * az);
  ax *= length, ay *= length, az *= length;
  s.across = make3((vf)ax, (vf)ay, (vf)az);
  s.along = make3((vf)(p->ny * az - p->nz * ay), (vf)(p->nz * ax - p->nx * az), (vf)(p->nx * ay - p->ny * ax));
  s.count = s.weight = s.inner = s.x = s.y = s.xx = s.xy = s.yy = zero_f();
  return s;
}

// A photon at the very place (of a cut's node) tells nothing of how the others are spread.
FN void spread_add(PhotonSpread* s, const PhotonMap* map, uint block, uint part, const MapPlace* p, float reach2,
                   vi near) {
  v3 d =
      make3(photon_f(map, block, part, PHOTON_POSITION) - p->x, photon_f(map, block, part, PHOTON_POSITION + 1u) - p->y,
            photon_f(map, block, part, PHOTON_POSITION + 2u) - p->z);
  vf x = pick(zero_f(), dot3(d, s->across), near), y = pick(zero_f(), dot3(d, s->along), near);
  vf weight = pick(zero_f(), (vf)(1.0f / reach2), near);
  s->count += pick(zero_f(), one_f(), near);
  s->weight += weight;
  vi inner = near & ((photon_u(map, block, part, PHOTON_SURFACE) & PHOTON_INNER) != 0u);
  s->inner += pick(zero_f(), weight, inner);
  s->x += weight * x;
  s->y += weight * y;
  s->xx += weight * x * x;
  s->xy += weight * x * y;
  s->yy += weight * y * y;
}

// The area of the photons' disc over that of an ellipse with their second moments. That has the disc's area where all
// of the disc lies on the surface, to 5 % that of half the disc where the other half hangs over an edge, and so on for
// all that is convex. Its reciprocal, times (n - 3) / (n - 1), has the mean 1 / area for n photons strewn evenly over
// an ellipse. Light that ends on a surface looks like an edge of it: so 1 as far as photons are known to lie inside a
// surface (PHOTON_INNER), and elsewhere AREA_LEAST_SHARE bounds what that may add.
FN float disc_over_surface(const PhotonSpread* s) {
  float n = sum_lanes(s->count);
  if (n < AREA_LEAST_PHOTONS) return 1.0f;
  float all = sum_lanes(s->weight), disc = AREA_PI * n / all, x = sum_lanes(s->x) / all, y = sum_lanes(s->y) / all;
  float xx = sum_lanes(s->xx) / all - x * x, xy = sum_lanes(s->xy) / all - x * y, yy = sum_lanes(s->yy) / all - y * y;
  float det = xx * yy - xy * xy;
  float away2 = x * x * yy - 2.0f * x * y * xy + y * y * xx;
  if (!(away2 < AREA_MOST_AWAY2 * det)) return 1.0f;
  float area = 4.0f * AREA_PI * sqrt(det) * (n - 1.0f) / (n - 3.0f);
  float inner = sum_lanes(s->inner) / all;
  return inner + (1.0f - inner) * disc / fmax(area, AREA_LEAST_SHARE * disc);
}

#endif
