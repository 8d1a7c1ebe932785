// The concentric map between a square and the hemisphere (Shirley & Chiu 1997): equal areas of the square are equal
// projected solid angles, and neighbours stay so.
#ifndef GLEANER_KERNELS_LINKS_CONCENTRIC_H
#define GLEANER_KERNELS_LINKS_CONCENTRIC_H

#include "kernels/sampling.h"

// Square to disc, then to the hemisphere above it: cosine-weighted.
FN v3 concentric_direction(vf u, vf v) {
  vf a = fma(u, (vf)2.0f, (vf)-1.0f), b = fma(v, (vf)2.0f, (vf)-1.0f);
  vi wide = fabs(a) > fabs(b);
  vf r = pick(b, a, wide);
  vf ratio = pick(zero_f(), pick(a, b, wide) / r, r != zero_f());
  vf turn = pick((vf)0.25f - 0.125f * ratio, 0.125f * ratio, wide);  // in turns, from -1/8 to 3/8
  vf s, c;
  sincos_2pi(turn - floor(turn), &s, &c);
  return make3(r * c, r * s, safe_sqrt(one_f() - r * r));
}

// Back from the hemisphere to the square.
FN void concentric_square(v3 direction, vf* u, vf* v) {
  vf r = safe_sqrt(direction.x * direction.x + direction.y * direction.y);
  vf x = fabs(direction.x), y = fabs(direction.y);
  vi wide = x > y;
  vf longer = max_f(x, y);
  // In eighths of a turn from the nearer axis.
  vf part = pick(zero_f(), atan(min_f(x, y) / longer) * (vf)1.27323954f, longer > zero_f());
  vf a = pick(part, one_f(), wide) * r, b = pick(one_f(), part, wide) * r;
  *u = fma(pick(a, -a, direction.x < zero_f()), (vf)0.5f, (vf)0.5f);
  *v = fma(pick(b, -b, direction.y < zero_f()), (vf)0.5f, (vf)0.5f);
}

#endif
