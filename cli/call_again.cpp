#include "cli/call_again.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <thread>
#include <utility>

#include "cli/progress.h"

namespace gleaner::cli {

namespace {

constexpr double first_wait_seconds = 1, longest_wait_seconds = 15;

}  // namespace

void add_give_up_option(CLI::App& command, double& seconds) {
  command
      .add_option("--give-up", seconds, "seconds for which a coordinator that went away is called again; 0: for ever")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
}

void CallAgain::answered() {
  if (std::exchange(lost_, false)) say_("the coordinator answers again");
  wait_seconds_ = first_wait_seconds;
}

void CallAgain::lost(const Error& error, const std::string& consequence) {
  if (error.kind() != ErrorKind::connection) throw error;
  if (!std::exchange(lost_, true)) {
    since_ = Clock::now();
    say_(std::string(error.what()) + "; trying again");
  }
  const double gone = std::chrono::duration<double>(Clock::now() - since_).count();
  if (give_up_seconds_ > 0 && gone > give_up_seconds_)
    throw Error::connection(std::string(error.what()) + "; given up after " + format_duration(gone) + consequence);
  std::this_thread::sleep_for(std::chrono::duration<double>(wait_seconds_));
  wait_seconds_ = std::min(2 * wait_seconds_, longest_wait_seconds);
}

}  // namespace gleaner::cli
