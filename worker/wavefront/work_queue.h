#pragma once
// A batch's items, claimed in blocks by the host threads that work on it.

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "worker/wavefront/run_threads.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {

// Threads claim blocks that begin at multiples of kAlignment, smaller ones near the end, so that they end together.
// What an item's record holds does not depend on how the items are cut into blocks. Thread-safe.
class WorkQueue {
 public:
  static constexpr std::uint64_t kAlignment = 16;  // rays of a packet

  struct Block {
    std::uint64_t first = 0, count = 0;
    explicit operator bool() const { return count != 0; }
  };

  // `least`: a smaller block costs more in launches than it saves in waiting. 0: a share of the items. No block is
  // given out any more once nobody wants what the thread that makes the queue works on (WantedScope).
  WorkQueue(std::uint64_t total, unsigned threads, std::uint64_t least = 0)
      : total_(total), threads_(threads), least_(aligned(least ? least : total / (6 * threads) + 1)) {}

  // At most `room` items; empty where none is left, or the batch was given up.
  Block claim(std::uint64_t room) {
    std::uint64_t next = next_.load();
    for (;;) {
      const std::uint64_t left = total_ - next;
      if (left == 0 || stopped()) return {};
      const std::uint64_t share = threads_ == 1 ? left : std::max(least_, aligned(left / (2 * threads_)));
      std::uint64_t take = std::min({room, share, left});
      if (take < left && take > kAlignment) take -= take % kAlignment;
      if (next_.compare_exchange_weak(next, next + take)) return {next, take};
    }
  }

  // After a thread has failed, the others get no more.
  void stop() { stopped_ = true; }
  bool stopped() const {
    return stopped_.load(std::memory_order_relaxed) || (given_up_ && given_up_->load(std::memory_order_relaxed));
  }
  unsigned threads() const { return threads_; }

 private:
  static std::uint64_t aligned(std::uint64_t n) { return (n + kAlignment - 1) / kAlignment * kAlignment; }

  std::uint64_t total_;
  unsigned threads_;
  const std::atomic<bool>* const given_up_ = given_up_flag();
  std::uint64_t least_;
  std::atomic<std::uint64_t> next_{0};
  std::atomic<bool> stopped_{false};
};

// Calls of(item) for items 0 to total - 1, by so many threads at most, each of which takes up to `room` of them at a
// time. Throws what the first thread threw, and Error::failed where nobody wants the batch any more.
template <typename Of>
void for_each_item(std::uint64_t total, unsigned threads, std::uint64_t room, const Of& of) {
  // Starting a thread that gets nothing would cost as much as starting any other.
  threads = static_cast<unsigned>(std::clamp<std::uint64_t>((total + room - 1) / room, 1, threads));
  WorkQueue work(total, threads, room);
  run_threads(threads, [&](unsigned) {
    while (const WorkQueue::Block block = work.claim(room))
      for (std::uint64_t item = block.first; item < block.first + block.count; ++item) of(item);
  });
  check_wanted();
}

}  // namespace gleaner::worker
