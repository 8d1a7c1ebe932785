#include "coordinator/jobs/kept_records.h"

namespace gleaner::coordinator {

KeptRecords::Records KeptRecords::find(const std::string& address) {
  for (auto entry = entries_.begin(); entry != entries_.end(); ++entry)
    if (entry->first == address) {
      entries_.splice(entries_.begin(), entries_, entry);
      return entry->second;
    }
  return nullptr;
}

void KeptRecords::put(const std::string& address, Records records) {
  if (records->bytes() > most_ / largest_share || find(address)) return;
  bytes_ += records->bytes();
  entries_.emplace_front(address, std::move(records));
  while (bytes_ > most_ && !entries_.empty()) {
    bytes_ -= entries_.back().second->bytes();
    entries_.pop_back();
  }
}

}  // namespace gleaner::coordinator
