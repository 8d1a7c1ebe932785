#include "worker/agent/part_client.h"

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <cstring>
#include <utility>

#include "proto/sha256.h"
#include "scene/model/error.h"
#include "worker/artifacts/part_image.h"

namespace gleaner::worker {

namespace pb = gleaner::v1;

namespace {

constexpr std::chrono::seconds shunned_for{60};  // an address that could not be reached
constexpr std::chrono::seconds patience{20};     // of a call, beside what its bytes take on a slow line
constexpr std::uint64_t slow_line = 1 << 20;     // bytes per second
constexpr std::size_t most_peers = 256;          // connections kept

// The holder has other bytes than those of the digest, or none any more: it is no holder.
struct WrongBytes : Error {
  explicit WrongBytes(const std::string& what) : Error(ErrorKind::connection, what) {}
};

// Nobody answers at the address.
struct Unreachable : Error {
  explicit Unreachable(const std::string& what) : Error(ErrorKind::connection, what) {}
};

std::string name_of(const LocatedPart& from) {
  return "artifact " + from.artifact + ", items " + std::to_string(from.part.first()) + " to " +
         std::to_string(from.part.first() + from.part.items() - 1);
}

}  // namespace

struct PartClient::Source {
  pb::Holder holder;
  std::shared_ptr<pb::WorkerPeer::Stub> peer;  // null: through the coordinator
};

PartClient::PartClient(std::shared_ptr<grpc::Channel> coordinator, std::shared_ptr<PartStore> own,
                       std::shared_ptr<ByteCache> cache, std::shared_ptr<const Keys> keys, Report report)
    : hub_(pb::WorkerHub::NewStub(std::move(coordinator))),
      own_(std::move(own)),
      cache_(std::move(cache)),
      keys_(std::move(keys)),
      report_(std::move(report)) {}

void PartClient::connected(const std::string& token) {
  std::lock_guard lock(mutex_);
  token_ = token;
  peers_.clear();
  unreachable_.clear();
}

std::vector<LocatedPart> PartClient::locate(const std::string& artifact, std::uint64_t epoch) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + patience);
  pb::LocateArtifactRequest request;
  {
    std::lock_guard lock(mutex_);
    request.set_token(token_);
  }
  request.set_epoch(epoch);
  request.set_artifact(artifact);
  pb::LocateArtifactReply reply;
  if (grpc::Status status = hub_->LocateArtifact(&context, request, &reply); !status.ok()) {
    const std::string what = "artifact " + artifact + ": " + status.error_message();
    if (status.error_code() == grpc::StatusCode::UNAVAILABLE ||
        status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED)
      throw Error::connection(what);
    throw Error::failed(what);
  }
  std::vector<LocatedPart> parts;
  for (pb::Part& part : *reply.mutable_parts()) parts.push_back({artifact, epoch, std::move(part)});
  return parts;
}

std::shared_ptr<const StoredPart> PartClient::own(const LocatedPart& part) const {
  return own_->find(part.artifact, part.part.first(), part.part.digest());
}

void PartClient::read(const LocatedPart& from, std::uint64_t offset, std::span<std::byte> out) {
  if (offset > from.part.bytes() || out.size() > from.part.bytes() - offset)
    throw Error::failed(name_of(from) + ": bytes " + std::to_string(offset) + " + " + std::to_string(out.size()) +
                        " were asked for, the part has " + std::to_string(from.part.bytes()));
  if (out.empty()) return;
  if (auto stored = own(from)) return stored->read(offset, out);
  std::string problems;
  for (const Source& source : sources_of(from)) {
    try {
      return read_checked(from, source, offset, out);
    } catch (const WrongBytes& error) {
      problems += std::string("; ") + error.what();
      pb::WrongPart wrong;
      wrong.set_artifact(from.artifact);
      wrong.set_first(from.part.first());
      wrong.set_digest(from.part.digest());
      wrong.set_holder(source.holder.worker());
      report_(wrong);
    } catch (const Unreachable& error) {
      problems += std::string("; ") + error.what();
      if (!source.peer) continue;
      std::lock_guard lock(mutex_);
      unreachable_[source.holder.address()] = Clock::now() + shunned_for;
    } catch (const Error& error) {
      problems += std::string("; ") + error.what();
    }
  }
  throw Error::connection(name_of(from) + ": no holder could be read" + problems);
}

// Holders that can be reached first, in the order in which the coordinator named them; then all through it.
std::vector<PartClient::Source> PartClient::sources_of(const LocatedPart& from) {
  std::vector<Source> sources;
  for (const pb::Holder& holder : from.part.holders())
    if (!holder.address().empty())
      if (auto stub = peer(holder.address())) sources.push_back({holder, std::move(stub)});
  for (const pb::Holder& holder : from.part.holders()) sources.push_back({holder, nullptr});
  return sources;
}

// Null for an address that was not reached a short while ago.
std::shared_ptr<pb::WorkerPeer::Stub> PartClient::peer(const std::string& address) {
  std::lock_guard lock(mutex_);
  if (auto found = unreachable_.find(address); found != unreachable_.end()) {
    if (found->second > Clock::now()) return nullptr;
    unreachable_.erase(found);
  }
  if (peers_.size() >= most_peers && !peers_.contains(address)) peers_.clear();
  std::shared_ptr<pb::WorkerPeer::Stub>& stub = peers_[address];
  if (!stub) {
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 15000);
    arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10000);
    arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 3000);  // which is how long connecting may take
    const auto credentials = channel_credentials(keys_.get(), Role::work, arguments);
    stub = pb::WorkerPeer::NewStub(grpc::CreateCustomChannel(address, credentials, arguments));
  }
  return stub;
}

void PartClient::fetch(const LocatedPart& from, const Source& source, bool sums, std::uint64_t offset,
                       std::uint64_t length, const std::function<void(std::span<const std::byte>)>& take) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + patience + std::chrono::seconds(length / slow_line));
  pb::FetchPartRequest request;
  request.set_artifact(from.artifact);
  request.set_first(from.part.first());
  request.set_digest(from.part.digest());
  request.set_sums(sums);
  request.set_offset(offset);
  request.set_length(length);
  std::unique_ptr<grpc::ClientReader<pb::PartPiece>> reader;
  if (source.peer) {
    request.set_ticket(source.holder.ticket());
    reader = source.peer->FetchPart(&context, request);
  } else {
    {
      std::lock_guard lock(mutex_);
      request.set_ticket(token_);
    }
    request.set_epoch(from.epoch);
    request.set_holder(source.holder.worker());
    reader = hub_->FetchPart(&context, request);
  }
  const std::string who = "worker " + source.holder.worker() + (source.peer ? "" : ", through the coordinator");
  std::uint64_t left = length;
  pb::PartPiece piece;
  try {
    while (reader->Read(&piece)) {
      if (source.peer) peer_bytes_ += piece.data().size();
      if (piece.data().size() > left) throw WrongBytes(who + ": more bytes than were asked for");
      left -= piece.data().size();
      take(std::as_bytes(std::span(piece.data())));
    }
  } catch (...) {
    context.TryCancel();
    reader->Finish();
    throw;
  }
  grpc::Status status = reader->Finish();
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE ||
      status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED)
    throw Unreachable(who + ": " + status.error_message());
  if (source.peer &&
      (status.error_code() == grpc::StatusCode::NOT_FOUND || status.error_code() == grpc::StatusCode::INTERNAL))
    throw WrongBytes(who + ": " + status.error_message());
  if (!status.ok()) throw Error::connection(who + ": " + status.error_message());
  if (left > 0) throw WrongBytes(who + ": " + std::to_string(left) + " bytes less than were asked for");
}

std::shared_ptr<const scene::Bytes> PartClient::sums_of(const LocatedPart& from, const Source& source) {
  const std::string key = "sums of " + to_hex(from.part.digest());
  if (auto cached = cache_->find(key); cached.bytes) return cached.bytes;
  auto sums = std::make_shared<scene::Bytes>();
  fetch(from, source, true, 0, pieces_of(from.part.bytes()) * sum_bytes,
        [&](std::span<const std::byte> bytes) { sums->insert(sums->end(), bytes.begin(), bytes.end()); });
  if (digest_of_sums(*sums) != from.part.digest())
    throw WrongBytes("worker " + source.holder.worker() + ": sums that are not those of the digest");
  cache_->put(key, {sums});
  return sums;
}

void PartClient::read_checked(const LocatedPart& from, const Source& source, std::uint64_t offset,
                              std::span<std::byte> out) {
  const auto sums = sums_of(from, source);
  // Whole pieces are fetched: each is checked before any of its bytes is used.
  const std::uint64_t begin = offset / summed_piece_bytes * summed_piece_bytes;
  const std::uint64_t end = std::min(pieces_of(offset + out.size()) * summed_piece_bytes, from.part.bytes());
  scene::Bytes piece;
  piece.reserve(summed_piece_bytes);
  std::uint64_t at = begin;  // of the piece
  const auto check = [&] {
    if (!piece_matches(*sums, at / summed_piece_bytes, piece))
      throw WrongBytes("worker " + source.holder.worker() + ": bytes that are not those of the digest");
    const std::uint64_t first = std::max(at, offset), last = std::min(at + piece.size(), offset + out.size());
    if (first < last) std::memcpy(out.data() + (first - offset), piece.data() + (first - at), last - first);
    at += piece.size();
    piece.clear();
  };
  fetch(from, source, false, begin, end - begin, [&](std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
      const std::size_t count = std::min(bytes.size(), summed_piece_bytes - piece.size());
      piece.insert(piece.end(), bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(count));
      bytes = bytes.subspan(count);
      if (piece.size() == summed_piece_bytes) check();
    }
  });
  if (!piece.empty()) check();
}

}  // namespace gleaner::worker
