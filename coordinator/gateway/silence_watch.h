#pragma once
// Ends calls whose peer says nothing: each of them holds a thread, of which there are not many.

#include <grpcpp/server_context.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <set>
#include <thread>

namespace gleaner::gateway {

// One of the places that a counter counts, for as long as it exists.
struct Seat {
  explicit Seat(std::atomic<unsigned>& counter) : taken(counter), before(counter.fetch_add(1)) {}
  ~Seat() { taken.fetch_sub(1); }
  Seat(const Seat&) = delete;
  Seat& operator=(const Seat&) = delete;
  std::atomic<unsigned>& taken;
  const unsigned before;  // places that were taken when it came
};

class SilenceWatch {
 public:
  using Clock = std::chrono::steady_clock;

  // A call that is cancelled when `patience` seconds have gone by since it was made or heard() was called.
  class Call {
   public:
    Call(SilenceWatch& watch, grpc::ServerContext& context, double patience);
    ~Call();
    Call(const Call&) = delete;
    Call& operator=(const Call&) = delete;
    void heard();

   private:
    friend class SilenceWatch;
    SilenceWatch& watch_;
    grpc::ServerContext& context_;
    const Clock::duration patience_;
    Clock::time_point due_;  // the watch's mutex guards it
  };

  SilenceWatch();
  ~SilenceWatch();  // no call may be watched any more
  SilenceWatch(const SilenceWatch&) = delete;
  SilenceWatch& operator=(const SilenceWatch&) = delete;

 private:
  void run();

  std::mutex mutex_;
  std::condition_variable wakes_;
  std::set<Call*> calls_;
  bool ending_ = false;
  std::thread thread_;
};

}  // namespace gleaner::gateway
