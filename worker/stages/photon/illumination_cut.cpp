#include "worker/stages/photon/illumination_cut.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <queue>
#include <utility>

#include "kernels/photon_records.h"
#include "kernels/rays.h"
#include "worker/stages/photon/packed.h"
#include "worker/stages/vectors.h"

namespace gleaner::worker {
namespace {

constexpr float kLeastRadius = 1e-6f;  // m

// Whether the surface at a place covers a photon: as far_below() and covered() of kernels/photon/map.h.
bool covers(const CutPlace& place, const CutPlace& photon) {
  const std::array<float, 3> off = photon.position - place.position;
  const float height = dot(off, place.normal), distance2 = dot(off, off);
  if (!(height < 0 && height * height > PHOTON_LEAST_DEPTH * PHOTON_LEAST_DEPTH * distance2)) return false;
  const float length = unpack_length(photon.arrival >> PHOTON_LENGTH_SHIFT);
  const float rise = -length * dot(unpack_unit(photon.arrival, 12), place.normal);
  return std::abs(rise + height) < -PHOTON_COVER_MARGIN * height && length * length < distance2;
}

// Holds no place until it is extended.
struct ReachBox {
  std::array<float, 3> lower, upper;
  ReachBox() {
    lower.fill(std::numeric_limits<float>::infinity());
    upper.fill(-std::numeric_limits<float>::infinity());
  }
  void extend(unsigned k, float from, float to) {
    lower[k] = std::min(lower[k], from);
    upper[k] = std::max(upper[k], to);
  }
};

// Appends the groups of 16 of these boxes to a cut's rows. Returns the boxes about the groups.
std::vector<ReachBox> append_groups(const std::vector<ReachBox>& boxes, std::vector<std::uint32_t>& rows) {
  std::vector<ReachBox> groups;
  for (std::size_t first = 0; first < boxes.size(); first += RAY_BLOCK) {
    const std::size_t words = rows.size();
    rows.resize(words + std::size_t{CUT_BOX_WORDS} * RAY_BLOCK);
    ReachBox about;
    for (std::size_t lane = 0; lane < RAY_BLOCK; ++lane) {
      const ReachBox box = first + lane < boxes.size() ? boxes[first + lane] : ReachBox();
      for (unsigned k = 0; k < 3; ++k) {
        rows[words + k * RAY_BLOCK + lane] = std::bit_cast<std::uint32_t>(box.lower[k]);
        rows[words + (3 + k) * RAY_BLOCK + lane] = std::bit_cast<std::uint32_t>(box.upper[k]);
        about.extend(k, box.lower[k], box.upper[k]);
      }
    }
    groups.push_back(about);
  }
  return groups;
}

}  // namespace

std::uint32_t IlluminationCut::word(std::size_t node, unsigned word) const {
  return map_[(1 + node) * PHOTON_WORDS + word];
}
float IlluminationCut::real(std::size_t node, unsigned word) const {
  return std::bit_cast<float>(this->word(node, word));
}
std::uint32_t IlluminationCut::block(std::size_t node) const { return word(node, NODE_BLOCK) & NODE_BLOCK_MASK; }
bool IlluminationCut::leaf(std::size_t node) const { return block(node) != NODE_NO_BLOCK; }
std::size_t IlluminationCut::right(std::size_t node) const { return word(node + 1, NODE_SKIP); }
float IlluminationCut::photon(std::uint32_t block, unsigned lane, unsigned word) const {
  const std::size_t first = (1 + std::size_t{nodes_}) * PHOTON_WORDS;
  return std::bit_cast<float>(map_[first + (std::size_t{block} * PHOTON_WORDS + word) * RAY_BLOCK + lane]);
}

IlluminationCut::IlluminationCut(std::vector<std::uint32_t> map)
    : map_(std::move(map)), nodes_(map_[MAP_NODES]), power_(nodes_, 0) {
  if (map_[MAP_CAUSTICS] > 1 && map_[MAP_CAUSTICS] < nodes_) root_ = 1;
  // Children stand behind their node.
  for (std::size_t node = nodes_; node-- > 0;) {
    if (!leaf(node)) {
      power_[node] = power_[node + 1] + power_[right(node)];
      continue;
    }
    for (unsigned lane = 0; lane < RAY_BLOCK; ++lane)
      for (unsigned k = 0; k < 3; ++k) power_[node] += double{photon(block(node), lane, PHOTON_POWER + k)};
  }
  cut_ = {root_};
  closed_ = {false};
}

void IlluminationCut::choose(std::uint32_t nodes) {
  // The first of equals is opened first.
  using Candidate = std::pair<double, std::int64_t>;
  std::priority_queue<Candidate> open;
  std::vector<std::uint32_t> closed;
  const auto add = [&](std::size_t node) {
    if (leaf(node))
      closed.push_back(static_cast<std::uint32_t>(node));
    else
      open.push({power_[node], -static_cast<std::int64_t>(node)});
  };
  add(root_);
  while (!open.empty() && open.size() + closed.size() < nodes) {
    const auto node = static_cast<std::size_t>(-open.top().second);
    open.pop();
    add(node + 1);
    add(right(node));
  }
  cut_ = std::move(closed);
  for (; !open.empty(); open.pop()) cut_.push_back(static_cast<std::uint32_t>(-open.top().second));
  std::ranges::sort(cut_);
  closed_.assign(cut_.size(), false);
}

float IlluminationCut::radius(std::size_t node) const {
  float most = kLeastRadius;
  for (unsigned k = 0; k < 3; ++k) most = std::max(most, real(node, NODE_UPPER + k) - real(node, NODE_LOWER + k));
  return most;
}

// Eq. 3, without its cosine: photons lie the thinner on a surface the more it is turned away from them.
double IlluminationCut::irradiance(std::size_t node) const {
  const double r = radius(node);
  return power_[node] / (r * r);
}

template <typename See>
void IlluminationCut::each_photon(std::size_t node, See see) const {
  for (std::size_t below = node; below < word(node, NODE_SKIP); ++below) {
    if (!leaf(below)) continue;
    for (unsigned lane = 0; lane < RAY_BLOCK; ++lane)
      if (photon(block(below), lane, 0) < kFarthestPhoton) see(block(below), lane);
  }
}

CutPlace IlluminationCut::photon_place(std::uint32_t block, unsigned lane) const {
  return {.position = {photon(block, lane, 0), photon(block, lane, 1), photon(block, lane, 2)},
          .normal = unpack_unit(std::bit_cast<std::uint32_t>(photon(block, lane, PHOTON_SURFACE)), 12),
          .arrival = std::bit_cast<std::uint32_t>(photon(block, lane, PHOTON_ARRIVAL))};
}

CutPlace IlluminationCut::place(std::size_t i) const {
  const std::size_t node = cut_[i];
  std::array<float, 3> middle{};
  for (unsigned k = 0; k < 3; ++k) middle[k] = (real(node, NODE_LOWER + k) + real(node, NODE_UPPER + k)) / 2;
  CutPlace best{};
  double nearest = std::numeric_limits<double>::infinity();
  each_photon(node, [&](std::uint32_t block, unsigned lane) {
    double off = 0;
    for (unsigned k = 0; k < 3; ++k) off += std::pow(double{photon(block, lane, k)} - middle[k], 2);
    if (!(off < nearest)) return;
    nearest = off;
    best = photon_place(block, lane);
  });
  return best;
}

std::vector<CutPlace> IlluminationCut::spread(std::size_t i, const CutPlace& place, std::uint32_t most) const {
  std::vector<CutPlace> alike;
  each_photon(cut_[i], [&](std::uint32_t block, unsigned lane) {
    const CutPlace other = photon_place(block, lane);
    if (dot(other.normal, place.normal) > MAP_LEAST_COSINE && other.position != place.position &&
        !covers(place, other) && !covers(other, place))
      alike.push_back(other);
  });
  std::vector<CutPlace> places;
  const std::size_t wanted = std::min<std::size_t>(most, alike.size());
  for (std::size_t k = 0; k < wanted; ++k) places.push_back(alike[(2 * k + 1) * alike.size() / (2 * wanted)]);
  return places;
}

bool IlluminationCut::bent(std::size_t node) const {
  bool first = true, unlike = false;
  std::array<float, 3> one{};
  each_photon(node, [&](std::uint32_t block, unsigned lane) {
    const std::array<float, 3> n = photon_place(block, lane).normal;
    if (first) one = n;
    first = false;
    unlike = unlike || dot(n, one) < MAP_LEAST_COSINE;
  });
  return unlike;
}

std::vector<std::uint32_t> IlluminationCut::refine(const std::vector<CutLight>& lights, double ratio, float spread) {
  std::vector<std::uint32_t> refined, from;
  std::vector<bool> closed;
  const auto add = [&](std::size_t node, std::uint32_t number) {
    refined.push_back(static_cast<std::uint32_t>(node));
    from.push_back(number);
    closed.push_back(number != GLEANER_NONE);
  };
  for (std::size_t i = 0; i < cut_.size(); ++i) {
    const std::size_t node = cut_[i];
    const double rough = this->irradiance(node);
    const CutLight& light = lights[i];
    const double exact = double{light.middle[0]} + light.middle[1] + light.middle[2];
    if (closed_[i] || leaf(node) || !(std::abs(exact - rough) > ratio * rough || light.spread > spread || bent(node))) {
      add(node, static_cast<std::uint32_t>(i));
    } else {
      add(node + 1, GLEANER_NONE);
      add(right(node), GLEANER_NONE);
    }
  }
  cut_ = std::move(refined);
  closed_ = std::move(closed);
  return from;
}

double IlluminationCut::median_radius() const {
  std::vector<float> radii;
  for (const std::uint32_t node : cut_) radii.push_back(radius(node));
  const auto middle = radii.begin() + static_cast<std::ptrdiff_t>(radii.size() / 2);
  std::nth_element(radii.begin(), middle, radii.end());
  return double{*middle};
}

template <typename See>
void IlluminationCut::each_run(std::size_t node, std::size_t first, std::size_t end, const See& see) const {
  if (end - first <= RAY_BLOCK) return see(first, end);
  const auto middle = static_cast<std::size_t>(std::ranges::lower_bound(cut_, right(node)) - cut_.begin());
  each_run(node + 1, first, middle, see);
  each_run(right(node), middle, end, see);
}

std::vector<std::uint32_t> IlluminationCut::rows(const std::vector<CutLight>& lights) const {
  std::vector<std::uint32_t> blocks;
  std::vector<ReachBox> boxes;
  each_run(root_, 0, cut_.size(), [&](std::size_t first, std::size_t end) {
    const std::size_t words = blocks.size();
    blocks.resize(words + std::size_t{CUT_WORDS} * RAY_BLOCK, 0);
    ReachBox box;
    for (std::size_t i = first; i < end; ++i) {
      const auto put = [&](unsigned word, float value) {
        blocks[words + std::size_t{word} * RAY_BLOCK + (i - first)] = std::bit_cast<std::uint32_t>(value);
      };
      const float r = radius(cut_[i]);
      for (unsigned k = 0; k < 3; ++k) {
        const CutPlace& place = lights[i].place;
        box.extend(k, place.position[k] - r, place.position[k] + r);
        put(CUT_PLACE + k, place.position[k]);
        put(CUT_NORMAL + k, place.normal[k]);
        put(CUT_IRRADIANCE + k, lights[i].mean[k]);
      }
      put(CUT_NEARNESS, 1 / (r * r));
      put(CUT_ARRIVAL, std::bit_cast<float>(lights[i].place.arrival));
      put(CUT_SPREAD, lights[i].spread);
    }
    boxes.push_back(box);
  });
  std::vector<std::uint32_t> rows(2 * PHOTON_WORDS);
  rows[MAP_BLOCKS] = static_cast<std::uint32_t>(boxes.size());
  do boxes = append_groups(boxes, rows);
  while (boxes.size() > 1);
  rows[MAP_NODES] = static_cast<std::uint32_t>(rows.size() / PHOTON_WORDS - 1);
  rows.insert(rows.end(), blocks.begin(), blocks.end());
  return rows;
}

}  // namespace gleaner::worker
