#include "coordinator/gateway/silence_watch.h"

namespace gleaner::gateway {

namespace {

constexpr std::chrono::milliseconds look{500};

}  // namespace

SilenceWatch::Call::Call(SilenceWatch& watch, grpc::ServerContext& context, double patience)
    : watch_(watch),
      context_(context),
      patience_(std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(patience))),
      due_(Clock::now() + patience_) {
  std::lock_guard lock(watch_.mutex_);
  watch_.calls_.insert(this);
}

SilenceWatch::Call::~Call() {
  std::lock_guard lock(watch_.mutex_);
  watch_.calls_.erase(this);
}

void SilenceWatch::Call::heard() {
  std::lock_guard lock(watch_.mutex_);
  due_ = Clock::now() + patience_;
}

SilenceWatch::SilenceWatch() : thread_([this] { run(); }) {}

SilenceWatch::~SilenceWatch() {
  {
    std::lock_guard lock(mutex_);
    ending_ = true;
  }
  wakes_.notify_all();
  thread_.join();
}

void SilenceWatch::run() {
  std::unique_lock lock(mutex_);
  while (!wakes_.wait_for(lock, look, [&] { return ending_; })) {
    const Clock::time_point now = Clock::now();
    for (Call* call : calls_)
      if (call->due_ <= now) call->context_.TryCancel();
  }
}

}  // namespace gleaner::gateway
