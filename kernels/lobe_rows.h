// Rough lobes of the points that a camera sees (kernels/transport/surface_points.h). Compiled by OpenCL C and by C++.
#ifndef GLEANER_KERNELS_LOBE_ROWS_H
#define GLEANER_KERNELS_LOBE_ROWS_H

// Below this alpha (glTF's roughness, squared) a lobe shows single lights, and is left to paths.
#define ROUGH_LOBE_ALPHA 0.2f

// A point's rough lobe: rows of LOBE_WORDS words beside those of the points.
#define LOBE_WORDS 16u
#define LOBE_VIEW 0u        // unit vector towards the viewer
#define LOBE_THROUGHPUT 3u  // RGB
#define LOBE_F0 6u          // RGB: colour at normal incidence
#define LOBE_F90 9u         // and at grazing incidence
#define LOBE_ALPHA 10u      // 0: no rough lobe

// Below this alpha a lobe is too sharp for hemispherical harmonics of this order: times the cosine and seen at 45
// degrees, GGX is off from its projection by 40 % of itself (rms) at this alpha, whatever the order. Most of that light
// does not tell: it varies less than lobes do (docs/explanation/photon.md).
#define HARMONIC_LEAST_ALPHA(order) (0.9f / (float)(order))

#endif
