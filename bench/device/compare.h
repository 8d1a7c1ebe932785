#pragma once
// Records of two devices against each other. Devices round functions otherwise, so that now and then a path takes
// another turn: a few records may differ by much, most must differ by little, and their sum by next to nothing.

#include <string>

#include "bench/device/recorded.h"

namespace gleaner::bench {

// What a stage's records may differ by.
struct Bound {
  double tolerance = 0;  // of a number, relative to the larger of it and its column's mean size
  double share = 0;      // of the rows, that may differ by more
  double sum = 0;        // of a column's sum, relative to the sum of its sizes
};

struct Comparison {
  Bound bound;
  std::uint64_t rows = 0, differ = 0;
  double worst_sum = 0;
  std::string error{};  // sizes that differ, numbers that are not finite
  bool holds() const {
    return error.empty() && static_cast<double>(differ) <= bound.share * static_cast<double>(rows) &&
           worst_sum <= bound.sum;
  }
};

Comparison compare_records(const RecordedBatch& expected, const scene::Bytes& found);

}  // namespace gleaner::bench
