#pragma once
// Pieces of parts on their way through the coordinator, from the worker that holds them to those that cannot reach it.
// A piece that several read is asked for once. Their memory is bounded: whoever would exceed it waits. Knows neither
// gRPC nor the farm. Thread-safe.

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <tuple>

#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

// Bytes [offset, offset + length) of a part's image, or of the sums of its pieces (worker.proto).
struct PartRange {
  std::string artifact;
  std::uint64_t first = 0;  // the part's first item
  std::string digest;       // 32 bytes
  bool sums = false;
  std::uint64_t offset = 0, length = 0;

  auto operator<=>(const PartRange&) const = default;
};

class Relay {
 private:
  struct Transfer;

 public:
  // `patience`: seconds that a holder has for its answer, and a reader for room.
  explicit Relay(std::uint64_t most_bytes = std::uint64_t{64} << 20, double patience = 15);
  ~Relay();

  // A piece that somebody waits for; it takes room until the last one who has it lets it go.
  using Piece = std::shared_ptr<Transfer>;
  // Asks the holder to deliver() under this number. False: it is gone.
  using Ask = std::function<bool(std::uint64_t request)>;

  // Throws Error::connection where there is no room in time, or the holder is gone.
  Piece begin(WorkerId holder, const PartRange& range, const Ask& ask);
  // Its bytes, when they have arrived. Throws Error::connection where they do not, Error::failed where the holder says
  // that it does not have them.
  const std::string& wait(const Piece& piece);

  // The holder's answer; `error`: why there are no bytes. False: nobody waits for it from this worker.
  bool deliver(WorkerId from, std::uint64_t request, std::string data, const std::string& error);
  void worker_lost(WorkerId worker);      // what was asked of it fails at once
  std::uint64_t delivered_bytes() const;  // that holders sent, so far

 private:
  struct Shared;  // outlives the relay where somebody still has a piece
  std::shared_ptr<Shared> shared_;
};

}  // namespace gleaner::coordinator
