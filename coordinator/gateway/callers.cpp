#include "coordinator/gateway/callers.h"

#include <algorithm>
#include <cstdio>

#include "scene/model/names.h"

namespace gleaner::gateway {

using grpc::Status;
using grpc::StatusCode;

namespace {

constexpr std::chrono::milliseconds between_looks{500};  // at the list of revoked certificates
constexpr std::chrono::seconds gives_way{5};             // to a new one, a call that has been silent for so long
constexpr std::size_t many_callers = 4096;

// Of "ipv4:1.2.3.4:5678" or "ipv6:%5B::1%5D:5678" what comes before the port.
std::string host_of(const std::string& peer) {
  if (!peer.starts_with("ipv4:") && !peer.starts_with("ipv6:")) return {};
  return peer.substr(5, peer.rfind(':') - 5);
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

}  // namespace

Callers::Callers(CallerLimits limits, std::shared_ptr<const Keys> keys)
    : limits_(limits),
      identities_(keys ? std::make_shared<Identities>(*keys) : nullptr),
      revocations_(keys ? std::make_shared<Revocations>(*keys) : nullptr) {
  if (revocations_) thread_ = std::thread([this] { end_revoked(); });
}

Callers::~Callers() {
  {
    std::lock_guard lock(mutex_);
    ending_ = true;
  }
  ends_.notify_all();
  if (thread_.joinable()) thread_.join();
}

Peer Callers::who(const grpc::ServerContext& context) {
  if (identities_)
    if (std::optional<Peer> peer = identities_->of(*context.auth_context(), context.client_metadata())) return *peer;
  return {.name = host_of(context.peer()), .serial = {}, .roles = {}};
}

Callers::Caller& Callers::caller(const std::string& name, Clock::time_point now) {
  // Whoever has been quiet for long is as one that was never here.
  if (callers_.size() >= many_callers)
    std::erase_if(callers_, [&](const auto& entry) {
      return std::all_of(entry.second.of.begin(), entry.second.of.end(), [&](const Bucket& bucket) {
        return bucket.calls == 0 && now - bucket.filled > std::chrono::seconds(2);
      });
    });
  auto [at, fresh] = callers_.try_emplace(name);
  if (fresh) at->second.of.fill({.requests = burst(), .filled = now, .calls = 0});
  return at->second;
}

Status Callers::take_request(const std::string& name, std::size_t kind, Clock::time_point now) {
  if (!(limits_.requests_a_second > 0) || name.empty()) return Status::OK;
  Bucket& bucket = caller(name, now).of[kind];
  const double seconds = std::chrono::duration<double>(now - bucket.filled).count();
  bucket.requests = std::min(burst(), bucket.requests + seconds * limits_.requests_a_second);
  bucket.filled = now;
  if (bucket.requests < 1)
    return {StatusCode::RESOURCE_EXHAUSTED, printable(name) + " makes more than " + number(limits_.requests_a_second) +
                                                " requests a second, which is this coordinator's limit: try again"};
  bucket.requests -= 1;
  return Status::OK;
}

Status Callers::admit(const grpc::ServerContext& context) {
  const std::string name = name_of(context);
  std::lock_guard lock(mutex_);
  return take_request(name, answered_at_once, Clock::now());
}

// The caller's call of this kind that has said nothing for longest gives way, if that is long enough.
bool Callers::make_room(const Call& call, Clock::time_point now) {
  Call* silent = nullptr;
  for (Call* other : calls_)
    if (other->counted_ && other->kind_ == call.kind_ && other->caller_ == call.caller_ &&
        now - other->heard_ > gives_way && (!silent || other->heard_ < silent->heard_))
      silent = other;
  if (!silent) return false;
  silent->counted_ = false;
  silent->context_.TryCancel();
  --callers_.at(call.caller_).of[call.kind_].calls;
  return true;
}

Callers::Call::Call(Callers& callers, grpc::ServerContext& context, Kind kind, Peer caller)
    : callers_(callers),
      context_(context),
      kind_(kind),
      caller_(std::move(caller.name)),
      serial_(std::move(caller.serial)) {
  static constexpr const char* names[] = {"uploads", "watches and downloads"};
  std::lock_guard lock(callers_.mutex_);
  callers_.calls_.insert(this);
  if (kind == work || caller_.empty()) return;
  status_ = callers_.take_request(caller_, kind, heard_);
  if (!status_.ok() || callers_.limits_.calls == 0) return;
  Bucket& bucket = callers_.caller(caller_, heard_).of[kind];
  if (bucket.calls >= callers_.limits_.calls && !callers_.make_room(*this, heard_)) {
    status_ = {StatusCode::RESOURCE_EXHAUSTED, printable(caller_) + " has " + std::to_string(bucket.calls) + " " +
                                                   names[kind] + " open, which is this coordinator's limit: try again"};
    return;
  }
  counted_ = true;
  ++bucket.calls;
}

Callers::Call::~Call() {
  std::lock_guard lock(callers_.mutex_);
  callers_.calls_.erase(this);
  if (counted_) --callers_.callers_.at(caller_).of[kind_].calls;
}

void Callers::Call::heard() {
  std::lock_guard lock(callers_.mutex_);
  heard_ = Clock::now();
}

void Callers::end_revoked() {
  std::unique_lock lock(mutex_);
  while (!ends_.wait_for(lock, between_looks, [&] { return ending_; }))
    for (Call* call : calls_)
      if (!call->serial_.empty() && revocations_->contains(call->serial_)) call->context_.TryCancel();
}

}  // namespace gleaner::gateway
