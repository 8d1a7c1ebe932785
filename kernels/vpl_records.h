// Records of virtual point lights (kernels/vpl/).
#ifndef GLEANER_KERNELS_VPL_RECORDS_H
#define GLEANER_KERNELS_VPL_RECORDS_H

#include "kernels/lobe_rows.h"
#include "kernels/records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
#endif

// Virtual point lights (VPLs), and clusters of them: rows of VPL_WORDS words. The first line is all that diffuse
// surfaces read of each other.
#define VPL_WORDS 32u
#define VPL_POSITION 0u
#define VPL_NORMAL 3u     // for shading, on the side that the light came from
#define VPL_GEOMETRIC 6u  // of the triangle, on that side
#define VPL_FLUX 9u       // W/sr at a cosine of 1, RGB: what the surface sends on, in the mean; 0: no VPL
#define VPL_TABLE 12u     // uint: the albedo table of the lobe above the diffuse layer, or GLEANER_NONE
#define VPL_ROW 13u       // its fractional row
#define VPL_RADIUS 14u    // clusters: of the sphere about the position that holds every member
#define VPL_DEPTH 15u     // VPLs: scatterings on the light path, this one included (float)
#define VPL_FIRST \
  15u                  // clusters: row of the first of their members, which follow each other; members: their
                       // cluster's row (uint)
#define VPL_COUNT 16u  // clusters: members (float)
#define VPL_ERROR 17u  // bound of the position's rounding
#define VPL_COS 20u    // clusters: least cosine between the normal and a member's
// A rough lobe (kernels/bsdf/lobe.h): of VPL_FLUX, sent * mean_lobe() is its part.
#define VPL_SENT 21u      // RGB: W that the surface scatters, or 0
#define VPL_F0 24u        // RGB: colour of the lobe at normal incidence
#define VPL_F90 27u       // and at grazing incidence
#define VPL_ALPHA 28u     // 0: no rough lobe
#define VPL_INCOMING 29u  // unit vector towards where the light came from

// Most VPLs of a light path: where it would leave more, it leaves half as many of twice the flux.
#define VPL_PATH_SLOTS 8u

// Stage kind "vpl_trace". An item is a light path; it has up to VPL_PATH_SLOTS records, rows of VPL_WORDS.
typedef struct {
  gl_uint items_low, items_high;
  gl_uint depth;  // most scatterings that end in a VPL; 0 = until Russian roulette ends the path
  gl_uint pass;   // passes are independent of each other
  gl_uint seed_low, seed_high;
  gl_uint reserved[2];
} VplTraceParameters;
GLEANER_SIZE(VplTraceParameters, 32);

// Points to be shaded, and clusters of them: rows of POINT_WORDS words.
#define POINT_WORDS 16u
#define POINT_POSITION 0u
#define POINT_NORMAL 3u  // for shading, on the viewer's side
#define POINT_TABLE 6u   // uint, as VPL_TABLE
#define POINT_ROW 7u
#define POINT_WEIGHT 8u  // spare in points; clusters: members (float)
#define POINT_ALBEDO \
  9u  // what a unit of irradiance adds to the pixel, RGB: throughput times the diffuse layer's albedo
#define POINT_TRIANGLE 12u  // uint; GLEANER_NONE: nothing to shade
#define POINT_B1 13u
#define POINT_B2 14u
#define POINT_INSTANCE 14u  // uint, in scenes with instances in place of B2: the triangle's, or GLEANER_NONE
#define POINT_COS 15u       // clusters: least cosine between the normal and a member's

// Camera paths that end at the first surface with a diffuse layer. Stage kinds "vpl_points" and "vpl_shade".
typedef struct {
  Camera camera;
  gl_uint width, height;  // pixels
  gl_uint samples;        // of a pixel in this pass: a power of two, at most 64
  gl_uint pass;
  gl_uint seed_low, seed_high;
  gl_uint items_low, items_high;
  gl_uint depth;           // most scatterings on a light path; 0 = unlimited
  gl_uint stride;          // vpl_points: item i is pixel i / points * stride, sample i % samples
  gl_uint clusters;        // vpl_shade: rows of the input "lights", a multiple of 32 * samples; sample j of a pixel
                           // sees one slice of clusters / samples rows. Behind them lie the members of those that
                           // are clusters
  gl_uint point_clusters;  // vpl_shade: rows of the input "points"; 0: every point queries all lights
  gl_uint fuzziness;       // clusters a point belongs to
  gl_uint equal_weights;   // 1: eq. 8, else eq. 9-10
  gl_float clamp;          // bound of the geometry term, 1/m^2; infinity: none
  // A point queries a light that would contribute more than this share of its light, and lesser ones at random
  // (kernels/vpl/residual.cl); 0: none, and points near no cluster query every light.
  gl_float residual_threshold;
  gl_uint points;  // vpl_points: of each stride-th pixel, 1 or `samples`; 0: 1
  gl_uint reserved[3];
} VplPointParameters;
GLEANER_SIZE(VplPointParameters, 144);

// Stage kind "vpl_visibility" (inputs "lights", "points"). An item is a point cluster; its record is a bit a light, 32
// to a word, then how many were not queried because they face away, and how many because they contribute next to
// nothing.
#define VISIBILITY_COUNTS 2u
typedef struct {
  gl_uint clusters;        // rows of "lights", a multiple of 32
  gl_uint point_clusters;  // rows of "points"
  gl_float clamp;          // bound of the geometry term, 1/m^2
  gl_float cutoff;         // share of the mean contribution of unshadowed lights: lights below it are not queried
} VisibilityParameters;
GLEANER_SIZE(VisibilityParameters, 16);

// A cluster nearer than so many times its radius shines from its members' places, not from its representative's. On
// white-room (4000 clusters of 10000 VPLs) the error is 11.7 % without it, 8.0, 7.5, 7.2 and 7.1 % for 2, 4, 8 and 16.
#define NEAR_RADII 4.0f

// Of 32 lights in a row: the box about them (its middle, half its edges) and the luminance of the brightest.
#define LIGHT_BOX_WORDS 8u
#define LIGHT_BOX_BRIGHTEST 6u

#define MAX_FUZZINESS 8u
#define MAX_RESIDUAL_SAMPLES 128u  // of a point
// A residual sample: a light's row, and why it was selected.
#define RESIDUAL_LIGHT 0xffffffu         // of the input "lights", members included
#define RESIDUAL_STOCHASTIC 0x80000000u  // its answer corrects what clusters said of many
#define RESIDUAL_CERTAIN 0x40000000u     // it would have been selected whatever the random number
#define RESIDUAL_AGREED 0x20000000u      // the point's clusters agree on it
#define RESIDUAL_SUBSAMPLED 0x10000000u  // of its neighbours only some were looked at

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::kernels
#endif

#endif
