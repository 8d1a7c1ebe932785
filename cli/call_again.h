#pragma once
// Calls a coordinator that went away again, with growing waits.

#include <chrono>
#include <functional>
#include <string>

#include "scene/model/error.h"

namespace CLI {
class App;
}

namespace gleaner::cli {

void add_give_up_option(CLI::App& command, double& seconds);

class CallAgain {
 public:
  // `give_up_seconds`: 0: never.
  CallAgain(double give_up_seconds, std::function<void(const std::string&)> say)
      : give_up_seconds_(give_up_seconds), say_(std::move(say)) {}

  void answered();
  // Waits before the next call. Throws what is no failure of the connection, and Error::connection where it gives up;
  // `consequence` is said then.
  void lost(const Error& error, const std::string& consequence);

 private:
  using Clock = std::chrono::steady_clock;

  const double give_up_seconds_;
  const std::function<void(const std::string&)> say_;
  bool lost_ = false;
  Clock::time_point since_{};
  double wait_seconds_ = 1;
};

}  // namespace gleaner::cli
