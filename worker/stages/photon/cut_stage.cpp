// Stage kind "photon_cut": the illumination cut of a photon map (illumination_cut.h), whose nodes' irradiance is
// estimated on the device (kernels/photon/read.h). Solo.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <span>
#include <vector>

#include "kernels/path_layout.h"
#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/illumination_cut.h"
#include "worker/stages/photon/map_table.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonCutFacts;
using kernels::PhotonCutParameters;
using Irradiance = std::vector<std::array<float, 3>>;

// Places a launch.
constexpr std::uint32_t kPlaces = 1u << 12;
// Photons of a node at which its irradiance is estimated.
constexpr std::uint32_t kNodePlaces = 6;
// By how much nodes' means are short otherwise. A count of n photons about one of them, itself included, has a
// reciprocal of the mean 1 / density, but at edges the surface's area is estimated, too (kernels/photon/area.h), and
// varies. Measured: 0.5 % on the Cornell box, 0.2 % with glossy boxes.
constexpr double kMeanShort = 0.004;
constexpr std::size_t kSlotWords = FILTERED_SLOT_WORDS;

// Of the clusters' gather, as that stage builds it: compiled once for both.
std::string gather_options() {
  return " -D PATH_FILTER=" + std::to_string(PATH_CLASS_DIFFUSE | PATH_CLASS_CAUSTIC | PATH_CLASS_MIXED);
}

PhotonCutParameters cut_parameters(const StageRun& run) {
  const auto p = run.parameters<PhotonCutParameters>();
  if (p.nodes == 0 || p.nodes > PHOTON_MOST_CUT)
    throw Error::bad_input(run.where(), "nodes", "1 to " + std::to_string(PHOTON_MOST_CUT), std::to_string(p.nodes));
  if (p.rounds > 64 || !(p.ratio > 0) || !std::isfinite(p.ratio) || !(p.spread > 0) || !std::isfinite(p.spread))
    throw Error::bad_input(
        run.where(), "rounds, ratio and spread", "at most 64, above 0 and above 0",
        std::to_string(p.rounds) + ", " + std::to_string(p.ratio) + " and " + std::to_string(p.spread));
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
class EstimateThread : public HostThread {
 public:
  EstimateThread(const StageRun& run, const PhotonCutParameters& p, const PhotonMapTable& map, const Program& program,
                 std::span<const CutPlace> places, Irradiance& irradiance, WorkQueue& work, unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        places_(places),
        irradiance_(irradiance),
        reads_(take("cut.reads", std::size_t{kPlaces} * READ_WORDS * 4)),
        slots_(take("cut.slots", (std::size_t{kPlaces} + 1) * kSlotWords * 4)),
        read_(run.device, program, "photon_read") {
    run.scene.set_arguments(read_);
    map.set_arguments(read_, "map");
    PhotonCutTable{.rows = slots_, .blocks = 0, .most_depth = 0, .size = 0}.set_arguments(read_);
    read_.set("reads", reads_)
        .set("neighbours", p.estimate.neighbours)
        .set("most_radius", p.estimate.most_radius)
        .set("slots", slots_)
        .set("slot_count", kPlaces);
  }

  void run(BatchResult&) {
    std::vector<float> reads, slots(std::size_t{kPlaces} * kSlotWords);
    while (const WorkQueue::Block block = work_.claim(kPlaces)) {
      reads.clear();
      for (std::uint32_t i = 0; i < block.count; ++i) append(places_[block.first + i], i, reads);
      queue_.enqueueWriteBuffer(reads_, CL_TRUE, 0, reads.size() * 4, reads.data());
      queue_.enqueueFillBuffer(slots_, cl_float{0}, 0, slots.size() * 4);
      read_.set("count", static_cast<cl_uint>(block.count));
      launch(read_, block.count, kPlaces, 1);
      queue_.enqueueReadBuffer(slots_, CL_TRUE, 0, block.count * kSlotWords * 4, slots.data());
      for (std::size_t i = 0; i < block.count; ++i)
        for (std::size_t k = 0; k < 3; ++k) {
          const float value = slots[i * kSlotWords + SLOT_INDIRECT + k];
          irradiance_[block.first + i][k] = std::isfinite(value) ? value : 0;
        }
    }
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

  std::span<const CutPlace> places_;
  Irradiance& irradiance_;
  cl::Buffer reads_, slots_;
  Kernel read_;
};

class Estimates {
 public:
  Estimates(const StageRun& run, const PhotonCutParameters& p, const PhotonMapTable& map)
      : run_(run), p_(p), map_(map), program_(run.build("cluster_gather.cl", gather_options())) {}

  // W/m^2, RGB, of each place.
  Irradiance at(std::span<const CutPlace> places, BatchResult& result) const {
    Irradiance irradiance(places.size());
    WorkQueue work(places.size(), host_threads(run_.device));
    run_host_threads(work, result, [&](unsigned index) {
      return std::make_unique<EstimateThread>(run_, p_, map_, program_, places, irradiance, work, index);
    });
    return irradiance;
  }

 private:
  const StageRun& run_;
  const PhotonCutParameters& p_;
  const PhotonMapTable& map_;
  Program program_;
};

// A node's mean over its area, and how much irradiance varies there, from estimates at its photons: these lie the
// denser the brighter it is, so that each counts by one over its estimate.
void sum_up(std::span<const std::array<float, 3>> estimates, CutLight& light) {
  double sum[3] = {}, bright = 0, weights = 0, count = 0;
  for (const std::array<float, 3>& one : estimates) {
    const double all = double{one[0]} + one[1] + one[2];
    if (!(all > 0)) continue;
    for (std::size_t k = 0; k < 3; ++k) sum[k] += double{one[k]} / all;
    bright += all;
    weights += 1 / all;
    ++count;
  }
  if (count == 0) return;
  for (std::size_t k = 0; k < 3; ++k) light.mean[k] = static_cast<float>((1 + kMeanShort) * sum[k] / weights);
  light.spread = static_cast<float>(std::max(0.0, bright * weights / (count * count) - 1));
}

// Of the cut's nodes. `from`: of each its number among `before`; GLEANER_NONE: it is new. Only new ones are estimated.
std::vector<CutLight> light_nodes(const IlluminationCut& cut, const std::vector<std::uint32_t>& from,
                                  const std::vector<CutLight>& before, const Estimates& estimates,
                                  BatchResult& result) {
  std::vector<CutLight> lights(from.size());
  std::vector<CutPlace> places;
  std::vector<std::size_t> firsts;  // of each new node, and their end
  for (std::size_t i = 0; i < from.size(); ++i) {
    if (from[i] != GLEANER_NONE) {
      lights[i] = before[from[i]];
      continue;
    }
    firsts.push_back(places.size());
    places.push_back(lights[i].place = cut.place(i));
    const std::vector<CutPlace> others = cut.spread(i, lights[i].place, kNodePlaces - 1);
    places.insert(places.end(), others.begin(), others.end());
  }
  firsts.push_back(places.size());
  const Irradiance estimated = estimates.at(places, result);
  for (std::size_t i = 0, next = 0; i < from.size(); ++i) {
    if (from[i] != GLEANER_NONE) continue;
    lights[i].middle = estimated[firsts[next]];
    sum_up(std::span(estimated).subspan(firsts[next], firsts[next + 1] - firsts[next]), lights[i]);
    ++next;
  }
  return lights;
}

}  // namespace

BatchResult run_photon_cut_stage(const StageRun& run) {
  const PhotonCutParameters p = cut_parameters(run);
  const double start = seconds_now();
  const auto map = photon_map_table(run, "map");
  IlluminationCut cut(read_map(run));
  const Estimates estimates(run, p, *map);
  BatchResult result;
  PhotonCutFacts facts;
  cut.choose(p.nodes);
  std::vector<CutLight> lights =
      light_nodes(cut, std::vector(cut.size(), std::uint32_t{GLEANER_NONE}), {}, estimates, result);
  for (std::uint32_t round = 0; round < p.rounds; ++round) {
    check_wanted();
    const std::vector<std::uint32_t> from = cut.refine(lights, p.ratio, p.spread);
    if (from.size() == lights.size()) break;
    facts.opened += from.size() - lights.size();
    lights = light_nodes(cut, from, lights, estimates, result);
  }
  const std::vector<std::uint32_t> rows = cut.rows(lights);
  facts.nodes = cut.size();
  facts.radius = cut.median_radius();
  result.records.resize(rows.size() * 4);
  std::memcpy(result.records.data(), rows.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(rows.size() / PHOTON_WORDS)};
  set_facts(result, facts);
  result.counters.seconds = seconds_now() - start;
  result.counters.kernel_seconds = result.counters.seconds;
  return result;
}

}  // namespace gleaner::worker
