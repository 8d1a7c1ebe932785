#pragma once
// What is known of how fast one worker runs one kind of stage, and what that says about its next batch.

#include <cstdint>

#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

class Throughput {
 public:
  // A batch of `items` took `seconds`, as the worker measured. `cut_short`: it was made smaller than the throughput
  // asked for (a stage's end), so its size says nothing about how large the next may be.
  void measured(std::uint64_t items, Seconds seconds, bool cut_short, const SchedulerSettings& settings);

  // A batch of `items` is not done after `seconds`: the throughput is below items / seconds.
  void overran(std::uint64_t items, Seconds seconds, const SchedulerSettings& settings);

  bool known() const { return items_per_second_ > 0; }
  double items_per_second() const { return items_per_second_; }  // 0 = unknown

  // Items of a batch that lasts target_batch, within the growth cap; first_batch_items where nothing was measured.
  double target_items(const SchedulerSettings& settings) const;
  // Items below which a batch's overhead rules; 0 where the throughput is unknown.
  double smallest_items(const SchedulerSettings& settings) const;

 private:
  double items_per_second_ = 0;
  std::uint64_t last_batch_ = 0;  // items; what the growth cap starts from
  bool last_too_short_ = false;   // the last batch ended before its time could be measured
};

}  // namespace gleaner::coordinator
