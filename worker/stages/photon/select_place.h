#pragma once
// Photons' places, and their division at a median, which most of the time of making a photon map goes into.

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

namespace gleaner::worker {

// The photon's number stands as bits behind the coordinates, so that four words are read and compared as one vector.
struct PhotonPlace {
  std::array<float, 4> words;
  float at(unsigned axis) const { return words[axis]; }
  std::uint32_t photon() const { return std::bit_cast<std::uint32_t>(words[3]); }
};

// Along an axis; equal places keep the photons' order: the same division everywhere.
inline bool is_before(const PhotonPlace& a, const PhotonPlace& b, unsigned axis) {
  return static_cast<unsigned>(a.at(axis) < b.at(axis)) |
         (static_cast<unsigned>(!(b.at(axis) < a.at(axis))) & static_cast<unsigned>(a.photon() < b.photon()));
}

// Divides `places` as std::nth_element does: what is before place `middle` (below their number) along the axis comes
// first. Quickselect by a partition without branches (Lomuto's): a comparison's outcome is as good as random, and a
// mispredicted branch takes longer than moving a place.
inline void select_place(std::span<PhotonPlace> places, std::size_t middle, unsigned axis) {
  constexpr std::size_t few = 32;
  const auto before = [axis](const PhotonPlace& a, const PhotonPlace& b) { return is_before(a, b, axis); };
  for (int rounds = 64; places.size() > few && rounds > 0; --rounds) {
    // The median of five, for the pivot: it goes to the end.
    const std::size_t step = places.size() / 5, last = places.size() - 1;
    std::array<std::size_t, 5> at = {0, step, 2 * step, 3 * step, last};
    std::ranges::sort(at, [&](std::size_t a, std::size_t b) { return before(places[a], places[b]); });
    std::swap(places[at[2]], places[last]);
    const PhotonPlace pivot = places[last];
    std::size_t first_after = 0;
    for (std::size_t i = 0; i < last; ++i) {
      // Compared where it lies: taken out of a vector register again, its words come late.
      const unsigned is_first = is_before(places[i], pivot, axis);
      std::swap(places[i], places[first_after]);
      first_after += is_first;
    }
    std::swap(places[first_after], places[last]);
    if (first_after == middle) return;
    if (middle < first_after) {
      places = places.first(first_after);
    } else {
      places = places.subspan(first_after + 1);
      middle -= first_after + 1;
    }
  }
  std::nth_element(places.begin(), places.begin() + static_cast<std::ptrdiff_t>(middle), places.end(), before);
}

}  // namespace gleaner::worker
