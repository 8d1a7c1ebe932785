// Reading the mesh of vertices (kernels/links_records.h).
#ifndef GLEANER_KERNELS_LINKS_MESH_H
#define GLEANER_KERNELS_LINKS_MESH_H

#include "kernels/links_records.h"
#include "kernels/transport/scattering.h"

typedef struct {
  global const uint *triangles, *nodes, *rings, *corners;
  uint elements;
} Mesh;

FN Mesh load_mesh(global const uint* words) {
  Mesh m;
  m.elements = 2u * words[MESH_VERTICES];
  m.triangles = words + MESH_HEADER;
  m.nodes = m.triangles + MESH_TRIANGLE_WORDS * words[MESH_TRIANGLES];
  m.rings = m.nodes + words[MESH_NODES];
  m.corners = m.rings + words[MESH_VERTICES] + 1u;
  return m;
}

FN vu node_number(vu i, vu j, vu n) { return j * (n + 1u) - ((j * (j - 1u)) >> 1) + i; }

// The three vertices about a point of a triangle, and their weights.
typedef struct {
  vu vertex[3];
  vf weight[3];
} Corners;

FN Corners corners_at(const Mesh* mesh, vu triangle, vf b1, vf b2) {
  vu first = gather_u(mesh->triangles, triangle * MESH_TRIANGLE_WORDS);
  vu n = (vu)1u << gather_u(mesh->triangles + 1, triangle * MESH_TRIANGLE_WORDS);
  vf x = clamp_f(b1, zero_f(), one_f()) * to_f(n), y = clamp_f(b2, zero_f(), one_f()) * to_f(n);
  // Rounding may leave b1 + b2 a little above 1.
  vu j = min(to_u(y), n - 1u);
  vu i = min(to_u(x), n - 1u - j);
  vf u = clamp_f(x - to_f(i), zero_f(), one_f()), v = clamp_f(y - to_f(j), zero_f(), one_f());
  // The upper of a cell's two triangles, where the cell has one.
  vi upper = (u + v > one_f()) & (i + j + 2u <= n);
  vf over = max_f(u + v, one_f());
  u = pick(u / over, one_f() - v, upper);
  v = pick(v / over, one_f() - (x - to_f(i)), upper);
  Corners c;
  vu across = pick_u((vu)0u, (vu)1u, upper);
  c.vertex[0] = gather_u(mesh->nodes, first + node_number(i + across, j + across, n));
  c.vertex[1] = gather_u(mesh->nodes, first + node_number(i + 1u, j, n));
  c.vertex[2] = gather_u(mesh->nodes, first + node_number(i, j + 1u, n));
  // Of the upper triangle, u weighs the node over the cell's second corner, v that over its third.
  c.weight[1] = u;
  c.weight[2] = v;
  c.weight[0] = max_f(one_f() - u - v, zero_f());
  return c;
}

// Weights of those corners alone that lie in the open, where any does. `outside`: a lane's corners, 1 or 0 each.
FN void weigh_outside(Corners* c, const vf* outside) {
  vf sum = zero_f(), weight[3];
  for (uint k = 0; k < 3u; ++k) {
    weight[k] = c->weight[k] * outside[k];
    sum += weight[k];
  }
  // A point that is all on the others keeps their light.
  vi any = sum > (vf)1e-3f;
  for (uint k = 0; k < 3u; ++k) c->weight[k] = pick(c->weight[k], weight[k] / sum, any);
}

// Whether one of the triangles that meet at a vertex is divided.
FN int is_of_divided(const Mesh* mesh, uint vertex) {
  global const float* steps = (global const float*)mesh->corners + CORNER_STEP;
  for (uint k = mesh->rings[vertex]; k < mesh->rings[vertex + 1u]; ++k)
    if (steps[CORNER_WORDS * k] < 1.0f) return 1;
  return 0;
}

// A point of a vertex's one-ring, with density in proportion to the vertex's hat function: 1 at the vertex, 0 at the
// ring's edge. All lanes ask for one vertex. Vertices at the edge of a wall or in a corner of the room are so sampled
// where the wall is, and never behind the one that it meets.
typedef struct {
  vu triangle;
  vf b1, b2;
} RingPoint;

// `reach`: of the way to the ring's edge.
FN RingPoint ring_point(const Mesh* mesh, uint vertex, float reach, vf u_corner, vf u_height, vf u_across) {
  uint first = mesh->rings[vertex], end = mesh->rings[vertex + 1u];
  vu corner = (vu)first;
  global const float* shares = (global const float*)mesh->corners + CORNER_SHARE;
  for (uint k = first; k + 1u < end; ++k)
    corner = pick_u(corner, (vu)(k + 1u), u_corner >= (vf)shares[CORNER_WORDS * k]);
  vu at = corner * CORNER_WORDS;
  vu place = gather_u(mesh->corners + CORNER_PLACE, at);
  vf step = gather_f((global const float*)mesh->corners + CORNER_STEP, at);
  vu kind = place >> 24;
  // The six small triangles at a node, by turns: the next one begins where the last one ended.
  vi i1 = select(select((vi)0, (vi)1, (kind == 0u) | (kind == 5u)), (vi)-1, (kind == 2u) | (kind == 3u));
  vi j1 = select(select((vi)0, (vi)1, (kind == 1u) | (kind == 2u)), (vi)-1, (kind == 4u) | (kind == 5u));
  vi i2 = select(select((vi)0, (vi)1, (kind == 4u) | (kind == 5u)), (vi)-1, (kind == 1u) | (kind == 2u));
  vi j2 = select(select((vi)0, (vi)1, (kind == 0u) | (kind == 1u)), (vi)-1, (kind == 3u) | (kind == 4u));
  // The corner's weight t has the density 6 t (1 - t).
  vf t = (vf)0.5f - sin(asin(clamp_f(one_f() - 2.0f * u_height, (vf)-1.0f, one_f())) * (vf)(1.0f / 3.0f));
  t = fma(t - one_f(), (vf)reach, one_f());
  vf w1 = (one_f() - t) * u_across, w2 = (one_f() - t) * (one_f() - u_across);
  RingPoint p;
  p.triangle = gather_u(mesh->corners + CORNER_TRIANGLE, at);
  p.b1 = (to_f(place & CORNER_GRID_MASK) + to_f_signed(i1) * w1 + to_f_signed(i2) * w2) * step;
  p.b2 = (to_f((place >> 12) & CORNER_GRID_MASK) + to_f_signed(j1) * w1 + to_f_signed(j2) * w2) * step;
  p.b1 = clamp_f(p.b1, zero_f(), one_f());
  p.b2 = clamp_f(p.b2, zero_f(), one_f() - p.b1);
  return p;
}

// An element's surface about a point of its one-ring, seen from its side along the normal: a vertex as scattering has
// it. `share`: what the lobe above the diffuse layer leaves of light from `cosine` comes by left_above().
FN Vertex element_hit(const Scene* scene, const RingPoint* at, vi active) {
  Vertex v;
  v.primitive = pick_u((vu)0u, at->triangle, active);
  v.hit = load_hit(scene, v.primitive, (vu)GLEANER_NONE, at->b1, at->b2, active);
  v.active = active;
  v.passes = no_lanes();
  load_color(scene, &v.hit, &v.surface, active);
#ifdef NEED_MEDIA
  v.media = media_of(0u, 0u);
#endif
  return v;
}
// The direction of a ray that meets it there.
FN v3 against_normal(const Hit* h, uint element) {
  v3 direction = element & 1u ? h->outward : negate3(h->outward);
#ifdef NEED_BENT_NORMALS
  direction = element & 1u ? h->normal : negate3(h->normal);
  // A normal map may bend the normal beyond the triangle's horizon.
  direction =
      pick3(direction, element & 1u ? h->outward : negate3(h->outward), dot3(h->normal, h->outward) <= zero_f());
#endif
  return direction;
}
FN Vertex element_surface(const Scene* scene, const RingPoint* at, uint element, vi active) {
  Vertex v = element_hit(scene, at, active);
  prepare_scattering(scene, &v, against_normal(&v.hit, element));
  return v;
}

// What lies above the diffuse layer leaves of light to or from `cosine`.
FN vf left_above(const Scene* scene, const Surface* m, vf cosine) {
#ifdef NEED_LOBE
  return left_to_layer(scene, m, cosine);
#else
  return one_f();
#endif
}

// What the diffuse layer reflects, less what the layers above it take, which depends on the angle.
FN v3 own_albedo(const Vertex* v) {
  v3 albedo = layer_albedo(&v->surface);
#ifdef NEED_LOBE
  albedo = scale3(albedo, pick(zero_f(), one_f() / v->surface.left_view, v->surface.left_view > zero_f()));
#endif
#ifdef NEED_TRANSMISSIVE
  albedo = scale3(albedo, one_f() - v->surface.transmission);
#endif
#ifdef NEED_UNLIT
  albedo = pick3(albedo, splat3(zero_f()), (as_vu(v->hit.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) != 0u);
#endif
  return albedo;
}

// Names a vertex by the first node that it is of: by triangle, and place in the triangle. Where that is divided alike,
// the vertex keeps its name when its scene moves, though others come or go before it in the list.
FN vu vertex_name(const Mesh* mesh, uint vertex) {
  global const uint* corner = mesh->corners + (ulong)CORNER_WORDS * mesh->rings[vertex];
  uint place = corner[CORNER_PLACE];
  float step = as_float(corner[CORNER_STEP]);
  vu name = hash_combine((vu)corner[CORNER_TRIANGLE], (vu)as_uint((float)(place & CORNER_GRID_MASK) * step));
  return hash_combine(name, (vu)as_uint((float)((place >> 12) & CORNER_GRID_MASK) * step));
}

// Random numbers of an element, of both sides of a vertex alike, or of whatever else has a name: key, and its sample's.
FN vu named_key(global const LinksParameters* p, vu name, uint purpose) {
  return hash_combine(hash_combine(hash_combine((vu)p->seed_low, (vu)p->seed_high), name), (vu)purpose);
}
FN vu element_key(global const LinksParameters* p, const Mesh* mesh, uint element, uint purpose) {
  return named_key(p, vertex_name(mesh, element >> 1), purpose);
}

FN RingPoint random_ring_point(const Mesh* mesh, uint element, float reach, vu key, vu sample) {
  vf u0, u1, u2, u3;
  sample_pair(key, sample, LINKS_MOST_DIRECTIONS, 4u, &u0, &u1);
  sample_pair(key, sample, LINKS_MOST_DIRECTIONS, 5u, &u2, &u3);
  return ring_point(mesh, element >> 1, reach, u2, u0, u1);
}

#endif
