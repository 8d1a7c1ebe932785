// The path tracer's buffers. Compiled by OpenCL C and by C++.
#ifndef GLEANER_KERNELS_PATH_LAYOUT_H
#define GLEANER_KERNELS_PATH_LAYOUT_H

#include "kernels/rays.h"

// Rows of a block of 16 paths: the ray and its hit as Embree knows them, then the path's own state.
#define ROW_THROUGHPUT 20u  // times 1 / survival of the roulette
#define ROW_PDF 23u    // density, per steradian, of the ray's direction; 0: lights could not have been sampled there
#define ROW_TOTAL 24u  // LightSample::total where the ray began
#define ROW_SLOT 25u
#define ROW_META 26u
#define ROW_KEY 27u
#define ROW_ETA 28u  // product of n_t / n_i along the path
#define PATH_ROWS 29u

// Rows of a block of 16 shadow rays: RTCRay16, then what arrives if nothing is in the way.
#define ROW_CONTRIBUTION 12u
#define ROW_SHADOW_SLOT 15u  // the slot, with SHADOW_INDIRECT; the slot count: no ray
#define SHADOW_ROWS 16u
#define SHADOW_INDIRECT 0x80000000u

// ROW_META: scatterings so far, those that were not specular (0, 1, 2 = more), whether a specular one came since, rays
// so far (the random numbers' dimension), the sample's index in its sequence.
#define META_DEPTH_MASK 255u
#define META_DIFFUSE 8u
#define META_SPECULAR_SINCE (1u << 10)
#define META_BOUNCE 11u
#define META_BOUNCE_MASK 255u
#define META_SAMPLE 19u
#define META_SAMPLE_MASK 4095u
#define META_IDLE (1u << 31)

// A path's slot: direct RGB, indirect RGB, two words of padding.
#define SLOT_WORDS 8u
// Albedo, normal, depth, 1 where something was hit.
#define FEATURE_WORDS 8u

#define COUNTER_ALIVE 0u
#define COUNTER_SHADOW 1u
#define COUNTERS 16u

#define REPORTED_ITEMS 8u

#ifndef ROULETTE_DEPTH
#define ROULETTE_DEPTH 3u
#endif
#ifndef ROULETTE_MOST
#define ROULETTE_MOST 0.95f
#endif

#endif
