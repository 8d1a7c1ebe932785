// What the path filters share whose partners carry light that leaves diffuse layers alone (kernels/radiosity_filter.h,
// kernels/irradiance_filter.h).
#ifndef GLEANER_KERNELS_LAYER_FILTER_H
#define GLEANER_KERNELS_LAYER_FILTER_H

// Which part of a surface scattered a path.
typedef struct {
  vi by_layer;  // the diffuse layer
  vi through;   // a mirror or glass, behind which the first surface is still to come
} LayerChoice;

// The layer or the lobe is chosen at random, which *throughput makes up for. `with_lobe`: rough lobes count as the
// layer.
FN LayerChoice choose_layer(const Scene* scene, const Vertex* v, v3 direction, vi specular, vi glass, vi with_lobe,
                            vu pair_key, vu sample, v3* throughput) {
  LayerChoice c;
  c.by_layer = none(specular | glass);
  c.through = glass;
#ifdef NEED_LOBE
  const Surface* m = &v->surface;
  vf u_part, u_spare, gain;
  v3 factor;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 4u, &u_part, &u_spare);
  vi opaque = c.by_layer;
  c.by_layer =
      choose_part(scene, m, v->frame.view, direction, opaque, with_lobe & has_rough_lobe(m), u_part, &gain, &factor);
  *throughput = pick3(*throughput, mul3(*throughput, factor), opaque);
  // As step_to_surface_point() has it.
  c.through = c.through | ((m->lobe_share >= one_f()) & none(has_rough_lobe(m)));
#endif
  return c;
}

// Lanes of `first`, which have met nothing but mirrors and glass, that leave their first surface by its layer. Not
// within a solid.
FN vi begins_by_layer(const Vertex* v, const LayerChoice* c, vi first) {
  vi begins = first & none(c->through) & c->by_layer;
#ifdef NEED_MEDIA
  begins = begins & (filling(v->media) == 0u);
#endif
  return begins;
}

#endif
