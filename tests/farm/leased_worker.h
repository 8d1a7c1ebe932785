#pragma once
// A worker of a farm as tests play it: leases wait until the test asks for the next one.

#include <atomic>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/jobs/farm.h"

namespace gleaner::test {

struct Offered {
  coordinator::Lease lease;
  std::shared_ptr<const coordinator::StageWork> work;
};

// Who derives from it leaves the farm in its destructor: until then the farm may call it.
class LeasedWorker : public coordinator::WorkerSession {
 public:
  void leave() {
    if (farm_) std::exchange(farm_, nullptr)->leave(id);
    std::lock_guard lock(mutex_);
    offered_.clear();
  }

  void welcome(const std::string& given) override { name = given; }
  void lease(const coordinator::Lease& lease, std::shared_ptr<const coordinator::StageWork> work) override {
    std::lock_guard lock(mutex_);
    offered_.push_back({lease, std::move(work)});
    changed_.notify_all();
  }
  void revoke(const coordinator::Lease& lease) override {
    std::lock_guard lock(mutex_);
    std::erase_if(offered_, [&](const Offered& offer) { return offer.lease.epoch == lease.epoch; });
  }
  void drain() override { drained = true; }
  void release(const std::vector<coordinator::ArtifactId>&) override {}
  void drop_part(const coordinator::ArtifactId&, std::uint64_t, const std::string&) override {}
  void send_part(std::uint64_t, const coordinator::PartRange&) override {}
  void close(const std::string&) override {}

  std::optional<Offered> next(double seconds = 20) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, std::chrono::duration<double>(seconds), [&] { return !offered_.empty(); });
    if (offered_.empty()) return std::nullopt;
    Offered offer = offered_.front();
    offered_.pop_front();
    return offer;
  }

  coordinator::WorkerId id = 0;
  std::string name;
  std::atomic<bool> drained{false};

 protected:
  // The farm keeps the session as long as it likes; the test keeps the worker.
  void join(coordinator::Farm& farm, const coordinator::WorkerHello& hello) {
    farm_ = &farm;
    id = farm.join(hello, std::shared_ptr<coordinator::WorkerSession>(this, [](coordinator::WorkerSession*) {})).id;
  }

  coordinator::Farm* farm_ = nullptr;
  std::mutex mutex_;  // of what the farm says

 private:
  std::condition_variable changed_;
  std::deque<Offered> offered_;
};

}  // namespace gleaner::test
