#include "coordinator/blobs/store.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
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

// The range must lie inside: offset + length may overflow.
void check_range(std::uint64_t bytes, std::uint64_t offset, std::uint64_t length) {
  if (offset > bytes || length > bytes - offset)
    throw Error::bad_input("blob", "range", "inside of " + std::to_string(bytes) + " bytes",
                           std::to_string(length) + " bytes from " + std::to_string(offset) + " on");
}

constexpr std::size_t check_piece_bytes = std::size_t{1} << 20;

}  // namespace

class BlobStore::MemorySource final : public BlobSource {
 public:
  explicit MemorySource(std::vector<Blob> segments) : segments_(std::move(segments)) {
    for (const Blob& segment : segments_) bytes_ += segment->size();
  }
  std::uint64_t bytes() const override { return bytes_; }
  void read(std::uint64_t offset, std::span<std::byte> out) const override {
    check_range(bytes_, offset, out.size());
    for (const Blob& segment : segments_) {
      if (offset < segment->size() && !out.empty()) {
        const std::size_t count = std::min<std::uint64_t>(out.size(), segment->size() - offset);
        std::memcpy(out.data(), segment->data() + offset, count);
        out = out.subspan(count);
        offset = 0;
      } else {
        offset -= std::min<std::uint64_t>(offset, segment->size());
      }
    }
  }

 private:
  std::vector<Blob> segments_;
  std::uint64_t bytes_ = 0;
};

class BlobStore::FileSource final : public BlobSource {
 public:
  // Null where there is no such file.
  static std::shared_ptr<FileSource> open(const fs::path& path) {
    const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (descriptor < 0 && errno == ENOENT) return nullptr;
    if (descriptor < 0) throw io_error(path, "cannot read", errno);
    return std::shared_ptr<FileSource>(new FileSource(path, descriptor));
  }
  ~FileSource() override { ::close(descriptor_); }
  std::uint64_t bytes() const override { return bytes_; }
  void read(std::uint64_t offset, std::span<std::byte> out) const override {
    check_range(bytes_, offset, out.size());
    while (!out.empty()) {
      const ssize_t count = ::pread(descriptor_, out.data(), out.size(), static_cast<off_t>(offset));
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) throw io_error(path_, "cannot read", errno);
      if (count == 0) throw Error::failed(path_.string() + ": it has become shorter");
      out = out.subspan(static_cast<std::size_t>(count));
      offset += static_cast<std::uint64_t>(count);
    }
  }
  const fs::path& path() const { return path_; }

 private:
  FileSource(fs::path path, int descriptor) : path_(std::move(path)), descriptor_(descriptor) {
    struct stat status {};
    if (::fstat(descriptor_, &status) != 0 || !S_ISREG(status.st_mode)) {
      ::close(descriptor_);
      throw Error::failed(path_.string() + ": expected a file");
    }
    bytes_ = static_cast<std::uint64_t>(status.st_size);
  }
  fs::path path_;
  int descriptor_;
  std::uint64_t bytes_ = 0;
};

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

std::vector<Blob> BlobStore::in_memory(const std::string& id) const {
  if (auto found = kept_.find(id); found != kept_.end()) return {found->second};
  const auto [first, last] = lent_.equal_range(id);
  for (auto lent = first; lent != last; ++lent) {
    std::vector<Blob> segments;
    for (const auto& segment : lent->second) segments.push_back(segment.lock());
    if (std::ranges::find(segments, nullptr) == segments.end()) return segments;
  }
  return {};
}

std::shared_ptr<const BlobSource> BlobStore::source(const std::string& id) {
  if (!is_sha256_hex(id)) return nullptr;
  {
    std::lock_guard lock(mutex_);
    if (auto segments = in_memory(id); !segments.empty()) return std::make_shared<MemorySource>(std::move(segments));
  }
  return open_file(id);
}

std::shared_ptr<const BlobSource> BlobStore::open_file(const std::string& id) {
  if (folder_.empty()) return nullptr;
  auto file = FileSource::open(path_of(id));
  if (!file) return nullptr;
  std::error_code code;
  const auto changed = fs::last_write_time(file->path(), code);
  std::promise<void> checked;
  std::unique_lock lock(mutex_);
  if (auto found = checked_.find(id); found != checked_.end() && found->second == changed) return file;
  if (auto found = checking_.find(id); found != checking_.end()) {
    const std::shared_future<void> other = found->second;
    lock.unlock();
    other.get();  // throws what the other check throws
    return file;
  }
  checking_[id] = checked.get_future().share();
  lock.unlock();
  try {
    check_file(id, *file);
  } catch (...) {
    lock.lock();
    checking_.erase(id);
    lock.unlock();
    checked.set_exception(std::current_exception());
    throw;
  }
  lock.lock();
  checked_[id] = changed;
  checking_.erase(id);
  lock.unlock();
  checked.set_value();
  return file;
}

void BlobStore::check_file(const std::string& id, const FileSource& file) {
  Sha256 hash;
  Bytes piece(std::min<std::uint64_t>(check_piece_bytes, file.bytes()));
  for (std::uint64_t offset = 0; offset < file.bytes(); offset += piece.size()) {
    const auto part = std::span(piece).first(std::min<std::uint64_t>(piece.size(), file.bytes() - offset));
    file.read(offset, part);
    hash.update(part);
  }
  {
    std::lock_guard lock(mutex_);
    bytes_checked_ += file.bytes();
  }
  if (hash.hex() == id) return;
  std::error_code code;
  fs::rename(file.path(), file.path().string() + ".damaged", code);
  throw Error::failed(file.path().string() + ": its bytes are not those of its name; submit the scene again");
}

Blob BlobStore::get(const std::string& id) {
  if (!is_sha256_hex(id)) return nullptr;
  std::promise<Blob> read;
  std::unique_lock lock(mutex_);
  if (auto segments = in_memory(id); segments.size() == 1) return segments.front();
  if (auto found = reading_.find(id); found != reading_.end()) {
    const std::shared_future<Blob> other = found->second;
    lock.unlock();
    return other.get();  // throws what the other reader throws
  }
  reading_[id] = read.get_future().share();
  lock.unlock();
  Blob blob;
  try {
    if (auto from = source(id)) {
      auto bytes = std::make_shared<Bytes>(static_cast<std::size_t>(from->bytes()));
      from->read(0, *bytes);
      blob = std::move(bytes);
    }
  } catch (...) {
    lock.lock();
    reading_.erase(id);
    lock.unlock();
    read.set_exception(std::current_exception());
    throw;
  }
  lock.lock();
  reading_.erase(id);
  // What is in use need not be read again; lent segments stay what they are.
  if (blob && in_memory(id).empty()) lent_.emplace(id, LentSegments{blob});
  lock.unlock();
  read.set_value(blob);
  return blob;
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

void BlobStore::lend(const std::string& id, const std::vector<Blob>& segments) {
  std::lock_guard lock(mutex_);
  std::erase_if(lent_, [](const auto& entry) {
    return std::any_of(entry.second.begin(), entry.second.end(), [](const auto& segment) { return segment.expired(); });
  });
  lent_.emplace(id, LentSegments(segments.begin(), segments.end()));
}

std::string BlobStore::lend(Blob blob) {
  std::string id = sha256_hex(*blob);
  lend(id, {std::move(blob)});
  return id;
}

std::uint64_t BlobStore::bytes_checked() const {
  std::lock_guard lock(mutex_);
  return bytes_checked_;
}

std::unique_ptr<BlobStore::Upload> BlobStore::begin_upload(const std::string& id, std::uint64_t bytes,
                                                           double patience) {
  std::unique_lock lock(mutex_);
  bool claims = uploading_.emplace(id, 0).second;
  while (!claims) {
    const std::uint64_t before = uploading_.at(id);
    upload_ended_.wait_for(lock, std::chrono::duration<double>(patience), [&] { return !uploading_.contains(id); });
    claims = uploading_.emplace(id, 0).second;
    if (!claims && uploading_.at(id) == before) break;  // it is stuck
  }
  lock.unlock();
  std::unique_ptr<Upload> upload;
  try {
    if (!has(id)) upload = std::make_unique<Upload>(*this, id, bytes);
  } catch (...) {
    if (claims) end_claim(id);
    throw;
  }
  if (upload)
    upload->claims_ = claims;
  else if (claims)
    end_claim(id);
  return upload;
}

void BlobStore::end_claim(const std::string& id) {
  std::lock_guard lock(mutex_);
  uploading_.erase(id);
  upload_ended_.notify_all();
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
  if (claims_) store_.end_claim(id_);
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
  if (claims_) {
    std::lock_guard lock(store_.mutex_);
    store_.uploading_[id_] = received_;
  }
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
