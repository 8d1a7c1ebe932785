// A hit: its point, its normals, its material evaluated there. What a wave of camera paths and a wave of light paths
// read of the scene in the same way.
#ifndef GLEANER_KERNELS_SURFACE_H
#define GLEANER_KERNELS_SURFACE_H

#include "kernels/bsdf.h"

typedef struct {
  v3 p, error;   // the point, and the bound of its rounding (surface_point)
  v3 geometric;  // of the triangle's winding
  v3 normal;     // for shading: interpolated and mapped, its side as modelled
  v3 e1, e2;     // edges
  vf b1, b2;     // weights of the second and third corner
  vu triangle;   // first word of its row
  vu material;   // index
  vf first[16];  // the triangle's first line
  vf words[16];  // the material's first line
#ifdef NEED_TEXTURES
  vf u, v;
#endif
#ifdef NEED_SECOND_UVS
  vf second_u, second_v;
#endif
#ifdef NEED_VERTEX_COLORS
  v3 color;  // interpolated from the corners', linear
  vf color_alpha;
#endif
} Hit;

#if defined(NEED_SMOOTH_NORMALS) || defined(NEED_TEXTURES) || defined(NEED_VERTEX_COLORS)
#define HIT_READS_SECOND_LINE
#endif

#ifdef NEED_TEXTURES
// What `texture` shows at a hit, read at the coordinates of its own set.
FN v3 texture_at(const Scene* scene, const Hit* h, vu texture, vi active, vf* alpha) {
  vf u = h->u, v = h->v;
#ifdef NEED_SECOND_UVS
  vi second = reads_second_uvs(scene, texture, active);
  u = pick(u, h->second_u, second);
  v = pick(v, h->second_v, second);
#endif
  return texture_lookup(scene, texture, u, v, active, alpha);
}
#endif

#ifdef NEED_VERTEX_COLORS
// Adds a corner's colour, two words of 16-bit channels, times its weight.
FN void add_corner_color(Hit* h, vu rg, vu ba, vf weight) {
  weight *= (vf)(1.0f / 65535.0f);
  h->color.x += to_f(rg & 0xffffu) * weight;
  h->color.y += to_f(rg >> 16) * weight;
  h->color.z += to_f(ba & 0xffffu) * weight;
  h->color_alpha += to_f(ba >> 16) * weight;
}
#endif

// Triangles in `active` lanes; the others read triangle 0. The point is reckoned from the corners, not along the ray,
// so that its error is the corners' and not the distance's.
FN Hit load_hit(const Scene* scene, vu primitive, vf b1, vf b2, vi active) {
  Hit h;
  h.triangle = primitive * TRIANGLE_WORDS;
  h.b1 = b1;
  h.b2 = b2;
  load_words(scene->triangles, h.triangle, h.first);
#ifdef HIT_READS_SECOND_LINE
  vf t2[16];
  load_words(scene->triangles + TRIANGLE_SECOND, h.triangle, t2);
#endif
  v3 p0 = words3(h.first, TRIANGLE_P0);
  h.e1 = sub3(words3(h.first, TRIANGLE_P1), p0);
  h.e2 = sub3(words3(h.first, TRIANGLE_P2), p0);
  h.p = surface_point(p0, h.e1, h.e2, b1, b2, &h.error);
  h.geometric = normalize3(cross3(h.e1, h.e2));
  h.material = as_vu(h.first[TRIANGLE_MATERIAL]);
  load_words(scene->materials, h.material * MATERIAL_WORDS, h.words);
#ifdef HIT_READS_SECOND_LINE
  vf b0 = one_f() - b1 - b2;
#endif
#ifdef NEED_VERTEX_COLORS
  h.color = splat3(zero_f());
  h.color_alpha = zero_f();
  add_corner_color(&h, as_vu(h.first[TRIANGLE_COLOR0]), as_vu(h.first[TRIANGLE_COLOR0 + 1]), b0);
  add_corner_color(&h, as_vu(h.first[TRIANGLE_COLOR1]), as_vu(h.first[TRIANGLE_COLOR1 + 1]), b1);
  add_corner_color(&h, as_vu(h.first[TRIANGLE_COLOR2_RG]), as_vu(t2[TRIANGLE_COLOR2_BA - TRIANGLE_SECOND]), b2);
#endif
#ifdef NEED_SECOND_UVS
  vf t3[16];
  load_words(scene->triangles + TRIANGLE_THIRD, h.triangle, t3);
  h.second_u = b0 * t3[TRIANGLE_SECOND_UV0 - TRIANGLE_THIRD] + b1 * t3[TRIANGLE_SECOND_UV1 - TRIANGLE_THIRD] +
               b2 * t3[TRIANGLE_SECOND_UV2 - TRIANGLE_THIRD];
  h.second_v = b0 * t3[TRIANGLE_SECOND_UV0 - TRIANGLE_THIRD + 1] + b1 * t3[TRIANGLE_SECOND_UV1 - TRIANGLE_THIRD + 1] +
               b2 * t3[TRIANGLE_SECOND_UV2 - TRIANGLE_THIRD + 1];
#endif
#ifdef NEED_TEXTURES
  h.u = b0 * t2[TRIANGLE_UV0 - TRIANGLE_SECOND] + b1 * t2[TRIANGLE_UV1 - TRIANGLE_SECOND] +
        b2 * t2[TRIANGLE_UV2 - TRIANGLE_SECOND];
  h.v = b0 * t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1] + b1 * t2[TRIANGLE_UV1 - TRIANGLE_SECOND + 1] +
        b2 * t2[TRIANGLE_UV2 - TRIANGLE_SECOND + 1];
#endif
  h.normal = h.geometric;
#ifdef NEED_SMOOTH_NORMALS
  {
    v3 n = mad3(
        words3(t2, TRIANGLE_N0 - TRIANGLE_SECOND), b0,
        mad3(words3(t2, TRIANGLE_N1 - TRIANGLE_SECOND), b1, scale3(words3(t2, TRIANGLE_N2 - TRIANGLE_SECOND), b2)));
    vf l2 = dot3(n, n);
    h.normal = pick3(h.geometric, scale3(n, one_f() / sqrt(l2)), l2 > (vf)1e-12f);
  }
#endif
#ifdef NEED_NORMAL_MAPS
  {
    vu texture = material_u(scene, h.material, MATERIAL_NORMAL_TEXTURE);
    vi mapped = active & (texture != GLEANER_NONE);
    if (any_lane(mapped)) {
      vf unused;
      v3 n = texture_at(scene, &h, texture, mapped, &unused);
      vf strength = material_f(scene, h.material, MATERIAL_NORMAL_SCALE);
      n = make3((2.0f * n.x - 1.0f) * strength, (2.0f * n.y - 1.0f) * strength, 2.0f * n.z - 1.0f);
      vf du1 = t2[TRIANGLE_UV1 - TRIANGLE_SECOND] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND];
      vf dv1 = t2[TRIANGLE_UV1 - TRIANGLE_SECOND + 1] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1];
      vf du2 = t2[TRIANGLE_UV2 - TRIANGLE_SECOND] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND];
      vf dv2 = t2[TRIANGLE_UV2 - TRIANGLE_SECOND + 1] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1];
#ifdef NEED_SECOND_UVS
      vi second = reads_second_uvs(scene, texture, mapped);
      const uint uv0 = TRIANGLE_SECOND_UV0 - TRIANGLE_THIRD, uv1 = TRIANGLE_SECOND_UV1 - TRIANGLE_THIRD,
                 uv2 = TRIANGLE_SECOND_UV2 - TRIANGLE_THIRD;
      du1 = pick(du1, t3[uv1] - t3[uv0], second);
      dv1 = pick(dv1, t3[uv1 + 1] - t3[uv0 + 1], second);
      du2 = pick(du2, t3[uv2] - t3[uv0], second);
      dv2 = pick(dv2, t3[uv2 + 1] - t3[uv0 + 1], second);
#endif
#ifdef NEED_TEXTURE_TRANSFORMS
      turn_uv(scene, texture_row(texture, mapped), &du1, &dv1);
      turn_uv(scene, texture_row(texture, mapped), &du2, &dv2);
#endif
      vf area = du1 * dv2 - du2 * dv1;
      // dp/du, made perpendicular to the normal; the bitangent's sense is that of -dv (v grows downwards in glTF).
      v3 tangent = scale3(sub3(scale3(h.e1, dv2), scale3(h.e2, dv1)), pick((vf)-1.0f, one_f(), area > zero_f()));
      tangent = sub3(tangent, scale3(h.normal, dot3(h.normal, tangent)));
      vi usable = mapped & (dot3(tangent, tangent) > zero_f()) & (area != zero_f());
      tangent = normalize3(tangent);
      v3 bitangent = scale3(cross3(h.normal, tangent), pick(one_f(), (vf)-1.0f, area > zero_f()));
      v3 bent = normalize3(mad3(tangent, n.x, mad3(bitangent, n.y, scale3(h.normal, n.z))));
      h.normal = pick3(h.normal, bent, usable & (dot3(bent, bent) > zero_f()));
    }
  }
#endif
  return h;
}

#ifdef NEED_ALPHA
// What of a material of opacity `alpha` is in light's way.
FN vf opacity_of(const Scene* scene, vu material, vu flags, vf alpha) {
  vf masked = pick(zero_f(), one_f(), alpha >= material_f(scene, material, MATERIAL_ALPHA_CUTOFF));
  alpha = pick(alpha, masked, (flags & GLEANER_MATERIAL_ALPHA_MASK) != 0u);
  return pick(one_f(), alpha, (flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND)) != 0u);
}
#endif

// Colour and opacity: all that emission and alpha tests ask of a material.
FN void load_color(const Scene* scene, const Hit* h, Surface* m, vi active) {
  m->base = words3(h->words, MATERIAL_BASE_COLOR);
#ifdef NEED_VERTEX_COLORS
  m->base = mul3(m->base, h->color);
#endif
#ifdef NEED_ALPHA
  vu flags = as_vu(h->words[MATERIAL_FLAGS]);
  m->opacity = h->words[MATERIAL_ALPHA];
#ifdef NEED_VERTEX_COLORS
  m->opacity = m->opacity * h->color_alpha;
#endif
#endif
#ifdef NEED_TEXTURES
  {
    vu texture = as_vu(h->words[MATERIAL_BASE_COLOR_TEXTURE]);
    vi textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      vf alpha;
      v3 color = texture_at(scene, h, texture, textured, &alpha);
      m->base = pick3(m->base, mul3(m->base, color), textured);
#ifdef NEED_ALPHA
      m->opacity = pick(m->opacity, m->opacity * alpha, textured);
#endif
    }
  }
#endif
#ifdef NEED_ALPHA
  m->opacity = opacity_of(scene, h->material, flags, m->opacity);
#endif
}

// What scattering needs beyond load_color().
FN void load_lobes(const Scene* scene, const Hit* h, Surface* m, vi active) {
#if defined(NEED_LOBE) || defined(NEED_TRANSMISSIVE)
  m->alpha = h->words[MATERIAL_ROUGHNESS];
#ifdef NEED_LOBE
  m->metallic = h->words[MATERIAL_METALLIC];
  m->specular = h->words[MATERIAL_SPECULAR];
  m->f0 = words3(h->words, MATERIAL_F0);
  m->table = as_vu(h->words[MATERIAL_ALBEDO_TABLE]);
  m->table_row = zero_f();
#endif
#ifdef NEED_TRANSMISSIVE
  m->transmission = h->words[MATERIAL_TRANSMISSION];
  m->ior = h->words[MATERIAL_IOR];
  m->solid = (as_vu(h->words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_SOLID) != 0u;
#endif
#ifdef NEED_MATERIAL_TEXTURES
  {
    vf unused;
    vu texture = material_u(scene, h->material, MATERIAL_METALLIC_ROUGHNESS_TEXTURE);
    vi textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      v3 c = texture_at(scene, h, texture, textured, &unused);
      m->alpha = pick(m->alpha, m->alpha * c.y, textured);
#ifdef NEED_LOBE
      m->metallic = pick(m->metallic, m->metallic * c.z, textured);
#endif
    }
#ifdef NEED_LOBE
    vu rows = as_vu(h->words[MATERIAL_ALBEDO_ROWS]);
    m->table_row =
        pick(zero_f(), clamp_f(m->alpha, zero_f(), one_f()) * (vf)(float)(GLEANER_ALBEDO_ROWS - 1), rows > 1u);
    texture = material_u(scene, h->material, MATERIAL_SPECULAR_TEXTURE);
    textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      vf a;
      texture_at(scene, h, texture, textured, &a);
      m->specular = pick(m->specular, m->specular * a, textured);
    }
    texture = material_u(scene, h->material, MATERIAL_SPECULAR_COLOR_TEXTURE);
    textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      v3 c = texture_at(scene, h, texture, textured, &unused);
      m->f0 = pick3(m->f0, mul3(m->f0, c), textured);
    }
#endif
#ifdef NEED_TRANSMISSIVE
    texture = material_u(scene, h->material, MATERIAL_TRANSMISSION_TEXTURE);
    textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      v3 c = texture_at(scene, h, texture, textured, &unused);
      m->transmission = pick(m->transmission, m->transmission * c.x, textured);
    }
#endif
  }
#endif
  m->alpha = m->alpha * m->alpha;
#ifdef NEED_LOBE
  m->alpha2 = m->alpha * m->alpha;
#endif
#endif
}

// Whether light passes an alpha-transparent surface undeflected: at random, in proportion. What is left of the number
// serves again.
FN vi stochastic_alpha(const Surface* m, vi active, vf* u) {
#ifdef NEED_ALPHA
  vi passes = active & (m->opacity < one_f()) & (*u >= m->opacity);
  *u = pick(*u, min_f(*u / m->opacity, (vf)0.99999994f), m->opacity > zero_f());
  return passes;
#else
  return no_lanes();
#endif
}

// The frame in which scattering is reckoned: interpolated and mapped normals decide the side and the cosine.
typedef struct {
  v3 normal;  // on the side that the ray came from
  v3 tangent, bitangent;
  v3 view;       // where the ray came from, in this frame
  vi from_back;  // of the normal as modelled
} ShadingFrame;

FN ShadingFrame shading_frame(v3 normal, v3 direction) {
  ShadingFrame f;
  vf facing = dot3(normal, direction);
  f.from_back = facing > zero_f();
  f.normal = pick3(normal, negate3(normal), f.from_back);
  basis3(f.normal, &f.tangent, &f.bitangent);
  f.view = make3(-dot3(f.tangent, direction), -dot3(f.bitangent, direction), fabs(facing));
  return f;
}

FN v3 from_frame(const ShadingFrame* f, v3 d) {
  return normalize3(add3(add3(scale3(f->tangent, d.x), scale3(f->bitangent, d.y)), scale3(f->normal, d.z)));
}

// What a solid absorbs of a segment that ended on its back face.
FN v3 absorbed(const Scene* scene, const Hit* h, v3 origin, v3 direction, v3 throughput, vi active) {
#ifdef NEED_ATTENUATION
  vi within = active & none(dot3(h->geometric, direction) < zero_f()) &
              ((as_vu(h->words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_ATTENUATES) != 0u);
  if (any_lane(within)) {
    vf distance = length3(sub3(h->p, origin));
    v3 k = material_3(scene, h->material, MATERIAL_ATTENUATION);
    v3 left = make3(exp(-k.x * distance), exp(-k.y * distance), exp(-k.z * distance));
    throughput = pick3(throughput, mul3(throughput, left), within);
  }
#endif
  return throughput;
}

#endif
