#include "worker/wavefront/kept_tables.h"

#include <algorithm>

namespace gleaner::worker {
namespace {

bool same_input(const TaskInput& a, const TaskInput& b) {
  return a.artifact.empty() || b.artifact.empty() ? a.source == b.source : a.artifact == b.artifact;
}

bool same_inputs(const std::map<std::string, TaskInput>& a, const std::map<std::string, TaskInput>& b) {
  return std::ranges::equal(
      a, b, [](const auto& x, const auto& y) { return x.first == y.first && same_input(x.second, y.second); });
}

}  // namespace

std::shared_ptr<const void> KeptTables::find(const StageTask& task) {
  const auto entry = std::ranges::find_if(entries_, [&](const Entry& e) {
    return e.scene == task.scene && e.kind == task.kind && e.parameters == task.parameters &&
           same_inputs(e.inputs, task.inputs);
  });
  if (entry == entries_.end()) return nullptr;
  entries_.splice(entries_.begin(), entries_, entry);
  return entries_.front().tables;
}

void KeptTables::put(const StageTask& task, std::shared_ptr<const void> tables, std::size_t bytes) {
  Entry entry{task.scene, task.kind, task.inputs, task.parameters, std::move(tables), bytes};
  // An id says enough; the bytes may go.
  for (auto& [name, input] : entry.inputs)
    if (!input.artifact.empty()) input.source = nullptr;
  entries_.push_front(std::move(entry));
  bytes_ += bytes;
  // The newest is in use whatever its size.
  while (bytes_ > most_ && entries_.size() > 1) {
    bytes_ -= entries_.back().bytes;
    entries_.pop_back();
  }
}

}  // namespace gleaner::worker
