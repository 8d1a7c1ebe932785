// Ray queries on the blob's binary BVH, for devices that Embree does not run on. One work-item a ray:
//
//   push the root; while the stack holds a node: test both children's boxes, go on with the nearer, push the farther;
//   at a leaf test its triangles. Ties in t go to the smaller triangle index.
//
// No ray slips through a seam, not even through a vertex (Woop, Benthin & Wald 2013, "Watertight Ray/Triangle
// Intersection"): corners are sheared into the plane across the ray, where all triangles around a vertex see it at the
// same place, and no edge function has the wrong sign. (Pluecker tests lose rays at vertices, where each edge has a
// noise of its own: measured one in 1700 on a sphere far from the origin.) Boxes are tested with room for the shear's
// rounding.
//
// Scenes with instances, or with meshes that deform, have TWO_LEVELS: leaves of the top level name entries, each a part
// of the BVH and the instance that places it. There the ray is taken to the mesh's own space, its direction at the
// length that this gives it, so that t stays the same; and back where the part is done.
//
// Tests are written in accept form: a NaN is a miss. A full stack raises a flag and the ray reports itself, nothing is
// lost in silence. Contraction is off: the sign of an edge must not depend on which product was rounded.
#pragma OPENCL FP_CONTRACT OFF

#include "kernels/rays.h"
#include "kernels/scene_layout.h"
#include "scene/model/records.h"

#ifndef STACK_SIZE
#define STACK_SIZE 64
#endif

// The library's versions may fuse; these may not.
FN float3 plain_cross(float3 a, float3 b) {
  return (float3)(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
FN float plain_dot(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// What boxes and triangles need of a ray.
typedef struct {
  float3 origin, direction;
  float3 inverse;  // of the direction; infinite where that is 0
  int axis;        // of the direction's largest component
  float largest;   // that component
  float sx, sy;    // the shear that turns the ray into that axis
} Line;

// (y, z, x), (z, x, y) or (x, y, z): the axis last.
FN float3 turned(float3 v, int axis) { return axis == 0 ? v.yzx : axis == 1 ? v.zxy : v; }

FN float largest(float3 v) { return fmax(fmax(v.x, v.y), v.z); }

// 0 where no triangle can be the answer: the ray is not finite, or its direction shorter than any that means something.
FN int make_line(float3 origin, float3 direction, Line* line) {
  float3 o = fabs(origin), d = fabs(direction);
  float most = largest(d);
  if (!(o.x <= FLT_MAX && o.y <= FLT_MAX && o.z <= FLT_MAX && d.x <= FLT_MAX && d.y <= FLT_MAX && d.z <= FLT_MAX &&
        most >= 1e-18f))
    return 0;
  line->origin = origin;
  line->direction = direction;
  line->axis = most == d.x ? 0 : most == d.y ? 1 : 2;
  float3 turn = turned(direction, line->axis);
  line->largest = turn.z;
  line->sx = turn.x / turn.z;
  line->sy = turn.y / turn.z;
  line->inverse = 1.0f / direction;
  return 1;
}

// `units`: of 2^-24 of a corner's distance, that the box is given room by.
FN int hits_box(global const float* lower, global const float* upper, const Line* line, float units, float far,
                float* entry) {
  float3 lo = (float3)(lower[0], lower[1], lower[2]) - line->origin;
  float3 hi = (float3)(upper[0], upper[1], upper[2]) - line->origin;
  // With room around it, no box is flat and no product is 0 times infinity but where the ray passes well outside.
  // A corner's place in the sheared plane is off by at most 5 units of 2^-24 of its distance along any axis (from the
  // difference, the shear's factor, product and sum), a plane of the box by 2 more.
  float room = units * 5.9604645e-8f * largest(fmax(fabs(lo), fabs(hi)));
  float3 s = (lo - room) * line->inverse, t = (hi + room) * line->inverse;
  float3 first = fmin(s, t), last = fmax(s, t);
  float enter = fmax(largest(first), 0.0f);
  float leave = fmin(fmin(fmin(last.x, last.y), last.z), far);
  *entry = enter;
  // The distance of a hit is rounded a few times, too.
  return enter <= leave * 1.0000011f;
}

// Rounding keeps the order of products: the sign is the exact value's, or the result is 0, which counts for either
// side.
FN float edge(float ax, float ay, float bx, float by) { return ax * by - bx * ay; }

FN int hits_triangle(global const float* triangles, uint index, const Line* line, float far, float* t, float* u,
                     float* v, float3* normal) {
  global const float* row = triangles + (ulong)TRIANGLE_WORDS * index;
  float3 a = (float3)(row[TRIANGLE_P0], row[TRIANGLE_P0 + 1], row[TRIANGLE_P0 + 2]) - line->origin;
  float3 b = (float3)(row[TRIANGLE_P1], row[TRIANGLE_P1 + 1], row[TRIANGLE_P1 + 2]) - line->origin;
  float3 c = (float3)(row[TRIANGLE_P2], row[TRIANGLE_P2 + 1], row[TRIANGLE_P2 + 2]) - line->origin;
  float3 p = turned(a, line->axis), q = turned(b, line->axis), r = turned(c, line->axis);
  float ax = fma(-line->sx, p.z, p.x), ay = fma(-line->sy, p.z, p.y);
  float bx = fma(-line->sx, q.z, q.x), by = fma(-line->sy, q.z, q.y);
  float cx = fma(-line->sx, r.z, r.x), cy = fma(-line->sy, r.z, r.y);
  // Weights of b, c and a.
  float u_edge = edge(cx, cy, ax, ay), v_edge = edge(ax, ay, bx, by), w_edge = edge(bx, by, cx, cy);
  if (!((u_edge >= 0.0f && v_edge >= 0.0f && w_edge >= 0.0f) || (u_edge <= 0.0f && v_edge <= 0.0f && w_edge <= 0.0f)))
    return 0;
  float sum = u_edge + v_edge + w_edge;
  // From the two shorter edges: those of a needle that are long differ by little, and their product by less.
  float3 ab = b - a, bc = c - b, ca = a - c;
  float l0 = plain_dot(ab, ab), l1 = plain_dot(bc, bc), l2 = plain_dot(ca, ca);
  float3 n = l0 >= l1 && l0 >= l2 ? plain_cross(bc, ca) : l1 >= l2 ? plain_cross(ca, ab) : plain_cross(ab, bc);
  float denominator = plain_dot(n, line->direction);
  // Of a plane seen edge-on, the quotient may be anything: the hit lies between the corners.
  float pt = p.z / line->largest, qt = q.z / line->largest, rt = r.z / line->largest;
  float distance = fmax(fmin(plain_dot(a, n) / denominator, fmax(fmax(pt, qt), rt)), fmin(fmin(pt, qt), rt));
  if (!(distance > 0.0f && distance <= far && denominator != 0.0f && sum != 0.0f)) return 0;
  *t = distance;
  *u = fmin(u_edge / sum, 1.0f);
  *v = fmin(v_edge / sum, 1.0f);
  *normal = n;
  return 1;
}

typedef struct {
  float t, u, v;
  float3 normal;
  uint primitive, instance;
} Hit;

typedef struct {
  global const BvhNode* nodes;
  global const uint* slots;
  global const float* triangles;
  global const BvhNode* top;     // of the top level
  global const uint* entries;    // of the top level's leaves: a part's root and an instance, or GLEANER_NONE
  global const float* inverses;  // of the instances' transforms, 16 words each: the linear part, then the translation
} Tables;

// The roundings of a node's box, of a corner and of the shear; see hits_box().
#define BOX_UNITS 8.0f
// Of the top level: what taking a ray to a mesh's own space rounds comes on top.
#define TOP_UNITS 64.0f

#ifdef TWO_LEVELS
// The ray in an instance's own space. 0 where nothing there can be hit.
FN int to_instance(global const float* inverses, uint instance, const Line* world, Line* line) {
  if (instance == GLEANER_NONE) {
    *line = *world;
    return 1;
  }
  global const float* m = inverses + (ulong)16u * instance;
  float3 x = (float3)(m[0], m[3], m[6]), y = (float3)(m[1], m[4], m[7]), z = (float3)(m[2], m[5], m[8]);
  float3 o = world->origin, d = world->direction;
  return make_line(x * o.x + (y * o.y + (z * o.z + (float3)(m[9], m[10], m[11]))), x * d.x + (y * d.y + z * d.z), line);
}
#endif

FN uint walk(const Tables* tables, float3 origin, float3 direction, float far, uint source, uint source_instance,
             int any, Hit* hit, global uint* overflow) {
  uint stack[STACK_SIZE];
  uint size = 0, node = 0, found = 0, instance = GLEANER_NONE;
  float units = BOX_UNITS;
  global const BvhNode* nodes = tables->nodes;
  Line line;
  if (!make_line(origin, direction, &line)) return 0;
#ifdef TWO_LEVELS
  const Line world = line;
  uint floor = GLEANER_NONE;  // of the stack, below which the top level's nodes lie; at the top level, none
  nodes = tables->top;
  units = TOP_UNITS;
#endif
  hit->t = far;
  hit->primitive = GLEANER_NONE;
  for (;;) {
    if (node & GLEANER_BVH_LEAF) {
      uint first = node & 0x07ffffffu, count = (node >> 27) & 15u;
#ifdef TWO_LEVELS
      if (floor == GLEANER_NONE) {
        if (count) {
          instance = tables->entries[2u * first + 1u];
          if (to_instance(tables->inverses, instance, &world, &line)) {
            node = tables->entries[2u * first];
            nodes = tables->nodes;
            units = BOX_UNITS;
            floor = size;
            continue;
          }
        }
        count = 0;
      }
#endif
      for (uint k = 0; k < count; ++k) {
        uint index = tables->slots[first + k];
        // A plane is never left through itself.
#ifdef NEED_INSTANCES
        if (index == source && instance == source_instance) continue;
#else
        if (index == source) continue;
#endif
        float t, u, v;
        float3 n;
        if (hits_triangle(tables->triangles, index, &line, hit->t, &t, &u, &v, &n)) {
          if (t < hit->t ||
              (t == hit->t && (index < hit->primitive || (index == hit->primitive && instance < hit->instance)))) {
            hit->t = t;
            hit->u = u;
            hit->v = v;
            hit->normal = n;
            hit->primitive = index;
            hit->instance = instance;
            found = 1;
            if (any) return 1;
          }
        }
      }
    } else {
      global const BvhNode* n = nodes + node;
      float entry0, entry1;
      int in0 = hits_box(n->lower0, n->upper0, &line, units, hit->t, &entry0);
      int in1 = hits_box(n->lower1, n->upper1, &line, units, hit->t, &entry1);
      uint child0 = n->child[0], child1 = n->child[1];
      if (in0 && in1) {
        if (size >= STACK_SIZE) {
          atomic_inc(overflow);
          return found;
        }
        int swapped = entry1 < entry0;
        stack[size++] = swapped ? child0 : child1;
        node = swapped ? child1 : child0;
        continue;
      }
      if (in0 || in1) {
        node = in0 ? child0 : child1;
        continue;
      }
    }
#ifdef TWO_LEVELS
    if (size == floor) {
      floor = GLEANER_NONE;
      nodes = tables->top;
      units = TOP_UNITS;
      line = world;
    }
#endif
    if (size == 0) return found;
    node = stack[--size];
  }
}

FN float3 read3(global const float* rays, uint i, uint rows, uint row) {
  ulong at = (ulong)(i >> 4) * rows * 16u + row * 16u + (i & 15u);
  return (float3)(rays[at], rays[at + 16u], rays[at + 32u]);
}

// Closest hits of rays [0, count): t, geometric normal (not unit; of an instance in its own
// space), u, v, primitive, instance; geometry 0 where something was hit.
kernel void trace_closest(global const BvhNode* restrict nodes, global const uint* restrict slots,
                          global const float* restrict triangles, global const BvhNode* restrict top,
                          global const uint* restrict entries, global const float* restrict inverses,
                          global float* rays, uint rows, uint count, global uint* overflow) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  ulong at = (ulong)(i >> 4) * rows * 16u + (i & 15u);
  float far = rays[at + 16u * ROW_FAR];
  if (!(far > 0.0f)) return;
  Hit hit;
  Tables tables = {nodes, slots, triangles, top, entries, inverses};
  uint source = ((global uint*)rays)[at + 16u * ROW_SOURCE];
  uint instance = ((global uint*)rays)[at + 16u * ROW_FLAGS];
  if (walk(&tables, read3(rays, i, rows, ROW_ORIGIN), read3(rays, i, rows, ROW_DIRECTION), far, source, instance, 0,
           &hit, overflow)) {
    rays[at + 16u * ROW_FAR] = hit.t;
    rays[at + 16u * ROW_NORMAL] = hit.normal.x;
    rays[at + 16u * (ROW_NORMAL + 1u)] = hit.normal.y;
    rays[at + 16u * (ROW_NORMAL + 2u)] = hit.normal.z;
    rays[at + 16u * ROW_U] = hit.u;
    rays[at + 16u * ROW_V] = hit.v;
    ((global uint*)rays)[at + 16u * ROW_PRIMITIVE] = hit.primitive;
    ((global uint*)rays)[at + 16u * ROW_GEOMETRY] = 0u;
#ifdef NEED_INSTANCES
    ((global uint*)rays)[at + 16u * ROW_INSTANCE] = hit.instance;
#endif
  }
}

// Any hit on rays [0, count): far becomes minus infinity where something is in the way.
kernel void trace_any(global const BvhNode* restrict nodes, global const uint* restrict slots,
                      global const float* restrict triangles, global const BvhNode* restrict top,
                      global const uint* restrict entries, global const float* restrict inverses, global float* rays,
                      uint rows, uint count, global uint* overflow) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  ulong at = (ulong)(i >> 4) * rows * 16u + (i & 15u);
  float far = rays[at + 16u * ROW_FAR];
  if (!(far > 0.0f)) return;
  Hit hit;
  Tables tables = {nodes, slots, triangles, top, entries, inverses};
  uint source = ((global uint*)rays)[at + 16u * ROW_SOURCE];
  uint instance = ((global uint*)rays)[at + 16u * ROW_FLAGS];
  if (walk(&tables, read3(rays, i, rows, ROW_ORIGIN), read3(rays, i, rows, ROW_DIRECTION), far, source, instance, 1,
           &hit, overflow))
    rays[at + 16u * ROW_FAR] = -INFINITY;
}
