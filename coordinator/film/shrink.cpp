#include "coordinator/film/shrink.h"

#include <algorithm>

#include "scene/model/error.h"

namespace gleaner::coordinator {

Film shrink(const Film& film, std::uint32_t longest_side) {
  const std::uint32_t block = (std::max(film.width, film.height) + longest_side - 1) / longest_side;
  if (block <= 1) return film;
  Film small{(film.width + block - 1) / block, (film.height + block - 1) / block, {}};
  for (const char* name : {"R", "G", "B"}) {
    const Channel* from = film.find(name);
    if (!from) throw Error::failed("a picture without RGB");
    std::vector<float>& to = small.channel(name).values;
    std::vector<double> sums(small.width);
    for (std::uint32_t y = 0; y < small.height; ++y) {
      std::ranges::fill(sums, 0);
      const std::uint32_t end = std::min(film.height, (y + 1) * block);
      for (std::uint32_t row = y * block; row < end; ++row)
        for (std::uint32_t x = 0; x < film.width; ++x)
          sums[x / block] += from->values[std::size_t{row} * film.width + x];
      for (std::uint32_t x = 0; x < small.width; ++x) {
        const std::uint32_t columns = std::min(block, film.width - x * block);
        to[std::size_t{y} * small.width + x] = static_cast<float>(sums[x] / (columns * (end - y * block)));
      }
    }
  }
  return small;
}

}  // namespace gleaner::coordinator
