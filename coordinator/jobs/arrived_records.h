#pragma once
// Records of a streamed stage that have arrived and that the plan has not taken yet. Batches come in any order; the
// plan gets them in item order.

#include <cstdint>
#include <functional>
#include <map>
#include <optional>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

class ArrivedRecords {
 public:
  struct Batch {
    std::uint64_t first = 0, count = 0;  // items
    scene::Bytes records;
    std::function<scene::Bytes()> read{};  // where they are not in memory
  };

  void put(Batch batch);  // of items that did not arrive before
  // The batch that follows the last one, where it has arrived.
  std::optional<Batch> next();
  bool ready() const { return !batches_.empty() && batches_.begin()->first == given_; }
  std::uint64_t given() const { return given_; }  // items that next() has returned: those before this one
  std::uint64_t ready_end() const;                // items that next() could have returned by now
  std::uint64_t bytes() const { return bytes_; }  // held

 private:
  std::map<std::uint64_t, Batch> batches_;  // by first item
  std::uint64_t given_ = 0, bytes_ = 0;
};

}  // namespace gleaner::coordinator
