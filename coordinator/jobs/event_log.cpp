#include "coordinator/jobs/event_log.h"

#include <algorithm>
#include <chrono>

namespace gleaner::coordinator {

namespace {

constexpr std::size_t most_events = 10000;

}  // namespace

double unix_now() { return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count(); }

void EventLog::add(FarmEvent event) {
  event.number = ++last_;
  event.unix_seconds = unix_now();
  events_.push_back(std::move(event));
  if (events_.size() > most_events) events_.pop_front();
}

std::vector<FarmEvent> EventLog::after(std::uint64_t number, const std::string& job) const {
  std::vector<FarmEvent> found;
  const std::uint64_t before_first = last_ - events_.size();
  if (number < before_first)
    found.push_back({.number = before_first,
                     .unix_seconds = events_.empty() ? 0 : events_.front().unix_seconds,
                     .kind = "missed",
                     .what = "missed",
                     .job = {},
                     .worker = {},
                     .message = "events before this one are no longer there"});
  const std::uint64_t skip = number > before_first ? std::min<std::uint64_t>(number - before_first, events_.size()) : 0;
  for (auto event = events_.begin() + static_cast<std::ptrdiff_t>(skip); event != events_.end(); ++event)
    if (job.empty() || event->job == job) found.push_back(*event);
  return found;
}

std::vector<FarmEvent> EventLog::latest(std::size_t most) const {
  const auto count = static_cast<std::ptrdiff_t>(std::min(most, events_.size()));
  return {events_.rbegin(), events_.rbegin() + count};
}

}  // namespace gleaner::coordinator
