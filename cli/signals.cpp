#include "cli/signals.h"

#include <signal.h>
#include <unistd.h>

#include <utility>

namespace gleaner::cli {

namespace {

sigset_t ending_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  return set;
}

}  // namespace

Signals::Signals() {
  sigset_t set = ending_signals();
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
  thread_ = std::thread([this] { wait(); });
}

Signals::~Signals() {
  ending_ = true;
  pthread_kill(thread_.native_handle(), SIGTERM);
  thread_.join();
}

void Signals::watch(std::function<void()> on_signal) {
  std::lock_guard lock(mutex_);
  on_signal_ = std::move(on_signal);
  if (raised_ && on_signal_) on_signal_();
}

void Signals::wait() {
  sigset_t set = ending_signals();
  for (;;) {
    int signal = 0;
    sigwait(&set, &signal);
    if (ending_) return;
    if (raised_ && signal == SIGINT) ::_exit(128 + signal);
    if (raised_) continue;
    std::lock_guard lock(mutex_);
    raised_ = true;
    if (on_signal_) on_signal_();
  }
}

}  // namespace gleaner::cli
