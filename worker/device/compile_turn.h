#pragma once
// Processes of one machine share PoCL's cache. Without turns, all that begin at once would compile the same kernels.

#include <chrono>
#include <filesystem>

namespace gleaner::worker {

// While it lives, no other process has the turn for the same mark. An empty mark, or a folder that cannot be written:
// no turns are taken, and each process compiles for itself.
class CompileTurn {
 public:
  // Waits while another process has the turn and the mark does not say that it is done; at most `patience`, as that
  // process may have been stopped.
  explicit CompileTurn(const std::filesystem::path& mark, std::chrono::milliseconds patience = std::chrono::minutes(2));
  ~CompileTurn();
  CompileTurn(const CompileTurn&) = delete;
  CompileTurn& operator=(const CompileTurn&) = delete;

  // The cache holds it: from now on nobody takes a turn.
  void done();

 private:
  int descriptor_ = -1;  // of the mark, whose first byte says "done"; -1: no turn is needed
};

}  // namespace gleaner::worker
