// Stage kind "photon_cluster_smooth": the records of shading clusters' samples, each averaged with those near it. Solo,
// on the host.
//
// A sample's rays are few, and their noise shows as blotches as wide as its cluster. Where surfaces are far away,
// irradiance changes slowly: a record takes the mean of what its neighbours say of its place, by their gradients (Ward
// & Heckbert 1992). How far neighbours count is in proportion to R, so that corners and contact shadows keep their
// detail. R is the harmonic mean distance, no more than R_j + |x_i - x_j| of any neighbour j (Krivanek, Bouatouch,
// Pattanaik & Zara 2006, "Making radiance and irradiance caching practical"): a sample that does not see what is near
// it through its few rays learns of it from others.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <unordered_map>

#include "kernels/photon_records.h"
#include "worker/stages/photon/reach_grid.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/points.h"
#include "worker/stages/splat/scalar.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// A neighbour counts up to this part of the smaller R of both, and no farther away than so many times what its record
// reaches. More: less noise, and less detail where light changes fast.
constexpr float kSmoothing = 0.2f, kMostReach = 3;
// Rounds in which R learns of R_j.
constexpr int kClampRounds = 3;
// A record that is brighter than so many times another that lies in its reach is weighed there for no more than this
// part of the other's light: what is beside a window would shine otherwise.
constexpr double kBrighter = 2, kMostLeak = 0.5;
// Not for the sake of one that reaches hardly any point but its own, where no other counts beside it.
constexpr float kFarOff = 4;

struct Offset {
  std::array<float, 3> to;
  float distance, turn;
};

class ClusterSmoothing {
 public:
  explicit ClusterSmoothing(std::vector<CacheRecord> records) : records_(std::move(records)) {
    std::vector<float> reaches;
    for (const CacheRecord& record : records_) reaches.push_back(record.spare[0]);
    cell_ = kMostReach * median_of(std::move(reaches));
    for (std::uint32_t i = 0; i < records_.size(); ++i) cells_[key_of(cell_at(i))].push_back(i);
    radius_.reserve(records_.size());
    for (const CacheRecord& record : records_) radius_.push_back(record.radius);
    weighing_.assign(records_.size(), std::numeric_limits<float>::infinity());
    near_.resize(records_.size());
    readable_.resize(records_.size());
    for (std::uint32_t i = 0; i < records_.size(); ++i) {
      check_wanted();
      find_near(i);
    }
  }

  void clamp_radii() {
    for (int round = 0; round < kClampRounds; ++round) {
      check_wanted();
      std::vector<float> clamped = radius_;
      for (std::uint32_t i = 0; i < records_.size(); ++i)
        for (const std::uint32_t j : near_[i]) clamped[i] = std::min(clamped[i], radius_[j] + offset(i, j).distance);
      radius_ = std::move(clamped);
    }
  }

  // Weights fall as the radius over the distance.
  void bound_leaks() {
    const auto light = [&](std::uint32_t i) {
      const auto& e = records_[i].irradiance;
      return double{e[0]} + e[1] + e[2];
    };
    for (std::uint32_t i = 0; i < records_.size(); ++i)
      for (const std::uint32_t j : readable_[i])
        if (light(j) > kBrighter * light(i) && offset(i, j).distance < kFarOff * reach(i))
          weighing_[j] = std::min(weighing_[j],
                                  static_cast<float>(kMostLeak * double{offset(i, j).distance} * light(i) / light(j)));
  }

  void smooth_gradients() {
    std::vector<CacheRecord> result = records_;
    for (std::uint32_t i = 0; i < records_.size(); ++i) {
      check_wanted();
      std::array<double, 9> rotation{}, translation{};
      double weights = 0;
      const auto add = [&](std::uint32_t j, double w) {
        for (std::size_t k = 0; k < 9; ++k) {
          rotation[k] += w * records_[j].rotation[k];
          translation[k] += w * records_[j].translation[k];
        }
        weights += w;
      };
      each_weighted(i, add);
      for (std::size_t k = 0; k < 9; ++k) {
        result[i].rotation[k] = static_cast<float>(rotation[k] / weights);
        result[i].translation[k] = static_cast<float>(translation[k] / weights);
      }
    }
    records_ = std::move(result);
  }

  std::vector<CacheRecord> smoothed() const {
    std::vector<CacheRecord> result;
    result.reserve(records_.size());
    for (std::uint32_t i = 0; i < records_.size(); ++i) {
      check_wanted();
      result.push_back(smoothed(i));
    }
    return result;
  }

 private:
  float reach(std::uint32_t i) const { return records_[i].spare[0]; }
  float turn(std::uint32_t i) const { return records_[i].spare[1]; }

  GridCell cell_at(std::uint32_t i) const {
    GridCell cell;
    for (std::size_t k = 0; k < 3; ++k)
      cell[k] = static_cast<std::int64_t>(std::floor(records_[i].position[k] / cell_));
    return cell;
  }

  Offset offset(std::uint32_t from, std::uint32_t to) const {
    const CacheRecord &a = records_[from], &b = records_[to];
    Offset off{};
    float squared = 0, turned = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      off.to[k] = b.position[k] - a.position[k];
      squared += off.to[k] * off.to[k];
      turned += (b.normal[k] - a.normal[k]) * (b.normal[k] - a.normal[k]);
    }
    off.distance = std::sqrt(squared);
    off.turn = std::sqrt(turned / 2);
    return off;
  }

  bool hidden(std::uint32_t i, std::uint32_t j, const Offset& off) const {
    const auto &n = records_[j].normal, &m = records_[i].normal;
    const float height =
        std::abs(off.to[0] * (n[0] + m[0]) + off.to[1] * (n[1] + m[1]) + off.to[2] * (n[2] + m[2])) / 2;
    return height > SPLAT_MOST_DEPTH * 2 * off.distance;
  }

  void find_near(std::uint32_t i) {
    const float most = std::min(kMostReach * reach(i), cell_);
    const GridCell middle = cell_at(i);
    for (std::int64_t x = -1; x <= 1; ++x)
      for (std::int64_t y = -1; y <= 1; ++y)
        for (std::int64_t z = -1; z <= 1; ++z) {
          const auto found = cells_.find(key_of({middle[0] + x, middle[1] + y, middle[2] + z}));
          if (found == cells_.end()) continue;
          for (const std::uint32_t j : found->second) {
            if (j == i) continue;
            const Offset off = offset(i, j);
            if (off.distance <= reach(j) && off.turn <= turn(j) && !hidden(i, j, off)) readable_[i].push_back(j);
            if (off.distance > std::min(most, kMostReach * reach(j)) || off.turn > std::min(turn(i), turn(j)) ||
                hidden(i, j, off))
              continue;
            near_[i].push_back(j);
          }
        }
    std::ranges::sort(near_[i]);
    near_[i].erase(std::unique(near_[i].begin(), near_[i].end()), near_[i].end());
  }

  float weight(std::uint32_t i, std::uint32_t j, const Offset& off) const {
    const float most =
        std::min({kMostReach * reach(i), kMostReach * reach(j), kSmoothing * radius_[i], kSmoothing * radius_[j]});
    const float away = off.distance / most, turned = off.turn / std::max(1e-6f, std::min(turn(i), turn(j)));
    return std::max(0.0f, 1 - away * away) * std::max(0.0f, 1 - turned * turned);
  }

  // Calls add(record, weight) with the record itself and with those that count beside it.
  template <typename Add>
  void each_weighted(std::uint32_t i, const Add& add) const {
    add(i, 1);
    for (const std::uint32_t j : near_[i])
      if (const float w = weight(i, j, offset(i, j)); w > 0) add(j, double{w});
  }

  CacheRecord smoothed(std::uint32_t i) const {
    CacheRecord result = records_[i];
    std::array<double, 3> e{};
    double weights = 0;
    const auto add = [&](std::uint32_t j, double w) {
      const CacheRecord &b = records_[j], &a = records_[i];
      const Offset off = offset(j, i);
      const auto &m = b.normal, &n = a.normal;
      const float turn[3] = {m[1] * n[2] - m[2] * n[1], m[2] * n[0] - m[0] * n[2], m[0] * n[1] - m[1] * n[0]};
      for (std::size_t c = 0; c < 3; ++c) {
        double value = b.irradiance[c];
        for (std::size_t k = 0; k < 3; ++k)
          value += turn[k] * (b.rotation[3 * c + k] + a.rotation[3 * c + k]) / 2 +
                   off.to[k] * (b.translation[3 * c + k] + a.translation[3 * c + k]) / 2;
        e[c] += w * std::max(0.0, value);
      }
      weights += w;
    };
    each_weighted(i, add);
    for (std::size_t c = 0; c < 3; ++c) result.irradiance[c] = static_cast<float>(e[c] / weights);
    const RecordExtent extent = record_extent(std::min(radius_[i], weighing_[i]), reach(i), turn(i));
    result.radius = extent.radius;
    result.accuracy = extent.accuracy;
    result.spare = {};
    result.hessian = {};
    return result;
  }

  std::vector<CacheRecord> records_;
  std::vector<float> radius_, weighing_;
  float cell_ = 1;
  std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells_;
  std::vector<std::vector<std::uint32_t>> near_, readable_;  // the latter: records that reach a record's place
};

void append_cluster_records(const StageTask& task, const std::string& name, std::vector<CacheRecord>& records) {
  const InputRows input(task, name, sizeof(CacheRecord));
  const std::size_t before = records.size();
  append_records(task, name, records);
  for (std::size_t i = 0; i < input.rows(); ++i) {
    const CacheRecord& record = records[before + i];
    float words[CACHE_WORDS];
    std::memcpy(words, &record, sizeof words);
    for (const float word : words)
      if (!std::isfinite(word)) input.fail(i, "", "finite numbers", std::to_string(word));
    if (!(record.radius > 0)) input.fail(i, "radius", "metres above 0", std::to_string(record.radius));
    if (!(record.spare[0] > 0)) input.fail(i, "reach", "metres above 0", std::to_string(record.spare[0]));
    if (!(record.spare[1] > 0)) input.fail(i, "turn", "a number above 0", std::to_string(record.spare[1]));
  }
}

}  // namespace

std::vector<CacheRecord> read_cluster_records(const StageTask& task) {
  std::vector<CacheRecord> records;
  for (unsigned part = 0; task.inputs.contains("records." + std::to_string(part)); ++part)
    append_cluster_records(task, "records." + std::to_string(part), records);
  return records;
}

std::vector<CacheRecord> smoothed_records(std::vector<CacheRecord> records) {
  ClusterSmoothing smoothing(std::move(records));
  smoothing.clamp_radii();
  smoothing.bound_leaks();
  smoothing.smooth_gradients();
  return smoothing.smoothed();
}

BatchResult smooth_photon_clusters(const StageTask& task) {
  return cache_result(smoothed_records(read_cluster_records(task)));
}

}  // namespace gleaner::worker
