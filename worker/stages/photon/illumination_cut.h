#pragma once
// The illumination cut (Wang et al. 2009, section 3.3): nodes of a photon map's tree that stand for all its photons.

#include <array>
#include <cstdint>
#include <vector>

namespace gleaner::worker {

// Where a node's irradiance is estimated: the place of the photon that is nearest to the middle of its box, the normal
// of that photon's surface, and how it came there (PHOTON_ARRIVAL).
struct CutPlace {
  std::array<float, 3> position, normal;
  std::uint32_t arrival = 0;
};

// What stands for a node.
struct CutLight {
  CutPlace place;
  std::array<float, 3> middle{};  // irradiance at the place, W/m^2
  std::array<float, 3> mean{};    // over the node's area: E_p
  float spread = 0;               // its variance over the area, over the squared mean
};

class IlluminationCut {
 public:
  // `map`: the words of a map's rows (kernels/photon_records.h), which have been checked.
  explicit IlluminationCut(std::vector<std::uint32_t> map);

  // The coarse cut: from the root on, the node of most power is opened, until there are `nodes`.
  void choose(std::uint32_t nodes);
  std::size_t size() const { return cut_.size(); }
  // Of the i-th of the cut's nodes, which stand in the tree's order.
  CutPlace place(std::size_t i) const;
  // Places of other photons on the surface of place(i), all over the node: at most `most`.
  std::vector<CutPlace> spread(std::size_t i, const CutPlace& place, std::uint32_t most) const;
  // Opens nodes whose irradiance at place(i) differs from eq. 3's by more than `ratio` of that, those within which it
  // varies by more than `spread`, and nodes of several surfaces that face elsewhere. What a former call left closed
  // stays so: its light is the same. Returns of each node of the new cut its number in the old one; GLEANER_NONE: it is
  // new.
  std::vector<std::uint32_t> refine(const std::vector<CutLight>& lights, double ratio, float spread);

  // Of the i-th node, by eq. 3, all colours.
  double rough_irradiance(std::size_t i) const { return irradiance(cut_[i]); }
  double median_radius() const;  // m
  // Words of the cut's rows (kernels/photon_records.h).
  std::vector<std::uint32_t> rows(const std::vector<CutLight>& lights) const;

 private:
  std::uint32_t word(std::size_t node, unsigned word) const;
  float real(std::size_t node, unsigned word) const;
  std::uint32_t block(std::size_t node) const;  // of a leaf
  bool leaf(std::size_t node) const;
  std::size_t right(std::size_t node) const;
  float photon(std::uint32_t block, unsigned lane, unsigned word) const;
  float radius(std::size_t node) const;  // r_p of eq. 3 and 4: the longest side of its box
  double irradiance(std::size_t node) const;
  bool bent(std::size_t node) const;  // whether its photons' normals are unlike
  CutPlace photon_place(std::uint32_t block, unsigned lane) const;
  // Calls see(block, lane) for each photon of a node.
  template <typename See>
  void each_photon(std::size_t node, See see) const;
  // Calls see(first, end) for runs of at most 16 of the cut's nodes, each below one node of the map's tree.
  template <typename See>
  void each_run(std::size_t node, std::size_t first, std::size_t end, const See& see) const;

  std::vector<std::uint32_t> map_;
  std::uint32_t nodes_ = 0;
  std::uint32_t root_ = 0;          // of the tree that is cut: where there are two, not the caustic photons'
  std::vector<double> power_;       // of each node's photons, W, all colours
  std::vector<std::uint32_t> cut_;  // rising
  std::vector<bool> closed_;        // of cut_: refine() has looked at it
};

}  // namespace gleaner::worker
