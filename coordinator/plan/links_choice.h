#pragma once
// How many vertices, directions and light samples method `links` takes where they are not set: such that the light
// between vertices is off by a part of what the paths beside it are. Pure.

#include <cstdint>
#include <optional>
#include <span>

#include "kernels/links_records.h"

namespace gleaner::coordinator {

struct LinksCounts {
  std::uint32_t vertices = 0;       // 0: the scene's own
  bool beside_own = false;          // these do not count among `vertices`
  std::uint32_t directions = 0;     // of an element: the square of a multiple of 4
  std::uint32_t light_samples = 0;  // of an element: a multiple of 16
};

// What was set, and stays.
struct GivenLinksCounts {
  std::optional<std::uint32_t> vertices{}, directions{}, light_samples{};
};

// Vertices of so many triangles of a closed surface.
double own_vertices(double triangles);

// What a picture is to be.
struct LinksTarget {
  std::uint64_t pixels = 0;
  std::uint32_t spp = 0;  // samples of a pixel
  double error = 0;       // above 0: RMSE over the mean radiance, whatever the samples
  bool denoised = false;  // the paths' noise is taken out of it; light between vertices stays as it is
};

// `triangles`: of the scene.
LinksCounts choose_links_counts(double triangles, const LinksTarget& target, const GivenLinksCounts& given);

// What an audit found: means over pixels and channels.
struct LinksError {
  double mean = 0;       // radiance
  double truth = 0;      // the same by the audit's own rays
  double square = 0;     // the squared error
  double deviation = 0;  // standard error of `square`
  double noise = 0;      // the part of it that directions make
  std::uint64_t pixels = 0;

  double upper() const;          // of the squared error
  double interpolation() const;  // the part of it that is no noise
};
// Rays of elements that hide behind walls (kernels/links_records.h), where others have so many: what they send is seen
// by few, and interpolated where nothing else is.
std::uint32_t hidden_directions(std::uint32_t directions);
// Rays of each half of an audit: fewer than a vertex has, for more points. Errors are large at few places.
std::uint32_t audit_directions(std::uint32_t directions);
// `records`: rows of AUDIT_WORDS, `points` of each pixel; `counts`: of the links.
LinksError links_error(std::span<const float> records, std::size_t points, const LinksCounts& counts);

// What links of these counts were found to be is known: counts that leave enough of `squared_error`, the whole
// picture's, to the paths. None: these do, or nothing may be changed.
std::optional<LinksCounts> better_links_counts(const LinksCounts& counts, const LinksError& found, double squared_error,
                                               const GivenLinksCounts& given);

}  // namespace gleaner::coordinator
