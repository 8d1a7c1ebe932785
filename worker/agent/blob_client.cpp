#include "worker/agent/blob_client.h"

#include <grpcpp/client_context.h>

#include <algorithm>
#include <cstring>

#include "proto/packing.h"
#include "proto/protocol.h"
#include "proto/sha256.h"
#include "scene/model/error.h"

namespace gleaner::worker {

namespace pb = gleaner::v1;

namespace {

// What could not be fetched is no fault of the items that read it, whatever went wrong on the way; but for a range that
// the blob does not have.
[[noreturn]] void fail(const std::string& id, const grpc::Status& status) {
  const std::string what = "blob " + id + ": " + status.error_message();
  if (status.error_code() == grpc::StatusCode::OUT_OF_RANGE ||
      status.error_code() == grpc::StatusCode::INVALID_ARGUMENT)
    throw Error::failed(what);
  throw Error::connection(what);
}

}  // namespace

BlobClient::BlobClient(std::shared_ptr<grpc::Channel> channel, bool packs)
    : stub_(pb::WorkerHub::NewStub(channel)), packs_(packs) {}

grpc::Status BlobClient::pieces(const pb::FetchBlobRequest& request,
                                const std::function<bool(std::uint64_t, std::span<const std::byte>)>& take) {
  grpc::ClientContext context;
  auto reader = stub_->FetchBlob(&context, request);
  pb::BlobPiece piece;
  scene::Bytes unpacked;
  std::string damage;
  for (bool more = true; more && reader->Read(&piece);) {
    fetched_bytes_ += piece.data().size();
    std::span<const std::byte> bytes = std::as_bytes(std::span(piece.data()));
    try {
      if (piece.packed() > 0) bytes = unpacked = unpack(piece.data(), piece.packed(), piece_bytes);
      more = take(piece.total_bytes(), bytes);
    } catch (const Error& error) {
      damage = error.what();
      more = false;
    }
    if (!more) context.TryCancel();
  }
  const grpc::Status status = reader->Finish();
  return damage.empty() ? status : grpc::Status(grpc::StatusCode::DATA_LOSS, damage);
}

std::shared_ptr<const scene::Bytes> BlobClient::fetch(const std::string& id) {
  pb::FetchBlobRequest request;
  request.set_id(id);
  request.set_pack(packs_ ? 1 : 0);
  auto bytes = std::make_shared<scene::Bytes>();
  const grpc::Status status = pieces(request, [&](std::uint64_t total, std::span<const std::byte> piece) {
    // The announced size is believed piece by piece only: memory is taken for what arrived.
    if (bytes->empty() && total <= (std::uint64_t{1} << 30)) bytes->reserve(total);
    bytes->insert(bytes->end(), piece.begin(), piece.end());
    return true;
  });
  if (!status.ok()) fail(id, status);
  if (sha256_hex(*bytes) != id) throw Error::connection("blob " + id + ": the bytes that came are not those of its id");
  return bytes;
}

void BlobClient::read(const std::string& id, std::uint64_t offset, std::span<std::byte> out, std::uint32_t stride) {
  if (out.empty()) return;
  pb::FetchBlobRequest request;
  request.set_id(id);
  request.set_offset(offset);
  request.set_length(out.size());
  request.set_pack(packs_ ? std::max(1u, stride) : 0);
  bool too_much = false;
  const grpc::Status status = pieces(request, [&](std::uint64_t, std::span<const std::byte> piece) {
    too_much = piece.size() > out.size();
    if (too_much) return false;
    std::memcpy(out.data(), piece.data(), piece.size());
    out = out.subspan(piece.size());
    return true;
  });
  if (too_much) throw Error::failed("blob " + id + ": more bytes than were asked for");
  if (!status.ok()) fail(id, status);
  if (!out.empty())
    throw Error::connection("blob " + id + ": " + std::to_string(out.size()) + " bytes less than were asked for");
}

}  // namespace gleaner::worker
