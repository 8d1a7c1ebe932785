#include "worker/wavefront/wanted.h"

#include "scene/model/error.h"

namespace gleaner::worker {

namespace {
thread_local const std::atomic<bool>* current = nullptr;
}

WantedScope::WantedScope(const std::atomic<bool>* given_up) : outer_(current) { current = given_up; }
WantedScope::~WantedScope() { current = outer_; }

const std::atomic<bool>* given_up_flag() { return current; }

void check_wanted() {
  if (current && current->load(std::memory_order_relaxed)) throw Error::failed(nobody_wants_it);
}

}  // namespace gleaner::worker
