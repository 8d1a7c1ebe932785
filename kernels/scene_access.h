// Reading the scene: hit points, textures, the environment.
#ifndef GLEANER_KERNELS_SCENE_ACCESS_H
#define GLEANER_KERNELS_SCENE_ACCESS_H

#include "kernels/instances.h"
#include "kernels/rays.h"
#include "kernels/scene_layout.h"

#define SCENE_PARAMETERS                                                                             \
  global const float *triangles, global const float *instances, global const float *materials,       \
      global const uint *textures, global const uint *texels, global const float *srgb,              \
      global const float *albedo_tables, global const float *emitters, global const float *clusters, \
      global const float *environment

typedef struct {
  global const float* triangles;
  global const float* instances;
  global const float* materials;
  global const uint* textures;
  global const uint* texels;
  global const float* srgb;  // 256 decoded values, then i / 255
  global const float* albedo_tables;
  global const float* emitters;
  global const float* clusters;
  global const float* environment;
} Scene;

#define SCENE_FROM_PARAMETERS \
  { triangles, instances, materials, textures, texels, srgb, albedo_tables, emitters, clusters, environment }

FN vf material_f(const Scene* scene, vu material, uint word) {
  return gather_f(scene->materials + word, material * MATERIAL_WORDS);
}
FN vu material_u(const Scene* scene, vu material, uint word) {
  return gather_u((global const uint*)scene->materials + word, material * MATERIAL_WORDS);
}
FN v3 material_3(const Scene* scene, vu material, uint word) {
  return gather3(scene->materials + word, material * MATERIAL_WORDS);
}

#ifdef NEED_TEXTURES

// Texture coordinate to texel, by the sampler's wrap mode. That of a lane which repeats or mirrors lies in [-1, 2 n].
FN vu wrap_texel(vi i, vi n, vu mode) {
  vi repeat = select(i, i + n, i < 0);
  repeat = select(repeat, repeat - n, repeat >= n);
  repeat = select(repeat, repeat - n, repeat >= n);
  vi clamped = select(select(i, n - 1, i >= n), (vi)0, i < 0);
  vi period = select(i, i + 2 * n, i < 0);
  period = select(period, period - 2 * n, period >= 2 * n);
  vi mirrored = select(period, 2 * n - 1 - period, period >= n);
#if LANES == 16
  vi r = select(select(repeat, clamped, as_vi(pick_u((vu)0u, (vu)0xffffffffu, mode == GLEANER_WRAP_CLAMP))), mirrored,
                as_vi(pick_u((vu)0u, (vu)0xffffffffu, mode == GLEANER_WRAP_MIRROR)));
  return as_uint16(r);
#else
  return (uint)(mode == GLEANER_WRAP_CLAMP ? clamped : mode == GLEANER_WRAP_MIRROR ? mirrored : repeat);
#endif
}

// A texture's row, for lanes outside `active` that of texture 0.
FN vu texture_row(vu texture, vi active) { return pick_u((vu)0u, texture, active) * TEXTURE_WORDS; }

#ifdef NEED_SECOND_UVS
FN vi reads_second_uvs(const Scene* scene, vu texture, vi active) {
  return active & (gather_u(scene->textures + TEXTURE_UV_SET, texture_row(texture, active)) == 1u);
}
#endif

FN void load_texture(const Scene* scene, vu texture, vi active, vf* words) {
  load_words((global const float*)scene->textures, texture_row(texture, active), words);
}

#ifdef NEED_TEXTURE_TRANSFORMS
// The linear part of a texture's transform.
FN void turn_uv(const vf* words, vf* u, vf* v) {
  const vf* t = words + TEXTURE_TRANSFORM;
  vf x = *u, y = *v;
  *u = t[0] * x + t[1] * y;
  *v = t[3] * x + t[4] * y;
}
#endif

// Bilinear lookup: bytes are decoded first, then filtered. Lanes outside `active` read texture 0. Gives RGB and alpha.
OUTLINED v3 texture_lookup(const Scene* scene, vu texture, vf u, vf v, vi active, vf* alpha) {
  vf words[16];
  load_texture(scene, texture, active, words);
#ifdef NEED_TEXTURE_TRANSFORMS
  turn_uv(words, &u, &v);
  u += words[TEXTURE_TRANSFORM + 2];
  v += words[TEXTURE_TRANSFORM + 5];
#endif
  vu first = as_vu(words[TEXTURE_FIRST_TEXEL]);
  vu width = as_vu(words[TEXTURE_WIDTH]), height = as_vu(words[TEXTURE_HEIGHT]);
  vu wrap_u = as_vu(words[TEXTURE_WRAP_U]), wrap_v = as_vu(words[TEXTURE_WRAP_V]);
  vu decode = pick_u((vu)256u, (vu)0u, (as_vu(words[TEXTURE_FLAGS]) & GLEANER_TEXTURE_SRGB) != 0u);
  // Coordinates beyond 2^20 have no texel of their own left in a float; NaN and such become 0.
  u = pick(zero_f(), u, fabs(u) < (vf)1048576.0f);
  v = pick(zero_f(), v, fabs(v) < (vf)1048576.0f);
  // Whole turns are dropped before scaling (periods of 2 keep mirrored wrapping).
  u -= pick(zero_f(), 2.0f * floor(u * 0.5f), wrap_u != GLEANER_WRAP_CLAMP);
  v -= pick(zero_f(), 2.0f * floor(v * 0.5f), wrap_v != GLEANER_WRAP_CLAMP);
  vf x = u * to_f(width) - 0.5f, y = v * to_f(height) - 0.5f;
  vf x0 = floor(x), y0 = floor(y);
  vf fx = x - x0, fy = y - y0;
#if LANES == 16
  vi w = convert_int16(width), h = convert_int16(height);
#else
  vi w = (int)width, h = (int)height;
#endif
  vi ix = to_i(x0), iy = to_i(y0);
  vu xa = wrap_texel(ix, w, wrap_u), xb = wrap_texel(ix + 1, w, wrap_u);
  vu ya = wrap_texel(iy, h, wrap_v) * width + first, yb = wrap_texel(iy + 1, h, wrap_v) * width + first;
  vu at[4] = {ya + xa, ya + xb, yb + xa, yb + xb};
  vf weight[4] = {(1.0f - fx) * (1.0f - fy), fx * (1.0f - fy), (1.0f - fx) * fy, fx * fy};
  v3 sum = splat3(zero_f());
  vf a = zero_f();
  // A loop: written out, the taps' gathers were a third of the kernel (see scatter_words()).
  __attribute__((opencl_unroll_hint(1))) for (int k = 0; k < 4; ++k) {
    vu texel = gather_u(scene->texels, at[k]);
    v3 c = make3(gather_f(scene->srgb, (texel & 255u) + decode), gather_f(scene->srgb, ((texel >> 8) & 255u) + decode),
                 gather_f(scene->srgb, ((texel >> 16) & 255u) + decode));
    sum = mad3(c, weight[k], sum);
    a = fma(to_f(texel >> 24) * (vf)(1.0f / 255.0f), weight[k], a);
  }
  *alpha = a;
  return sum;
}

#endif

#ifdef NEED_ALPHA
// What of a material of opacity `alpha` is in light's way.
FN vf opacity_of(const Scene* scene, vu material, vu flags, vf alpha) {
  vf masked = pick(zero_f(), one_f(), alpha >= material_f(scene, material, MATERIAL_ALPHA_CUTOFF));
  alpha = pick(alpha, masked, (flags & GLEANER_MATERIAL_ALPHA_MASK) != 0u);
  return pick(one_f(), alpha, (flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND)) != 0u);
}
#endif

#ifdef NEED_ENVIRONMENT

// Lat-long coordinates of a unit direction: d = (sin t sin p, cos t, -sin t cos p), p = 2 pi u, t = pi v.
FN void environment_uv(v3 d, vf* u, vf* v) {
  vf p = atan2(d.x, -d.z) * (vf)0.15915494309189535f;
  *u = p - floor(p);
  *v = acos(clamp_f(d.y, (vf)-1.0f, one_f())) * (vf)0.3183098861837907f;
}

// Bilinear radiance at (u, v): wrapped in u, clamped at the poles.
OUTLINED v3 environment_radiance(const Scene* scene, vf u, vf v) {
  global const uint* header = (global const uint*)scene->environment;
  uint width = header[0], height = header[1];
  vf x = u * (vf)(float)width - 0.5f, y = v * (vf)(float)height - 0.5f;
  // The bounds are those of u and v in [0, 1]. Of a direction that is not a number they keep the look-up in the table.
  vf x0 = clamp_f(floor(x), (vf)-1.0f, (vf)(float)width), y0 = clamp_f(floor(y), (vf)-1.0f, (vf)(float)height);
  vf fx = x - x0, fy = y - y0;
  int w = (int)width, h = (int)height;
  vi xa = to_i(x0), ya = to_i(y0);
  xa = select(xa, xa + w, xa < 0);
  xa = select(xa, xa - w, xa >= w);
  vi xb = xa + 1;
  xb = select(xb, xb - w, xb >= w);
  vi yb = min(ya + 1, (vi)(h - 1));
  ya = max(ya, (vi)0);
  ya = min(ya, (vi)(h - 1));
  global const float* texels = scene->environment + ENVIRONMENT_HEADER;
#if LANES == 16
#define CELL(y, x) (as_uint16((y)*w + (x)) * 3u)
#else
#define CELL(y, x) ((uint)((y)*w + (x)) * 3u)
#endif
  v3 sum = scale3(gather3(texels, CELL(ya, xa)), (1.0f - fx) * (1.0f - fy));
  sum = mad3(gather3(texels, CELL(ya, xb)), fx * (1.0f - fy), sum);
  sum = mad3(gather3(texels, CELL(yb, xa)), (1.0f - fx) * fy, sum);
  sum = mad3(gather3(texels, CELL(yb, xb)), fx * fy, sum);
#undef CELL
  return sum;
}

FN global const float* environment_column_cdf(const Scene* scene) {
  global const uint* header = (global const uint*)scene->environment;
  return scene->environment + ENVIRONMENT_HEADER + 3u * header[0] * header[1];
}
FN global const float* environment_row_cdf(const Scene* scene) {
  global const uint* header = (global const uint*)scene->environment;
  return environment_column_cdf(scene) + header[0] * header[1];
}

// Density, per steradian, of environment_sample() at (u, v) of polar sine `sine`.
OUTLINED vf environment_pdf(const Scene* scene, vf u, vf v, vf sine) {
  global const uint* header = (global const uint*)scene->environment;
  uint width = header[0], height = header[1];
  vu x = min(to_u(u * (vf)(float)width), (vu)(width - 1u));
  vu y = min(to_u(v * (vf)(float)height), (vu)(height - 1u));
  global const float* columns = environment_column_cdf(scene);
  global const float* rows = environment_row_cdf(scene);
  vf row = gather_f(rows, y) - pick(zero_f(), gather_f(rows, pick_u((vu)0u, y - 1u, y > 0u)), y > 0u);
  vu cell = y * width + x;
  vf column = gather_f(columns, cell) - pick(zero_f(), gather_f(columns, pick_u((vu)0u, cell - 1u, x > 0u)), x > 0u);
  vf density = row * column * (vf)((float)width * (float)height * 0.05066059182116889f);  // 1 / (2 pi^2)
  return pick(zero_f(), density / sine, sine > zero_f());
}

// A direction by luminance times solid angle; u0 finds the column, u1 the row.
OUTLINED v3 environment_sample(const Scene* scene, vf u0, vf u1, vf* pdf, v3* radiance) {
  global const uint* header = (global const uint*)scene->environment;
  uint width = header[0], height = header[1];
  global const float* columns = environment_column_cdf(scene);
  global const float* rows = environment_row_cdf(scene);
  // First entry of the cumulated density above the number, by halving.
  vu low = (vu)0u;
  for (uint step = header[2]; step > 0u; step >>= 1) {
    vu probe = low + step;
    vu at = min(probe, (vu)height) - 1u;
    low = pick_u(low, probe, (probe < height) & (gather_f(rows, at) <= u1));
  }
  vu y = min(low, (vu)(height - 1u));
  vf below = pick(zero_f(), gather_f(rows, pick_u((vu)0u, y - 1u, y > 0u)), y > 0u);
  vf share = gather_f(rows, y) - below;
  vf fy = clamp_f(pick((vf)0.5f, (u1 - below) / share, share > zero_f()), zero_f(), (vf)0.99999994f);
  vf row_share = share;
  low = (vu)0u;
  vu first = y * width;
  for (uint step = header[3]; step > 0u; step >>= 1) {
    vu probe = low + step;
    vu at = first + min(probe, (vu)width) - 1u;
    low = pick_u(low, probe, (probe < width) & (gather_f(columns, at) <= u0));
  }
  vu x = min(low, (vu)(width - 1u));
  below = pick(zero_f(), gather_f(columns, first + pick_u((vu)0u, x - 1u, x > 0u)), x > 0u);
  share = gather_f(columns, first + x) - below;
  vf fx = clamp_f(pick((vf)0.5f, (u0 - below) / share, share > zero_f()), zero_f(), (vf)0.99999994f);
  vf u = (to_f(x) + fx) / (float)width, v = (to_f(y) + fy) / (float)height;
  vf sp, cp, st, ct;
  sincos_2pi(u, &sp, &cp);
  sincos_2pi(v * 0.5f, &st, &ct);
  vf density = row_share * share * (vf)((float)width * (float)height * 0.05066059182116889f);
  *pdf = pick(zero_f(), density / st, st > zero_f());
  *radiance = environment_radiance(scene, u, v);
  return make3(st * sp, ct, -st * cp);
}

#endif

#endif
