#include "worker/agent/blob_client.h"

#include <grpcpp/client_context.h>

#include <algorithm>
#include <cstring>

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

BlobClient::BlobClient(std::shared_ptr<grpc::Channel> channel) : stub_(pb::WorkerHub::NewStub(channel)) {}

std::shared_ptr<const scene::Bytes> BlobClient::fetch(const std::string& id) {
  grpc::ClientContext context;
  pb::FetchBlobRequest request;
  request.set_id(id);
  auto reader = stub_->FetchBlob(&context, request);
  auto bytes = std::make_shared<scene::Bytes>();
  pb::BlobPiece piece;
  while (reader->Read(&piece)) {
    // The announced size is believed piece by piece only: memory is taken for what arrived.
    if (bytes->empty() && piece.total_bytes() <= (std::uint64_t{1} << 30)) bytes->reserve(piece.total_bytes());
    auto part = std::as_bytes(std::span(piece.data()));
    bytes->insert(bytes->end(), part.begin(), part.end());
    fetched_bytes_ += part.size();
  }
  if (grpc::Status status = reader->Finish(); !status.ok()) fail(id, status);
  if (sha256_hex(*bytes) != id) throw Error::connection("blob " + id + ": the bytes that came are not those of its id");
  return bytes;
}

void BlobClient::read(const std::string& id, std::uint64_t offset, std::span<std::byte> out) {
  if (out.empty()) return;
  grpc::ClientContext context;
  pb::FetchBlobRequest request;
  request.set_id(id);
  request.set_offset(offset);
  request.set_length(out.size());
  auto reader = stub_->FetchBlob(&context, request);
  pb::BlobPiece piece;
  bool too_much = false;
  while (!too_much && reader->Read(&piece)) {
    fetched_bytes_ += piece.data().size();
    too_much = piece.data().size() > out.size();
    if (too_much) break;
    std::memcpy(out.data(), piece.data().data(), piece.data().size());
    out = out.subspan(piece.data().size());
  }
  if (too_much) context.TryCancel();
  grpc::Status status = reader->Finish();
  if (too_much) throw Error::failed("blob " + id + ": more bytes than were asked for");
  if (!status.ok()) fail(id, status);
  if (!out.empty())
    throw Error::connection("blob " + id + ": " + std::to_string(out.size()) + " bytes less than were asked for");
}

}  // namespace gleaner::worker
