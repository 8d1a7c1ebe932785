// Reading an illumination cut (kernels/photon_records.h; Wang et al. 2009, section 3.3): the irradiance of the cut's
// nodes near a place, weighed by eq. 4 and 5.
#ifndef GLEANER_KERNELS_PHOTON_CUT_H
#define GLEANER_KERNELS_PHOTON_CUT_H

#include "kernels/photon/map.h"

// Light that changes within the nodes near a place, or from one to the next, is not what their mean says: a shadow's
// edge, a small thing between large ones. So is light at the rim of nodes, where none of their photons may lie. There
// photons are read. Variance of irradiance over its squared mean, at most; sum of K(r) of eq. 5, at least.
#define CUT_MOST_VARIANCE 0.16f
#define CUT_LEAST_COVER 1.0f

typedef struct {
  global const float* boxes;
  global const float* nodes;
  uint count;              // of blocks
  uint top;                // the level of one group
  uint first[CUT_LEVELS];  // groups before those of a level
} Cut;

// `blocks`: 1 or more.
FN Cut illumination_cut(global const float* rows, uint blocks) {
  Cut cut;
  uint groups = 0u, level = 0u, of_level = blocks;
  for (;;) {
    cut.first[level] = groups;
    of_level = (of_level + RAY_BLOCK - 1u) / RAY_BLOCK;
    groups += of_level;
    if (of_level <= 1u || level + 1u == CUT_LEVELS) break;
    ++level;
  }
  cut.boxes = rows + 2u * PHOTON_WORDS;
  cut.nodes = cut.boxes + groups * CUT_BOX_WORDS * RAY_BLOCK;
  cut.count = blocks;
  cut.top = level;
  return cut;
}

FN vf cut_word(const Cut* cut, uint block, uint part, uint word) {
  return row_f(cut->nodes, CUT_WORDS, block * MAP_PARTS + part, word);
}

// Of a group's 16 boxes those that hold the place: a bit each.
FN uint cut_boxes_at(const Cut* cut, uint group, const MapPlace* p) {
  uint bits = 0u;
  for (uint part = 0; part < MAP_PARTS; ++part) {
    uint at = group * MAP_PARTS + part;
    vi in = (row_f(cut->boxes, CUT_BOX_WORDS, at, 0u) <= (vf)p->x) &
            (row_f(cut->boxes, CUT_BOX_WORDS, at, 3u) >= (vf)p->x) &
            (row_f(cut->boxes, CUT_BOX_WORDS, at, 1u) <= (vf)p->y) &
            (row_f(cut->boxes, CUT_BOX_WORDS, at, 4u) >= (vf)p->y) &
            (row_f(cut->boxes, CUT_BOX_WORDS, at, 2u) <= (vf)p->z) &
            (row_f(cut->boxes, CUT_BOX_WORDS, at, 5u) >= (vf)p->z);
    bits |= any_bits(pick_u((vu)0u, (vu)1u << (lane_index() + part), in));
  }
  return bits;
}

// A walk through the tree: of each level the group that it is in, and which of that group's boxes are to come.
typedef struct {
  uint level;
  uint group[CUT_LEVELS], boxes[CUT_LEVELS];
} CutWalk;

FN CutWalk begin_cut_walk(const Cut* cut, const MapPlace* p) {
  CutWalk walk;
  walk.level = cut->top;
  walk.group[cut->top] = 0u;
  walk.boxes[cut->top] = cut_boxes_at(cut, cut->first[cut->top], p);
  return walk;
}

// The next block whose box holds the place; GLEANER_NONE: there is none.
FN uint next_cut_block(const Cut* cut, const MapPlace* p, CutWalk* walk) {
  for (;;) {
    uint level = walk->level, boxes = walk->boxes[level];
    if (boxes == 0u) {
      if (level == cut->top) return GLEANER_NONE;
      ++walk->level;
      continue;
    }
    walk->boxes[level] = boxes & (boxes - 1u);
    uint child = walk->group[level] * RAY_BLOCK + 31u - clz(boxes & (0u - boxes));
    if (level == 0u) return child < cut->count ? child : GLEANER_NONE;
    walk->level = --level;
    walk->group[level] = child;
    walk->boxes[level] = cut_boxes_at(cut, cut->first[level] + child, p);
  }
}

// Whether the cut tells the irradiance, W/m^2, RGB, in `to`. As in a map, what is off the surface's plane is farther
// away.
FN bool cut_irradiance(global const float* rows, uint blocks, const MapPlace* p, float* to) {
  Cut cut = illumination_cut(rows, blocks);
  vf weights = zero_f(), cover = zero_f(), squares = zero_f(), r = zero_f(), g = zero_f(), b = zero_f();
  CutWalk walk = begin_cut_walk(&cut, p);
  for (;;) {
    uint block = next_cut_block(&cut, p, &walk);
    if (block == GLEANER_NONE) break;
    for (uint part = 0; part < MAP_PARTS; ++part) {
      vf x = cut_word(&cut, block, part, CUT_PLACE) - p->x;
      vf y = cut_word(&cut, block, part, CUT_PLACE + 1u) - p->y;
      vf z = cut_word(&cut, block, part, CUT_PLACE + 2u) - p->z;
      vf nearness = cut_word(&cut, block, part, CUT_NEARNESS);
      vf height = x * p->nx + y * p->ny + z * p->nz;
      vf distance2 = x * x + y * y + z * z + MAP_FLATNESS * height * height;
      vf falloff = 1.0f - distance2 * nearness;
      if (!any_lane(falloff > zero_f())) continue;
      vf cosine = cut_word(&cut, block, part, CUT_NORMAL) * p->nx +
                  cut_word(&cut, block, part, CUT_NORMAL + 1u) * p->ny +
                  cut_word(&cut, block, part, CUT_NORMAL + 2u) * p->nz;
      // Over r_p^1.5: nodes have nearly equal power, so that dark ones are wide, and would darken what is bright beside
      // them. Over r_p^2 bright ones shine on what is dark.
      vi near = (falloff > zero_f()) & (cosine > (vf)MAP_LEAST_COSINE);
      vi below = near & far_below(height, distance2);
      if (any_lane(below))
        near = near & none(below & covered(p, as_vu(cut_word(&cut, block, part, CUT_ARRIVAL)), height, distance2));
      vf weight = pick(zero_f(), falloff * cosine * sqrt(nearness * sqrt(nearness)), near);
      vf red = cut_word(&cut, block, part, CUT_IRRADIANCE), green = cut_word(&cut, block, part, CUT_IRRADIANCE + 1u),
         blue = cut_word(&cut, block, part, CUT_IRRADIANCE + 2u), all = red + green + blue;
      weights += weight;
      cover += pick(zero_f(), falloff, near);
      r += weight * red;
      g += weight * green;
      b += weight * blue;
      squares += weight * all * all * (1.0f + cut_word(&cut, block, part, CUT_SPREAD));
    }
  }
  float sum = sum_lanes(weights);
  if (!(sum_lanes(cover) >= CUT_LEAST_COVER && sum > 0.0f)) return false;
  to[0] = sum_lanes(r) / sum;
  to[1] = sum_lanes(g) / sum;
  to[2] = sum_lanes(b) / sum;
  float mean = to[0] + to[1] + to[2];
  return sum_lanes(squares) <= sum * mean * mean * (1.0f + CUT_MOST_VARIANCE);
}

#endif
