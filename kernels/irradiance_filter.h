// The path filter of PATH_CLASS_IRRADIANCE (kernels/path_filter.h says what a filter is): the partner has an irradiance
// cache. And of PATH_CLASS_RADIANCE: the partner caches incoming radiance where lobes are rough, too, and has what
// leaves the first surface by these.
//
// The first surface that a camera path meets past mirrors and glass shows the partner's light where that leaves by its
// diffuse layer, was scattered before, and not by mirrors and smooth glass alone. So direct light stays the path
// tracer's, and so do caustics of perfect mirrors and smooth glass, which change too fast over a surface to be
// interpolated. What leaves a first surface within a solid is the path tracer's as well.
//
// With SPLAT_GATHER this is the partner's own side: paths that have left a record's place gather just that light
// (kernels/splat/gather.cl). Both sides tell by one state whether a path has met nothing but mirrors and smooth glass
// since.
#ifndef GLEANER_KERNELS_IRRADIANCE_FILTER_H
#define GLEANER_KERNELS_IRRADIANCE_FILTER_H

// States of a path.
#define FILTER_NO_SURFACE 0.0f  // has met nothing but mirrors and glass
#define FILTER_KEEP -1.0f       // all that is found from here on is found by this side
#define FILTER_LAYER 1.0f  // left the first surface's diffuse layer: lights found from here on are the path tracer's

typedef struct {
  vf state;
  vi compensates;  // never: the partner lacks nothing
  vi layered;      // lanes that came from the first surface's layer, and scatter here
} PathFilter;

FN PathFilter load_filter(global const float* paths, uint block) {
  PathFilter f;
  f.state = row_f(paths, PATH_ROWS, block, ROW_FILTER);
  f.compensates = no_lanes();
  f.layered = no_lanes();
  return f;
}

#ifdef SPLAT_GATHER
FN vi shows_emission(const PathFilter* f, vi found) { return found & (f->state != (vf)FILTER_LAYER); }
#else
FN vi shows_emission(const PathFilter* f, vi found) { return found; }
#endif
FN vi shows_unlit(const PathFilter* f, vi found) { return shows_emission(f, found); }

FN void filter_vertex(PathFilter* f, float clamp_to, v3 origin, v3 direction, Vertex* v) {
#ifndef SPLAT_GATHER
  f->layered = v->active & none(v->passes) & (f->state == (vf)FILTER_LAYER);
#if !defined(NEED_LOBE) && !defined(NEED_TRANSMISSIVE)
  v->active = v->active & none(f->layered);
#endif
#endif
}

FN v3 filter_reflectance(const PathFilter* f, const Scene* scene, const Surface* m, float clamp_to, vf nl,
                         v3 reflectance) {
  return pick3(reflectance, splat3(zero_f()), f->layered);
}

FN v3 filter_sharp(const PathFilter* f, v3 glass) { return pick3(glass, splat3(zero_f()), f->layered); }

FN vf filter_scattering(const PathFilter* f, const Scene* scene, const Vertex* v, float clamp_to, v3 direction,
                        vi specular, vi glass, vu pair_key, vu sample, v3* throughput) {
#ifdef SPLAT_GATHER
  return pick((vf)FILTER_KEEP, f->state, specular);
#else
  vi with_lobe = PATH_FILTER == PATH_CLASS_RADIANCE ? all_lanes() : no_lanes();
  LayerChoice c = choose_layer(scene, v, direction, specular, glass, with_lobe, pair_key, sample, throughput);
  *throughput = pick3(*throughput, splat3(zero_f()), f->layered & none(specular));
  vi first = f->state == (vf)FILTER_NO_SURFACE;
  vf state = pick((vf)FILTER_KEEP, f->state, (first & c.through) | (f->layered & specular));
  vi begins = begins_by_layer(v, &c, first);
  return pick(state, (vf)FILTER_LAYER, begins);
#endif
}

FN vf filter_passing(const PathFilter* f, const Vertex* v, vf state) { return pick(state, f->state, v->passes); }

#endif
