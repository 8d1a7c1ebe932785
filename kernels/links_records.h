// Records of radiance links between vertices (kernels/links/).
#ifndef GLEANER_KERNELS_LINKS_RECORDS_H
#define GLEANER_KERNELS_LINKS_RECORDS_H

#include "kernels/records.h"

#ifndef __OPENCL_VERSION__
#include <algorithm>
#include <cmath>

namespace gleaner::kernels {
#endif

// --- The mesh: which vertices there are, and between which of them a triangle interpolates ---
//
// A triangle of level l is divided by a regular grid of n = 2^l steps along its edges. Node (i, j) of the grid, i along
// the edge to the second corner and j along that to the third, i + j <= n, has number j (n + 1) - j (j - 1) / 2 + i. A
// node is a vertex, which other nodes at the same place, of the same material and of (nearly) the same normal share.
// Each vertex has two sides: element 2 v is vertex v seen from its front, element 2 v + 1 from its back.
//
// Stage kind "links_mesh"; solo. One item, whose records are words: this header, then the sections
//   triangles   2 words each: number of its first node, level
//   nodes       a word each: its vertex
//   rings       a word a vertex and one more: its first corner; the corners of a vertex follow each other
//   corners     CORNER_WORDS each: the corners of small triangles that meet at a vertex (its one-ring)
//   areas       a float a vertex: a third of its one-ring, m^2
//   places      PLACE_WORDS a vertex: its normal, and the first vertex at the same place
//   hanging     HANGING_WORDS each: vertices on an edge that another triangle divides less, and the two on that edge
//               between which the other triangle interpolates
#define MESH_TRIANGLES 0u
#define MESH_NODES 1u
#define MESH_VERTICES 2u
#define MESH_CORNERS 3u
#define MESH_HANGING 4u
#define MESH_HEADER 16u
#define MESH_TRIANGLE_WORDS 2u
#define MESH_MOST_LEVEL 10u

#define CORNER_WORDS 4u
#define CORNER_TRIANGLE 0u
#define CORNER_PLACE 1u  // uint: i, j << 12, CORNER_KIND << 24
#define CORNER_SHARE 2u  // of the one-ring's area, cumulated
#define CORNER_STEP 3u   // 1 / n
#define CORNER_GRID_MASK 0xfffu
// The grid steps from the corner to the other two of its small triangle: one of six.
#define CORNER_KINDS 6u

#define PLACE_WORDS 4u
#define PLACE_NORMAL 0u
#define PLACE_FIRST 3u  // uint

#define HANGING_WORDS 4u
#define HANGING_VERTEX 0u
#define HANGING_FROM 1u
#define HANGING_TO 2u
#define HANGING_PART 3u  // float: of the way from the one to the other

// With the inputs "coarse", a mesh, and "probe", what links_probe found of it: triangles are divided on where
// irradiance bends, that is where it is not what a triangle interpolates. With the input "divided", a mesh of the same
// triangles in another pose, each is divided as there, and `vertices` is not read.
typedef struct {
  // Wanted: triangles are divided until there are about so many; 0: none is.
  gl_uint vertices;
  // 1: the scene's own do not count among these. 0: they do, as many as closed surfaces of its triangles have.
  gl_uint beside_own;
  gl_uint reserved[2];
} LinksMeshParameters;
GLEANER_SIZE(LinksMeshParameters, 16);

// Stage kind "links_probe" (input "mesh"): an element's irradiance by PROBE_LIGHTS test lights that know nothing of the
// scene's: every surface shines by a smooth random function of the place. Twice, by the even rays and by the odd ones:
// the products of their differences have no noise in the mean.
#define PROBE_LIGHTS 4u
// The share of the rays' hits that are on surfaces' backs: where that is most of them, the element lies inside of
// something (the floor under a box), and nothing is interpolated from it unless it has no neighbour outside.
#define PROBE_BACKS (2u * PROBE_LIGHTS)
// The share of the rays that hit something.
#define PROBE_HITS (PROBE_BACKS + 1u)
#define PROBE_WORDS (PROBE_HITS + 1u)
#define PROBE_MOST_BACKS 0.5f
// An element is hidden where it lies inside of something and its vertex' other side sees fronts in so many rays at
// least: what is behind a wall whose front is in a room. Where a room is seen from its walls' backs, these walls' other
// sides see nothing.
#define PROBE_LEAST_HITS 0.25f

// What kernels are told of that: SIDE_BITS an element, from the lowest of a word on. The host makes it of the probe's
// rows: a few words stay in a core's cache, where rows do not.
#define SIDE_BITS 2u
#define SIDE_INSIDE 1u
#define SIDE_HIDDEN 2u
#define SIDES_OF_WORD 16u

// What the plan is told of a mesh.
typedef struct {
  gl_uint vertices, nodes, divided, triangles;
} LinksMeshFacts;
GLEANER_SIZE(LinksMeshFacts, 16);

// --- Elements ---

// Of stage kinds "links_probe", "links_albedo", "links_make", "links_light": an item is an element, a tile is a vertex.
typedef struct {
  gl_uint elements;    // of the mesh: two a vertex
  gl_uint directions;  // links_make, links_probe: rays of an element, n^2 with n a multiple of 4
  gl_uint samples;     // links_albedo, links_light: of an element, a multiple of 16
  gl_uint seed_low, seed_high;
  gl_uint compress;  // links_make: 1: links of the same end are one
  gl_uint exact;     // links_make: 1: weights are floats, else 16 bits
  gl_float wave;     // links_probe: of the test lights, 1/m
  // links_make: rays of a hidden element, n^2 with n a multiple of 4 and at most `directions`; 0: as many as of others.
  gl_uint hidden_directions;
  gl_uint divided;  // links_probe: 1: only elements of divided triangles send rays; rows of others are 0
  gl_uint reserved[2];
} LinksParameters;
GLEANER_SIZE(LinksParameters, 48);

#define LINKS_MOST_DIRECTIONS 4096u
#define LINKS_MOST_SAMPLES 4096u

// Stage kind "links_albedo" (input "mesh"): the diffuse layer's albedo, RGB, less what the layers above it take, which
// depends on the angle and belongs to the links; then a spare word.
#define ALBEDO_WORDS 4u

// Stage kind "links_make" (inputs "mesh", "probe"): an element's links, counted words: n elements, then n weights, two
// to a word (the first in the low half) in units of 1 / 65535, or as floats. A weight is the share of the element's
// cosine-weighted hemisphere in which it sees the other, at most 1 in sum. Ends are numbered front sides first, then
// back sides: most vertices are seen from one side alone, and what a bounce looks up then lies closely.
#define LINK_END(element, vertices) (((element) >> 1) + ((element)&1u) * (vertices))

// --- Lobe elements: what rough metal sends by direction (kernels/links/lobes.h) ---
//
// Behind the mesh's elements, LOBE_BINS for each of them that has a lobe; as ends of links they have their own number.
// Bins are equal squares of the one that the concentric map takes to the hemisphere about the normal.
#define LOBE_SIDE 4u
#define LOBE_BINS 16u

// Stage kind "links_lobes" (input "mesh"); solo. One item, whose records are words: for each of the mesh's
// elements its number among those that have a lobe, or GLEANER_NONE; then those elements. No parameters but these.
typedef struct {
  gl_uint elements;  // of the mesh
  gl_uint reserved[3];
} LinksLobesParameters;
GLEANER_SIZE(LinksLobesParameters, 16);

#ifndef __OPENCL_VERSION__
struct LinksLobesFacts {
  std::uint32_t lobes = 0, reserved = 0;
};
#endif
// With the input "lobes" (of stage kind "links_lobes"; "links_audit" then reads "albedo" as well), stages
// "links_albedo", "links_make", "links_light", "links_flux", "links_exchange" and "links_audit" have elements of lobes
// behind those of the mesh. An albedo of a lobe element is its colour alone, by its luminance; links weigh that.

// Stage kinds "links_light" (inputs "mesh", "albedo": own items) and "links_gather" (inputs "links", "light", "albedo":
// own items; "radiosity": whole): rows of RADIOSITY_WORDS.
#define RADIOSITY_WORDS 8u
#define RADIOSITY_IRRADIANCE 0u  // RGB: of the direct light (links_light), or of all light from other elements
#define RADIOSITY_NOISE 3u       // links_gather: standard deviation of the irradiance, of its noisiest channel
#define RADIOSITY_OUTSIDE 3u     // links_smooth: 1 where the element lies in the open, else 0
#define RADIOSITY_SENT 4u        // RGB: what the element sends: albedo times all irradiance, W/m^2

typedef struct {
  gl_uint elements;
  gl_uint exact;       // as of links_make
  gl_uint directions;  // as of links_make; 0: noise is not told
  gl_uint plain;       // elements of the mesh: those behind them are of lobes
} LinksGatherParameters;
GLEANER_SIZE(LinksGatherParameters, 16);

// Stage kind "links_flux" (inputs "mesh", "radiosity", "before", "earlier": rows after a bounce and after the two
// before it); solo. No records; facts: what all elements send, and how that grows.
typedef struct {
  gl_uint elements;
  gl_uint reserved[3];
} LinksFluxParameters;
GLEANER_SIZE(LinksFluxParameters, 16);

#ifndef __OPENCL_VERSION__
// Sums over elements, of each channel, W. The bounce before the last added d' to what an element sends, the last d:
struct LinksFluxFacts {
  double flux[3] = {};     // what all send
  double grown[3] = {};    // d
  double earlier[3] = {};  // d'
  double strayed[3] = {};  // |d - r d'|, where r is the ratio of the two sums above
};

// Bounces until what is left out of the light is less than a share of it. Bounces shrink by a ratio that soon is
// steady, so that those to come are told by the last one, element by element: its tail is d r / (1 - r) in each
// channel. With T for one bounce, the tail is off by (1 - T)^-1 T (d - r d') / (1 - r), and so by r / (1 - r)^2 times
// what d strays from r d' at most, as far as T shrinks no light by less than r. That ratio still grows a little:
// kTailMargin. Light is measured after bounce 2, and then after as many as that error asks for.
struct LinksBounces {
  static constexpr double kTailMargin = 1.25;
  // Of the tail's error at each bounce, by 0.35 to 0.55 (cornell-box, hall, sponza-dabrovic).
  static constexpr double kShrinks = 0.4;

  bool adds_tail = true;             // false: bounces are limited, and those to come must not be told
  std::uint32_t done = 0, next = 2;  // measured last; to be measured next
  double left = 0;                   // the share of the light that is left out, or that its tail is off by
  float tail[3] = {};                // of what the last bounce added

  static double ratio(const LinksFluxFacts& facts, unsigned c) {
    return facts.earlier[c] > 0 ? std::clamp(facts.grown[c] / facts.earlier[c], 0.0, 0.99) : 0.0;
  }

  // After bounce `next`: whether the light is all there but for `least_share`; else `next` is further on.
  bool is_enough(const LinksFluxFacts& facts, double least_share) {
    constexpr double luminance[3] = {0.2126, 0.7152, 0.0722};
    done = next;
    double all = 0, out = 0, most = 0;
    for (unsigned c = 0; c < 3; ++c) {
      const double r = ratio(facts, c), to_come = r / (1 - r);
      all += luminance[c] * facts.flux[c];
      out += luminance[c] * (adds_tail ? kTailMargin * facts.strayed[c] / (1 - r) : facts.grown[c]) * to_come;
      most = std::max(most, r);
      if (adds_tail) tail[c] = static_cast<float>(to_come);
    }
    left = all > 0 ? out / all : 0;
    if (left < least_share) return true;
    // At most as many again: the ratio is not known that well.
    const double shrinks = adds_tail ? kShrinks : most;
    ++next;
    for (double then = left * shrinks; then >= least_share && next < 2 * done; then *= shrinks) ++next;
    return false;
  }
};
#endif

// Stage kind "links_exchange" (inputs "mesh", "links", "light", "albedo": whole); solo. All bounces at once, on one
// worker: the rows that "links_smooth" has of as many "links_gather" stages, with the tail, to the bit. Facts:
// LinksExchangeFacts.
typedef struct {
  gl_uint elements;
  gl_uint exact;         // as of links_make
  gl_uint most_bounces;  // 1 or more
  gl_float least_share;  // bounces end where those to come would add less (LinksBounces); 0: at most_bounces alone
  gl_uint directions;    // as of links_gather
  gl_uint plain;         // likewise
  gl_uint adds_tail;     // 1: bounces to come are added (LinksBounces)
  gl_uint reserved;
} LinksExchangeParameters;
GLEANER_SIZE(LinksExchangeParameters, 32);

#ifndef __OPENCL_VERSION__
struct LinksExchangeFacts {
  std::uint32_t bounces = 0, reserved = 0;
  double left = 0;
};
#endif

// Stage kind "links_smooth" (inputs "mesh", "probe", "irradiance", and "before" where there is a tail: rows of the
// bounce before); solo, an item an element: rows of RADIOSITY_WORDS. Bounces to come are added first (LinksBounces).
// Irradiance is smoothed over the one-ring within feature edges (eq. 5-6), by no more in any channel than the
// RADIOSITY_NOISE of these elements (root mean square), and what hangs on an edge is put on it.
// Rows of lobe elements, behind those of the mesh, stay as they are.
typedef struct {
  gl_uint elements;
  gl_float least_cosine;  // between the normals of neighbours that are smoothed; above 1: none is
  gl_float tail[3];       // of what the last bounce added, RGB; 0: none
  gl_uint reserved[3];
} LinksSmoothParameters;
GLEANER_SIZE(LinksSmoothParameters, 32);

// Stage kind "links_shade" (inputs "mesh", "irradiance": rows of RADIOSITY_WORDS): VplPointParameters; an item is a
// pixel, its record the mean radiance of its samples, RGB.

// Stage kind "links_audit" (inputs "mesh", "probe", "irradiance": rows of RADIOSITY_WORDS, and "points": rows of
// POINT_WORDS, kernels/vpl_records.h): LinksParameters, whose elements are the points; an item is a point. Its record
// is what the pixel shows of the light between vertices, RGB; twice what it would show of the mean over as many rays
// from the point itself as a vertex has, with direct light from where they end; and twice the same with what the
// elements send in place of this. The first two are independent of each other and of what is shown, but for bounces
// before the last: the product of both differences is the squared error, without bias. The last two differ by a vertex'
// noise.
#define AUDIT_WORDS 15u
#define AUDIT_SHOWN 0u
#define AUDIT_HALVES 3u
#define AUDIT_BY_ELEMENTS 9u

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::kernels
#endif

#endif
