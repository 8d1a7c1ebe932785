#pragma once
// A set of a job's frames, which mostly are neighbours: kept as ranges.

#include <cstdint>
#include <map>
#include <utility>
#include <vector>

namespace gleaner::coordinator {

// Frames are named by their places among the job's frames, from 0.
class FrameSet {
 public:
  void insert(std::uint64_t frame);
  bool contains(std::uint64_t frame) const;
  std::uint64_t count() const { return count_; }
  // [first, last], in order and apart from each other.
  std::vector<std::pair<std::uint64_t, std::uint64_t>> ranges() const { return {ranges_.begin(), ranges_.end()}; }

 private:
  std::map<std::uint64_t, std::uint64_t> ranges_;  // first -> last
  std::uint64_t count_ = 0;
};

}  // namespace gleaner::coordinator
