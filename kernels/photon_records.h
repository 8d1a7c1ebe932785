// Records of photon maps (kernels/photon/).
#ifndef GLEANER_KERNELS_PHOTON_RECORDS_H
#define GLEANER_KERNELS_PHOTON_RECORDS_H

#include "kernels/splat_records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
#endif

// A photon: 32 bytes.
#define PHOTON_WORDS 8u
#define PHOTON_POSITION 0u
#define PHOTON_POWER 3u  // W, RGB: what arrives, weighed for the normal for shading
#define PHOTON_ARRIVAL \
  6u  // uint: the ray that arrived: its direction, octahedral, 12 + 12 bits; from bit 24 on its
      // length, in eighths of octaves (kernels/photon/pack.h)
#define PHOTON_SURFACE \
  7u  // uint: the triangle's normal on the side that it came from, octahedral, 12 + 12 bits; from
      // bit 24 on its class; from bit 27 on its depth: scatterings so far, 31: or more
#define PHOTON_LENGTH_SHIFT 24u
#define PHOTON_CLASS_SHIFT 24u
#define PHOTON_CLASS_MASK 7u
#define PHOTON_DEPTH_SHIFT 27u
// Of a map's photons, whose classes are below PHOTON_CLASSES: the surface goes on all about the photon's block.
#define PHOTON_INNER 0x04000000u
#define PHOTON_MOST_DEPTH 31u

// How a photon came to its surface, by what scattered it last. Broad and sharp parts: kernels/transport/parts.h.
#define PHOTON_DIRECT 0u   // nothing has scattered it
#define PHOTON_BROAD 1u    // a broad part
#define PHOTON_CAUSTIC 2u  // sharp parts alone, since it left its light
#define PHOTON_MIXED 3u    // sharp parts, since a broad part
#define PHOTON_CLASSES 4u
// Of the balance of a path's power (PhotonTraceParameters::balance); no photons.
#define PHOTON_ABSORBED 4u
#define PHOTON_ESCAPED 5u

#define PHOTON_CLASS_BIT(c) (1u << (c))
#define PHOTON_ALL_CLASSES 15u

// Photons that lie by less than this part of their distance below a place's plane are on its surface. Of others, those
// whose light begins at that plane, to within this part of their depth, are covered by it (kernels/photon/map.h):
// lengths are off by 6 %.
#define PHOTON_LEAST_DEPTH 5e-4f
#define PHOTON_COVER_MARGIN 0.25f

// Photons that a path may leave. Of a path that would leave more, this many are kept at random, each of them the more
// powerful for it.
#define PHOTON_PATH_SLOTS 16u

// Stage kind "photon_trace" (input "emission", or none: an emission guide). An item is a light path; its records are
// the photons it leaves, 0 to PHOTON_PATH_SLOTS, and two rows more where a balance is asked for.
typedef struct {
  gl_uint items_low, items_high;  // paths of the whole stage: a photon's power is the flux of its path over these
  gl_uint most_depth;             // a photon's scatterings, at most; GLEANER_NONE: until Russian roulette ends its path
  gl_uint classes;                // that are kept: PHOTON_CLASS_BIT each
  gl_uint pass;
  gl_uint seed_low, seed_high;
  gl_uint balance;  // 1: each path also tells what of its power was absorbed and what left the scene
  gl_uint pilot;    // 1: photons tell what their paths began with, in the place of their power
  gl_uint reserved[3];
} PhotonTraceParameters;
GLEANER_SIZE(PhotonTraceParameters, 48);

// A pilot's photon: the numbers, times 65,536, that its path began with (kernels/transport/light_paths.h).
#define PILOT_LIGHT 3u      // uint: light, u0 << 16
#define PILOT_POINT 4u      // uint: u1, d0 << 16
#define PILOT_DIRECTION 5u  // uint: d1

// An emission guide: how densely light paths' five numbers (light, u0, u1, d0, d1) lie in the unit cube. A tree, rows
// of GUIDE_WORDS words, the root first: a row halves its box along an axis, or is a cell, in which they lie evenly.
#define GUIDE_WORDS 16u
#define GUIDE_NUMBERS 5u
#define GUIDE_AXIS 0u     // uint: of the numbers; GLEANER_NONE: a cell
#define GUIDE_CHILD 1u    // uint: the row of the lower half, the upper one's is the next; behind the row itself
#define GUIDE_SHARE 2u    // of the row's paths that the lower half has: above 0, below 1
#define GUIDE_DENSITY 3u  // of a cell: 1 as without a guide
#define GUIDE_LOWER 4u    // of a cell, five
#define GUIDE_EXTENT 9u   // of a cell, five
#define GUIDE_MOST_ROWS 8191u

// A photon map: rows of PHOTON_WORDS words. Row 0 is the header; then the nodes of a kd-tree in depth-first order, an
// odd number of them; then its leaves, blocks of 16 photons that lie word by word (as rays do: kernels/rays.h). Where
// there are caustic photons and others, these are the root's two children: trees of their own, the caustic one behind.
#define MAP_NODES 0u     // uint
#define MAP_BLOCKS 1u    // uint
#define MAP_PHOTONS 2u   // uint: those of a tree's last block that are none lie far away and have no power
#define MAP_CAUSTICS 3u  // uint: the first node of the caustic photons' tree; the number of nodes: there are none
#define MAP_REACH 4u     // m^2: the largest squared distance that a photon may shine
// How much farther a photon is from a place for being off its plane: squared distance + this * squared height.
#define MAP_FLATNESS 15.0f
// Least cosine between the normals of a place and of a photon's surface.
#define MAP_LEAST_COSINE 0.7f
// A node: the box about its photons; its left child follows it, its right child is where the left one's skip leads.
#define NODE_LOWER 0u
#define NODE_UPPER 3u
#define NODE_BLOCK \
  6u                  // uint: of a leaf, NODE_NO_BLOCK: an inner node; from bit 24 on how far its photons shine: n says
                      // MAP_REACH times the float whose bits are those of 1 less n << NODE_REACH_STEP, quarters of
                      // octaves; of an inner node the farthest
#define NODE_SKIP 7u  // uint: the first node behind all below this one
#define NODE_BLOCK_MASK 0xffffffu
#define NODE_NO_BLOCK 0xffffffu
#define NODE_REACH_SHIFT 24u
#define NODE_REACH_STEP 21u

// An illumination cut: rows of PHOTON_WORDS words. Row 0 is a header as a map's, row 1 is empty; then the boxes of a
// tree of 16 children a node, in groups of 16 that lie word by word; then blocks of up to 16 of the cut's nodes, of
// CUT_WORDS words each. The box of a block is what its nodes reach. Group g of the first level holds the boxes of
// blocks 16 g to 16 g + 15, group g of a later level those of groups 16 g to 16 g + 15 of the level before; the last
// level is one group. Boxes that stand for nothing hold no place. MAP_NODES counts the rows between row 0 and the
// blocks.
#define CUT_BOX_WORDS 6u  // m: lower, upper corner
#define CUT_BOX_ROWS (CUT_BOX_WORDS * RAY_BLOCK / PHOTON_WORDS)
#define CUT_LEVELS 6u
#define CUT_WORDS 12u
#define CUT_PLACE 0u       // m
#define CUT_NORMAL 3u      // of the surface there
#define CUT_NEARNESS 6u    // 1/m^2: one over r_p^2 of eq. 4; 0: no node
#define CUT_IRRADIANCE 7u  // W/m^2, RGB: E_p
#define CUT_ARRIVAL 10u    // uint: of the photon there, as PHOTON_ARRIVAL
#define CUT_SPREAD 11u     // variance of irradiance over the node's area, over E_p squared
// Nodes that a coarse cut may have.
#define PHOTON_MOST_CUT (1u << 22)

// Photons that a density estimate asks for, at most.
#define PHOTON_MOST_NEIGHBOURS 128u

// How a map's density is estimated at a place.
typedef struct {
  gl_uint neighbours;    // photons that count at a place: what is gathered takes those that shine as far, as the map
                         // says; stage kind "photon_caustics" the nearest ones; 0: the radius is `most_radius`
  gl_float most_radius;  // m
} PhotonEstimate;
GLEANER_SIZE(PhotonEstimate, 8);

// Where there is an input "cut", places read it where its nodes are near and agree (kernels/photon/cut.h).
// Not where photons of fewer scatterings than the map's count alone: `cut_depth` are the most that one of them has, 31:
// or more.

// Stage kind "photon_gather" (inputs "map", "cut"): items and records are those of stage kind "path". Where a path has
// left its first surface, the light of the diffuse layers that it meets is read off the map.
typedef struct {
  PathParameters samples;  // the filter holds PATH_CLASS_DIFFUSE and PATH_CLASS_MIXED; in the place of the clamp stands
                           // the spacing, m: a surface nearer than this is not read off the map, the path goes on
  PhotonEstimate estimate;
  gl_uint cut_depth;
  gl_uint order;  // of the harmonics that hold PATH_CLASS_LOBE, where the filter has it
} PhotonGatherParameters;
GLEANER_SIZE(PhotonGatherParameters, 144);

// Stage kind "photon_cluster_gather" (inputs "places", "map", "cut"): items and records are those of stage kind
// "splat_gather", with an order above 0 those of "splat_lobe_gather".
typedef struct {
  // The filter is all that PATH_CLASS_LAYER may take, and CAUSTIC; the clamp is the map's spacing, m.
  SplatGatherParameters records;
  PhotonEstimate estimate;
  gl_uint cut_depth;
  gl_uint order;  // of hemispherical harmonics
} PhotonClusterGatherParameters;
GLEANER_SIZE(PhotonClusterGatherParameters, 176);
// Of a record of irradiance, whose CACHE_SPARE has other numbers until "photon_cluster_smooth": as CACHE_NOISE.
#define CLUSTER_NOISE 34u

// A place where a map is read: rows of 16 words.
#define READ_WORDS 16u
#define READ_POSITION 0u
#define READ_GEOMETRIC 3u  // the triangle's normal, on the viewer's side
#define READ_NORMAL 6u     // for shading
#define READ_TABLE 9u      // uint: the albedo table of the lobe above the diffuse layer, or GLEANER_NONE
#define READ_ROW 10u       // its fractional row
#define READ_FACTOR 11u    // RGB: what irradiance here adds to the picture
#define READ_SLOT 14u      // uint: where it is added
#define READ_LIMITS 15u    // uint: scatterings of a photon, at most; with this bit, caustic photons alone
#define READ_CAUSTICS 0x80000000u

// Stage kind "photon_caustics" (inputs "guide", "map": maps of caustic photons; of the guide's photons the radius is
// made). An item is a pixel; its record is RGB, what the map's photons bring to its samples in the mean.
typedef struct {
  Camera camera;
  gl_uint width, height;  // pixels
  gl_uint samples;        // of a pixel in this pass: a power of two, at most 64
  gl_uint pass;
  gl_uint seed_low, seed_high;
  gl_uint depth;  // most scatterings on a light's way; 0: no limit
  gl_uint reserved;
  PhotonEstimate estimate;
  gl_float shrink;  // factor of the guide's radius
  gl_uint spare[5];
} PhotonCausticsParameters;
GLEANER_SIZE(PhotonCausticsParameters, 128);

// Of a pixel: the squared radius at its first point, m^2, and that point's row of READ_WORDS, uint; GLEANER_NONE: it
// shows none.
#define CAUSTIC_RADIUS_WORDS 2u

#ifndef __OPENCL_VERSION__
// Stage kind "photon_map"; solo. Input "photons". One item: the rows of a map of the photons of these classes.
struct PhotonMapParameters {
  std::uint32_t classes = 0;  // PHOTON_CLASS_BIT each
  std::uint32_t neighbours = 0;
  std::uint32_t shine = 0;  // 1: nodes say how far their photons shine, and rays tell PHOTON_INNER; 0: the map is read
                            // by the photons that are nearest alone
  float most_radius = 0;    // m: no photon shines farther; 0: the map's extent
};
static_assert(sizeof(PhotonMapParameters) == 16);

// Stage kind "photon_cluster" (inputs "points" and, where there are sample points already, "given": their places);
// solo. One item: the places of the clusters' sample points, 0 or more, those given first.
struct PhotonClusterParameters {
  std::uint32_t width = 0, height = 0, samples = 0;  // as SplatPointParameters
  std::uint32_t clusters = 0;                        // from as many as there are points on each is its own cluster
  std::uint32_t iterations = 0;                      // of k-means
  std::uint32_t seed_low = 0, seed_high = 0;
  float kept_footprint = 0;  // a sample that was given stands for points whose footprint is its own over this, or more
  std::uint32_t whole = 0;   // 1: so many clusters are a whole picture's, of which pixels without points take none
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(PhotonClusterParameters) == 48);

// Stage kind "photon_extend" (input "given", or none); solo: the same for what a camera sees, whose points are made on
// the way and not kept. Width, height and samples of both parts are the same.
struct PhotonExtendParameters {
  SplatPointParameters points;
  PhotonClusterParameters clusters;
};
static_assert(sizeof(PhotonExtendParameters) == 160);

struct PhotonClusterFacts {
  std::uint64_t points = 0;  // that pixels show
  std::uint64_t places = 0;  // sample points in all
  std::uint64_t given = 0;   // of these: those that were given
  std::uint64_t strays = 0;  // of these: of points that are too unlike the rest of their cluster
  double reach = 0;          // m: the median
};

// Stage kind "photon_cluster_refine" (inputs "points", "records.0", "records.1", ..., of stage kind
// "photon_cluster_gather", and, where there are such places already, "given"); solo. One item: places of more sample
// points, 0 or more, where what points read of the records may be off most, those given first.
struct PhotonClusterRefineParameters {
  std::uint32_t width = 0, height = 0, samples = 0;  // as SplatPointParameters
  std::uint32_t most = 0;  // places for what these points show, those of the given that they show among them
  float noise = 0;         // of a record, over its irradiance
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(PhotonClusterRefineParameters) == 32);

// Stage kind "photon_extend_refine" (inputs as "photon_cluster_refine", but no points); solo: the same for what a
// camera sees, as "photon_extend".
struct PhotonExtendRefineParameters {
  SplatPointParameters points;
  PhotonClusterRefineParameters refine;
};
static_assert(sizeof(PhotonExtendRefineParameters) == 144);

// Stage kind "photon_cluster_smooth" (inputs "records.0", "records.1", ..., of stage kind "photon_cluster_gather");
// solo. One item: as many rows of the cache as there are records.
struct PhotonClusterSmoothParameters {
  std::uint32_t reserved[4] = {};
};
static_assert(sizeof(PhotonClusterSmoothParameters) == 16);

// Stage kind "photon_cut" (input "map"); solo. One item: the rows of a cut.
struct PhotonCutParameters {
  std::uint32_t nodes = 0;   // of the coarse cut
  std::uint32_t rounds = 0;  // of refinement
  float ratio = 0;           // eq. 3's irradiance may be off by so much of itself
  float spread = 0;          // CUT_SPREAD of a node that is not opened, at most
  PhotonEstimate estimate{};
  std::uint32_t spare[2] = {};
};
static_assert(sizeof(PhotonCutParameters) == 32);

struct PhotonCutFacts {
  std::uint64_t nodes = 0;   // of the cut
  std::uint64_t opened = 0;  // by refinement
  double radius = 0;         // m: the median
};

// Stage kind "photon_guide" (inputs "points" and "photons", those of a pilot); solo. One item: the rows of an emission
// guide. Photons are of use where they lie near what is seen, or near what is read from there.
struct PhotonGuideParameters {
  std::uint32_t width = 0, height = 0, samples = 0;  // as SplatPointParameters
  std::uint32_t paths = 0;                           // of the pilot
  std::uint32_t classes = 0;                         // of photons: PHOTON_CLASS_BIT each
  std::uint32_t gathers = 0;                         // 1: photons are read where rays from the points end; 0: at these
  float near = 0;                                    // m
  std::uint32_t seed_low = 0, seed_high = 0;
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(PhotonGuideParameters) == 48);

struct PhotonGuideFacts {
  std::uint64_t useful = 0;  // paths of the pilot that left a photon of use
  std::uint64_t cells = 0;
  double most = 0;  // the largest density
};

struct PhotonMapFacts {
  std::uint64_t photons = 0, nodes = 0;
  double power[3] = {};  // W, of all its photons
  double radius = 0;     // m: the median, over photons, of a disc that holds `neighbours` of them
};

}  // namespace gleaner::kernels
#endif

#endif
