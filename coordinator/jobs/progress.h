#pragma once
// How far a frame is, and how long it will take, over all its stages: those to come included, by the work that the plan
// predicts for them. And the same of a job, whose work is its frames.

#include <deque>
#include <utility>

#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

class FrameProgress {
 public:
  FrameProgress() = default;
  // `done`: what was done before. The rate is that of the last `window` seconds.
  explicit FrameProgress(Seconds begun, double done = 0, Seconds window = 10)
      : window_(window), samples_{{begun, done}} {}

  // Work that is done and that is left, in the units of StageSpec::work. A prediction may change what is left.
  void update(Seconds now, double done, double left);

  // Of all work, 0 to 1. It never falls: where more is left than was predicted, it waits.
  double part() const { return part_; }
  // By the rate of the last seconds; negative: nothing is known of it.
  Seconds seconds_left() const;
  // Work a second, of the last seconds; what came before the first result is no part of it, as programs were compiled
  // then. 0: nothing is known of it.
  double pace() const;

 private:
  Seconds window_ = 10;
  double left_ = 0, part_ = 0;
  std::deque<std::pair<Seconds, double>> samples_;  // (when, work done), the oldest first; the last is the latest
};

}  // namespace gleaner::coordinator
