#pragma once
// Where records are needed: the cache's filling (Gautron et al. 2005, algorithm 2, steps 3 and 4) in rounds.
//
// The paper visits pixels one after the other, and computes a record where the weights of those before do not suffice.
// Which pixels these are depends on the records' places and mean distances alone, not on their light. So places are
// chosen first, by a few rays each; the light is gathered later, by all workers at once. Blocks of pixels are visited
// side by side: each round takes the next uncovered point of every block, looks how far the surfaces about them are,
// and keeps those, in the blocks' order, that the ones before them do not cover. Rounds end when every point is
// covered. Records that exist are given, and only what they do not cover gets others.

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "worker/stages/splat/points.h"

namespace gleaner::worker {

struct SelectSettings {
  std::uint32_t width = 0, height = 0, samples = 0;  // of the picture; points of a pixel
  float accuracy = 0;                                // a of eq. 3, above 0
  float least_radius = 0, most_radius = 0;           // of R_k, in pixels
  std::uint32_t block_tiles = 2;  // edge of a block in tiles; 0: the whole picture, as the paper has it
  std::uint32_t most_new = 0;     // gives up beyond so many records that were not given; 0: never
  unsigned threads = 1;           // that look for points; places are the same by any number
};

struct Selection {
  struct Place {
    SplatPoint point{};
    float mean = 0;                 // the harmonic mean distance, without bounds, m
    float radius = 0;               // R_k, m
    std::array<float, 2> narrow{};  // CACHE_NARROW
    bool shaped = false;            // Hessians tell the radius: neighbours' mean distances do not change it
    Clearance clearance{};
  };
  std::vector<Place> places;  // those that were given, in their order, and the new ones
  std::uint64_t points = 0, rounds = 0, probes = 0;
  bool whole = false;  // every point is covered
};

struct Surroundings {
  float mean = 0;  // harmonic mean distance to the surfaces about a point, m; 0: none is in sight
  Clearance clearance{};
};
// Those of each of these points.
using ProbePoints = std::function<std::vector<Surroundings>(std::span<const std::uint32_t> points)>;

// `points`: of whole tiles, as kernels/splat_records.h has them. Radii of `given` places may shrink: where this picture
// shows them from nearer by, or a new record finds a surface that their rays missed. Where they are shaped, new places
// near them are shaped like them.
Selection select_places(const SelectSettings& settings, std::span<const SplatPoint> points,
                        std::span<const Selection::Place> given, const ProbePoints& probe);

}  // namespace gleaner::worker
