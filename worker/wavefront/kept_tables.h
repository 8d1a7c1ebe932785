#pragma once
// What stages made of their inputs, for the batches to come that read the same.

#include <cstddef>
#include <list>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

// Bounded by bytes; the least recently used tables go first. Not thread-safe.
class KeptTables {
 public:
  explicit KeptTables(std::size_t most_bytes) : most_(most_bytes) {}

  // The tables that `make` makes of the task's inputs and parameters, from an earlier batch of the same scene, kind,
  // inputs and parameters where there was one. Tables says by bytes() what it takes. A task with an input of its
  // batch's own items must not ask: the next batch has other records.
  template <typename Tables, typename Make>
  std::shared_ptr<const Tables> get(const StageTask& task, Make make) {
    if (auto held = find(task)) return std::static_pointer_cast<const Tables>(held);
    auto made = std::make_shared<const Tables>(make());
    put(task, made, made->bytes());
    return made;
  }

  std::size_t bytes() const { return bytes_; }

 private:
  struct Entry {
    std::string scene, kind;
    // Sources without an id are held, so that no other can come to lie at the same place.
    std::map<std::string, TaskInput> inputs;
    std::vector<std::byte> parameters;
    std::shared_ptr<const void> tables;
    std::size_t bytes = 0;
  };
  std::shared_ptr<const void> find(const StageTask& task);
  void put(const StageTask& task, std::shared_ptr<const void> tables, std::size_t bytes);

  std::size_t most_, bytes_ = 0;
  std::list<Entry> entries_;  // the latest used first
};

}  // namespace gleaner::worker
