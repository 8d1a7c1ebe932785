#pragma once
// Who calls, and how much of the coordinator one caller may have: requests a second, and calls that last. Ends the
// calls of those whose certificate or token is revoked meanwhile.
//
// A caller is the name in its certificate or token; in the clear it is the host that it calls from, which may be more
// than one person. So calls of one kind take nothing from the others, and one that says nothing gives way to a new one.
// Calls from within the process have no bounds.

#include <grpcpp/server_context.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>

#include "proto/credentials.h"

namespace gleaner::gateway {

struct CallerLimits {
  double requests_a_second = 0;  // on average; twice as many at once; 0: any number
  unsigned calls = 0;            // that last, of each kind; 0: any number
};

class Callers {
 public:
  using Clock = std::chrono::steady_clock;

  Callers(CallerLimits limits, std::shared_ptr<const Keys> keys);
  ~Callers();  // no call is open any more
  Callers(const Callers&) = delete;
  Callers& operator=(const Callers&) = delete;

  // Empty: a call from within this process.
  std::string name_of(const grpc::ServerContext& context) { return who(context).name; }
  // Takes one request of the caller's, of those that are answered at once. RESOURCE_EXHAUSTED: it has none left at the
  // moment.
  grpc::Status admit(const grpc::ServerContext& context);

  // A call that lasts. It is cancelled when what its caller shows is revoked.
  class Call {
   public:
    enum Kind { upload, download, work };  // of watched jobs, too; workers' calls have bounds of their own
    Call(Callers& callers, grpc::ServerContext& context, Kind kind)
        : Call(callers, context, kind, callers.who(context)) {}
    ~Call();
    Call(const Call&) = delete;
    Call& operator=(const Call&) = delete;
    // RESOURCE_EXHAUSTED: its caller has as many of them as it may, or begins too many.
    const grpc::Status& status() const { return status_; }
    void heard();  // it goes on

   private:
    friend class Callers;
    Call(Callers& callers, grpc::ServerContext& context, Kind kind, Peer caller);
    Callers& callers_;
    grpc::ServerContext& context_;
    const Kind kind_;
    const std::string caller_, serial_;
    // The callers' mutex guards these.
    bool counted_ = false;
    Clock::time_point heard_ = Clock::now();
    grpc::Status status_;
  };

 private:
  struct Bucket {
    double requests = 0;  // that may be made at once, at `filled`
    Clock::time_point filled;
    unsigned calls = 0;
  };
  static constexpr std::size_t answered_at_once = Call::work;  // in the place of calls that have no bounds
  struct Caller {
    std::array<Bucket, 3> of;  // by kind of call
  };

  // In the clear: the host that it calls from, and no serial number.
  Peer who(const grpc::ServerContext& context);
  double burst() const { return 2 * std::max(1.0, limits_.requests_a_second); }
  // Mutex held.
  Caller& caller(const std::string& name, Clock::time_point now);
  grpc::Status take_request(const std::string& name, std::size_t kind, Clock::time_point now);
  bool make_room(const Call& call, Clock::time_point now);

  void end_revoked();  // in a thread

  const CallerLimits limits_;
  const std::shared_ptr<Identities> identities_;    // null: in the clear
  const std::shared_ptr<Revocations> revocations_;  // likewise
  std::mutex mutex_;
  std::map<std::string, Caller> callers_;
  std::set<Call*> calls_;
  std::condition_variable ends_;
  bool ending_ = false;
  std::thread thread_;
};

}  // namespace gleaner::gateway
