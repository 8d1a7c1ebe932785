// Records of the path tracer (kernels/path.cl).
#ifndef GLEANER_KERNELS_PATH_RECORDS_H
#define GLEANER_KERNELS_PATH_RECORDS_H

#include "kernels/records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
#endif

// Samples of one item at most: an item's samples are consecutive points of an Owen-scrambled Sobol sequence.
#define GLEANER_PATH_MAX_ITEM_SAMPLES 64
// Points of a sequence before the pixel begins another one.
#define GLEANER_PATH_SEQUENCE 4096u

// Classes of indirect light, by how it leaves the first surface that a camera path meets past mirrors and glass, and
// how it came there: kernels/path_filter.h.
#define PATH_CLASS_DIFFUSE 1u
#define PATH_CLASS_CAUSTIC 2u
#define PATH_CLASS_MIXED 4u
#define PATH_CLASS_GLOSSY 8u
#define PATH_CLASSES 15u
// Instead of these: indirect light that diffuse layers alone passed on, each straight to the next, from direct light on
// (kernels/radiosity_filter.h).
#define PATH_CLASS_RADIOSITY 16u
// Instead of these: indirect light that leaves the first surface by its diffuse layer, but for caustics of perfect
// mirrors and smooth glass (kernels/irradiance_filter.h).
#define PATH_CLASS_IRRADIANCE 32u
// As IRRADIANCE, with what leaves the first surface by a rough lobe (kernels/bsdf/lobe.h).
#define PATH_CLASS_RADIANCE 256u
// As RADIOSITY. Where every surface is diffuse, paths also end at their first surface, and light samples alone bring
// direct light.
#define PATH_CLASS_SAMPLED_RADIOSITY 128u
// As RADIOSITY, with light that lobes of rough metal passed on beside diffuse layers (kernels/rough_metal.h).
#define PATH_CLASS_METAL_RADIOSITY 512u
// With DIFFUSE and MIXED, which photon maps gather: what of these leaves the first surface by its diffuse layer is
// interpolated between records (kernels/photon/cluster_gather.cl), so that paths gather the rest alone.
#define PATH_CLASS_LAYER 64u
// Beside LAYER: the same of what leaves it by a rough lobe that hemispherical harmonics hold (HARMONIC_LEAST_ALPHA of
// kernels/lobe_rows.h).
#define PATH_CLASS_LOBE 1024u

// Emission seen directly: that a camera path finds before any scattering, straight or past what it passes straight.
#define PATH_SEEN_WITHIN 0u  // is part of the direct light, as any other
#define PATH_SEEN_APART 1u   // is that, and stands apart at the records' end as well
#define PATH_SEEN_ALONE 2u   // is all that the paths look for: they end at the first surface that they do not pass

// Stage kind "path". An item is (pixel, chunk): samples_per_item camera paths through one pixel. Without the input
// "items", item i is pixel i % (width * height), chunk first_chunk + i / (width * height); with it, item i is what the
// list says. A pixel has two independently scrambled sequences; chunk c goes on with sequence c % 2 where its last
// chunk ended, so that a pixel's samples stay well spread however many there come to be, and the two tell its variance.
typedef struct {
  Camera camera;
  gl_uint width, height;      // pixels
  gl_uint samples_per_item;   // a power of two, at most GLEANER_PATH_MAX_ITEM_SAMPLES
  gl_uint last_item_samples;  // samples of the stage's last item (a budget need not divide), 1..samples_per_item
  gl_uint depth;              // most scatterings on a light's way; 0 = until Russian roulette ends it
  gl_uint first_chunk;
  gl_uint seed_low, seed_high;
  gl_uint features;               // 1: records are PathFeatureRecord, else PathRecord
  gl_uint items_low, items_high;  // items of the whole stage
  // Classes of light that a partner method has (kernels/path_filter.h), or 0. With any, records end with three words
  // more, the sums of what the partner lacks.
  gl_uint filter;
  gl_float clamp;  // with a filter: the partner's bound of the geometry term, 1/m^2; infinity: none
  gl_uint seen;    // PATH_SEEN_...; APART: records have three words more, before those of a filter
  gl_uint reserved[2];
} PathParameters;
GLEANER_SIZE(PathParameters, 128);

// One entry of the input "items".
typedef struct {
  gl_uint pixel;
  gl_uint chunk;
} PathItem;
GLEANER_SIZE(PathItem, 8);

// Sums (not means) over the item's samples. Direct: light seen, or reflected once after specular bounces; the rest is
// indirect.
typedef struct {
  gl_float direct[3];
  gl_float indirect[3];
} PathRecord;
GLEANER_SIZE(PathRecord, 24);

typedef struct {
  gl_float direct[3];
  gl_float indirect[3];
  gl_float albedo[3];
  gl_float normal[3];
  gl_float depth;  // metres along the camera ray; 0 where nothing was hit
  gl_float hits;   // samples that hit anything
} PathFeatureRecord;
GLEANER_SIZE(PathFeatureRecord, 56);

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::kernels
#endif

#endif
