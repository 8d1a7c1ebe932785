#include "worker/agent/blob_client.h"

#include <grpcpp/client_context.h>
#include <openssl/evp.h>

#include <array>
#include <span>

#include "scene/model/error.h"

namespace gleaner::worker {

namespace pb = gleaner::v1;

namespace {

std::string sha256_hex(std::span<const std::byte> bytes) {
  std::array<unsigned char, 32> digest{};
  if (EVP_Digest(bytes.data(), bytes.size(), digest.data(), nullptr, EVP_sha256(), nullptr) != 1)
    throw Error::failed("OpenSSL has no SHA-256");
  std::string text;
  for (unsigned char byte : digest) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

}  // namespace

BlobClient::BlobClient(std::shared_ptr<grpc::Channel> channel, std::uint64_t cache_bytes)
    : stub_(pb::WorkerHub::NewStub(channel)), cache_bytes_(cache_bytes) {}

std::shared_ptr<const scene::Bytes> BlobClient::fetch(const std::string& id) {
  if (auto found = cache_.find(id); found != cache_.end()) {
    uses_.splice(uses_.begin(), uses_, found->second.use);
    return found->second.blob;
  }
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
  }
  if (grpc::Status status = reader->Finish(); !status.ok())
    throw Error::failed("blob " + id + ": " + status.error_message());
  fetched_bytes_ += bytes->size();
  if (sha256_hex(*bytes) != id) throw Error::failed("blob " + id + ": the bytes that came are not those of its id");
  return bytes;
}

std::shared_ptr<const scene::Bytes> BlobClient::fetch_and_keep(const std::string& id) {
  auto blob = fetch(id);
  if (cache_.count(id) || blob->size() > cache_bytes_) return blob;
  while (cached_bytes_ + blob->size() > cache_bytes_) {
    auto oldest = cache_.find(uses_.back());
    cached_bytes_ -= oldest->second.blob->size();
    cache_.erase(oldest);
    uses_.pop_back();
  }
  uses_.push_front(id);
  cache_[id] = {blob, uses_.begin()};
  cached_bytes_ += blob->size();
  return blob;
}

}  // namespace gleaner::worker
