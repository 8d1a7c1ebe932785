#include "coordinator/blobs/store.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <system_error>

#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

Error io_error(const fs::path& path, const std::string& what, int code) {
  return Error::failed(path.string() + ": " + what + ": " + std::strerror(code));
}

void write_all(int descriptor, std::span<const std::byte> bytes, const fs::path& path) {
  while (!bytes.empty()) {
    ssize_t written = ::write(descriptor, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) throw io_error(path, "cannot write", errno);
    bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
}

}  // namespace

BlobStore::BlobStore(fs::path folder) : folder_(std::move(folder)) {
  if (folder_.empty()) return;
  std::error_code code;
  fs::create_directories(folder_ / "incoming", code);
  if (code) throw io_error(folder_, "cannot make the folder", code.value());
  if (::access((folder_ / "incoming").c_str(), W_OK) != 0) throw io_error(folder_, "cannot write", errno);
  // What a coordinator that died was receiving is of no use to this one.
  for (const auto& entry : fs::directory_iterator(folder_ / "incoming", code)) fs::remove(entry.path(), code);
}

fs::path BlobStore::path_of(const std::string& id) const { return folder_ / id.substr(0, 2) / id; }

bool BlobStore::has(const std::string& id) const {
  if (!is_sha256_hex(id)) return false;
  {
    std::lock_guard lock(mutex_);
    if (kept_.count(id)) return true;
  }
  std::error_code code;
  return !folder_.empty() && fs::is_regular_file(path_of(id), code);
}

Blob BlobStore::get(const std::string& id) {
  if (!is_sha256_hex(id)) return nullptr;
  {
    std::lock_guard lock(mutex_);
    if (auto found = kept_.find(id); found != kept_.end()) return found->second;
    if (auto found = lent_.find(id); found != lent_.end())
      if (Blob blob = found->second.lock()) return blob;
  }
  if (folder_.empty()) return nullptr;
  fs::path path = path_of(id);
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return nullptr;
  auto bytes = std::make_shared<Bytes>(static_cast<std::size_t>(file.tellg()));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(bytes->data()), static_cast<std::streamsize>(bytes->size()));
  if (!file) throw Error::failed(path.string() + ": cannot read");
  if (sha256_hex(*bytes) != id) {
    std::error_code code;
    fs::rename(path, path.string() + ".damaged", code);
    throw Error::failed(path.string() + ": its bytes are not those of its name; submit the scene again");
  }
  lend(bytes);
  return bytes;
}

std::string BlobStore::put(Bytes bytes) {
  std::string id = sha256_hex(bytes);
  if (has(id)) return id;
  if (folder_.empty()) {
    std::lock_guard lock(mutex_);
    kept_[id] = std::make_shared<const Bytes>(std::move(bytes));
    return id;
  }
  Upload upload(*this, id, bytes.size());
  upload.append(bytes);
  upload.commit();
  return id;
}

std::string BlobStore::lend(Blob blob) {
  std::string id = sha256_hex(*blob);
  std::lock_guard lock(mutex_);
  std::erase_if(lent_, [](const auto& entry) { return entry.second.expired(); });
  lent_[id] = blob;
  return id;
}

BlobStore::Upload::Upload(BlobStore& store, std::string id, std::uint64_t bytes)
    : store_(store), id_(std::move(id)), expected_(bytes) {
  if (!is_sha256_hex(id_))
    throw Error::bad_input("blob", "id", "64 lower-case hexadecimal digits", "\"" + id_.substr(0, 80) + "\"");
  if (store_.folder_.empty()) return;
  std::uint64_t serial;
  {
    std::lock_guard lock(store_.mutex_);
    serial = store_.uploads_++;
  }
  file_ = store_.folder_ / "incoming" / (id_ + "." + std::to_string(serial));
  descriptor_ = ::open(file_.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0644);
  if (descriptor_ < 0) throw io_error(file_, "cannot make the file", errno);
}

BlobStore::Upload::~Upload() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!file_.empty()) {
    std::error_code code;
    fs::remove(file_, code);
  }
}

void BlobStore::Upload::append(std::span<const std::byte> piece) {
  if (piece.size() > expected_ - received_)
    throw Error::bad_input("blob " + id_, "", std::to_string(expected_) + " bytes", "more");
  received_ += piece.size();
  hash_.update(piece);
  if (descriptor_ >= 0)
    write_all(descriptor_, piece, file_);
  else
    memory_.insert(memory_.end(), piece.begin(), piece.end());
}

void BlobStore::Upload::commit() {
  if (received_ != expected_)
    throw Error::bad_input("blob " + id_, "", std::to_string(expected_) + " bytes", std::to_string(received_));
  if (std::string found = hash_.hex(); found != id_)
    throw Error::bad_input("blob " + id_, "", "bytes of that SHA-256", found);
  if (descriptor_ < 0) {
    std::lock_guard lock(store_.mutex_);
    store_.kept_[id_] = std::make_shared<const Bytes>(std::move(memory_));
    return;
  }
  if (::fsync(descriptor_) != 0) throw io_error(file_, "cannot write", errno);
  fs::path target = store_.path_of(id_);
  std::error_code code;
  fs::create_directories(target.parent_path(), code);
  if (!code) fs::rename(file_, target, code);
  if (code) throw io_error(target, "cannot write", code.value());
  file_.clear();
}

}  // namespace gleaner::coordinator
