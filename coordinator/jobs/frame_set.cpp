#include "coordinator/jobs/frame_set.h"

#include <iterator>

namespace gleaner::coordinator {

bool FrameSet::contains(std::uint64_t frame) const {
  const auto after = ranges_.upper_bound(frame);
  return after != ranges_.begin() && std::prev(after)->second >= frame;
}

void FrameSet::insert(std::uint64_t frame) {
  if (contains(frame)) return;
  ++count_;
  const auto after = ranges_.upper_bound(frame);
  auto own = after;
  if (after != ranges_.begin() && std::prev(after)->second + 1 == frame)
    (own = std::prev(after))->second = frame;
  else
    own = ranges_.emplace_hint(after, frame, frame);
  if (after != ranges_.end() && after->first == frame + 1) {
    own->second = after->second;
    ranges_.erase(after);
  }
}

}  // namespace gleaner::coordinator
