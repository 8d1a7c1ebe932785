// What the specular lobe leaves to the layer below it: tables of scene/model/albedo_tables.cpp.
#ifndef GLEANER_KERNELS_BSDF_ALBEDO_TABLES_H
#define GLEANER_KERNELS_BSDF_ALBEDO_TABLES_H

#include "kernels/bsdf/point.h"

#ifdef NEED_LOBE

FN vf pow5(vf x) {
  vf x2 = x * x;
  return x2 * x2 * x;
}

OUTLINED vf table_lookup(const Scene* scene, vu first, vf row, vf mu) {
  vf x = clamp_f(mu * (vf)(float)GLEANER_ALBEDO_NODES - 0.5f, zero_f(), (vf)(float)(GLEANER_ALBEDO_NODES - 1));
  vu i = min(to_u(x), (vu)(GLEANER_ALBEDO_NODES - 2u));
  vf t = x - to_f(i);
#ifdef NEED_MATERIAL_TEXTURES
  vu r = to_u(row);
  vf s = row - to_f(r);
  vu a = first + r * (GLEANER_ALBEDO_NODES + 1u) + i;
  vu b = pick_u(a, a + (GLEANER_ALBEDO_NODES + 1u), s > zero_f());
  vf lower = mix(gather_f(scene->albedo_tables, a), gather_f(scene->albedo_tables, a + 1u), t);
  vf upper = mix(gather_f(scene->albedo_tables, b), gather_f(scene->albedo_tables, b + 1u), t);
  return mix(lower, upper, s);
#else
  vu a = first + i;
  return mix(gather_f(scene->albedo_tables, a), gather_f(scene->albedo_tables, a + 1u), t);
#endif
}

// 1 - s E(mu): what the specular lobe leaves to the layer under it.
FN vf left_to_layer(const Scene* scene, const Surface* m, vf mu) {
  // Lanes without a table read the first row there is, whatever row they hold.
  vi has = m->table != GLEANER_NONE;
  vf row = pick(zero_f(), m->table_row, has);
  return pick(one_f(), table_lookup(scene, pick_u((vu)0u, m->table, has), row, mu), has);
}

FN vf left_mean_of(const Scene* scene, const Surface* m) {
  vi has = m->table != GLEANER_NONE;
  vu first = pick_u((vu)0u, m->table, has) + GLEANER_ALBEDO_NODES;
#ifdef NEED_MATERIAL_TEXTURES
  vf row = pick(zero_f(), m->table_row, has);
  vu r = to_u(row);
  vf s = row - to_f(r);
  vu a = first + r * (GLEANER_ALBEDO_NODES + 1u);
  vu b = pick_u(a, a + (GLEANER_ALBEDO_NODES + 1u), s > zero_f());
  vf mean = mix(gather_f(scene->albedo_tables, a), gather_f(scene->albedo_tables, b), s);
#else
  vf mean = gather_f(scene->albedo_tables, first);
#endif
  return pick(one_f(), mean, has);
}

#endif

#endif
