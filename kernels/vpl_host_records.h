#pragma once
// What stages of method `vpl` that run on a worker's host read and answer: few rows, sums in double precision. Rows are
// those of the method's kernels: VPL_WORDS words a light, POINT_WORDS a point. C++ alone; little-endian.

#include <cstdint>

#include "scene/model/records.h"

namespace gleaner::kernels {

// Stage kind "vpl_resample"; solo. Input "paths": the rows that vpl_trace made of `paths` light paths. One item, of at
// most `count` rows: systematic resampling by flux, the mean picture the same.
struct VplResampleParameters {
  std::uint32_t paths = 0, count = 0;
  std::uint32_t seed_low = 0, seed_high = 0;
  std::uint32_t pass = 0;  // passes are resampled independently
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(VplResampleParameters) == 32);

struct VplResampleFacts {
  std::uint64_t made = 0, kept = 0;  // VPLs of some flux: of the light paths, and drawn
  double density = 0;  // of the first pass: drawn VPLs a square metre of lit surface; 0: fewer than two places
};

// Stage kind "vpl_order"; solo. Inputs "lights": the resampled rows; "clusters": what vpl_cluster made of them, or
// absent: each light is its own cluster. One item: a table of `rows` rows, in slices of equal width, padded by rows of
// no flux; behind it the rows of clusters' members.
struct VplOrderParameters {
  std::uint32_t slices = 1;    // a power of two
  std::uint32_t clusters = 0;  // of the input "clusters", empty ones included
  std::uint32_t reserved[2] = {};
};
static_assert(sizeof(VplOrderParameters) == 16);

struct VplOrderFacts {
  std::uint64_t rows = 0, clusters = 0, members = 0;  // clusters: rows of some flux
};

// Stage kind "vpl_sample_points"; solo. Input "points". Item k is a random row of the k-th part of them.
struct VplSamplePointsParameters {
  std::uint32_t count = 0;
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(VplSamplePointsParameters) == 16);

// Stage kind "vpl_merge_points"; solo. Inputs "points.0", "points.1", ...: what vpl_points made for each camera of a
// trajectory; "cameras": Camera each. One item: the rows that represent all of them.
struct VplMergePointsParameters {
  std::uint32_t cameras = 0;
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(VplMergePointsParameters) == 16);

struct VplMergePointsFacts {
  std::uint64_t points = 0;            // rows
  std::uint64_t most_of_a_camera = 0;  // points that one of the cameras sees at most
};

// Stage kind "vpl_skipped"; split. Input "visibility": own items. An item's record: how many of its queries were not
// made, because the clusters face away from each other, and because the light can contribute next to nothing.
struct VplSkippedParameters {
  std::uint32_t lights = 0;  // of a row of the input, a multiple of 32
  std::uint32_t reserved[3] = {};
};
static_assert(sizeof(VplSkippedParameters) == 16);
struct VplSkippedRecord {
  std::uint32_t faced_away = 0, negligible = 0;
};

// --- The pilot: estimates, from a few points of the picture, of the errors that numbers of VPLs and of clusters would
// leave.

struct VplPilotShape {
  static constexpr std::uint32_t points = 160;        // that represent the picture
  static constexpr std::uint32_t lights = 64;         // that they query, a multiple of 32
  static constexpr std::uint32_t neighbours = 6;      // in place of the point clusters a point belongs to
  static constexpr std::uint32_t mean_points = 2048;  // at most, for the mean
  // Points to a cluster, of the points given: neighbours are looked for at these spacings, others are interpolated.
  static constexpr std::uint32_t spacing[] = {2, 8, 32};
  static constexpr std::uint32_t spacings = 3;
  // Clusters of lights: powers of two from 2^first_level on.
  static constexpr std::uint32_t first_level = 4, levels = 10;
  static constexpr std::uint32_t bounds = 4;        // of the geometry term
  static constexpr std::uint32_t path_samples = 4;  // camera paths of a pilot's path item
  static constexpr std::uint32_t queried_points = points * (1 + spacings * neighbours);  // at most
};

// Stage kind "vpl_pilot_points"; solo. Input "points", spread evenly over the picture's pixels, those of triangle
// GLEANER_NONE included. One item: the points that represent the picture, then for each spacing and point its
// neighbours (triangle GLEANER_NONE where it has fewer); no rows where there is no point. Stage kind
// "vpl_pilot_lights"; solo. Input "lights". One item: the lights that are queried; none where none shines.
struct VplPilotRowsParameters {
  std::uint32_t reserved[4] = {};
};
static_assert(sizeof(VplPilotRowsParameters) == 16);

// Stage kind "vpl_pilot"; solo. Inputs "lights", "points", "queried_lights", "queried_points", "visibility" (of these),
// "paths.0", "paths.1" (path records of two chunks a pixel, complement of the VPLs of the least and the highest bound).
// No records; the facts are VplPilotFacts. Light and albedo are taken for grey (the mean of the channels). Squared
// errors are means over the picture's pixels, in radiance squared, of the VPLs' light alone.
struct VplPilotParameters {
  double bounds[VplPilotShape::bounds] = {};  // of the geometry term, 1/m^2, rising
};
static_assert(sizeof(VplPilotParameters) == 32);

struct VplPilotFacts {
  struct Spacing {
    double coherent = 0;  // squared error of all lights' light, if lights were endlessly many
    double single = 0;    // the rest, for one light in place of all
    double disputed = 0;  // mean over points of light squared times the share interpolated wrongly, squared a light
    double queries = 0;   // lights that a point queries itself, times the residual threshold
  };
  // What paths do beside the VPLs of a bound: the variance of one sample a pixel, and the mean radiance.
  struct Paths {
    double variance = 0, mean = 0;
  };
  double mean[VplPilotShape::bounds] = {};       // over all pixels, of the VPLs' light
  double per_light[VplPilotShape::bounds] = {};  // variance of one light in place of all
  // Squared errors of so many clusters, each at the member in its middle, or at one drawn by flux (a variance).
  double middle[VplPilotShape::bounds][VplPilotShape::levels] = {};
  double drawn[VplPilotShape::bounds][VplPilotShape::levels] = {};
  double looked[VplPilotShape::levels] = {};  // lights that a point looks at: near clusters member by member
  Spacing spacings[VplPilotShape::spacings] = {};
  Paths paths[2] = {};
};

}  // namespace gleaner::kernels
