// Stage kind "photon_cut": the illumination cut of a photon map (illumination_cut.h), whose nodes' irradiance is
// estimated on the device (kernels/photon/read.h). Solo.

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/path_layout.h"
#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/illumination_cut.h"
#include "worker/stages/photon/map_table.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonCutFacts;
using kernels::PhotonCutParameters;
using Irradiance = std::vector<std::array<float, 3>>;

// Places a launch.
constexpr std::uint32_t kPlaces = 1u << 12;
// Photons of a node at which its irradiance is estimated.
constexpr std::uint32_t kNodePlaces = 8;
constexpr std::size_t kSlotWords = FILTERED_SLOT_WORDS;

// Of the clusters' gather, as that stage builds it: compiled once for both.
std::string gather_options() {
  return " -D PATH_FILTER=" + std::to_string(PATH_CLASS_DIFFUSE | PATH_CLASS_CAUSTIC | PATH_CLASS_MIXED);
}

PhotonCutParameters read_parameters(const StageRun& run) {
  const auto p = run.parameters<PhotonCutParameters>();
  if (p.nodes == 0 || p.nodes > PHOTON_MOST_CUT)
    throw Error::bad_input(run.where(), "nodes", "1 to " + std::to_string(PHOTON_MOST_CUT), std::to_string(p.nodes));
  if (p.rounds > 64 || !(p.ratio > 0) || !std::isfinite(p.ratio))
    throw Error::bad_input(run.where(), "rounds and ratio", "at most 64, above 0",
                           std::to_string(p.rounds) + " and " + std::to_string(p.ratio));
  check_photon_estimate(run, p.estimate);
  run.check_range(1);
  return p;
}

std::vector<std::uint32_t> read_map(const StageRun& run) {
  const InputRows input(run.task, "map", PHOTON_WORDS * 4);
  std::vector<std::uint32_t> words(input.rows() * PHOTON_WORDS);
  input.visit(0, input.rows(), [&](std::uint64_t row, std::span<const std::byte> piece) {
    std::memcpy(&words[row * PHOTON_WORDS], piece.data(), piece.size());
  });
  return words;
}

// Density estimates at places, by all photons of the map.
class Estimates {
 public:
  Estimates(const StageRun& run, const PhotonCutParameters& p, const PhotonMapTable& map)
      : queue_(run.device.make_queue()),
        reads_(run.workspace.take("cut.reads", std::size_t{kPlaces} * READ_WORDS * 4)),
        slots_(run.workspace.take("cut.slots", (std::size_t{kPlaces} + 1) * kSlotWords * 4)),
        read_(run.device, run.build("cluster_gather.cl", gather_options()), "photon_read") {
    run.scene.set_arguments(read_);
    map.set_arguments(read_, "map");
    no_cut().set_arguments(read_);
    read_.set("reads", reads_)
        .set("neighbours", p.estimate.neighbours)
        .set("most_radius", p.estimate.most_radius)
        .set("slots", slots_)
        .set("slot_count", kPlaces);
  }

  // W/m^2, RGB, of each place.
  Irradiance at(const std::vector<CutPlace>& places) {
    Irradiance irradiance(places.size());
    std::vector<float> slots(std::size_t{kPlaces} * kSlotWords);
    for (std::size_t base = 0; base < places.size(); base += kPlaces) {
      const std::size_t count = std::min<std::size_t>(kPlaces, places.size() - base);
      std::vector<float> reads;
      reads.reserve(count * READ_WORDS);
      for (std::size_t i = 0; i < count; ++i) append(places[base + i], static_cast<std::uint32_t>(i), reads);
      queue_.enqueueWriteBuffer(reads_, CL_TRUE, 0, reads.size() * 4, reads.data());
      queue_.enqueueFillBuffer(slots_, cl_float{0}, 0, slots.size() * 4);
      read_.set("count", static_cast<cl_uint>(count));
      read_.launch(queue_, {.work = count, .capacity = kPlaces, .per_item = 1});
      queue_.enqueueReadBuffer(slots_, CL_TRUE, 0, slots.size() * 4, slots.data());
      for (std::size_t i = 0; i < count; ++i)
        for (std::size_t k = 0; k < 3; ++k) {
          const float value = slots[i * kSlotWords + SLOT_INDIRECT + k];
          irradiance[base + i][k] = std::isfinite(value) ? value : 0;
        }
    }
    return irradiance;
  }

 private:
  static void append(const CutPlace& place, std::uint32_t slot, std::vector<float>& reads) {
    float row[READ_WORDS] = {};
    const std::uint32_t table = GLEANER_NONE, limits = PHOTON_MOST_DEPTH;
    for (unsigned k = 0; k < 3; ++k) {
      row[READ_POSITION + k] = place.position[k];
      row[READ_GEOMETRIC + k] = row[READ_NORMAL + k] = place.normal[k];
      row[READ_FACTOR + k] = 1;
    }
    std::memcpy(row + READ_TABLE, &table, 4);
    std::memcpy(row + READ_SLOT, &slot, 4);
    std::memcpy(row + READ_LIMITS, &limits, 4);
    reads.insert(reads.end(), row, row + READ_WORDS);
  }

  PhotonCutTable no_cut() const { return {.rows = slots_, .nodes = 0, .most_depth = 0, .size = 0}; }

  cl::CommandQueue queue_;
  cl::Buffer reads_, slots_;
  Kernel read_;
};

// A node's mean over its area, from estimates at its photons: these lie the denser the brighter it is, so that each
// counts by one over its estimate.
Irradiance node_means(const IlluminationCut& cut, const std::vector<CutPlace>& places, Estimates& estimates) {
  std::vector<CutPlace> spread;
  std::vector<std::size_t> ends;
  for (std::size_t i = 0; i < places.size(); ++i) {
    const std::vector<CutPlace> of_node = cut.spread(i, places[i], kNodePlaces);
    spread.insert(spread.end(), of_node.begin(), of_node.end());
    ends.push_back(spread.size());
  }
  const Irradiance all = estimates.at(spread);
  Irradiance means(places.size());
  std::size_t at = 0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    double sum[3] = {}, weights = 0;
    for (; at < ends[i]; ++at) {
      const double bright = double{all[at][0]} + all[at][1] + all[at][2];
      if (!(bright > 0)) continue;
      for (std::size_t k = 0; k < 3; ++k) sum[k] += double{all[at][k]} / bright;
      weights += 1 / bright;
    }
    for (std::size_t k = 0; k < 3; ++k) means[i][k] = static_cast<float>(weights > 0 ? sum[k] / weights : 0);
  }
  return means;
}

}  // namespace

BatchResult run_photon_cut_stage(const StageRun& run) {
  const PhotonCutParameters p = read_parameters(run);
  const double start = seconds_now();
  const auto map = photon_map_table(run, "map");
  IlluminationCut cut(read_map(run));
  Estimates estimates(run, p, *map);
  PhotonCutFacts facts;
  cut.choose(p.nodes);
  std::vector<CutPlace> places = cut.places();
  Irradiance irradiance = estimates.at(places);
  for (std::uint32_t round = 0; round < p.rounds; ++round) {
    const std::size_t opened = cut.refine(irradiance, p.ratio);
    if (opened == 0) break;
    facts.opened += opened;
    places = cut.places();
    irradiance = estimates.at(places);
  }
  const std::vector<std::uint32_t> rows = cut.rows(places, node_means(cut, places, estimates));
  facts.nodes = cut.size();
  facts.radius = cut.median_radius();
  BatchResult result;
  result.records.resize(rows.size() * 4);
  std::memcpy(result.records.data(), rows.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(rows.size() / CUT_WORDS)};
  set_facts(result, facts);
  result.counters.seconds = seconds_now() - start;
  result.counters.kernel_seconds = result.counters.seconds;
  return result;
}

}  // namespace gleaner::worker
