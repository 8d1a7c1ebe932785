// What stages take and give, as bytes on the wire and as kernels read them. Compiled by OpenCL C and by C++;
// little-endian.
#ifndef GLEANER_KERNELS_STAGE_RECORDS_H
#define GLEANER_KERNELS_STAGE_RECORDS_H

#include "scene/model/records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
using scene::Camera;
#endif

// Samples of one item at most: an item's samples are consecutive points of an Owen-scrambled Sobol sequence.
#define GLEANER_PATH_MAX_ITEM_SAMPLES 64
// Points of a sequence before the pixel begins another one.
#define GLEANER_PATH_SEQUENCE 4096u

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
  // 1: light that reaches the first non-specular surface straight from another one is left to virtual point lights
  // (kernels/vpl.cl), but for what they clamp and for lobes that are not rough; records then end with three words more,
  // the sums of what was clamped.
  gl_uint covered;
  gl_float clamp;  // covered: the geometry term's bound, 1/m^2; infinity: none
  gl_uint reserved[3];
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
#define VPL_DEPTH 15u     // VPLs: scatterings on the light's way, this one included (float)
#define VPL_FIRST \
  15u                  // clusters: row of the first of their members, which follow each other; members: their
                       // cluster's row (uint)
#define VPL_COUNT 16u  // clusters: members (float)
#define VPL_ERROR 17u  // bound of the position's rounding
#define VPL_COS 20u    // clusters: least cosine between the normal and a member's
// A rough lobe (bsdf.h): of VPL_FLUX, sent * mean_lobe() is its part.
#define VPL_SENT 21u      // RGB: W that the surface scatters, or 0
#define VPL_F0 24u        // RGB: colour of the lobe at normal incidence
#define VPL_F90 27u       // and at grazing incidence
#define VPL_ALPHA 28u     // 0: no rough lobe
#define VPL_INCOMING 29u  // unit vector towards where the light came from

// Most VPLs of a light path: where it would leave more, it leaves half as many of twice the flux.
#define VPL_PATH_SLOTS 8u

// Stage kind "vpl_trace". An item is a light path; its record is VPL_PATH_SLOTS rows of VPL_WORDS.
typedef struct {
  gl_uint items_low, items_high;
  gl_uint depth;  // most scatterings that end in a VPL; 0 = until Russian roulette ends the path
  gl_uint set;    // sets are independent of each other
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
#define POINT_COS 15u  // clusters: least cosine between the normal and a member's

// A point's rough lobe: rows of LOBE_WORDS words beside those of the points.
#define LOBE_WORDS 16u
#define LOBE_VIEW 0u        // unit vector towards the viewer
#define LOBE_THROUGHPUT 3u  // RGB
#define LOBE_F0 6u          // RGB: colour at normal incidence
#define LOBE_F90 9u         // and at grazing incidence
#define LOBE_ALPHA 10u      // 0: no rough lobe

// Camera paths that end at the first surface with a diffuse layer. Stage kinds "vpl_points" and "vpl_shade".
typedef struct {
  Camera camera;
  gl_uint width, height;  // pixels
  gl_uint samples;        // of a pixel in this set: a power of two, at most 64
  gl_uint set;
  gl_uint seed_low, seed_high;
  gl_uint items_low, items_high;
  gl_uint depth;           // most scatterings on a light's way; 0 = without end
  gl_uint stride;          // vpl_points: item i is pixel i * stride, sample i % samples
  gl_uint clusters;        // vpl_shade: rows of the input "lights", a multiple of 32 * samples; sample j of a pixel
                           // sees one slice of clusters / samples rows. The input "members" (maybe of no rows) goes on
                           // where those rows end: clusters' members
  gl_uint point_clusters;  // vpl_shade: rows of the input "points"; 0: every point asks for itself
  gl_uint fuzziness;       // clusters a point belongs to
  gl_uint equal_weights;   // 1: eq. 8, else eq. 9-10
  gl_float clamp;          // bound of the geometry term, 1/m^2; infinity: none
  gl_float doubt;  // a point asks itself for a light that would bring it more than this share of its light, for lesser
                   // ones by lot; 0: none, and points near no cluster ask for all
} VplPointParameters;
GLEANER_SIZE(VplPointParameters, 128);

// Stage kinds "vpl_cluster" (input "lights": rows of VPL_WORDS) and "point_cluster" (input "points"); solo. An item is
// a cluster; its record is a row of VPL_WORDS or POINT_WORDS words, of flux 0 or triangle GLEANER_NONE where empty.
// vpl_cluster says behind its clusters which one each of the lights is in: uints, in the lights' order, in rows of
// VPL_WORDS.
typedef struct {
  gl_uint clusters;
  gl_uint iterations;
  gl_float least_cosine;  // eq. 7: nt
  gl_uint draw;    // 0: the member nearest to the centroid stands for its cluster; else one drawn by what it sends, by
                   // this key: the mean over many keys is what all members would give
  gl_uint lights;  // rows of "lights", all of some flux
  gl_uint reserved[3];
} ClusterParameters;
GLEANER_SIZE(ClusterParameters, 32);

// Stage kind "vpl_visibility" (inputs "lights", "points"). An item is a point cluster; its record is a bit a light, 32
// to a word, then how many were not asked because they face away, and how many because they bring next to nothing.
#define VISIBILITY_COUNTS 2u
typedef struct {
  gl_uint clusters;        // rows of "lights", a multiple of 32
  gl_uint point_clusters;  // rows of "points"
  gl_float clamp;          // bound of the geometry term, 1/m^2
  gl_float least;  // of what a light would bring in the mean if nothing stood between: what can bring less is not asked
} VisibilityParameters;
GLEANER_SIZE(VisibilityParameters, 16);

// Normals that may share a cluster, and points that a cluster may speak for: eq. 7's threshold nt, sqrt(3) / 2.
#define CLUSTER_LEAST_COSINE 0.8660254f

// A cluster nearer than so many times its radius shines from its members' places, not from its representative's. On
// white-room (4000 clusters of 10000 VPLs) the error is 11.7 % without it, 8.0, 7.5, 7.2 and 7.1 % for 2, 4, 8 and 16.
#define NEAR_RADII 4.0f

// Of 32 lights in a row: the box about them (its middle, half its edges) and the luminance of the brightest.
#define LIGHT_BOX_WORDS 8u
#define LIGHT_BOX_BRIGHTEST 6u

#define MOST_FUZZINESS 8u
#define MOST_DOUBTS 128u  // lights that a point asks for itself
// A doubt: a light's row, and why it is asked for.
#define DOUBT_LIGHT 0xffffffu      // in "lights", or behind them in "members"
#define DOUBT_BY_LOT 0x80000000u   // its answer corrects what clusters said of many
#define DOUBT_CERTAIN 0x40000000u  // it would have been asked for whatever the lot
#define DOUBT_AGREED 0x20000000u   // the point's clusters agree on it
#define DOUBT_THIN 0x10000000u     // of its neighbours only some were looked at

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::kernels
#endif

#endif
