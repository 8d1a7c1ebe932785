#include "coordinator/jobs/progress.h"

#include <algorithm>

namespace gleaner::coordinator {

namespace {

constexpr Seconds sample_interval = 0.1;  // a frame has thousands of results

}  // namespace

void FrameProgress::update(Seconds now, double done, double left) {
  left_ = std::max(0.0, left);
  if (done > 0) part_ = std::max(part_, done / (done + left_));
  // The one before the last is kept until the last is old enough to be worth a sample of its own.
  const std::size_t count = samples_.size();
  if (count >= 2 && samples_.back().first - samples_[count - 2].first < sample_interval)
    samples_.back() = {now, done};
  else
    samples_.emplace_back(now, done);
  while (samples_.size() > 2 && samples_[1].first < now - window_) samples_.pop_front();
}

Seconds FrameProgress::seconds_left() const {
  if (samples_.size() < 2) return -1;
  if (left_ <= 0) return 0;
  const auto& [since, before] = samples_.front();
  const auto& [until, done] = samples_.back();
  return done > before && until > since ? left_ * (until - since) / (done - before) : -1;
}

double FrameProgress::pace() const {
  if (samples_.size() < 2) return 0;
  const auto& [since, before] = samples_[samples_.size() > 2 ? 1 : 0];
  const auto& [until, done] = samples_.back();
  return until > since ? std::max(0.0, done - before) / (until - since) : 0;
}

}  // namespace gleaner::coordinator
