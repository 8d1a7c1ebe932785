#include "coordinator/schedule/throughput.h"

#include <algorithm>
#include <cmath>

namespace gleaner::coordinator {

void Throughput::measured(std::uint64_t items, Seconds seconds, bool cut_short, const SchedulerSettings& settings) {
  // A clock that runs backwards or says nothing must not reach the estimate: NaN fails this comparison.
  if (!(seconds >= 0) || !std::isfinite(seconds) || items == 0) return;

  last_batch_ = cut_short ? std::max(last_batch_, items) : items;
  if (seconds < settings.shortest_sample) {
    // A stage's small last batches are short by intent, not because the worker turned out to be fast.
    if (!cut_short || !known()) last_too_short_ = true;
    return;
  }
  last_too_short_ = false;

  const double sample = static_cast<double>(items) / seconds;
  if (!known()) {
    items_per_second_ = sample;
    return;
  }
  // Too much given to a slow worker holds up the stage, too little costs one more batch: so believe bad news sooner.
  const double weight = sample > items_per_second_ ? settings.good_news : settings.bad_news;
  items_per_second_ += weight * (sample - items_per_second_);
}

void Throughput::overran(std::uint64_t items, Seconds seconds, const SchedulerSettings& settings) {
  if (!(seconds > 0) || !std::isfinite(seconds) || items == 0) return;
  const double bound = static_cast<double>(items) / seconds;
  if (!known()) {
    items_per_second_ = bound;
  } else if (bound < items_per_second_) {
    items_per_second_ += settings.bad_news * (bound - items_per_second_);
  }
}

double Throughput::target_items(const SchedulerSettings& settings) const {
  const double cap = settings.growth * static_cast<double>(last_batch_);
  if (!known()) return std::max(cap, static_cast<double>(settings.first_batch_items));
  // Nothing could be measured: grow until something can.
  if (last_too_short_) return cap;
  const double target = settings.target_batch * items_per_second_;
  return last_batch_ > 0 ? std::min(target, cap) : target;
}

double Throughput::smallest_items(const SchedulerSettings& settings) const {
  return settings.smallest_batch * items_per_second_;
}

}  // namespace gleaner::coordinator
