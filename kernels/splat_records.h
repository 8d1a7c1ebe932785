// Records of radiance cache splatting (kernels/splat/): Gautron, Krivanek, Bouatouch & Pattanaik 2005, "Radiance Cache
// Splatting: A GPU-Friendly Global Illumination Algorithm". Equations are theirs.
#ifndef GLEANER_KERNELS_SPLAT_RECORDS_H
#define GLEANER_KERNELS_SPLAT_RECORDS_H

#include "kernels/lobe_rows.h"
#include "kernels/path_records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
#endif

// Pixels are dealt with in square tiles, row by row over the picture; those of the last column and row may hang over.
// A tile's pixels go row by row, and a pixel's points follow each other.
#define SPLAT_TILE 8u
#define SPLAT_TILE_PIXELS 64u
// Points of a pixel, at most.
#define SPLAT_MOST_SAMPLES 16u

// A surface point that a pixel shows: rows of SPLAT_POINT_WORDS words.
#define SPLAT_POINT_WORDS 16u
#define SPLAT_POSITION 0u
#define SPLAT_NORMAL 3u      // for shading, on the viewer's side
#define SPLAT_GEOMETRIC 6u   // of the triangle, on that side
#define SPLAT_FACTOR 9u      // RGB: what a unit of irradiance adds to the pixel's sample
#define SPLAT_FOOTPRINT 12u  // m: a pixel's width there, across the ray; 0: no point
#define SPLAT_TABLE 13u      // uint: the albedo table of the lobe above the diffuse layer, or GLEANER_NONE
#define SPLAT_ROW 14u        // its fractional row
#define SPLAT_KEY 15u        // uint: of random numbers
// A level is how many scatterings before the point its record's light lacks. Points and records of different levels
// have nothing to do with each other. SPLAT_TABLE has it in the bits above those of the table, inverted where there is
// none (kernels/splat/level.h): tables begin in the first 16 million words.
#define SPLAT_LEVEL_SHIFT 24u
#define SPLAT_TABLE_BITS 0xffffffu
#define SPLAT_LEVEL 255u  // above all levels

// What is found: points of diffuse layers; points of rough lobes (has_rough_lobe() of kernels/bsdf/lobe.h); of these,
// at the same places, the lobes themselves (kernels/lobe_rows.h).
#define SPLAT_LAYERS 0u
#define SPLAT_LOBES 1u
#define SPLAT_LOBE_ROWS 2u

// Stage kind "splat_points". An item is a tile; its record has a row for each of its points.
typedef struct {
  Camera camera;
  gl_uint width, height;  // pixels
  gl_uint samples;        // points of a pixel: a power of two
  gl_uint depth;          // most scatterings on a light's way; 0: no limit
  gl_uint seed_low, seed_high;
  gl_uint free_scatterings;  // so many before a point are no part of its level
  gl_uint what;              // SPLAT_LAYERS, SPLAT_LOBES or SPLAT_LOBE_ROWS
  gl_uint order;  // of harmonics: lobes below HARMONIC_LEAST_ALPHA(order) are left out; 0: all rough ones are taken
  gl_uint reserved[3];
} SplatPointParameters;
GLEANER_SIZE(SplatPointParameters, 112);

// A place where irradiance is to be gathered: the row of the point that it was chosen at, of which the words below mean
// something else.
#define SPLAT_RADIUS 9u  // m: the harmonic mean distance, within its bounds; of a shading cluster: how far it reaches
#define SPLAT_ACCURACY 10u  // a; of a shading cluster: the same for normals, as sqrt(1 - n.m)
#define SPLAT_SPACING \
  11u  // m, of a shading cluster: how far its members lie apart; else the mean distance without bounds
// Places of the cache have more words: rows of SPLAT_PLACE_WORDS words.
#define SPLAT_PLACE_WORDS 36u
#define SPLAT_NARROW 16u     // as CACHE_NARROW
#define SPLAT_SHAPED 18u     // uint: 1: Hessians tell how far it reaches; 0: mean distances do
#define SPLAT_CLEARANCE 20u  // as CACHE_CLEARANCE

// Stage kind "splat_gather" (input "places"). An item is a place; its record is a row of the cache.
typedef struct {
  PathParameters samples;    // camera, size and items are not read; the depth is the light's
  gl_uint records;           // items of the stage
  gl_uint polar, azimuthal;  // strata of the hemisphere: azimuthal is a multiple of 16
  gl_uint first_place;       // row of the first item's place
  gl_uint hessian;           // not 0: records get CACHE_HESSIAN
  gl_uint place_stride;      // above 0: items are some of the places, so many rows from one to the next
  gl_uint reserved[2];
} SplatGatherParameters;
GLEANER_SIZE(SplatGatherParameters, 160);
// Strata, at most.
#define SPLAT_MOST_RAYS 65536u

// A record of the cache: rows of CACHE_WORDS words. Gradients are vectors, a colour after the other: W/m^2 per radian
// of rotation about their axis, and per metre.
#define CACHE_WORDS 52u
#define CACHE_POSITION 0u
#define CACHE_NORMAL 3u
#define CACHE_RADIUS 6u        // m: R_k
#define CACHE_IRRADIANCE 7u    // W/m^2, RGB: E_k
#define CACHE_ROTATION 10u     // nabla_r
#define CACHE_TRANSLATION 19u  // nabla_t
#define CACHE_ACCURACY 28u     // a: where eq. 2 gives more than 1 / a, the record counts
#define CACHE_LEVEL 29u        // uint: of its place
#define CACHE_SPARE 30u
#define CACHE_NOISE CACHE_SPARE  // of E_k, over it: half the difference between the means of its even and odd strata
// The record reaches R_k across the vector a s + b t and R_k / sqrt(1 + a^2 + b^2) along it; s and t are the tangents
// of its normal (basis3()). Zeros: equally far along both.
#define CACHE_NARROW 32u
// Of what was gathered with Hessians, until "splat_merge" puts CACHE_NARROW there: second derivatives of the irradiance
// by s s, s t and t t, over it, 1/m^2. Of the mean of the colours.
#define CACHE_HESSIAN 32u
// One over how far the surface is clear about the record, 1/m, in SPLAT_DIRECTIONS directions; 0: nothing stands there.
// Directions and distances are those of the diamond |x| + |y| = 1 about it, in the tangents of its normal: so one over
// the distance to a straight wall is linear between neighbouring directions. A point beyond gets no light of the
// record (kernels/splat/weight.h).
#define CACHE_LEAST_CLEAR 35u  // the largest of them
#define CACHE_CLEARANCE 36u
#define SPLAT_DIRECTIONS 16u

// Stage kind "splat_lobe_gather" (input "places"): incoming radiance. An item is a place; its record is a row of
// RADIANCE_WORDS(order) words.
typedef struct {
  SplatGatherParameters records;
  gl_uint order;  // of hemispherical harmonics: l < order
  gl_uint reserved[3];
} SplatLobeGatherParameters;
GLEANER_SIZE(SplatLobeGatherParameters, 176);
#define SPLAT_MOST_ORDER 10u

// A record of incoming radiance: the words of a record of the cache, of which those of irradiance are not read, and
// then of each pair (l, m), m >= 0, RADIANCE_PAIR_WORDS: the coefficients of the cosine and of the sine, RGB, each
// behind itself with its derivatives along both tangents of the record's normal (basis3()), per metre.
#define RADIANCE_PAIR_WORDS 18u
#define HARMONIC_PAIRS(order) ((order) * ((order) + 1u) / 2u)
#define RADIANCE_WORDS(order) (CACHE_WORDS + RADIANCE_PAIR_WORDS * HARMONIC_PAIRS(order))

// Lobes in hemispherical harmonics (worker/stages/splat/lobe_table.h): rows by alpha, from LOBE_TABLE_LEAST to 1 in
// equal ratios, and by the view's angle to the normal, from 0 to a right one in equal steps.
#define LOBE_TABLE_ALPHAS 12u
#define LOBE_TABLE_VIEWS 24u
#define LOBE_TABLE_LEAST 0.2f
#define LOBE_TABLE_WORDS(order) (2u * HARMONIC_PAIRS(order))

// Stage kind "splat_shade" (inputs "points", of the stage's items, and "cache"). An item is a tile; its record is RGB
// of each of its pixels.
typedef struct {
  gl_uint tiles;
  gl_uint samples;  // as SplatPointParameters
  gl_uint order;    // above 0: the cache is of incoming radiance, and input "lobes" has the points' lobes
  gl_uint reserved;
} SplatShadeParameters;
GLEANER_SIZE(SplatShadeParameters, 16);

#ifndef __OPENCL_VERSION__
// Stage kind "splat_select" (inputs "points" and, where there are records already, "given": their places); solo. One
// item: the places of all records, those given first.
struct SplatSelectParameters {
  std::uint32_t width = 0, height = 0, samples = 0;  // as SplatPointParameters
  float accuracy = 0;                                // a; 0: every point is a place
  std::uint32_t most_new = 0;                        // places beside the given ones, at most; 0: no limit
  std::uint32_t probe_rays = 0;                      // that tell a place's mean distance: a multiple of 16
  float least_radius = 0, most_radius = 0;           // of R_k, in pixels
  std::uint32_t block_tiles = 0;    // edge of blocks that are visited side by side; 0: the whole picture
  std::uint32_t keep_accuracy = 0;  // not 0: no finer than the given places'
  std::uint32_t reserved[2] = {};
};
static_assert(sizeof(SplatSelectParameters) == 48);

// Stage kind "splat_extend" (input "given", or none); solo: the same for what a camera sees, whose points are made on
// the way and not kept. Width, height and samples of both parts are the same.
struct SplatExtendParameters {
  SplatPointParameters points;
  SplatSelectParameters select;
};
static_assert(sizeof(SplatExtendParameters) == 160);

struct SplatSelectFacts {
  std::uint64_t points = 0, records = 0, given = 0, rounds = 0, probes = 0;
  double accuracy = 0;  // that the records were chosen with: above the one asked for where there were too many
};

// Stage kind "splat_shape" (inputs "places" and "records": what was gathered at these, with Hessians); solo. One item:
// the same places, which reach as far as the Hessians say.
struct SplatShapeParameters {
  float least_radius = 0, most_radius = 0;  // of R_k, in pixels
};
static_assert(sizeof(SplatShapeParameters) == 8);

// Stage kind "splat_merge" (inputs "places" and "records.0", "records.1", ...: what was gathered at them, in their
// order); solo. One item: the cache, with the places' radii and accuracy.
struct SplatMergeParameters {
  std::uint32_t records = 0;
  std::uint32_t reserved = 0;
};
static_assert(sizeof(SplatMergeParameters) == 8);

// Stage kind "splat_smooth" (input "cache"); solo. One item: the same records, each blended with its neighbours.
struct SplatSmoothParameters {
  std::uint32_t reserved[2] = {};
};
static_assert(sizeof(SplatSmoothParameters) == 8);

// Stage kind "splat_judge" (inputs "points" and "cache"); solo. One item, no records: what a look at a cache tells.
struct SplatJudgeParameters {
  std::uint32_t samples = 0;  // as SplatPointParameters
  std::uint32_t pixels = 0;   // that are looked at, at most
};
static_assert(sizeof(SplatJudgeParameters) == 8);

// Means over pixels and channels, in radiance and its square.
struct SplatJudgeFacts {
  std::uint64_t pixels = 0;     // that were looked at
  double mean = 0, square = 0;  // of the cache's light
  double noise = 0;             // squared error that the records' own noise makes
  double sampling = 0;          // squared error of a pixel's few points
  double spread = 0;            // of what several records say of one point: their variance, less that of their noise
};

}  // namespace gleaner::kernels
#endif

#endif
