#pragma once
// Whether anybody still wants the batch that this thread works on. Algorithms on the host ask between their rounds, so
// that a cancelled frame does not hold its worker.

#include <atomic>

namespace gleaner::worker {

inline constexpr const char* nobody_wants_it = "nobody wants the batch any more";

// While it lives, what this thread works on is wanted until `*given_up` turns true. Null: it always is.
class WantedScope {
 public:
  explicit WantedScope(const std::atomic<bool>* given_up);
  ~WantedScope();
  WantedScope(const WantedScope&) = delete;
  WantedScope& operator=(const WantedScope&) = delete;

 private:
  const std::atomic<bool>* const outer_;
};

// Of this thread's innermost scope; null without one.
const std::atomic<bool>* given_up_flag();
// Throws Error::failed where nobody wants it any more.
void check_wanted();

}  // namespace gleaner::worker
