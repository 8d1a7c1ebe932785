// Shadow rays: light samples, which arrive at their paths' slots if nothing is in the way.
//
//   write_connection   a light sample as a shadow ray that carries what it would add
//   trace              any hit
//   shadow_connect     light samples that arrived are added to their paths' slots
//
// Where light passes surfaces straight, trace (closest hits) and shadow_pass take turns until no ray is left. Every
// program that includes this file has one of the two kernels.
#ifndef GLEANER_KERNELS_TRANSPORT_SHADOW_RAYS_H
#define GLEANER_KERNELS_TRANSPORT_SHADOW_RAYS_H

#include "kernels/transport/camera_samples.h"
#include "kernels/transport/scattering.h"

// A light sample: its shadow ray, and what it adds to the path's slot if nothing is in the way.
typedef struct {
  v3 origin, direction, contribution;
  vf far;    // not positive: no ray
  vf total;  // LightSample::total here
  vu bits;   // SHADOW_...
  vi connected;
#ifdef NEED_MEDIA
  Media media;  // where the ray begins
#endif
} Connection;

FN void write_connection(global float* shadows, uint block, const Connection* c, const Vertex* v, vu slot,
                         uint slot_count) {
  set_ray(shadows, SHADOW_ROWS, block, c->origin, c->direction, c->far, v->primitive, hit_instance(&v->hit));
  set_row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION, c->contribution);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, pick_u((vu)slot_count, slot | c->bits, c->connected));
#ifdef TRANSPARENT_SHADOWS
  set_row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
#ifdef NEED_MEDIA
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA, c->media.high);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u, c->media.low);
#endif
#endif
}

#ifdef TRANSPARENT_SHADOWS

// Shadow rays and their closest hits: adds the light samples that arrived, and sends on, weakened, those that met a
// surface which light passes straight.
kernel WIDE void shadow_pass(global float* restrict shadows, global float* restrict slots, uint slot_count, uint count,
                             global uint* counters, SCENE_PARAMETERS) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu slot = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT);
  vi asked = (slot != slot_count) & ((vu)(block * LANES) + lane_index() < count);
  if (!any_lane(asked)) return;
  vi infinite = (slot & SHADOW_INFINITE) != 0u;
  // A tracer that looks on behind the ray's own source may come back with a hit beyond the light.
  vi hit = asked & (row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE) &
           (infinite | (row_f(shadows, SHADOW_ROWS, block, ROW_FAR) <= (vf)SHADOW_FAR));
  v3 contribution = row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION);
  v3 origin = row_3(shadows, SHADOW_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(shadows, SHADOW_ROWS, block, ROW_DIRECTION);
  vu primitive = pick_u((vu)0u, row_u(shadows, SHADOW_ROWS, block, ROW_PRIMITIVE), hit);
  Hit h = load_hit(scene, primitive, row_u(shadows, SHADOW_ROWS, block, ROW_INSTANCE),
                   row_f(shadows, SHADOW_ROWS, block, ROW_U), row_f(shadows, SHADOW_ROWS, block, ROW_V), hit);
#ifdef NEED_MEDIA
  Media media;
  media.high = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA);
  media.low = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u);
  media = media_at_end(media, &h, scene, meets_back(&h, direction), hit);
  vf reach = pick(length3(direction), (vf)INFINITY, infinite);
  reach = pick(reach, length3(sub3(h.p, origin)), hit);
  contribution = mul3(contribution, absorption(scene, media, reach, asked));
#endif
  vi arrived = asked & none(hit);
  if (any_lane(arrived)) {
    add_to_slots(slots, slot_count, slot & ~SHADOW_BITS, (slot & SHADOW_INDIRECT) != 0u, contribution, arrived);
    add_compensation(slots, slot_count, slot & ~SHADOW_BITS, contribution,
                     arrived & ((slot & SHADOW_COMPENSATES) != 0u));
  }

  vi passes = hit;
  Surface m;
  load_color(scene, &h, &m, passes);
  vf cosine = one_f();
#ifdef PASSES_GLASS
  load_lobes(scene, &h, &m, passes);
  ShadingFrame frame = shading_frame(&h, normalize3(direction));
  set_side(&m, frame.from_back);
  cosine = frame.view.z;
#endif
#ifdef NEED_MEDIA
  Media beyond = media_beyond(media, &h, scene, frame.from_back, passes);
  set_boundary(scene, &m, media, beyond, passes);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA, beyond.high);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u, beyond.low);
#endif
  contribution = mul3(contribution, straight_share(&m, cosine));
  passes = passes & (max_component(contribution) > zero_f());
  v3 start = offset_ray_origin(h.p, h.error, h.geometric, direction);
  passes = passes & finite3(start);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_ORIGIN, start);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_DIRECTION,
            pick3(sub3(add3(origin, direction), start), direction, infinite));
  set_row_f(shadows, SHADOW_ROWS, block, ROW_NEAR, zero_f());
  set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR,
            pick((vf)-1.0f, pick((vf)SHADOW_FAR, (vf)INFINITY, infinite), passes));
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SOURCE, primitive);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_FLAGS, hit_instance(&h));
  set_row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION, contribution);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, pick_u((vu)slot_count, slot, passes));
  uint passing;
  rank_lanes(passes, &passing);
  if (passing) atomic_add(counters + COUNTER_SHADOW, passing);
}

#else

// Adds the light samples whose shadow rays met nothing.
kernel WIDE void shadow_connect(global const float* restrict shadows, global float* restrict slots, uint slot_count,
                                uint count) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  vu slot = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT);
  // Embree and our own tracer set `far` to minus infinity where something is in the way.
  vi arrived = (row_f(shadows, SHADOW_ROWS, block, ROW_FAR) > zero_f()) & (slot != slot_count) &
               ((vu)(block * LANES) + lane_index() < count);
  if (!any_lane(arrived)) return;
  vi indirect = (slot & SHADOW_INDIRECT) != 0u;
  v3 contribution = row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION);
  add_to_slots(slots, slot_count, slot & ~SHADOW_BITS, indirect, contribution, arrived);
  add_compensation(slots, slot_count, slot & ~SHADOW_BITS, contribution, arrived & ((slot & SHADOW_COMPENSATES) != 0u));
}

#endif

#endif
