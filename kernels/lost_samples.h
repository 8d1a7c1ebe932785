// Samples that are not finite: kernels that make records leave them out, and report them (FiniteReport of
// worker/wavefront/counters.h).
#ifndef GLEANER_KERNELS_LOST_SAMPLES_H
#define GLEANER_KERNELS_LOST_SAMPLES_H

#include "kernels/lanes.h"
#include "kernels/records.h"

// Whether `count` words from there on are finite numbers.
FN int finite_words(global const float* words, uint count) {
  int fine = 1;
  for (uint k = 0; k < count; ++k) fine = fine && fabs(words[k]) <= 3.402823466e38f;
  return fine;
}

// So many samples of an item were left out.
FN void report_lost(global uint* report, uint item, uint lost) {
  if (!lost) return;
  atomic_add(report, lost);
  uint at = atomic_inc(report + 1);
  if (at < REPORTED_ITEMS) report[2 + at] = item;
}

#endif
