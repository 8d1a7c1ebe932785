#pragma once
// What happened on the farm, for programs that act upon it: the last events, numbered. Whoever owns it guards it.

#include <cstdint>
#include <deque>
#include <string>
#include <vector>

namespace gleaner::coordinator {

double unix_now();  // s, of the system's clock

struct FarmEvent {
  std::uint64_t number = 0;  // grows by one; those of a coordinator's next start are greater than all before
  double unix_seconds = 0;
  std::string kind;  // "job", "frame", "worker", or "missed": some are no longer there
  std::string what;  // job: submitted, started, paused, resumed, retried, done, failed, cancelled; frame: started,
                     // written, failed; worker: joined, left, draining, aside
  std::string job, worker;
  std::uint32_t frame = 0;  // its number
  std::string message;      // why; may be empty
};

class EventLog {
 public:
  // `incarnation`: greater at each start of the coordinator.
  explicit EventLog(std::uint64_t incarnation) : last_(incarnation << 32) {}

  void add(FarmEvent event);
  std::uint64_t last() const { return last_; }
  // Those after the event of that number, of the job where it is not empty. Where some of them are no longer there,
  // the first one says so.
  std::vector<FarmEvent> after(std::uint64_t number, const std::string& job) const;
  std::vector<FarmEvent> latest(std::size_t most) const;  // the latest first

 private:
  std::uint64_t last_;
  std::deque<FarmEvent> events_;  // the last one has number `last_`
};

}  // namespace gleaner::coordinator
