// The path tracer's buffers. Compiled by OpenCL C and by C++.
#ifndef GLEANER_KERNELS_PATH_LAYOUT_H
#define GLEANER_KERNELS_PATH_LAYOUT_H

#include "kernels/rays.h"

// Surfaces that light passes straight, weakened: what is not opaque, smooth panes, and boundaries of solids that bend
// nothing.
#if (defined(NEED_ALPHA) || defined(NEED_PANES) || defined(NEED_MEDIA)) && defined(CLUSTERS)
#define TRANSPARENT_SHADOWS
#endif

// Rows of a block of 16 paths: the ray and its hit as Embree knows them, then the path's own state.
#define ROW_THROUGHPUT 20u  // times 1 / survival of the roulette
#define ROW_PDF 23u    // density, per steradian, of the ray's direction; 0: lights could not have been sampled there
#define ROW_TOTAL 24u  // LightSample::total where the ray began
#define ROW_SLOT 25u
#define ROW_META 26u
#define ROW_KEY 27u
#define ROW_ETA 28u     // product of n_t / n_i along the path
#define ROW_FILTER 29u  // PATH_FILTER: the path's state (kernels/path_filter.h)
// In scenes with surfaces that light passes straight: the way since the ray's direction was drawn, m. Passing is no
// scattering: emission found beyond weighs against the light samples of where the direction was drawn, for shadow rays
// pass the same surfaces.
#define ROW_TRAVELLED 30u
// In scenes with media: the solids that the path is in (kernels/surface.h), two words.
#define ROW_MEDIA 31u
#define PLAIN_PATH_ROWS 30u
#define TRANSPARENT_PATH_ROWS 31u
#define MEDIA_PATH_ROWS 33u
#if defined(NEED_MEDIA)
#define PATH_ROWS MEDIA_PATH_ROWS
#elif defined(TRANSPARENT_SHADOWS)
#define PATH_ROWS TRANSPARENT_PATH_ROWS
#else
#define PATH_ROWS PLAIN_PATH_ROWS
#endif

// Rows of a block of 16 shadow rays: RTCRay16, then what arrives if nothing is in the way. Where a scene has surfaces
// that light passes straight, its shadow rays pass them too, weakened: they ask for the closest hit.
#define PLAIN_SHADOW_ROWS 16u
#define TRANSPARENT_SHADOW_ROWS 24u
#define MEDIA_SHADOW_ROWS 26u
#ifdef TRANSPARENT_SHADOWS
#define ROW_CONTRIBUTION 20u
#define ROW_SHADOW_SLOT 23u
#ifdef NEED_MEDIA
#define ROW_SHADOW_MEDIA 24u  // as ROW_MEDIA
#define SHADOW_ROWS MEDIA_SHADOW_ROWS
#else
#define SHADOW_ROWS TRANSPARENT_SHADOW_ROWS
#endif
#else
#define ROW_CONTRIBUTION 12u
#define ROW_SHADOW_SLOT 15u  // the slot and the bits below; the slot count: no ray
#define SHADOW_ROWS PLAIN_SHADOW_ROWS
#endif
// How far shadow rays go, the light being at 1.
#define SHADOW_FAR 0.9999999f
#define SHADOW_INDIRECT 0x80000000u
#define SHADOW_INFINITE 0x20000000u     // its light is not at `far` 1
#define SHADOW_COMPENSATES 0x10000000u  // is what the partner of a path filter lacks
#define SHADOW_BITS (SHADOW_INDIRECT | SHADOW_INFINITE | SHADOW_COMPENSATES)
// Of rays between points and virtual point lights.
#define VISIBILITY_ROWS 16u

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

// A path's slot: direct RGB, indirect RGB, (with a path filter: of that, what the partner lacks), padding.
#define PLAIN_SLOT_WORDS 8u
#define FILTERED_SLOT_WORDS 12u
#ifdef PATH_FILTER
#define SLOT_WORDS FILTERED_SLOT_WORDS
#else
#define SLOT_WORDS PLAIN_SLOT_WORDS
#endif
#define SLOT_INDIRECT 3u
#define SLOT_COMPENSATION 6u
// Albedo, normal, depth, 1 where something was hit; emission seen directly.
#define FEATURE_WORDS 12u
#define FEATURE_SEEN 8u

#define COUNTER_ALIVE 0u
#define COUNTER_SHADOW 1u
#define COUNTERS 16u

#ifndef ROULETTE_DEPTH
#define ROULETTE_DEPTH 3u
#endif
#ifndef ROULETTE_MOST
#define ROULETTE_MOST 0.95f
#endif

#endif
