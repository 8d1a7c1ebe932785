// Stage kind "splat_smooth": the records of a cache, of which each takes part of what its neighbours say of its place.
// Solo, on the host's threads.
//
// Two estimates of one number whose errors know nothing of each other: the record's own, of variance s^2, and the
// neighbours', e'. Where d^2 is the mean square of their difference, what is least wrong is E + s^2 / d^2 (E' - E)
// (James & Stein 1961, in the form of Efron & Morris 1973). Both s^2 and d^2 are means over the neighbours, without the
// record itself: what is chosen by its own noise would be biased. Where light changes fast d^2 is large, and records
// stay as they are; so they do where there is no noise.
//
// That trusts records to be as noisy as their neighbours. A ray that finds a lamp by chance makes one brighter than all
// of them, in one half of its strata alone. What is beyond both the neighbours' word, with what records there usually
// differ by, and the record's darker half is such a ray's: it is light of all of them that one found, and goes to all.

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/record_grid.h"
#include "worker/stages/splat/smooth.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/work_queue.h"

namespace gleaner::worker {
namespace {

using splat::Color;

// Records lie where no other one reaches: as neighbours they count farther. Measured: 2 leaves a seventh more noise,
// and beside caustics 4 errs more.
constexpr float kNeighbourStretch = 3;
constexpr std::size_t kLeastNeighbours = 3;
// No record moves farther than so many times its noise: what many rays agree on is no noise.
constexpr double kMostMove = 2;
// Of the neighbours' word, at most.
constexpr double kMostShare = 0.85;
// A record is brighter than its neighbours say by so many times the median of what they are off by, where that is not
// chance: three standard deviations of normal numbers.
constexpr double kPlausible = 4.5;
// Records that a thread takes at a time.
constexpr std::size_t kRecordsAtOnce = 256;

using Neighbour = splat::RecordGrid::Near;

double square_of(const Color& color) { return color[0] * color[0] + color[1] * color[1] + color[2] * color[2]; }

class RecordSmoothing {
 public:
  RecordSmoothing(std::vector<CacheRecord> records, unsigned threads)
      : records_(std::move(records)),
        threads_(threads),
        neighbours_(records_.size()),
        cut_off_(records_.size()),
        said_(records_.size()) {
    const splat::RecordGrid grid(records_, kNeighbourStretch);
    for_all([&](std::uint32_t i) {
      find_neighbours(grid, i);
      if (neighbours_[i].size() < kLeastNeighbours) {
        cut_off_[i] = true;
        find_neighbours(grid, i);
      }
    });
    hear_all();
    take_back_chance();
  }

  std::vector<CacheRecord> smoothed() const {
    std::vector<CacheRecord> result = records_;
    for_all([&](std::uint32_t i) {
      if (const double share = share_of_neighbours(i); share > 0) result[i] = blended(i, share);
    });
    return result;
  }

 private:
  // Calls of(record) for all records, several at a time.
  template <typename Of>
  void for_all(const Of& of) const {
    for_each_item(records_.size(), threads_, kRecordsAtOnce,
                  [&](std::uint64_t i) { of(static_cast<std::uint32_t>(i)); });
  }

  // What the neighbours say of a record's place.
  struct Said {
    Color light{};
    double weights = 0, noise = 0;  // noise: the record's own, squared, summed over the channels
  };

  // Of two records as neighbours: each reaches the other. What reaches far says little of a corner, where light changes
  // within the little that records reach there. Walls leave some records hardly any neighbours, and a single ray that
  // finds a lamp would stay in their light: these ask beyond the walls.
  double weight_at(std::uint32_t of, std::uint32_t at) const {
    if (of == at || records_[of].level != records_[at].level) return 0;
    const CacheRecord &a = records_[of], &b = records_[at];
    const bool past_walls = cut_off_[at];
    const double weight = splat::record_weight(a, b.position, b.normal, kNeighbourStretch, past_walls);
    return weight > 0 ? std::min(weight, splat::record_weight(b, a.position, a.normal, kNeighbourStretch, past_walls))
                      : 0;
  }

  void find_neighbours(const splat::RecordGrid& grid, std::uint32_t i) {
    neighbours_[i] = grid.near(records_[i].position, [&](std::uint32_t k) { return weight_at(k, i); });
  }

  // Weighed as the neighbours are; 0 where there are none.
  template <typename Of>
  auto mean_over(std::uint32_t i, const Of& of) const {
    std::array<double, std::tuple_size_v<decltype(of(0u))>> mean{};
    double weights = 0;
    for (const Neighbour& n : neighbours_[i]) {
      const auto values = of(n.record);
      for (std::size_t k = 0; k < mean.size(); ++k) mean[k] += n.weight * values[k];
      weights += n.weight;
    }
    if (weights > 0)
      for (double& value : mean) value /= weights;
    return mean;
  }

  // What one record says of another's place, by the mean of both gradients: that is exact where irradiance curves, and
  // what one gives the other takes.
  Color light_at(std::uint32_t of, std::uint32_t at) const {
    const CacheRecord &a = records_[of], &b = records_[at];
    const Color there = splat::record_light(a, b.position, b.normal),
                back = splat::record_light(b, a.position, a.normal);
    Color light{};
    for (std::size_t c = 0; c < 3; ++c)
      light[c] = std::max(0.0, (there[c] + a.irradiance[c] + b.irradiance[c] - back[c]) / 2);
    return light;
  }

  void hear_all() {
    for_all([&](std::uint32_t i) { said_[i] = said(i); });
  }

  Said said(std::uint32_t i) const {
    Said said;
    said.light = mean_over(i, [&](std::uint32_t other) { return light_at(other, i); });
    for (const Neighbour& n : neighbours_[i]) said.weights += n.weight;
    said.noise = square_of(splat::record_noise(records_[i]));
    return said;
  }

  // How far a record is from what its neighbours but `without` say, squared; none: it has no others.
  std::optional<double> difference(std::uint32_t i, std::uint32_t without) const {
    const CacheRecord& at = records_[i];
    Color off = said_[i].light;
    if (const double weight = weight_at(without, i); weight > 0) {
      const double rest = said_[i].weights - weight;
      if (!(rest > 1e-6 * said_[i].weights)) return std::nullopt;
      const Color light = light_at(without, i);
      for (std::size_t c = 0; c < 3; ++c) off[c] = (off[c] * said_[i].weights - weight * light[c]) / rest;
    }
    for (std::size_t c = 0; c < 3; ++c) off[c] -= at.irradiance[c];
    return square_of(off);
  }

  // What of a record's difference from its neighbours' word is a single ray's, found by chance. Records that ask beyond
  // walls would send their light there.
  double share_of_chance(std::uint32_t i) const {
    if (cut_off_[i] || neighbours_[i].size() < kLeastNeighbours) return 0;
    const CacheRecord& at = records_[i];
    double brighter = 0;
    for (std::size_t c = 0; c < 3; ++c) brighter += at.irradiance[c] - said_[i].light[c];
    if (!(brighter > 0)) return 0;
    std::vector<double> differences;
    for (const Neighbour& n : neighbours_[i])
      if (!neighbours_[n.record].empty())
        if (const std::optional<double> off = difference(n.record, i)) differences.push_back(*off);
    if (differences.empty()) return 0;
    const auto middle = differences.begin() + static_cast<std::ptrdiff_t>(differences.size() / 2);
    std::ranges::nth_element(differences, middle);
    const double off = std::sqrt(*difference(i, i)), plausible = kPlausible * std::sqrt(*middle);
    return std::clamp(std::min(off - plausible, std::sqrt(said_[i].noise)) / off, 0.0, 1.0);
  }

  // Single rays' light goes from the records that they belong to, to these and their neighbours alike.
  void take_back_chance() {
    std::vector<Color> given(records_.size());
    std::vector<CacheRecord> without = records_;
    std::vector<double> chances(records_.size());
    for_all([&](std::uint32_t i) { chances[i] = share_of_chance(i); });
    bool any = false;
    for (std::uint32_t i = 0; i < records_.size(); ++i) {
      if (!(chances[i] > 0)) continue;
      any = true;
      without[i] = blended(i, chances[i]);
      give(i, without[i], given);
    }
    if (!any) return;
    records_ = std::move(without);
    for (std::uint32_t i = 0; i < records_.size(); ++i)
      for (std::size_t c = 0; c < 3; ++c)
        records_[i].irradiance[c] = std::max(0.0f, records_[i].irradiance[c] + static_cast<float>(given[i][c]));
    hear_all();
  }

  // What record i has lost, as it is `now`, so that the light of the surface about them stays: each stands for as much
  // of it as it reaches over.
  void give(std::uint32_t i, const CacheRecord& now, std::vector<Color>& given) const {
    const double own = said_[i].weights / static_cast<double>(neighbours_[i].size());
    double all = own * area(i);
    for (const Neighbour& n : neighbours_[i]) all += n.weight * area(n.record);
    const auto add = [&](std::uint32_t to, double weight) {
      for (std::size_t c = 0; c < 3; ++c)
        given[to][c] += weight * area(i) / all * (double{records_[i].irradiance[c]} - now.irradiance[c]);
    };
    add(i, own);
    for (const Neighbour& n : neighbours_[i]) add(n.record, n.weight);
  }

  double area(std::uint32_t i) const {
    const double reach = double{records_[i].accuracy} * records_[i].radius;
    return reach * reach;
  }

  double share_of_neighbours(std::uint32_t i) const {
    if (neighbours_[i].size() < kLeastNeighbours) return 0;
    double noise = 0, differences = 0, weights = 0;
    for (const Neighbour& n : neighbours_[i]) {
      // Of a record without neighbours nothing is known.
      const std::optional<double> off = neighbours_[n.record].empty() ? std::nullopt : difference(n.record, i);
      if (!off) continue;
      noise += n.weight * said_[n.record].noise;
      differences += n.weight * *off;
      weights += n.weight;
    }
    if (!(noise > 0)) return 0;
    const double share = std::min(noise / std::max(differences, noise), kMostShare);
    // What lies behind walls may be noisier for reasons of its own.
    const double own = said_[i].noise, noisiest = cut_off_[i] ? own : std::max(own, noise / weights);
    const double most = kMostMove * std::sqrt(noisiest);
    const double move = share * std::sqrt(*difference(i, i));
    return move > most ? share * most / move : share;
  }

  CacheRecord blended(std::uint32_t i, double share) const {
    CacheRecord record = records_[i];
    const auto blend = [share](auto& own, const auto& others) {
      for (std::size_t k = 0; k < own.size(); ++k)
        own[k] = static_cast<float>((1 - share) * own[k] + share * others[k]);
    };
    Color noise = splat::record_noise(record);
    const Color others = mean_over(i, [&](std::uint32_t other) { return splat::record_noise(records_[other]); });
    blend(record.irradiance, said_[i].light);
    blend(record.rotation, mean_over(i, [&](std::uint32_t other) { return records_[other].rotation; }));
    blend(record.translation, mean_over(i, [&](std::uint32_t other) { return records_[other].translation; }));
    double of = 0, over = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      of += (1 - share) * noise[c] + share * others[c];
      over += record.irradiance[c];
    }
    record.spare[CACHE_NOISE - CACHE_SPARE] = over > 0 ? static_cast<float>(of / over) : 0;
    return record;
  }

  std::vector<CacheRecord> records_;
  unsigned threads_;
  std::vector<std::vector<Neighbour>> neighbours_;
  std::vector<char> cut_off_;  // whether walls leave a record too few neighbours
  std::vector<Said> said_;
};

}  // namespace

std::vector<CacheRecord> smooth_cache(std::vector<CacheRecord> records, unsigned threads) {
  return RecordSmoothing(std::move(records), threads).smoothed();
}

BatchResult run_splat_smooth_stage(const StageRun& run) {
  const double start = seconds_now();
  host_parameters<kernels::SplatSmoothParameters>(run.task);
  std::vector<CacheRecord> records;
  append_records(run.task, "cache", records);
  BatchResult result = cache_result(smooth_cache(std::move(records), host_threads(run.device)));
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
