#include "worker/artifacts/part_store.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "scene/model/error.h"
#include "worker/artifacts/part_image.h"

namespace gleaner::worker {

namespace fs = std::filesystem;

// A file without a name: the parts of one artifact, one behind the other.
class SpillFile {
 public:
  explicit SpillFile(const fs::path& folder) : folder_(folder) {
    descriptor_ = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (descriptor_ >= 0) return;
    // Not every file system has O_TMPFILE.
    std::string path = (folder / "gleaner-parts-XXXXXX").string();
    descriptor_ = ::mkostemp(path.data(), O_CLOEXEC);
    if (descriptor_ < 0) fail("cannot make a temporary file", errno);
    ::unlink(path.c_str());
  }
  ~SpillFile() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  SpillFile(const SpillFile&) = delete;
  SpillFile& operator=(const SpillFile&) = delete;

  // Takes room at the end. Writers of different rooms may write at the same time.
  std::uint64_t take(std::uint64_t bytes) {
    const std::uint64_t at = end_;
    end_ += bytes;
    return at;
  }
  void write(std::uint64_t at, std::span<const std::byte> bytes) const {
    while (!bytes.empty()) {
      const ssize_t count = ::pwrite(descriptor_, bytes.data(), bytes.size(), static_cast<off_t>(at));
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) fail("cannot write a temporary file", errno);
      bytes = bytes.subspan(static_cast<std::size_t>(count));
      at += static_cast<std::uint64_t>(count);
    }
  }
  void read(std::uint64_t at, std::span<std::byte> out) const {
    while (!out.empty()) {
      const ssize_t count = ::pread(descriptor_, out.data(), out.size(), static_cast<off_t>(at));
      if (count < 0 && errno == EINTR) continue;
      if (count <= 0) fail("cannot read a temporary file", count < 0 ? errno : EIO);
      out = out.subspan(static_cast<std::size_t>(count));
      at += static_cast<std::uint64_t>(count);
    }
  }

 private:
  [[noreturn]] void fail(const std::string& what, int code) const {
    throw Error::failed(folder_.string() + ": " + what + ": " + std::strerror(code));
  }
  fs::path folder_;
  int descriptor_ = -1;
  std::uint64_t end_ = 0;
};

namespace {

fs::path temporary_folder() {
  const char* folder = std::getenv("TMPDIR");
  return folder && *folder ? folder : "/tmp";
}

}  // namespace

void StoredPart::read(std::uint64_t offset, std::span<std::byte> out) const {
  if (offset > bytes_ || out.size() > bytes_ - offset)
    throw Error::failed("part: expected a range inside of its " + std::to_string(bytes_) + " bytes, found " +
                        std::to_string(out.size()) + " from " + std::to_string(offset) + " on");
  if (file_) return file_->read(at_ + offset, out);
  if (offset < counts_.size()) {
    const std::size_t count = std::min<std::uint64_t>(out.size(), counts_.size() - offset);
    if (count > 0) std::memcpy(out.data(), counts_.data() + offset, count);
    out = out.subspan(count);
    offset += count;
  }
  if (!out.empty()) std::memcpy(out.data(), records_->data() + (offset - counts_.size()), out.size());
}

PartStore::PartStore(std::uint64_t memory_bytes, fs::path folder)
    : most_memory_(memory_bytes), folder_(folder.empty() ? temporary_folder() : std::move(folder)) {}

PartStore::Owner PartStore::new_owner() {
  std::lock_guard lock(mutex_);
  return ++owners_;
}

std::shared_ptr<const StoredPart> PartStore::put(Owner owner, const std::string& artifact, std::uint64_t first,
                                                 std::uint64_t items, const std::vector<std::uint32_t>& counts,
                                                 scene::Bytes records) {
  const auto table = std::as_bytes(std::span(counts));
  auto part = std::make_shared<StoredPart>();
  part->items_ = items;
  part->bytes_ = table.size() + records.size();
  part->sums_ = piece_sums({table, records});
  part->digest_ = digest_of_sums(part->sums_);

  const Key key{artifact, first, part->digest_};
  std::unique_lock lock(mutex_);
  if (!parts_.contains(key) && in_memory_ + part->bytes_ > most_memory_) {
    std::shared_ptr<SpillFile>& of_artifact = files_[artifact];
    if (!of_artifact) of_artifact = std::make_shared<SpillFile>(folder_);
    part->file_ = of_artifact;
    part->at_ = of_artifact->take(part->bytes_);
    // Written without holding up those who read other parts, and before anybody can find it.
    lock.unlock();
    part->file_->write(part->at_, table);
    part->file_->write(part->at_ + table.size(), records);
    lock.lock();
  }
  if (auto found = parts_.find(key); found != parts_.end()) {
    ++found->second.puts[owner];
    return found->second.part;
  }
  if (!part->file_) {
    part->counts_.assign(table.begin(), table.end());
    part->records_ = std::make_shared<const scene::Bytes>(std::move(records));
  }
  (part->file_ ? in_files_ : in_memory_) += part->bytes_;
  parts_[key] = {part, {{owner, 1}}};
  return part;
}

std::shared_ptr<const StoredPart> PartStore::find(const std::string& artifact, std::uint64_t first,
                                                  const std::string& digest) const {
  std::lock_guard lock(mutex_);
  const auto found = parts_.find({artifact, first, digest});
  return found == parts_.end() ? nullptr : found->second.part;
}

PartStore::Entries::iterator PartStore::forget(Entries::iterator at, Owner owner, unsigned puts) {
  auto& owners = at->second.puts;
  const auto own = owners.find(owner);
  if (own == owners.end()) return std::next(at);
  if (puts > 0 && own->second > puts)
    own->second -= puts;
  else
    owners.erase(own);
  if (!owners.empty()) return std::next(at);
  const StoredPart& part = *at->second.part;
  (part.file_ ? in_files_ : in_memory_) -= part.bytes_;
  const std::string artifact = std::get<0>(at->first);
  const auto next = parts_.erase(at);
  const auto first = parts_.lower_bound({artifact, 0, {}});
  if (first == parts_.end() || std::get<0>(first->first) != artifact) files_.erase(artifact);
  return next;
}

void PartStore::drop(Owner owner, const std::string& artifact) {
  std::lock_guard lock(mutex_);
  for (auto at = parts_.lower_bound({artifact, 0, {}}); at != parts_.end() && std::get<0>(at->first) == artifact;)
    at = forget(at, owner, 0);
}

void PartStore::drop(Owner owner, const std::string& artifact, std::uint64_t first, const std::string& digest) {
  std::lock_guard lock(mutex_);
  if (const auto found = parts_.find({artifact, first, digest}); found != parts_.end()) forget(found, owner, 1);
}

void PartStore::clear(Owner owner) {
  std::lock_guard lock(mutex_);
  for (auto at = parts_.begin(); at != parts_.end();) at = forget(at, owner, 0);
}

std::uint64_t PartStore::memory_bytes() const {
  std::lock_guard lock(mutex_);
  return in_memory_;
}

std::uint64_t PartStore::file_bytes() const {
  std::lock_guard lock(mutex_);
  return in_files_;
}

}  // namespace gleaner::worker
