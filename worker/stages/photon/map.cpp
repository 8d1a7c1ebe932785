// Stage kind "photon_map": the trees over photons (kernels/photon_records.h). Kd-trees split at medians: the widest
// axis of each node's box is cut where half of its blocks of 16 photons lie on either side, so that all leaves are
// whole blocks. Photons lie on surfaces, in clumps; a median tree's depth does not depend on that, a grid's cells do.

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "kernels/photon_records.h"
#include "kernels/rays.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "worker/stages/photon/inner_blocks.h"
#include "worker/stages/photon/map_blocks.h"
#include "worker/stages/photon/select_place.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonMapFacts;
using kernels::PhotonMapParameters;

// The last block of each of two trees may be all but empty.
constexpr std::uint64_t kMostPhotons = std::uint64_t{NODE_NO_BLOCK - 1} * RAY_BLOCK;
constexpr float kFar = 3e18f;  // its square is still a float

struct Photon {
  std::array<std::uint32_t, PHOTON_WORDS> words;
};
static_assert(sizeof(Photon) == PHOTON_WORDS * 4);

float as_float(std::uint32_t word) {
  float value;
  std::memcpy(&value, &word, 4);
  return value;
}
std::uint32_t as_word(float value) {
  std::uint32_t word;
  std::memcpy(&word, &value, 4);
  return word;
}

std::uint32_t class_of(const Photon& photon) {
  return photon.words[PHOTON_SURFACE] >> PHOTON_CLASS_SHIFT & PHOTON_CLASS_MASK;
}

class MapBuilder {
 public:
  MapBuilder(std::vector<Photon> photons, std::uint32_t neighbours, unsigned threads)
      : photons_(std::move(photons)), neighbours_(std::max(neighbours, 1u)) {
    places_.reserve(photons_.size());
    add_places(false);
    front_ = places_.size();
    add_places(true);
    const std::size_t before = blocks_of(front_), behind = blocks_of(places_.size() - front_);
    const std::size_t blocks = std::max<std::size_t>(1, before + behind);
    nodes_.resize(2 * blocks - 1);
    rows_.resize((1 + nodes_.size() + blocks * RAY_BLOCK) * sizeof(Photon));
    if (before > 0 && behind > 0)
      add_both(before, threads);
    else
      add_node(0, {.first = 0, .last = places_.size(), .block = 0}, true, threads);
    for (const Node& node : nodes_)
      if (node.disc >= 0) radii_.push_back(node.disc);
    write(blocks, threads);
  }

  // Rows of the map, once.
  scene::Bytes take_rows() { return std::move(rows_); }
  PhotonMapFacts facts() {
    PhotonMapFacts facts;
    facts.photons = photons_.size();
    facts.nodes = nodes_.size();
    for (const Photon& photon : photons_)
      for (unsigned k = 0; k < 3; ++k) facts.power[k] += double{as_float(photon.words[PHOTON_POWER + k])};
    if (!radii_.empty()) {
      const auto middle = radii_.begin() + static_cast<std::ptrdiff_t>(radii_.size() / 2);
      std::nth_element(radii_.begin(), middle, radii_.end());
      facts.radius = *middle;
    }
    return facts;
  }

 private:
  struct Node {
    std::array<float, 3> lower{kFar, kFar, kFar}, upper{-kFar, -kFar, -kFar};
    std::uint32_t block = NODE_NO_BLOCK, skip = 0;
    double disc = -1;  // m: the radius of a disc of so many neighbours, where this node tells it
  };

  // Places [first, last), which are those of blocks from `block` on.
  struct Part {
    std::size_t first, last, block;
  };

  static std::size_t blocks_of(std::size_t places) { return (places + RAY_BLOCK - 1) / RAY_BLOCK; }

  // The first node of the caustic photons' tree, where there are any.
  std::size_t caustics_node() const { return 2 * blocks_of(front_); }

  void add_places(bool caustic) {
    for (std::size_t i = 0; i < photons_.size(); ++i) {
      const Photon& photon = photons_[i];
      if ((class_of(photon) == PHOTON_CAUSTIC) != caustic) continue;
      places_.push_back({{as_float(photon.words[0]), as_float(photon.words[1]), as_float(photon.words[2]),
                          as_float(static_cast<std::uint32_t>(i))}});
    }
  }

  // The root, and a tree of each kind of photons: who looks for caustic ones alone would go through all others.
  // `before`: blocks of the others.
  void add_both(std::size_t before, unsigned threads) {
    const std::size_t caustics = caustics_node();
    add_node(1, {.first = 0, .last = front_, .block = 0}, true, threads);
    add_node(caustics, {.first = front_, .last = places_.size(), .block = before}, false, threads);
    Node& root = nodes_[0];
    bound(places_, root);
    root.skip = static_cast<std::uint32_t>(nodes_.size());
  }

  // Node number `index`, over a part of one kind's places, and those below it. `looks`: it, or one below it, tells how
  // wide the nearest neighbours' disc is. How many places there are says where each node and block stands, so that the
  // two halves are made side by side.
  void add_node(std::size_t index, const Part& part, bool looks, unsigned threads) {
    const std::size_t first = part.first, last = part.last;
    Node& node = nodes_[index];
    bound(std::span(places_).subspan(first, last - first), node);
    if (first == last) node.upper = node.lower;  // of a map without photons: far away
    const std::size_t blocks = blocks_of(last - first);
    if (looks && last > first && last - first <= std::max<std::size_t>(2 * neighbours_, RAY_BLOCK)) {
      node.disc = disc_of(node, last - first);
      looks = false;
    }
    if (blocks <= 1) {
      node.block = static_cast<std::uint32_t>(part.block);
      node.skip = static_cast<std::uint32_t>(index + 1);
      return;
    }
    check_wanted();
    const std::size_t left = (blocks + 1) / 2, middle = first + left * RAY_BLOCK;
    node.skip = static_cast<std::uint32_t>(index + 2 * blocks - 1);
    split(first, middle, last, node);
    const auto half = [&](unsigned k, unsigned others) {
      if (k == 0)
        add_node(index + 1, {.first = first, .last = middle, .block = part.block}, looks, others);
      else
        add_node(index + 2 * left, {.first = middle, .last = last, .block = part.block + left}, looks, others);
    };
    if (threads > 1) {
      run_threads(2, [&](unsigned k) { half(k, (threads + 1 - k) / 2); });
    } else {
      half(0, 1);
      half(1, 1);
    }
  }

  void split(std::size_t first, std::size_t middle, std::size_t last, const Node& node) {
    unsigned axis = 0;
    for (unsigned k = 1; k < 3; ++k)
      if (node.upper[k] - node.lower[k] > node.upper[axis] - node.lower[axis]) axis = k;
    select_place(std::span(places_).subspan(first, last - first), middle - first, axis);
  }

  // The fourth word, of four that are compared at once, tells nothing.
  static void bound(std::span<const PhotonPlace> places, Node& node) {
    std::array<float, 4> lower{kFar, kFar, kFar, kFar}, upper{-kFar, -kFar, -kFar, -kFar};
    for (const PhotonPlace& place : places)
      for (unsigned k = 0; k < 4; ++k) {
        lower[k] = place.words[k] < lower[k] ? place.words[k] : lower[k];
        upper[k] = place.words[k] > upper[k] ? place.words[k] : upper[k];
      }
    std::copy_n(lower.begin(), 3, node.lower.begin());
    std::copy_n(upper.begin(), 3, node.upper.begin());
  }

  // A surface's piece in a box is about as large as the box's largest face.
  double disc_of(const Node& node, std::size_t photons) const {
    std::array<double, 3> edge{};
    for (unsigned k = 0; k < 3; ++k) edge[k] = double{node.upper[k]} - node.lower[k];
    std::ranges::sort(edge);
    const double area = edge[1] * edge[2] * neighbours_ / static_cast<double>(photons);
    return std::sqrt(area / std::numbers::pi);
  }

  void write(std::size_t blocks, unsigned threads) {
    std::uint32_t* words = row(0);
    words[MAP_NODES] = static_cast<std::uint32_t>(nodes_.size());
    words[MAP_BLOCKS] = static_cast<std::uint32_t>(blocks);
    words[MAP_PHOTONS] = static_cast<std::uint32_t>(photons_.size());
    const std::size_t caustics = front_ < places_.size() ? caustics_node() : nodes_.size();
    words[MAP_CAUSTICS] = static_cast<std::uint32_t>(caustics);
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      words = row(1 + i);
      for (unsigned k = 0; k < 3; ++k) {
        words[NODE_LOWER + k] = as_word(nodes_[i].lower[k]);
        words[NODE_UPPER + k] = as_word(nodes_[i].upper[k]);
      }
      words[NODE_BLOCK] = nodes_[i].block;
      words[NODE_SKIP] = nodes_[i].skip;
    }
    run_threads(threads, [&](unsigned k) { write_blocks(blocks * k / threads, blocks * (k + 1) / threads); });
  }

  std::uint32_t* row(std::size_t i) { return reinterpret_cast<std::uint32_t*>(rows_.data() + i * sizeof(Photon)); }

  void write_blocks(std::size_t begin, std::size_t end) {
    std::uint32_t* to = row(1 + nodes_.size());
    const std::size_t before = blocks_of(front_) * RAY_BLOCK;
    for (std::size_t i = begin * RAY_BLOCK; i < end * RAY_BLOCK; ++i) {
      Photon photon{};
      for (unsigned k = 0; k < 3; ++k) photon.words[PHOTON_POSITION + k] = as_word(kFar);
      const std::size_t place = i < before ? i : front_ + (i - before);
      if (place < (i < before ? front_ : places_.size())) photon = photons_[places_[place].photon()];
      for (unsigned word = 0; word < PHOTON_WORDS; ++word)
        to[(i / RAY_BLOCK * PHOTON_WORDS + word) * RAY_BLOCK + i % RAY_BLOCK] = photon.words[word];
    }
  }

  std::vector<Photon> photons_;
  scene::Bytes rows_;
  std::size_t neighbours_;
  std::vector<PhotonPlace> places_;  // caustic photons' behind the others'
  std::size_t front_ = 0;            // places of the others
  std::vector<Node> nodes_;
  std::vector<double> radii_;
};

std::vector<Photon> read_photons(const StageTask& task, std::uint32_t classes) {
  const InputRows input(task, "photons", sizeof(Photon));
  if (input.rows() > kMostPhotons)
    throw Error::bad_input("stage " + task.kind, "input photons", "at most " + std::to_string(kMostPhotons) + " rows",
                           std::to_string(input.rows()));
  std::vector<Photon> photons;
  photons.reserve(input.rows());
  input.visit(0, input.rows(), [&](std::uint64_t row, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += sizeof(Photon), ++row) {
      Photon photon;
      std::memcpy(&photon, &piece[at], sizeof photon);
      if (class_of(photon) >= PHOTON_CLASSES || !(classes & PHOTON_CLASS_BIT(class_of(photon)))) continue;
      for (unsigned k = 0; k < 3; ++k) {
        const float x = as_float(photon.words[PHOTON_POSITION + k]);
        const float power = as_float(photon.words[PHOTON_POWER + k]);
        if (!(std::abs(x) <= 2 * scene::kMaxCoordinate) || !(power >= 0) || !std::isfinite(power))
          input.fail(row, "position and power", "finite numbers of a scene's size",
                     std::to_string(x) + " and " + std::to_string(power));
      }
      photons.push_back(photon);
    }
  });
  return photons;
}

}  // namespace

BatchResult run_photon_map_stage(const StageRun& run) {
  const double start = seconds_now();
  const auto p = host_parameters<PhotonMapParameters>(run.task);
  if (!(p.most_radius >= 0) || !std::isfinite(p.most_radius))
    throw Error::bad_input("stage " + run.task.kind, "most_radius", "a finite number, not negative",
                           std::to_string(p.most_radius));
  MapBuilder builder(read_photons(run.task, p.classes), p.neighbours, host_threads(run.device));
  BatchResult result;
  result.records = builder.take_rows();
  const std::span words(reinterpret_cast<std::uint32_t*>(result.records.data()), result.records.size() / 4);
  set_most_reach(words, p.most_radius);
  if (p.shine) {
    const std::vector<MapLeaf> leaves = set_reaches(words, std::max(p.neighbours, 1u), host_threads(run.device));
    mark_inner_blocks(run, words, leaves, result);
  }
  result.counts = {static_cast<std::uint32_t>(result.records.size() / sizeof(Photon))};
  set_facts(result, builder.facts());
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
