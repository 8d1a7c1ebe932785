#pragma once
// Bytes of artifacts that lie with the coordinator: a plan's own data, and collected outputs.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

// Where the records of a counted artifact's items begin.
class CountIndex {
 public:
  // `counts`: one little-endian 32-bit number an item.
  explicit CountIndex(std::shared_ptr<const scene::Bytes> counts);
  // How many records lie before those of the item; of the item behind the last one: all.
  std::uint64_t first_record(std::uint64_t item) const;
  const std::shared_ptr<const scene::Bytes>& counts() const { return counts_; }

 private:
  std::shared_ptr<const scene::Bytes> counts_;
  std::vector<std::uint64_t> before_;  // of every so-many-th item; the counts between are added up when asked for
};

struct ArtifactData {
  std::string blob;  // id under which workers fetch its image: of a counted artifact the counts, then the records
  std::shared_ptr<const scene::Bytes> records;
  std::shared_ptr<const CountIndex> index{};  // counted, else null
  std::uint64_t items = 0;                    // of a stage's output; 0: a plan's own data
  std::uint32_t record_bytes = 0;             // as above
  scene::Bytes facts{};                       // of a solo stage's output

  std::uint64_t bytes() const { return records->size() + (index ? index->counts()->size() : 0); }  // of the image
};

}  // namespace gleaner::coordinator
