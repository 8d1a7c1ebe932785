#pragma once
// Small pictures of large films, for those who only look.

#include "coordinator/film/film.h"

namespace gleaner::coordinator {

// R, G, B alone, of at most `longest_side` pixels a side: means of blocks of pixels, of linear radiance. A film that is
// not larger stays as it is. Throws Error::failed for a film without R, G, B.
Film shrink(const Film& film, std::uint32_t longest_side);

}  // namespace gleaner::coordinator
