#include "coordinator/artifacts/relay.h"

#include <chrono>
#include <random>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::coordinator {

using Clock = std::chrono::steady_clock;

struct Relay::Transfer {
  PartRange range;
  WorkerId holder = 0;
  std::uint64_t request = 0;
  Clock::time_point begun = Clock::now();
  unsigned users = 1;
  bool ended = false;        // `data` or `error` is there, and stays
  bool holder_says = false;  // the error
  std::string data, error;
};

struct Relay::Shared {
  std::uint64_t most_bytes = 0;
  std::chrono::duration<double> patience{};
  std::mutex mutex;  // guards what follows
  std::condition_variable changed;
  std::mt19937_64 random{std::random_device{}()};
  std::uint64_t bytes = 0, delivered = 0;                    // bytes: of all transfers that somebody uses
  std::map<PartRange, std::shared_ptr<Transfer>> transfers;  // those that have not failed
  std::map<std::uint64_t, std::shared_ptr<Transfer>> unanswered;

  void end(const std::shared_ptr<Transfer>& transfer, std::string data, const std::string& error) {
    unanswered.erase(transfer->request);
    transfer->ended = true;
    transfer->data = std::move(data);
    transfer->error = error;
    // Whoever asks from now on tries again.
    if (!error.empty()) forget(transfer);
    changed.notify_all();
  }
  void forget(const std::shared_ptr<Transfer>& transfer) {
    const auto at = transfers.find(transfer->range);
    if (at != transfers.end() && at->second == transfer) transfers.erase(at);
  }
  void let_go(const std::shared_ptr<Transfer>& transfer) {
    std::lock_guard lock(mutex);
    if (--transfer->users > 0) return;
    unanswered.erase(transfer->request);
    forget(transfer);
    bytes -= transfer->range.length;
    changed.notify_all();
  }
};

Relay::Relay(std::uint64_t most_bytes, double patience) : shared_(std::make_shared<Shared>()) {
  shared_->most_bytes = most_bytes;
  shared_->patience = std::chrono::duration<double>(patience);
}

Relay::~Relay() = default;

Relay::Piece Relay::begin(WorkerId holder, const PartRange& range, const Ask& ask) {
  const auto handle = [shared = shared_](std::shared_ptr<Transfer> transfer) {
    Transfer* raw = transfer.get();
    return Piece(raw, [shared, transfer = std::move(transfer)](Transfer*) { shared->let_go(transfer); });
  };
  std::unique_lock lock(shared_->mutex);
  const auto shared_one = [&]() -> std::shared_ptr<Transfer> {
    const auto at = shared_->transfers.find(range);
    return at == shared_->transfers.end() ? nullptr : at->second;
  };
  const auto room = [&] { return shared_->bytes == 0 || shared_->bytes + range.length <= shared_->most_bytes; };
  if (!shared_->changed.wait_for(lock, shared_->patience, [&] { return shared_one() || room(); }))
    throw Error::connection("too many workers read through the coordinator at the moment");
  if (auto other = shared_one()) {
    ++other->users;
    return handle(std::move(other));
  }
  auto transfer = std::make_shared<Transfer>();
  transfer->range = range;
  transfer->holder = holder;
  do transfer->request = shared_->random();
  while (shared_->unanswered.contains(transfer->request));
  shared_->bytes += range.length;
  shared_->transfers[range] = transfer;
  shared_->unanswered[transfer->request] = transfer;
  lock.unlock();
  Piece piece = handle(transfer);
  if (!ask(transfer->request)) {
    lock.lock();
    shared_->end(transfer, {}, "the worker that holds it is gone");
    lock.unlock();
    throw Error::connection(transfer->error);
  }
  return piece;
}

const std::string& Relay::wait(const Piece& piece) {
  std::unique_lock lock(shared_->mutex);
  const auto until = piece->begun + std::chrono::duration_cast<Clock::duration>(shared_->patience);
  if (!shared_->changed.wait_until(lock, until, [&] { return piece->ended; }))
    throw Error::connection("the worker that holds it does not answer");
  if (!piece->error.empty()) throw piece->holder_says ? Error::failed(piece->error) : Error::connection(piece->error);
  return piece->data;
}

bool Relay::deliver(WorkerId from, std::uint64_t request, std::string data, const std::string& error) {
  std::lock_guard lock(shared_->mutex);
  const auto at = shared_->unanswered.find(request);
  if (at == shared_->unanswered.end() || at->second->holder != from) return false;
  const std::shared_ptr<Transfer> transfer = at->second;
  shared_->delivered += data.size();
  transfer->holder_says = true;
  if (error.empty() && data.size() != transfer->range.length)
    shared_->end(transfer, {},
                 "the worker that holds it sent " + std::to_string(data.size()) + " bytes instead of " +
                     std::to_string(transfer->range.length));
  else
    shared_->end(transfer, std::move(data), error);
  return true;
}

void Relay::worker_lost(WorkerId worker) {
  std::lock_guard lock(shared_->mutex);
  for (auto at = shared_->unanswered.begin(); at != shared_->unanswered.end();) {
    const std::shared_ptr<Transfer> transfer = (at++)->second;
    if (transfer->holder == worker) shared_->end(transfer, {}, "the worker that holds it is gone");
  }
}

std::uint64_t Relay::delivered_bytes() const {
  std::lock_guard lock(shared_->mutex);
  return shared_->delivered;
}

}  // namespace gleaner::coordinator
