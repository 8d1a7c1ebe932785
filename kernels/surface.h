// A hit: its point, its normals, its material evaluated there. What a wave of camera paths and a wave of light paths
// read of the scene in the same way.
#ifndef GLEANER_KERNELS_SURFACE_H
#define GLEANER_KERNELS_SURFACE_H

#include "kernels/bsdf.h"

typedef struct {
  v3 p, error;   // the point, and the bound of its rounding (surface_point)
  v3 geometric;  // of the triangle's winding
  v3 outward;    // the same, turned to the side that the vertices' normals say is the front
  v3 normal;     // for shading: interpolated and mapped, its side as modelled
  v3 e1, e2;     // edges
  vf b1, b2;     // weights of the second and third corner
  vu triangle;   // first word of its row
#ifdef NEED_INSTANCES
  vu instance;  // GLEANER_NONE: the triangle stands in the world as it is
  vf side;      // -1 where the instance's transform turns triangles inside out
#endif
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
#if defined(NEED_CLEARCOAT) && defined(NEED_NORMAL_MAPS)
  v3 coat_normal;  // interpolated, and mapped by the coat's own texture
#endif
#ifdef NEED_ANISOTROPY
  v3 tangent, bitangent;  // perpendicular to the normal
#endif
} Hit;

#if defined(NEED_SMOOTH_NORMALS) || defined(NEED_TEXTURES) || defined(NEED_VERTEX_COLORS) || defined(NEED_ANISOTROPY)
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

#if defined(NEED_NORMAL_MAPS) || defined(NEED_ANISOTROPY)
// The tangent along which u grows, perpendicular to the hit's normal, and the bitangent, by the coordinates that
// `texture` reads (GLEANER_NONE: the first ones as they are); the triangle's lines t2 and t3. Gives the lanes whose
// coordinates span the triangle.
OUTLINED vi tangent_frame(const Scene* scene, const Hit* h, const vf* t2, const vf* t3, vu texture, vi active,
                          v3* tangent_out, v3* bitangent_out) {
  vf du1 = t2[TRIANGLE_UV1 - TRIANGLE_SECOND] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND];
  vf dv1 = t2[TRIANGLE_UV1 - TRIANGLE_SECOND + 1] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1];
  vf du2 = t2[TRIANGLE_UV2 - TRIANGLE_SECOND] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND];
  vf dv2 = t2[TRIANGLE_UV2 - TRIANGLE_SECOND + 1] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1];
  vi textured = active & (texture != GLEANER_NONE);
#ifdef NEED_SECOND_UVS
  vi second = reads_second_uvs(scene, texture, textured);
  const uint uv0 = TRIANGLE_SECOND_UV0 - TRIANGLE_THIRD, uv1 = TRIANGLE_SECOND_UV1 - TRIANGLE_THIRD,
             uv2 = TRIANGLE_SECOND_UV2 - TRIANGLE_THIRD;
  du1 = pick(du1, t3[uv1] - t3[uv0], second);
  dv1 = pick(dv1, t3[uv1 + 1] - t3[uv0 + 1], second);
  du2 = pick(du2, t3[uv2] - t3[uv0], second);
  dv2 = pick(dv2, t3[uv2 + 1] - t3[uv0 + 1], second);
#endif
#ifdef NEED_TEXTURE_TRANSFORMS
  vf words[16];
  load_texture(scene, texture, textured, words);
  vf turned_u1 = du1, turned_v1 = dv1, turned_u2 = du2, turned_v2 = dv2;
  turn_uv(words, &turned_u1, &turned_v1);
  turn_uv(words, &turned_u2, &turned_v2);
  du1 = pick(du1, turned_u1, textured);
  dv1 = pick(dv1, turned_v1, textured);
  du2 = pick(du2, turned_u2, textured);
  dv2 = pick(dv2, turned_v2, textured);
#endif
  vf area = du1 * dv2 - du2 * dv1;
  // dp/du, made perpendicular to the normal; the bitangent's sense is that of -dv (v grows downwards in glTF).
  v3 tangent = scale3(sub3(scale3(h->e1, dv2), scale3(h->e2, dv1)), pick((vf)-1.0f, one_f(), area > zero_f()));
  tangent = sub3(tangent, scale3(h->normal, dot3(h->normal, tangent)));
  vi usable = active & (dot3(tangent, tangent) > zero_f()) & (area != zero_f());
  tangent = normalize3(tangent);
  *tangent_out = tangent;
  vf handedness = pick(one_f(), (vf)-1.0f, area > zero_f());
#ifdef NEED_INSTANCES
  handedness *= h->side;
#endif
  *bitangent_out = scale3(cross3(h->normal, tangent), handedness);
  return usable;
}
#endif

#ifdef NEED_NORMAL_MAPS
// The hit's normal as a normal texture bends it.
OUTLINED v3 mapped_normal(const Scene* scene, const Hit* h, const vf* t2, const vf* t3, vu texture, vf strength,
                          vi active) {
  v3 normal = h->normal;
  vi mapped = active & (texture != GLEANER_NONE);
  if (any_lane(mapped)) {
    vf unused;
    v3 n = texture_at(scene, h, texture, mapped, &unused);
    n = make3((2.0f * n.x - 1.0f) * strength, (2.0f * n.y - 1.0f) * strength, 2.0f * n.z - 1.0f);
    v3 tangent, bitangent;
    vi usable = tangent_frame(scene, h, t2, t3, texture, mapped, &tangent, &bitangent);
    v3 bent = normalize3(mad3(tangent, n.x, mad3(bitangent, n.y, scale3(normal, n.z))));
    normal = pick3(normal, bent, usable & (dot3(bent, bent) > zero_f()));
  }
  return normal;
}
#endif

#ifdef NEED_ANISOTROPY
// The frame of the grain: that of the normal texture, or of the anisotropy's own. Where coordinates say nothing, any.
FN void load_tangents(const Scene* scene, Hit* h, const vf* t2, const vf* t3, vi active) {
  basis3(h->normal, &h->tangent, &h->bitangent);
  vi grained = active & (material_f(scene, h->material, MATERIAL_ANISOTROPY) > zero_f());
  if (!any_lane(grained)) return;
  vu texture = material_u(scene, h->material, MATERIAL_ANISOTROPY_TEXTURE);
  vu normal_texture = material_u(scene, h->material, MATERIAL_NORMAL_TEXTURE);
  texture = pick_u(texture, normal_texture, texture == GLEANER_NONE);
  v3 tangent, bitangent;
  vi usable = tangent_frame(scene, h, t2, t3, texture, grained, &tangent, &bitangent);
  h->tangent = pick3(h->tangent, tangent, usable);
  h->bitangent = pick3(h->bitangent, bitangent, usable);
}
#endif

// The instance that a hit's triangle is of; 0 in scenes without instances, as rays have it (set_ray).
FN vu hit_instance(const Hit* h) {
#ifdef NEED_INSTANCES
  return h->instance;
#else
  return (vu)0u;
#endif
}

#ifdef NEED_SMOOTH_NORMALS
// The vertices' normals, interpolated; of any length.
FN v3 interpolated_normal(const Scene* scene, const Hit* h, const vf* t2, vf b0) {
  v3 n0 = words3(t2, TRIANGLE_N0 - TRIANGLE_SECOND), n1 = words3(t2, TRIANGLE_N1 - TRIANGLE_SECOND),
     n2 = words3(t2, TRIANGLE_N2 - TRIANGLE_SECOND);
#ifdef NEED_INSTANCES
  // Each corner's by itself, as where the mesh is stored in the world.
  vf turn[16];
  load_words(scene->instances + INSTANCE_SECOND, instance_row(h->instance), turn);
  n0 = normalize3(turn3(turn, n0));
  n1 = normalize3(turn3(turn, n1));
  n2 = normalize3(turn3(turn, n2));
#endif
  return mad3(n0, b0, mad3(n1, h->b1, scale3(n2, h->b2)));
}
#endif

#ifdef NEED_SMOOTH_NORMALS
// The corners' normals, interpolated; the triangle's own where they cancel out.
FN v3 smooth_normal(const Scene* scene, const Hit* h, const vf* second_words, vf b0) {
  v3 n = interpolated_normal(scene, h, second_words, b0);
  vf l2 = dot3(n, n);
  return pick3(h->geometric, scale3(n, one_f() / sqrt(l2)), l2 > (vf)1e-12f);
}
#endif

// Triangles in `active` lanes; the others read triangle 0. The point is computed from the corners, not along the ray,
// so that its error is the corners' and not the distance's.
OUTLINED Hit load_hit(const Scene* scene, vu primitive, vu instance, vf b1, vf b2, vi active) {
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
#ifdef NEED_INSTANCES
  h.instance = pick_u((vu)GLEANER_NONE, instance, active);
  vf place[16];
  load_words(scene->instances, instance_row(h.instance), place);
  h.side = place[INSTANCE_SIDE];
  h.p = place_point(place, h.p);
  h.error = placed_error(place, h.e1, h.e2, h.p);
  h.e1 = place_vector(place, h.e1);
  h.e2 = place_vector(place, h.e2);
  h.geometric = scale3(normalize3(cross3(h.e1, h.e2)), h.side);
#else
  h.geometric = normalize3(cross3(h.e1, h.e2));
#endif
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
  h.outward = h.geometric;
#ifdef NEED_SMOOTH_NORMALS
  h.normal = smooth_normal(scene, &h, t2, b0);
  h.outward = pick3(h.outward, negate3(h.outward), dot3(h.outward, h.normal) < zero_f());
#endif
#if defined(NEED_NORMAL_MAPS) || defined(NEED_ANISOTROPY)
#ifndef NEED_SECOND_UVS
  const vf* t3 = t2;
#endif
#endif
#ifdef NEED_NORMAL_MAPS
#ifdef NEED_CLEARCOAT
  h.coat_normal = mapped_normal(scene, &h, t2, t3, material_u(scene, h.material, MATERIAL_CLEARCOAT_NORMAL_TEXTURE),
                                material_f(scene, h.material, MATERIAL_CLEARCOAT_NORMAL_SCALE), active);
#endif
  h.normal = mapped_normal(scene, &h, t2, t3, material_u(scene, h.material, MATERIAL_NORMAL_TEXTURE),
                           material_f(scene, h.material, MATERIAL_NORMAL_SCALE), active);
#endif
#ifdef NEED_ANISOTROPY
  load_tangents(scene, &h, t2, t3, active);
#endif
  return h;
}

// Whether light that the triangle emits leaves it against `direction`.
FN vi shines_towards(const Hit* h, v3 direction) {
  vf facing = dot3(h->geometric, direction);
#ifdef NEED_TWO_SIDED_EMITTERS
  return (facing < zero_f()) |
         ((facing > zero_f()) & ((as_vu(h->words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_DOUBLE_SIDED) != 0u));
#else
  return facing < zero_f();
#endif
}

// Colour and opacity: all that emission and alpha tests ask of a material. Programs that see no colour define
// SEES_NO_COLOR, and look textures up where these hold alpha: their texels lie all over the memory.
#if defined(NEED_TEXTURES) && (defined(NEED_ALPHA) || !defined(SEES_NO_COLOR))
#define LOOKS_TEXTURES_UP
#endif
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
#ifdef LOOKS_TEXTURES_UP
  {
    vu texture = as_vu(h->words[MATERIAL_BASE_COLOR_TEXTURE]);
    vi textured = active & (texture != GLEANER_NONE);
#ifdef SEES_NO_COLOR
    textured = textured & ((flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND)) != 0u);
#endif
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

#ifdef NEED_MATERIAL_TEXTURES
// A texture's texel times `value`, and its alpha; `value` where there is none.
FN v3 textured_value(const Scene* scene, const Hit* h, uint word, vi active, v3 value, vf* alpha) {
  vu texture = material_u(scene, h->material, word);
  vi textured = active & (texture != GLEANER_NONE);
  *alpha = one_f();
  if (any_lane(textured)) {
    vf a;
    v3 c = texture_at(scene, h, texture, textured, &a);
    value = pick3(value, mul3(value, c), textured);
    *alpha = pick(*alpha, a, textured);
  }
  return value;
}
#endif

#ifdef NEED_MATERIAL_TEXTURES
FN vi has_texture(const Scene* scene, const Hit* h, uint word) {
  return material_u(scene, h->material, word) != GLEANER_NONE;
}
#endif

// *level: the largest of what textures leave of coat, sheen and film.
#ifdef NEED_CLEARCOAT
FN void load_coat(const Scene* scene, const Hit* h, Surface* m, vi active, vf* level) {
  m->coat = material_f(scene, h->material, MATERIAL_CLEARCOAT);
  vf roughness = material_f(scene, h->material, MATERIAL_CLEARCOAT_ROUGHNESS);
  m->coat_table = material_u(scene, h->material, MATERIAL_CLEARCOAT_TABLE);
  m->coat_row = zero_f();
#ifdef NEED_MATERIAL_TEXTURES
  vi coated = active & (m->coat > zero_f());
  vf unused;
  vf share = textured_value(scene, h, MATERIAL_CLEARCOAT_TEXTURE, coated, splat3(one_f()), &unused).x;
  m->coat *= share;
  *level = pick(*level, share, coated & has_texture(scene, h, MATERIAL_CLEARCOAT_TEXTURE));
  roughness = textured_value(scene, h, MATERIAL_CLEARCOAT_ROUGHNESS_TEXTURE, coated, splat3(roughness), &unused).y;
  vi varies = has_texture(scene, h, MATERIAL_CLEARCOAT_ROUGHNESS_TEXTURE);
  m->coat_row = pick(zero_f(), clamp_f(roughness, zero_f(), one_f()) * (vf)(float)(GLEANER_ALBEDO_ROWS - 1), varies);
#endif
  m->coat_alpha = roughness * roughness;
}
#endif

#ifdef NEED_SHEEN
FN void load_sheen(const Scene* scene, const Hit* h, Surface* m, vi active, vf* level) {
  m->sheen = material_3(scene, h->material, MATERIAL_SHEEN_COLOR);
  vf roughness = material_f(scene, h->material, MATERIAL_SHEEN_ROUGHNESS);
  m->sheen_table = material_u(scene, h->material, MATERIAL_SHEEN_TABLE);
  m->sheen_row = zero_f();
#ifdef NEED_MATERIAL_TEXTURES
  vf most = max_component(m->sheen);
  vi covered = active & (most > zero_f());
  vf unused, share;
  m->sheen = textured_value(scene, h, MATERIAL_SHEEN_COLOR_TEXTURE, covered, m->sheen, &unused);
  *level = pick(*level, max_f(*level, max_component(m->sheen) / most),
                covered & has_texture(scene, h, MATERIAL_SHEEN_COLOR_TEXTURE));
  textured_value(scene, h, MATERIAL_SHEEN_ROUGHNESS_TEXTURE, covered, splat3(roughness), &share);
  roughness *= share;
  vi varies = has_texture(scene, h, MATERIAL_SHEEN_ROUGHNESS_TEXTURE);
  m->sheen_row = pick(zero_f(), clamp_f(roughness, zero_f(), one_f()) * (vf)(float)(GLEANER_ALBEDO_ROWS - 1), varies);
#endif
  m->sheen_most = max_component(m->sheen);
  m->sheen_alpha = max_f(roughness * roughness, (vf)GLEANER_SHEEN_ALPHA);
}
#endif

#ifdef NEED_IRIDESCENCE
FN void load_film(const Scene* scene, const Hit* h, Surface* m, vi active, vf* level) {
  m->film = material_f(scene, h->material, MATERIAL_IRIDESCENCE);
  m->film_ior = material_f(scene, h->material, MATERIAL_IRIDESCENCE_IOR);
  m->film_thickness = material_f(scene, h->material, MATERIAL_IRIDESCENCE_MAXIMUM);
#ifdef NEED_MATERIAL_TEXTURES
  vi filmed = active & (m->film > zero_f());
  vf unused;
  vf share = textured_value(scene, h, MATERIAL_IRIDESCENCE_TEXTURE, filmed, splat3(one_f()), &unused).x;
  m->film *= share;
  *level = pick(*level, max_f(*level, share), filmed & has_texture(scene, h, MATERIAL_IRIDESCENCE_TEXTURE));
  vf least = material_f(scene, h->material, MATERIAL_IRIDESCENCE_MINIMUM);
  // 1 where there is no texture.
  vf place = textured_value(scene, h, MATERIAL_IRIDESCENCE_THICKNESS_TEXTURE, filmed, splat3(one_f()), &unused).y;
  m->film_thickness = mix(least, m->film_thickness, place);
#endif
}
#endif

#ifdef NEED_ANISOTROPY
// After `alpha` is known. The grain's direction in the plane of tangent and bitangent, for orient_layers() to turn.
FN void load_grain(const Scene* scene, const Hit* h, Surface* m, vi active) {
  vf strength = material_f(scene, h->material, MATERIAL_ANISOTROPY);
  vf x = one_f(), y = zero_f();
  vi grained = active & (strength > zero_f());
#ifdef NEED_MATERIAL_TEXTURES
  vu texture = material_u(scene, h->material, MATERIAL_ANISOTROPY_TEXTURE);
  vi textured = grained & (texture != GLEANER_NONE);
  if (any_lane(textured)) {
    vf unused;
    v3 c = texture_at(scene, h, texture, textured, &unused);
    vf dx = fma(c.x, (vf)2.0f, (vf)-1.0f), dy = fma(c.y, (vf)2.0f, (vf)-1.0f), l2 = dx * dx + dy * dy;
    vi told = textured & (l2 > (vf)1e-6f);
    vf scale = one_f() / sqrt(pick(one_f(), l2, told));
    x = pick(x, dx * scale, told);
    y = pick(y, dy * scale, told);
    strength = pick(strength, strength * c.z, textured);
  }
#endif
  vf rotation = material_f(scene, h->material, MATERIAL_ANISOTROPY_ROTATION);
  vf s = sin(rotation), c = cos(rotation);
  m->grain_x = x * c - y * s;
  m->grain_y = x * s + y * c;
  // A lobe that is a mirror one way stays a lobe.
  m->alpha = pick(m->alpha, max_f(m->alpha, (vf)GLEANER_LEAST_GRAINED_ALPHA), grained);
  m->alpha_along = pick(m->alpha, mix(m->alpha, one_f(), strength * strength), grained);
}
#endif

#ifdef NEED_DIFFUSE_TRANSMISSION
// The layer that light shines through, beside glass in what transmits light.
FN void load_shining(const Scene* scene, const Hit* h, Surface* m, vi active) {
  vf share = material_f(scene, h->material, MATERIAL_DIFFUSE_TRANSMISSION);
  m->shining_color = material_3(scene, h->material, MATERIAL_DIFFUSE_TRANSMISSION_COLOR);
#ifdef NEED_MATERIAL_TEXTURES
  vi shines = active & (share > zero_f());
  vf unused, alpha;
  textured_value(scene, h, MATERIAL_DIFFUSE_TRANSMISSION_TEXTURE, shines, splat3(one_f()), &alpha);
  share *= alpha;
  m->shining_color =
      textured_value(scene, h, MATERIAL_DIFFUSE_TRANSMISSION_COLOR_TEXTURE, shines, m->shining_color, &unused);
#endif
  vf layer = (one_f() - m->transmission) * share;
  m->transmission += layer;
  m->shining = pick(zero_f(), layer / m->transmission, m->transmission > zero_f());
  m->layer_kept = one_f();
}
#endif

#if (defined(NEED_LOBE) || defined(NEED_TRANSMISSIVE)) && defined(NEED_MATERIAL_TEXTURES)
// What textures say of roughness, metal, the lobe's weight and colour, and glass.
FN void load_lobe_textures(const Scene* scene, const Hit* h, Surface* m, vi active) {
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
  m->table_row = pick(zero_f(), clamp_f(m->alpha, zero_f(), one_f()) * (vf)(float)(GLEANER_ALBEDO_ROWS - 1), rows > 1u);
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

#if defined(NEED_LOBE) && (defined(NEED_LAYERS) || defined(NEED_IRIDESCENCE)) && defined(NEED_MATERIAL_TEXTURES)
// Of a table with rows for each `level` of the layers above, 0 to 1: the row for this one.
FN void choose_table_level(const Hit* h, Surface* m, vf level) {
  vu rows = as_vu(h->words[MATERIAL_ALBEDO_ROWS]);
  vi textured = (rows == (vu)GLEANER_ALBEDO_ROWS) | (rows == (vu)(GLEANER_ALBEDO_ROWS * GLEANER_ALBEDO_LEVELS));
  vf row = pick(zero_f(), m->table_row, textured);
  vf set = floor(fma(clamp_f(level, zero_f(), one_f()), (vf)(float)(GLEANER_ALBEDO_LEVELS - 1), (vf)0.5f));
  vf stride = pick(one_f(), (vf)(float)GLEANER_ALBEDO_ROWS, textured);
  vi levels = (rows != 1u) & (rows != (vu)GLEANER_ALBEDO_ROWS);
  m->table_row = pick(row, fma(set, stride, row), levels & (rows != 0u));
}
#endif

// What scattering needs beyond load_color().
OUTLINED void load_lobes(const Scene* scene, const Hit* h, Surface* m, vi active) {
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
  load_lobe_textures(scene, h, m, active);
#endif
#if defined(NEED_LAYERS) || defined(NEED_IRIDESCENCE)
  vf level = zero_f();
#ifdef NEED_CLEARCOAT
  load_coat(scene, h, m, active, &level);
#endif
#ifdef NEED_SHEEN
  load_sheen(scene, h, m, active, &level);
#endif
#ifdef NEED_IRIDESCENCE
  load_film(scene, h, m, active, &level);
#endif
#ifdef NEED_MATERIAL_TEXTURES
  choose_table_level(h, m, level);
#endif
#endif
  m->alpha = m->alpha * m->alpha;
#ifdef NEED_ANISOTROPY
  load_grain(scene, h, m, active);
#endif
#ifdef NEED_LOBE
  m->alpha2 = m->alpha * m->alpha;
#endif
#if defined(NEED_TRANSMISSIVE) && defined(NEED_LOBE)
  // Only what is not metal transmits; `metallic` becomes its share of what glass leaves.
  m->transmission *= one_f() - m->metallic;
  vf left = one_f() - m->transmission;
  m->metallic = pick(zero_f(), m->metallic / left, left > zero_f());
#endif
#ifdef NEED_DIFFUSE_TRANSMISSION
  load_shining(scene, h, m, active);
#endif
#ifdef NEED_TRANSMISSIVE
  m->hidden = no_lanes();
#endif
#endif
}

#ifdef NEED_TRANSMISSIVE
FN void set_eta(Surface* m, vf eta) {
  m->eta = eta;
  // A rough boundary between equals neither bends light nor blurs it.
  m->blurs = (m->alpha >= (vf)GLEANER_SMOOTH_GLASS_ALPHA) & none(m->solid & (fabs(eta - one_f()) < (vf)1e-3f));
}
#endif

// After load_lobes(): the index of refraction on the other side over that on the ray's, around a solid nothing but air.
FN void set_side(Surface* m, vi from_back) {
#ifdef NEED_TRANSMISSIVE
  set_eta(m, pick(m->ior, one_f() / m->ior, from_back & m->solid));
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

// The frame in which scattering is computed. Geometry decides the side; normals for shading decide the cosines.
typedef struct {
  v3 normal;     // for shading, on the side that the ray came from
  v3 geometric;  // of the triangle, on that side
  v3 tangent, bitangent;
  v3 view;       // where the ray came from, in this frame
  vf facing;     // cosine between it and the normal: view.z, or less where the normal faces away
  vi from_back;  // of the surface as modelled
} ShadingFrame;

// Least cosine of the view to a normal for shading, and of such a normal to the triangle's own: a bent normal that
// faces away from the viewer is seen as if at grazing incidence.
#define LEAST_COSINE 1e-3f

FN ShadingFrame shading_frame(const Hit* h, v3 direction) {
  ShadingFrame f;
#ifdef NEED_BENT_NORMALS
  f.from_back = dot3(h->outward, direction) > zero_f();
  f.geometric = pick3(h->outward, negate3(h->outward), f.from_back);
  f.normal = pick3(h->normal, negate3(h->normal), f.from_back);
  vf above = dot3(f.normal, f.geometric);
  f.normal =
      pick3(f.normal, normalize3(mad3(f.geometric, (vf)LEAST_COSINE - above, f.normal)), above < (vf)LEAST_COSINE);
  basis3(f.normal, &f.tangent, &f.bitangent);
  f.facing = -dot3(f.normal, direction);
  v3 along = make3(-dot3(f.tangent, direction), -dot3(f.bitangent, direction), zero_f());
  vf z = max_f(f.facing, (vf)LEAST_COSINE);
  vf stretch = sqrt((one_f() - z * z) / max_f(dot3(along, along), (vf)1e-12f));
  stretch = pick(one_f(), stretch, f.facing < (vf)LEAST_COSINE);
  f.view = make3(along.x * stretch, along.y * stretch, z);
#else
  vf facing = dot3(h->normal, direction);
  f.from_back = facing > zero_f();
  f.normal = pick3(h->normal, negate3(h->normal), f.from_back);
  f.geometric = f.normal;
  basis3(f.normal, &f.tangent, &f.bitangent);
  f.facing = fabs(facing);
  f.view = make3(-dot3(f.tangent, direction), -dot3(f.bitangent, direction), f.facing);
#endif
  return f;
}

#if defined(NEED_ANISOTROPY) || defined(NEED_CLEARCOAT)
// Turns what of a surface has a direction of its own into the frame of scattering.
FN void orient_layers(const Scene* scene, const Hit* h, const ShadingFrame* f, Surface* m) {
#ifdef NEED_ANISOTROPY
  v3 grain = mad3(h->tangent, m->grain_x, scale3(h->bitangent, m->grain_y));
  vf x = dot3(f->tangent, grain), y = dot3(f->bitangent, grain), l2 = x * x + y * y;
  vi told = l2 > (vf)1e-12f;
  vf scale = one_f() / sqrt(pick(one_f(), l2, told));
  m->grain_x = pick(one_f(), x * scale, told);
  m->grain_y = pick(zero_f(), y * scale, told);
#endif
#ifdef NEED_CLEARCOAT
  m->coat_normal = uniform3(0.0f, 0.0f, 1.0f);
#ifdef NEED_NORMAL_MAPS
  v3 n = pick3(h->coat_normal, negate3(h->coat_normal), f->from_back);
  m->coat_bent =
      (m->coat > zero_f()) & ((material_u(scene, h->material, MATERIAL_NORMAL_TEXTURE) != GLEANER_NONE) |
                              (material_u(scene, h->material, MATERIAL_CLEARCOAT_NORMAL_TEXTURE) != GLEANER_NONE));
  v3 turned = normalize3(make3(dot3(f->tangent, n), dot3(f->bitangent, n), dot3(f->normal, n)));
  m->coat_normal = pick3(m->coat_normal, turned, m->coat_bent & (turned.z > (vf)LEAST_COSINE));
#endif
#endif
}
#endif

FN v3 from_frame(const ShadingFrame* f, v3 d) {
  return normalize3(add3(add3(scale3(f->tangent, d.x), scale3(f->bitangent, d.y)), scale3(f->normal, d.z)));
}

#ifdef NEED_BENT_NORMALS
// What geometry leaves of light from unit `l` that is scattered above the surface (nl > 0, the cosine to the normal for
// shading) or goes through it: nothing where geometry says the other side.
FN vf geometric_share(const ShadingFrame* f, v3 l, vf nl) {
  vf gl = dot3(f->geometric, l);
  vf above = terminator(gl, nl, dot3(f->normal, f->geometric));
  vf through = pick(zero_f(), one_f(), gl < zero_f());
  return pick(through, above, nl > zero_f());
}
#endif

// A scattered direction. What mirrors and smooth glass send to the wrong side of the geometry is turned to its horizon;
// what rough lobes send there is lost (geometric_share).
FN v3 scattered_direction(const ShadingFrame* f, v3 scattered, vi smooth) {
  v3 out = from_frame(f, scattered);
#ifdef NEED_BENT_NORMALS
  vf side = pick((vf)-1.0f, one_f(), scattered.z > zero_f());
  vf height = dot3(f->geometric, out) * side;
  v3 level = normalize3(mad3(f->geometric, side * ((vf)LEAST_COSINE - height), out));
  out = pick3(out, level, smooth & (height < (vf)LEAST_COSINE));
#endif
  return out;
}

#if defined(NEED_PANES) || defined(NEED_MEDIA)
#define PASSES_GLASS
// May light go straight on through the surface's glass? After set_side() and set_boundary().
FN vi is_passable(const Surface* m) {
  vi passable = none(m->solid) & none(m->blurs);
#ifdef NEED_MEDIA
  passable = passable | bends_nothing(m);
#endif
  return passable & (m->transmission > zero_f());
}
#endif

// What a surface lets go straight on of light that meets it at cosine nv, RGB: what is not opaque, and what glass
// passes. The same on both sides, and in the mean what a path lets through.
FN v3 straight_share(const Surface* m, vf nv) {
  v3 share = splat3(zero_f());
#ifdef PASSES_GLASS
  vi passable = is_passable(m);
  if (any_lane(passable)) {
    vf unused;
    vf fresnel = glass_fresnel(m, nv, &unused);
    v3 tint = m->base;
#ifdef NEED_MEDIA
    fresnel = pick(fresnel, zero_f(), bends_nothing(m));
    tint = pick3(tint, splat3(one_f()), m->hidden);
#endif
    vf glass = m->transmission;
#ifdef NEED_DIFFUSE_TRANSMISSION
    glass *= one_f() - m->shining;
#endif
    share = pick3(share, scale3(tint, glass * (one_f() - fresnel)), passable);
  }
#endif
#ifdef NEED_ALPHA
  share = mad3(share, m->opacity, splat3(one_f() - m->opacity));
#endif
  return share;
}

// --- Segments: what the media along a ray absorb ---

#ifdef NEED_MEDIA

// The solids that a path is in: ranks (scene/model/media.h), the highest first, two to a word; 0 where there is none. A
// fifth solid about a point is forgotten.
typedef struct {
  vu high, low;
} Media;

FN Media media_of(uint high, uint low) {
  Media m;
  m.high = (vu)high;
  m.low = (vu)low;
  return m;
}
FN void unpack_media(Media m, vu* rank) {
  rank[0] = m.high >> 16;
  rank[1] = m.high & 0xffffu;
  rank[2] = m.low >> 16;
  rank[3] = m.low & 0xffffu;
}
FN Media pack_media(const vu* rank) {
  Media m;
  m.high = (rank[0] << 16) | rank[1];
  m.low = (rank[2] << 16) | rank[3];
  return m;
}
// Rank of the solid that fills the space; 0: air.
FN vu filling(Media m) { return m.high >> 16; }

FN Media enter_medium(Media m, vu entered, vi active) {
  vu rank[4];
  unpack_media(m, rank);
  for (uint k = 0; k < 4u; ++k) {
    vu lesser = min(rank[k], entered);
    rank[k] = pick_u(rank[k], max(rank[k], entered), active);
    entered = lesser;
  }
  return pack_media(rank);
}
FN Media leave_medium(Media m, vu left, vi active) {
  vu rank[5];
  unpack_media(m, rank);
  rank[4] = (vu)0u;
  vi found = no_lanes();
  for (uint k = 0; k < 4u; ++k) {
    found = found | (active & (rank[k] == left));
    rank[k] = pick_u(rank[k], rank[k + 1u], found);
  }
  return pack_media(rank);
}
FN vi is_in_medium(Media m, vu rank) {
  vu held[4];
  unpack_media(m, held);
  return (held[0] == rank) | (held[1] == rank) | (held[2] == rank) | (held[3] == rank);
}

FN vu material_of_medium(const Scene* scene, vu rank) {
  return material_u(scene, pick_u((vu)0u, rank - 1u, rank != 0u), MATERIAL_OF_MEDIUM);
}
FN vf ior_of_medium(const Scene* scene, vu rank) {
  return pick(one_f(), material_f(scene, material_of_medium(scene, rank), MATERIAL_IOR), rank != 0u);
}

// What is left of light after `distance` in what fills the space there.
FN v3 absorption(const Scene* scene, Media media, vf distance, vi active) {
  v3 left = splat3(one_f());
#ifdef NEED_ATTENUATION
  vu rank = filling(media);
  vi within = active & (rank != 0u);
  if (any_lane(within)) {
    v3 k = material_3(scene, material_of_medium(scene, pick_u((vu)0u, rank, within)), MATERIAL_ATTENUATION);
    // Only what absorbs may meet an infinite distance: 0 * infinity is no number.
    v3 depth = make3(pick(zero_f(), k.x * distance, k.x > zero_f()), pick(zero_f(), k.y * distance, k.y > zero_f()),
                     pick(zero_f(), k.z * distance, k.z > zero_f()));
    left = pick3(left, make3(exp(-depth.x), exp(-depth.y), exp(-depth.z)), within);
  }
#endif
  return left;
}

// Does a ray meet the surface from behind, as modelled?
FN vi meets_back(const Hit* h, v3 direction) { return dot3(h->outward, direction) > zero_f(); }

// The media of a segment that ended at `h`, on the surface's back or not. Who leaves a solid has been in it, even where
// its entering was not seen (the path began there, or the surface is open).
FN Media media_at_end(Media media, const Hit* h, const Scene* scene, vi from_back, vi active) {
  vu rank = material_u(scene, h->material, MATERIAL_MEDIUM);
  return enter_medium(media, rank, active & from_back & (rank != 0u) & none(is_in_medium(media, rank)));
}

// Those beyond the surface.
FN Media media_beyond(Media media, const Hit* h, const Scene* scene, vi from_back, vi active) {
  vu rank = material_u(scene, h->material, MATERIAL_MEDIUM);
  active = active & (rank != 0u);
  media = leave_medium(media, rank, active & from_back);
  return enter_medium(media, rank, active & none(from_back));
}

// After load_lobes(): the boundary between two media. It is hidden where one solid fills the space on both sides.
FN void set_boundary(const Scene* scene, Surface* m, Media before, Media beyond, vi active) {
  vu inner = filling(before), outer = filling(beyond);
  vi solid = active & m->solid;
  if (!any_lane(solid)) return;
  vf eta = ior_of_medium(scene, pick_u((vu)0u, outer, solid)) / ior_of_medium(scene, pick_u((vu)0u, inner, solid));
  m->hidden = solid & (inner == outer);
  set_eta(m, pick(m->eta, eta, solid));
}

#endif

#endif
