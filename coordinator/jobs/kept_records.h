#pragma once
// Records of stages that other frames may read, the least recently used leaving first.

#include <cstdint>
#include <list>
#include <memory>
#include <string>
#include <utility>

#include "coordinator/artifacts/artifact_data.h"

namespace gleaner::coordinator {

class KeptRecords {
 public:
  using Records = std::shared_ptr<const ArtifactData>;

  // One of more than so large a part of the bound is not kept: it would drive out what serves many frames.
  static constexpr std::uint64_t largest_share = 4;

  explicit KeptRecords(std::uint64_t most) : most_(most) {}  // bytes

  Records find(const std::string& address);  // null: not kept
  void put(const std::string& address, Records records);
  void clear() {
    entries_.clear();
    bytes_ = 0;
  }

 private:
  std::uint64_t most_, bytes_ = 0;
  std::list<std::pair<std::string, Records>> entries_;  // the last used first
};

}  // namespace gleaner::coordinator
