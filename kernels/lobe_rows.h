// Rough lobes of the points that a camera sees (kernels/transport/surface_points.h). Compiled by OpenCL C and by C++.
#ifndef GLEANER_KERNELS_LOBE_ROWS_H
#define GLEANER_KERNELS_LOBE_ROWS_H

// A point's rough lobe: rows of LOBE_WORDS words beside those of the points.
#define LOBE_WORDS 16u
#define LOBE_VIEW 0u        // unit vector towards the viewer
#define LOBE_THROUGHPUT 3u  // RGB
#define LOBE_F0 6u          // RGB: colour at normal incidence
#define LOBE_F90 9u         // and at grazing incidence
#define LOBE_ALPHA 10u      // 0: no rough lobe

#endif
