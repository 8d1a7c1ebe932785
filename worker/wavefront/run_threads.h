#pragma once

#include <atomic>
#include <exception>
#include <thread>
#include <vector>

#include "worker/wavefront/wanted.h"

namespace gleaner::worker {

// Calls run(0) to run(threads - 1), each in a thread; throws what the first of them threw, after all have ended.
template <typename Run>
void run_threads(unsigned threads, Run run) {
  std::vector<std::exception_ptr> errors(threads);
  const std::atomic<bool>* const given_up = given_up_flag();
  const auto guarded = [&](unsigned k) {
    const WantedScope wanted(given_up);
    try {
      run(k);
    } catch (...) {
      errors[k] = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> others;
    for (unsigned k = 1; k < threads; ++k) others.emplace_back(guarded, k);
    guarded(0);
  }
  for (auto& error : errors)
    if (error) std::rethrow_exception(error);
}

}  // namespace gleaner::worker
