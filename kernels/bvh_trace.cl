// Ray queries on the blob's binary BVH, for devices that Embree does not run on. One work-item a ray:
//
//   push the root; while the stack holds a node: test both children's boxes, go on with the nearer, push the farther;
//   at a leaf test its triangles (Pluecker coordinates relative to the origin: Davidovic et al. 2012; watertight, since
//   neighbours compute the shared edge's sign from the same products). Ties in t go to the smaller triangle index.
//
// Tests are written in accept form: a NaN is a miss. A full stack raises a flag and the ray reports itself, nothing is lost
// in silence. Contraction is off: the sign of an edge must not depend on which product was rounded.
#pragma OPENCL FP_CONTRACT OFF

#include "kernels/rays.h"
#include "scene/model/records.h"

#ifndef STACK_SIZE
#define STACK_SIZE 64
#endif

// The library's versions may fuse; these may not.
FN float3 plain_cross(float3 a, float3 b) {
  return (float3)(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
FN float plain_dot(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// The far side is widened by the error bound of the slab test (Ize 2013; pbrt-v4, 6.8.2: 1 + 2 gamma(3)).
FN int hits_box(global const float* lower, global const float* upper, float3 origin, float3 inverse, float far, float* entry) {
  // Near and far planes by the direction's sign: where the ray lies in a plane, 0 * infinity is NaN, which fmax and fmin
  // skip, so that it counts as inside the slab.
  float ax = ((inverse.x >= 0.0f ? lower[0] : upper[0]) - origin.x) * inverse.x;
  float bx = ((inverse.x >= 0.0f ? upper[0] : lower[0]) - origin.x) * inverse.x;
  float ay = ((inverse.y >= 0.0f ? lower[1] : upper[1]) - origin.y) * inverse.y;
  float by = ((inverse.y >= 0.0f ? upper[1] : lower[1]) - origin.y) * inverse.y;
  float az = ((inverse.z >= 0.0f ? lower[2] : upper[2]) - origin.z) * inverse.z;
  float bz = ((inverse.z >= 0.0f ? upper[2] : lower[2]) - origin.z) * inverse.z;
  float enter = fmax(fmax(ax, ay), fmax(az, 0.0f));
  float leave = fmin(fmin(bx, by), fmin(bz, far));
  *entry = enter;
  return enter <= leave * 1.0000011f;
}

FN int hits_triangle(global const float* triangles, uint index, float3 origin, float3 direction, float far, float* t, float* u,
                     float* v, float3* normal) {
  global const float* row = triangles + (ulong)32u * index;
  float3 a = (float3)(row[0], row[1], row[2]) - origin;
  float3 b = (float3)(row[3], row[4], row[5]) - origin;
  float3 c = (float3)(row[6], row[7], row[8]) - origin;
  float3 e0 = c - a, e1 = a - b, e2 = b - c;
  float u_edge = plain_dot(plain_cross(e0, c + a), direction);
  float v_edge = plain_dot(plain_cross(e1, a + b), direction);
  float w_edge = plain_dot(plain_cross(e2, b + c), direction);
  float sum = u_edge + v_edge + w_edge;
  float slack = 1.1920929e-7f * fabs(sum);
  float least = fmin(fmin(u_edge, v_edge), w_edge), most = fmax(fmax(u_edge, v_edge), w_edge);
  if (!(least >= -slack || most <= slack)) return 0;
  float3 n = plain_cross(e2, e1);
  float denominator = 2.0f * plain_dot(n, direction);
  float distance = 2.0f * plain_dot(a, n) / denominator;
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
  uint primitive;
} Hit;

FN uint walk(global const BvhNode* nodes, global const uint* slots, global const float* triangles, float3 origin,
             float3 direction, float far, uint source, int any, Hit* hit, global uint* overflow) {
  uint stack[STACK_SIZE];
  uint size = 0, node = 0, found = 0;
  float3 inverse = 1.0f / direction;
  hit->t = far;
  hit->primitive = GLEANER_NONE;
  for (;;) {
    if (node & GLEANER_BVH_LEAF) {
      uint first = node & 0x07ffffffu, count = (node >> 27) & 15u;
      for (uint k = 0; k < count; ++k) {
        uint index = slots[first + k];
        if (index == source) continue;  // a plane is never left through itself
        float t, u, v;
        float3 n;
        if (hits_triangle(triangles, index, origin, direction, hit->t, &t, &u, &v, &n)) {
          if (t < hit->t || (t == hit->t && index < hit->primitive)) {
            hit->t = t;
            hit->u = u;
            hit->v = v;
            hit->normal = n;
            hit->primitive = index;
            found = 1;
            if (any) return 1;
          }
        }
      }
    } else {
      global const BvhNode* n = nodes + node;
      float entry0, entry1;
      int in0 = hits_box(n->lower0, n->upper0, origin, inverse, hit->t, &entry0);
      int in1 = hits_box(n->lower1, n->upper1, origin, inverse, hit->t, &entry1);
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
    if (size == 0) return found;
    node = stack[--size];
  }
}

FN float3 read3(global const float* rays, uint i, uint rows, uint row) {
  ulong at = (ulong)(i >> 4) * rows * 16u + row * 16u + (i & 15u);
  return (float3)(rays[at], rays[at + 16u], rays[at + 32u]);
}

// Closest hits of rays [0, count): t, geometric normal (not unit), u, v, primitive; geometry 0 where something was hit.
kernel void trace_closest(global const BvhNode* restrict nodes, global const uint* restrict slots,
                          global const float* restrict triangles, global float* rays, uint rows, uint count,
                          global uint* overflow) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  ulong at = (ulong)(i >> 4) * rows * 16u + (i & 15u);
  float far = rays[at + 16u * ROW_FAR];
  if (!(far > 0.0f)) return;
  Hit hit;
  uint source = ((global uint*)rays)[at + 16u * ROW_SOURCE];
  if (walk(nodes, slots, triangles, read3(rays, i, rows, ROW_ORIGIN), read3(rays, i, rows, ROW_DIRECTION), far, source, 0, &hit,
           overflow)) {
    rays[at + 16u * ROW_FAR] = hit.t;
    rays[at + 16u * ROW_NORMAL] = hit.normal.x;
    rays[at + 16u * (ROW_NORMAL + 1u)] = hit.normal.y;
    rays[at + 16u * (ROW_NORMAL + 2u)] = hit.normal.z;
    rays[at + 16u * ROW_U] = hit.u;
    rays[at + 16u * ROW_V] = hit.v;
    ((global uint*)rays)[at + 16u * ROW_PRIMITIVE] = hit.primitive;
    ((global uint*)rays)[at + 16u * ROW_GEOMETRY] = 0u;
  }
}

// Any hit on rays [0, count): far becomes minus infinity where something is in the way.
kernel void trace_any(global const BvhNode* restrict nodes, global const uint* restrict slots,
                      global const float* restrict triangles, global float* rays, uint rows, uint count,
                      global uint* overflow) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  ulong at = (ulong)(i >> 4) * rows * 16u + (i & 15u);
  float far = rays[at + 16u * ROW_FAR];
  if (!(far > 0.0f)) return;
  Hit hit;
  uint source = ((global uint*)rays)[at + 16u * ROW_SOURCE];
  if (walk(nodes, slots, triangles, read3(rays, i, rows, ROW_ORIGIN), read3(rays, i, rows, ROW_DIRECTION), far, source, 1, &hit,
           overflow))
    rays[at + 16u * ROW_FAR] = -INFINITY;
}
