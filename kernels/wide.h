// Lets PoCL's compiler use registers of 512 bits: by itself it halves them.
#ifndef GLEANER_KERNELS_WIDE_H
#define GLEANER_KERNELS_WIDE_H

#ifdef __has_attribute
#if __has_attribute(min_vector_width)
#define WIDE __attribute__((min_vector_width(512)))
#endif
#endif
#ifndef WIDE
#define WIDE
#endif

#endif
