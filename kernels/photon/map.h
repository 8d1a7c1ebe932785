// Reading a photon map (kernels/photon_records.h): the photons near a place, and how near they are.
//
//   nearest_radius   the distance to the k-th nearest photon: nodes nearest first, a heap of the k best so far
//   next_leaf        leaves that a radius reaches, or whose photons reach the place, in the tree's order: the stackless
//                    walk by skips
//   photons_near     of a leaf's photons, those within the radius, a lane each
//
// Distances are measured in a flattened ball: what is off the surface's plane counts for more, so that photons on other
// surfaces in a corner stay out. A photon counts where its surface faces as the place does.
//
// The tree is a kd-tree whose leaves are whole blocks of 16 photons, which a work-item of 16 lanes tests at once; a
// work-item reads one place. Median splits keep it balanced: a stack of MAP_STACK holds the other children.
#ifndef GLEANER_KERNELS_PHOTON_MAP_H
#define GLEANER_KERNELS_PHOTON_MAP_H

#include "kernels/photon/pack.h"
#include "kernels/photon_records.h"
#include "kernels/rays.h"

#define MAP_STACK 40u

typedef struct {
  global const float* nodes;
  global const float* photons;
  uint count;     // of nodes
  uint caustics;  // the first of the caustic photons' tree
  float reach;    // MAP_REACH
} PhotonMap;

FN PhotonMap photon_map(global const float* rows, uint nodes) {
  PhotonMap map;
  map.nodes = rows + PHOTON_WORDS;
  map.photons = rows + PHOTON_WORDS * (1u + nodes);
  map.count = nodes;
  map.caustics = ((global const uint*)rows)[MAP_CAUSTICS];
  map.reach = rows[MAP_REACH];
  return map;
}

// A place, and which photons count there.
typedef struct {
  float x, y, z;
  float nx, ny, nz;  // the triangle's normal, on the viewer's side
  uint most_depth;
  uint caustics;  // not 0: caustic photons alone count
} MapPlace;

// Scatterings that a photon may have where `depth` of a light's way are the camera path's own, and one is the place's.
// `most`: of all; 0: no limit.
FN vu scatterings_left(uint most, vu depth) {
  return most ? (vu)(most - 1u) - min(depth, (vu)(most - 1u)) : (vu)PHOTON_MOST_DEPTH;
}

FN MapPlace map_place(global const float* read) {
  MapPlace p;
  p.x = read[READ_POSITION];
  p.y = read[READ_POSITION + 1u];
  p.z = read[READ_POSITION + 2u];
  p.nx = read[READ_GEOMETRIC];
  p.ny = read[READ_GEOMETRIC + 1u];
  p.nz = read[READ_GEOMETRIC + 2u];
  uint limits = ((global const uint*)read)[READ_LIMITS];
  p.most_depth = limits & ~READ_CAUSTICS;
  p.caustics = limits & READ_CAUSTICS;
  return p;
}

FN uint node_word(const PhotonMap* map, uint node, uint word) {
  return ((global const uint*)map->nodes)[node * PHOTON_WORDS + word];
}

// Squared distance to a node's box.
FN float box_distance2(const PhotonMap* map, uint node, const MapPlace* p) {
  global const float* n = map->nodes + node * PHOTON_WORDS;
  float x = max(max(n[NODE_LOWER] - p->x, p->x - n[NODE_UPPER]), 0.0f);
  float y = max(max(n[NODE_LOWER + 1u] - p->y, p->y - n[NODE_UPPER + 1u]), 0.0f);
  float z = max(max(n[NODE_LOWER + 2u] - p->z, p->z - n[NODE_UPPER + 2u]), 0.0f);
  return x * x + y * y + z * z;
}

// Squared distance within which a node's photons shine.
FN float node_reach2(const PhotonMap* map, uint node) {
  return map->reach *
         as_float(0x3f800000u - ((node_word(map, node, NODE_BLOCK) >> NODE_REACH_SHIFT) << NODE_REACH_STEP));
}

// The node that a walk through the photons that count at a place begins with.
FN uint first_node(const PhotonMap* map, const MapPlace* p) { return p->caustics ? map->caustics : 0u; }

// The next leaf's block from node *at on, and *at behind it; GLEANER_NONE: there is none. Leaves that the radius
// reaches, or, with `own`, whose photons shine as far as the place: *reach2 is how far, at most as far as the radius.
FN uint next_leaf(const PhotonMap* map, const MapPlace* p, float radius2, bool own, uint* at, float* reach2) {
  while (*at < map->count) {
    uint node = *at;
    *reach2 = own ? fmin(radius2, node_reach2(map, node)) : radius2;
    if (box_distance2(map, node, p) >= *reach2) {
      *at = node_word(map, node, NODE_SKIP);
      continue;
    }
    *at = node + 1u;
    uint block = node_word(map, node, NODE_BLOCK) & NODE_BLOCK_MASK;
    if (block != NODE_NO_BLOCK) return block;
  }
  return GLEANER_NONE;
}

// Blocks are read by work-items of one lane in 16 parts, by those of 16 lanes at once.
#define MAP_PARTS (RAY_BLOCK / LANES)

FN vf photon_f(const PhotonMap* map, uint block, uint part, uint word) {
  return row_f(map->photons, PHOTON_WORDS, block * MAP_PARTS + part, word);
}
FN vu photon_u(const PhotonMap* map, uint block, uint part, uint word) {
  return row_u(map->photons, PHOTON_WORDS, block * MAP_PARTS + part, word);
}

// Below the place's plane: too far to be on its surface.
FN vi far_below(vf height, vf distance2) {
  return (height < zero_f()) & (height * height > PHOTON_LEAST_DEPTH * PHOTON_LEAST_DEPTH * distance2);
}

// Of photons far below the place's plane, those whose light comes from that plane, from nearer than the place is: the
// back of the place's own surface sends it. Such photons are inside a thin sheet, whose other side the place is on.
FN vi covered(const MapPlace* p, vu arrival, vf height, vf distance2) {
  v3 d = unpack_unit(arrival, 12u);
  vf length = unpack_length(arrival >> PHOTON_LENGTH_SHIFT);
  vf rise = -length * (d.x * p->nx + d.y * p->ny + d.z * p->nz);
  return (fabs(rise + height) < -PHOTON_COVER_MARGIN * height) & (length * length < distance2);
}

// The photons that count within the radius, and their distances squared.
FN vi photons_near(const PhotonMap* map, uint block, uint part, const MapPlace* p, float radius2, vf* distance2) {
  vf x = photon_f(map, block, part, PHOTON_POSITION) - p->x;
  vf y = photon_f(map, block, part, PHOTON_POSITION + 1u) - p->y;
  vf z = photon_f(map, block, part, PHOTON_POSITION + 2u) - p->z;
  vf height = x * p->nx + y * p->ny + z * p->nz;
  vf d2 = x * x + y * y + z * z + MAP_FLATNESS * height * height;
  *distance2 = d2;
  vi near = d2 < radius2;
  if (!any_lane(near)) return near;
  vu surface = photon_u(map, block, part, PHOTON_SURFACE);
  v3 n = unpack_unit(surface, 12u);
  near = near & (n.x * p->nx + n.y * p->ny + n.z * p->nz > (vf)MAP_LEAST_COSINE);
  vi below = near & far_below(height, d2);
  if (any_lane(below)) near = near & none(below & covered(p, photon_u(map, block, part, PHOTON_ARRIVAL), height, d2));
  if (p->most_depth < PHOTON_MOST_DEPTH) near = near & ((surface >> PHOTON_DEPTH_SHIFT) <= p->most_depth);
  return near;
}

FN void spill_lanes(vf x, float* to) {
#if LANES == 16
  vstore16(x, 0, to);
#else
  *to = x;
#endif
}

// A binary heap of the least distances so far, the greatest on top.
FN void heap_add(float* heap, uint* count, uint most, float value) {
  uint at;
  if (*count < most) {
    at = (*count)++;
    while (at > 0u && heap[(at - 1u) / 2u] < value) {
      heap[at] = heap[(at - 1u) / 2u];
      at = (at - 1u) / 2u;
    }
  } else {
    at = 0u;
    for (;;) {
      uint child = 2u * at + 1u;
      if (child >= most) break;
      if (child + 1u < most && heap[child + 1u] > heap[child]) ++child;
      if (heap[child] <= value) break;
      heap[at] = heap[child];
      at = child;
    }
  }
  heap[at] = value;
}

FN void heap_leaf(const PhotonMap* map, uint block, const MapPlace* p, uint most, float* heap, uint* count,
                  float* bound2) {
  for (uint part = 0; part < MAP_PARTS; ++part) {
    vf d2;
    vi near = photons_near(map, block, part, p, *bound2, &d2);
    if (!any_lane(near)) continue;
    float d[LANES];
    spill_lanes(pick((vf)INFINITY, d2, near), d);
    for (uint k = 0; k < LANES; ++k)
      if (d[k] < *bound2) {
        heap_add(heap, count, most, d[k]);
        if (*count == most) *bound2 = heap[0];
      }
  }
}

// The squared distance to the photon of rank `wanted` (1 to PHOTON_MOST_NEIGHBOURS); most2 where there are fewer within
// it.
FN float nearest_radius2(const PhotonMap* map, const MapPlace* p, uint wanted, float most2) {
  float heap[PHOTON_MOST_NEIGHBOURS];
  uint stack[MAP_STACK];
  float apart2[MAP_STACK];
  uint count = 0u, top = 0u;
  float bound2 = most2;
  uint node = map->count && box_distance2(map, 0u, p) < bound2 ? 0u : GLEANER_NONE;
  for (;;) {
    if (node == GLEANER_NONE) {
      do {
        if (top == 0u) return bound2;
        node = stack[--top];
      } while (apart2[top] >= bound2);
    }
    uint block = node_word(map, node, NODE_BLOCK) & NODE_BLOCK_MASK;
    if (block != NODE_NO_BLOCK) {
      heap_leaf(map, block, p, wanted, heap, &count, &bound2);
      node = GLEANER_NONE;
      continue;
    }
    uint near = node + 1u, far = min(node_word(map, near, NODE_SKIP), map->count - 1u);
    float near2 = box_distance2(map, near, p), far2 = box_distance2(map, far, p);
    if (far2 < near2) {
      uint other = near;
      float other2 = near2;
      near = far;
      near2 = far2;
      far = other;
      far2 = other2;
    }
    if (far2 < bound2 && top < MAP_STACK) {
      stack[top] = far;
      apart2[top++] = far2;
    }
    node = near2 < bound2 ? near : GLEANER_NONE;
  }
}

// Squared radius of the density estimate at a place.
FN float estimate_radius2(const PhotonMap* map, const MapPlace* p, uint neighbours, float most_radius) {
  float most2 = most_radius * most_radius;
  return neighbours ? nearest_radius2(map, p, min(neighbours, PHOTON_MOST_NEIGHBOURS), most2) : most2;
}

// In the order of the lanes, so that it is the same sum on every device of a kind.
FN float sum_lanes(vf x) {
#if LANES == 16
  float d[16], sum = 0.0f;
  vstore16(x, 0, d);
  for (uint k = 0; k < 16u; ++k) sum += d[k];
  return sum;
#else
  return x;
#endif
}

#endif
