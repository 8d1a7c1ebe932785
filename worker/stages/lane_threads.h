#pragma once
// Host threads of a CPU device, each with a command queue of its own.

#include <exception>
#include <thread>
#include <vector>

namespace gleaner::worker {

// Calls run(0) to run(lanes - 1), each in a thread; throws what the first of them threw, after all have ended.
template <typename Run>
void run_lanes(unsigned lanes, Run run) {
  std::vector<std::exception_ptr> errors(lanes);
  const auto guarded = [&](unsigned k) {
    try {
      run(k);
    } catch (...) {
      errors[k] = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> threads;
    for (unsigned k = 1; k < lanes; ++k) threads.emplace_back(guarded, k);
    guarded(0);
  }
  for (auto& error : errors)
    if (error) std::rethrow_exception(error);
}

}  // namespace gleaner::worker
