// What a point's row says in SPLAT_TABLE (kernels/splat_records.h).
#ifndef GLEANER_KERNELS_SPLAT_LEVEL_H
#define GLEANER_KERNELS_SPLAT_LEVEL_H

#include "kernels/lanes.h"
#include "kernels/splat_records.h"

FN vi names_no_table(vu word) { return (word & SPLAT_TABLE_BITS) == SPLAT_TABLE_BITS; }
FN vu table_of_point(vu word) { return pick_u(word & SPLAT_TABLE_BITS, (vu)GLEANER_NONE, names_no_table(word)); }
FN vu level_of_point(vu word) { return (word ^ table_of_point(word)) >> SPLAT_LEVEL_SHIFT; }

#endif
