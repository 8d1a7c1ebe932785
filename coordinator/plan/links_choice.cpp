#include "coordinator/plan/links_choice.h"

#include <algorithm>
#include <cmath>

#include "coordinator/plan/noise_left.h"

namespace gleaner::coordinator {
namespace {

// Fitted to cornell-box. A sample a pixel of what the links leave to paths is noisy by so much of the picture's mean.
constexpr double kSampleError = 0.14;
constexpr double kLeastSamples = 4;

// So is the light of vertices with a direction each, and so far is what 1,000 vertices interpolate off, in a picture of
// which a third is that light. The squares fall by these powers.
constexpr double kDirectionNoise = 0.39, kOrderOfDirections = 1.25;
constexpr double kInterpolation = 0.026, kOrderOfVertices = 0.86;
// A scene of many triangles has edges that want vertices, on any scale.
constexpr double kUsualTriangles = 2000;
// Where no error was promised, links cost no more than so many times the paths.
constexpr double kRaysOfASample = 8;
// ... nor of those that are denoised, where links soon take most of the time.
constexpr double kRaysOfADenoisedSample = 2;
constexpr double kLeastVertices = 500, kMostVertices = 1u << 18;
constexpr double kLeastDirections = 64, kMostDirections = 1024;
// Of all elements: their links take 9 bytes a ray, as seen.
constexpr double kMostRays = 1.5e8;
// Noise of the direct light at vertices does not show beside that of directions: many vertices share it.
constexpr double kDirectionsOfALightSample = 16;

// Of the picture's squared error, at most: the paths', what directions and what interpolation do. Beyond the last two
// links are made anew.
constexpr double kPathShare = 0.6, kNoiseShare = 0.15, kInterpolationShare = 0.25;
constexpr double kMostNoiseShare = 0.3, kMostInterpolationShare = 0.4, kMostStep = 16;
// Of a vertex' squared noise, what is left of it between three of them: the mean of the squared weights' sum over a
// triangle.
constexpr double kNoiseBetween = 0.5;
constexpr double kAuditPart = 4;

// The nearest square of a multiple of 4.
std::uint32_t directions_of(double directions) {
  const auto side =
      static_cast<std::uint32_t>(std::lround(std::sqrt(std::clamp(directions, kLeastDirections, kMostDirections)) / 4));
  return 16 * side * side;
}

// With so many directions, beside so many that are there anyway.
std::uint32_t vertices_of(double vertices, double directions, double own) {
  const double most =
      std::max(kLeastVertices, std::clamp(kMostRays / (2 * directions), kLeastVertices, kMostVertices) - own);
  return static_cast<std::uint32_t>(std::lround(std::clamp(vertices, kLeastVertices, most)));
}

// Vertices beside the scene's own, and directions, for the least rays. The scene's own say nothing of what the large
// triangles among them interpolate: a wall's corners lie in the dark corners of its room. Own vertices need directions,
// too: where most are own, more of the others cost little, and directions are dear.
struct Balanced {
  double vertices, directions;
};
Balanced balanced(double triangles, double squared_error) {
  Balanced found{};
  double added = 1;  // of all vertices
  for (int step = 0; step < 8; ++step) {
    const double ratio = kNoiseShare / (kInterpolationShare * added);
    const double noise_share = (kNoiseShare + kInterpolationShare) * ratio / (1 + ratio);
    const double interpolation_share = kNoiseShare + kInterpolationShare - noise_share;
    found.directions =
        std::pow(kDirectionNoise * kDirectionNoise / (noise_share * squared_error), 1 / kOrderOfDirections);
    found.vertices =
        1000 * std::pow(kInterpolation * kInterpolation / (interpolation_share * squared_error), 1 / kOrderOfVertices);
    found.vertices *= std::max(1.0, triangles / kUsualTriangles);
    added = found.vertices / (found.vertices + own_vertices(triangles));
  }
  return found;
}

std::uint32_t light_samples_of(double directions) {
  return 16 * static_cast<std::uint32_t>(std::max(1L, std::lround(directions / kDirectionsOfALightSample / 16)));
}

}  // namespace

double own_vertices(double triangles) { return triangles / 2; }

LinksCounts choose_links_counts(double triangles, const LinksTarget& target, const GivenLinksCounts& given) {
  const double samples = std::max(kLeastSamples, static_cast<double>(target.spp));
  const double of_paths = kSampleError * kSampleError / samples * (target.denoised ? noise_left(samples) : 1);
  const bool promised = target.error > 0;
  const double squared_error = promised ? target.error * target.error : of_paths / kPathShare;
  const double own = own_vertices(triangles);
  auto [vertices, directions] = balanced(triangles, squared_error);
  if (!promised) {
    const double rays = target.denoised ? kRaysOfADenoisedSample : kRaysOfASample;
    const double most = rays * static_cast<double>(target.pixels) * samples;
    const double part = std::min(1.0, most / (2 * (own + vertices) * directions));
    vertices *= std::sqrt(part), directions *= std::sqrt(part);
  }
  LinksCounts counts;
  counts.directions = given.directions.value_or(directions_of(directions));
  counts.vertices = given.vertices.value_or(vertices_of(vertices, counts.directions, own));
  counts.beside_own = !given.vertices;
  counts.light_samples = given.light_samples.value_or(light_samples_of(counts.directions));
  return counts;
}

double LinksError::upper() const { return std::max(0.0, square) + 2 * deviation; }
double LinksError::interpolation() const { return std::max(0.0, square - noise); }

std::uint32_t hidden_directions(std::uint32_t directions) {
  const auto side = static_cast<std::uint32_t>(std::lround(std::sqrt(directions))) / 8;
  return 16 * std::max(1u, side * side);
}

std::uint32_t audit_directions(std::uint32_t directions) { return directions_of(directions / kAuditPart); }

LinksError links_error(std::span<const float> records, std::size_t points, const LinksCounts& counts) {
  // Of a vertex' noise, by that of the audit's rays, which mostly are fewer.
  const double falls =
      std::pow(static_cast<double>(audit_directions(counts.directions)) / counts.directions, kOrderOfDirections);
  const std::size_t stride = points * AUDIT_WORDS;
  LinksError found;
  found.pixels = records.size() / stride;
  double squares = 0;
  for (std::size_t pixel = 0; pixel < found.pixels; ++pixel) {
    double product = 0;
    for (unsigned k = 0; k < 3; ++k) {
      double shown = 0, one = 0, other = 0;
      for (std::size_t at = pixel * stride; at < (pixel + 1) * stride; at += AUDIT_WORDS) {
        shown += double{records[at + AUDIT_SHOWN + k]} / static_cast<double>(points);
        one += double{records[at + AUDIT_HALVES + k]} / static_cast<double>(points);
        other += double{records[at + AUDIT_HALVES + 3 + k]} / static_cast<double>(points);
        const double noise = double{records[at + AUDIT_BY_ELEMENTS + k]} - records[at + AUDIT_BY_ELEMENTS + 3 + k];
        found.noise += falls * kNoiseBetween * noise * noise / (6 * static_cast<double>(points));
      }
      found.mean += shown / 3;
      found.truth += (one + other) / 6;
      product += (shown - one) * (shown - other) / 3;
    }
    found.square += product;
    squares += product * product;
  }
  const double pixels = std::max<double>(1, static_cast<double>(found.pixels));
  found.mean /= pixels;
  found.truth /= pixels;
  found.square /= pixels;
  found.noise /= pixels;
  found.deviation = std::sqrt(std::max(0.0, squares / pixels - found.square * found.square) / pixels);
  return found;
}

std::optional<LinksCounts> better_links_counts(const LinksCounts& counts, const LinksError& found, double squared_error,
                                               const GivenLinksCounts& given) {
  if (!(squared_error > 0)) return std::nullopt;
  LinksCounts better = counts;
  const auto step = [](double share, double wanted, double order) {
    return std::min(std::pow(share / wanted, 1 / order), kMostStep);
  };
  const double noise = found.noise / squared_error, off = found.interpolation() / squared_error;
  if (!given.directions && noise > kMostNoiseShare)
    better.directions = directions_of(counts.directions * step(noise, kNoiseShare, kOrderOfDirections));
  if (!given.vertices && off > kMostInterpolationShare)
    better.vertices =
        std::max(counts.vertices,
                 vertices_of(counts.vertices * step(off, kInterpolationShare, kOrderOfVertices), better.directions, 0));
  if (better.directions <= counts.directions && better.vertices <= counts.vertices) return std::nullopt;
  return better;
}

}  // namespace gleaner::coordinator
