#include "bench/device/compare.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "kernels/cluster_records.h"
#include "kernels/links_records.h"
#include "kernels/path_records.h"
#include "kernels/photon_records.h"
#include "kernels/splat_records.h"
#include "kernels/vpl_records.h"

namespace gleaner::bench {
namespace {

// Which words of a row are numbers, which are bits; others are not looked at.
struct Layout {
  unsigned row_words = 0;
  std::vector<unsigned> reals{}, words{};
  bool bits = false;  // all words are bits: a row is a bit
  // Rows of light paths or links, which may come in other numbers: `bound.share` is of the number, and means of columns
  // are compared alone.
  bool counted = false;
  std::uint64_t rows = 0;        // 0: all
  std::vector<unsigned> sums{};  // reals whose sums are compared
  Bound bound{};
};

std::vector<unsigned> range(unsigned first, unsigned count) {
  std::vector<unsigned> words(count);
  for (unsigned k = 0; k < count; ++k) words[k] = first + k;
  return words;
}

template <typename Parameters>
Parameters parameters_of(const RecordedBatch& batch) {
  Parameters p{};
  std::memcpy(&p, batch.task.parameters.data(), std::min(sizeof p, batch.task.parameters.size()));
  return p;
}

// The bounds were set on PoCL, where 1 and 16 lanes and Embree and the OpenCL tracer were compared.
Layout layout_of(const RecordedBatch& batch) {
  const std::string& kind = batch.task.kind;
  if (kind == "path" || kind == "ao" || kind == "photon_gather") {
    const auto p = parameters_of<kernels::PathParameters>(batch);
    const unsigned words = (p.features ? 14 : 6) + (p.seen == PATH_SEEN_APART ? 3 : 0) + (p.filter ? 3 : 0);
    return {.row_words = words, .reals = range(0, words), .sums = range(0, 6), .bound = {0.01, 0.03, 0.01}};
  }
  if (kind == "vpl_trace")
    return {.row_words = VPL_WORDS,
            .reals = range(VPL_POSITION, 12),
            .counted = true,
            .sums = range(VPL_FLUX, 3),
            .bound = {0, 0.01, 0.01}};
  if (kind == "photon_trace")
    return {.row_words = PHOTON_WORDS,
            .reals = range(PHOTON_POSITION, 6),
            .counted = true,
            .sums = range(PHOTON_POWER, 3),
            .bound = {0, 0.01, 0.01}};
  if (kind == "links_make") return {.row_words = 1, .counted = true, .bound = {0, 0.01, 0}};
  if (kind == "links_probe")
    return {.row_words = PROBE_WORDS, .reals = range(0, PROBE_WORDS), .bound = {0.01, 0.05, 0}};
  if (kind == "links_albedo") return {.row_words = ALBEDO_WORDS, .reals = range(0, 3), .bound = {0.01, 0.05, 0}};
  if (kind == "links_light" || kind == "links_gather" || kind == "links_smooth")
    return {.row_words = RADIOSITY_WORDS,
            .reals = range(RADIOSITY_IRRADIANCE, 3),
            .sums = range(RADIOSITY_IRRADIANCE, 3),
            .bound = {0.01, 0.05, 0.01}};
  if (kind == "splat_points")
    return {.row_words = SPLAT_POINT_WORDS, .reals = range(SPLAT_POSITION, 12), .bound = {0.01, 0.02, 0}};
  if (kind == "splat_select")
    return {.row_words = SPLAT_POINT_WORDS, .reals = range(SPLAT_POSITION, 3), .counted = true, .bound = {0, 0.05, 0}};
  if (kind == "splat_gather")
    return {.row_words = CACHE_WORDS,
            .reals = range(CACHE_RADIUS, 4),
            .sums = range(CACHE_IRRADIANCE, 3),
            .bound = {0.01, 0.1, 0.01}};
  if (kind == "vpl_points")
    return {.row_words = POINT_WORDS,
            .reals = range(POINT_POSITION, 6),
            .words = {POINT_TRIANGLE},
            .bound = {0.001, 0.01, 0.01}};
  if (kind == "vpl_visibility") return {.row_words = 1, .bits = true, .bound = {0, 0.002, 0}};
  if (kind == "vpl_shade" || kind == "photon_caustics" || kind == "links_shade" || kind == "splat_shade")
    return {.row_words = 3, .reals = range(0, 3), .sums = range(0, 3), .bound = {0.01, 0.05, 0.01}};
  // A datum that is as near to two centroids changes both, and these their neighbours in each iteration.
  if (kind == "vpl_cluster")
    return {.row_words = VPL_WORDS,
            .reals = range(VPL_POSITION, 12),
            .rows = parameters_of<kernels::ClusterParameters>(batch).clusters,
            .sums = range(VPL_FLUX, 3),
            .bound = {0.01, 0.2, 0.001}};
  if (kind == "point_cluster")
    return {.row_words = POINT_WORDS, .reals = range(POINT_POSITION, 6), .bound = {0.01, 0.2, 0.01}};
  // Stages on the host: the same numbers everywhere.
  return {.row_words = 1, .bits = true, .bound = {}};
}

std::uint32_t word_of(const scene::Bytes& bytes, std::uint64_t row, unsigned row_words, unsigned word) {
  std::uint32_t value;
  std::memcpy(&value, &bytes[(row * row_words + word) * 4], 4);
  return value;
}
double real_of(const scene::Bytes& bytes, std::uint64_t row, unsigned row_words, unsigned word) {
  return std::bit_cast<float>(word_of(bytes, row, row_words, word));
}

void compare_bits(const scene::Bytes& expected, const scene::Bytes& found, Comparison& result) {
  const std::uint64_t words = expected.size() / 4;
  result.rows = words * 32;
  for (std::uint64_t k = 0; k < words; ++k)
    result.differ += static_cast<unsigned>(std::popcount(word_of(expected, k, 1, 0) ^ word_of(found, k, 1, 0)));
}

void compare_rows(const Layout& layout, const scene::Bytes& expected, const scene::Bytes& found, Comparison& result) {
  const unsigned words = layout.row_words;
  result.rows = layout.rows ? layout.rows : expected.size() / 4 / words;
  std::vector<double> size(words, 0.0), difference(words, 0.0);
  for (std::uint64_t row = 0; row < result.rows; ++row)
    for (const unsigned word : layout.reals) {
      const double a = real_of(expected, row, words, word), b = real_of(found, row, words, word);
      if (std::isnan(a)) continue;  // of a row that holds nothing
      if (!std::isfinite(b)) result.error = "row " + std::to_string(row) + " is not finite";
      size[word] += std::abs(a);
      difference[word] += b - a;
    }
  for (std::uint64_t row = 0; row < result.rows; ++row) {
    bool same = true;
    for (const unsigned word : layout.words)
      same = same && word_of(expected, row, words, word) == word_of(found, row, words, word);
    for (const unsigned word : layout.reals) {
      const double a = real_of(expected, row, words, word), b = real_of(found, row, words, word);
      const double scale = std::max(std::abs(a), size[word] / static_cast<double>(result.rows));
      same = same && (std::isnan(a) ? std::isnan(b) : std::abs(a - b) <= layout.bound.tolerance * scale);
    }
    result.differ += !same;
  }
  for (const unsigned word : layout.sums)
    if (size[word] > 0) result.worst_sum = std::max(result.worst_sum, std::abs(difference[word]) / size[word]);
}

void compare_counted(const Layout& layout, const scene::Bytes& expected, const scene::Bytes& found,
                     Comparison& result) {
  const unsigned words = layout.row_words;
  const std::uint64_t rows[] = {expected.size() / 4 / words, found.size() / 4 / words};
  result.rows = rows[0];
  result.differ = rows[0] > rows[1] ? rows[0] - rows[1] : rows[1] - rows[0];
  for (const unsigned word : layout.reals) {
    double sum[2] = {}, size = 0;
    for (int k = 0; k < 2; ++k)
      for (std::uint64_t row = 0; row < rows[k]; ++row) {
        const double value = real_of(k ? found : expected, row, words, word);
        if (!std::isfinite(value)) result.error = "row " + std::to_string(row) + " is not finite";
        sum[k] += value;
        if (k == 0) size += std::abs(value);
      }
    const bool compared = std::ranges::find(layout.sums, word) != layout.sums.end();
    if (compared && size > 0) result.worst_sum = std::max(result.worst_sum, std::abs(sum[1] - sum[0]) / size);
  }
}

}  // namespace

Comparison compare_records(const RecordedBatch& expected, const scene::Bytes& found) {
  const Layout layout = layout_of(expected);
  Comparison result{.bound = layout.bound};
  if (layout.counted)
    compare_counted(layout, expected.records, found, result);
  else if (found.size() != expected.records.size())
    result.error = std::to_string(found.size()) + " bytes, expected " + std::to_string(expected.records.size());
  else if (layout.bits)
    compare_bits(expected.records, found, result);
  else
    compare_rows(layout, expected.records, found, result);
  return result;
}

}  // namespace gleaner::bench
