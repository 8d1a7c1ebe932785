#include "worker/agent/input_loader.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::worker {

namespace pb = gleaner::v1;

namespace {

constexpr std::uint64_t count_bytes = sizeof(std::uint32_t);

using Offsets = std::vector<std::uint64_t>;

// A range of a blob that stays with the coordinator.
class BlobRange final : public ArtifactSource {
 public:
  BlobRange(BlobClient& blobs, std::string id, std::uint64_t offset, std::uint64_t bytes, std::uint32_t stride)
      : blobs_(blobs), id_(std::move(id)), offset_(offset), bytes_(bytes), stride_(stride) {}
  std::uint64_t bytes() const override { return bytes_; }
  void read(std::uint64_t offset, std::span<std::byte> out) const override {
    check_range(offset, out.size());
    blobs_.read(id_, offset_ + offset, out, stride_);
  }

 private:
  BlobClient& blobs_;
  std::string id_;
  std::uint64_t offset_, bytes_;
  std::uint32_t stride_;  // of its records; 0: none are known
};

// The records of neighbouring parts as one run of bytes.
class PartRecords final : public ArtifactSource {
 public:
  explicit PartRecords(PartClient& client) : client_(client) {}

  // Bytes [offset, offset + bytes) of the part's image come next.
  void add(LocatedPart part, std::uint64_t offset, std::uint64_t bytes) {
    if (bytes == 0) return;
    slices_.push_back({std::move(part), bytes_, offset, bytes});
    bytes_ += bytes;
  }
  std::uint64_t bytes() const override { return bytes_; }
  void read(std::uint64_t offset, std::span<std::byte> out) const override {
    check_range(offset, out.size());
    auto slice = std::upper_bound(slices_.begin(), slices_.end(), offset,
                                  [](std::uint64_t at, const Slice& s) { return at < s.begin + s.bytes; });
    for (; !out.empty(); ++slice) {
      const std::uint64_t inside = offset - slice->begin;
      const std::size_t count = std::min<std::uint64_t>(out.size(), slice->bytes - inside);
      client_.read(slice->part, slice->image_offset + inside, out.first(count));
      out = out.subspan(count);
      offset += count;
    }
  }
  // The bytes where one part of this process has them all, in memory; else null.
  std::shared_ptr<const scene::Bytes> at_hand() const {
    if (slices_.size() != 1) return nullptr;
    const auto stored = client_.own(slices_[0].part);
    if (!stored) return nullptr;
    auto records = stored->records_in_memory();
    return records && records->size() == bytes_ ? records : nullptr;
  }

 private:
  struct Slice {
    LocatedPart part;
    std::uint64_t begin, image_offset, bytes;  // begin: in this source
  };
  PartClient& client_;
  std::vector<Slice> slices_;
  std::uint64_t bytes_ = 0;
};

Error inconsistent(const pb::StageInput& input, const std::string& what) {
  return Error::failed("input " + input.name() + ", artifact " + input.artifact() + ": " + what);
}

// Appends where the records of these items begin, from `next` on; the last one is where they end.
void append_offsets(Offsets& offsets, std::span<const std::uint32_t> counts) {
  if (offsets.empty()) offsets.push_back(0);
  offsets.reserve(offsets.size() + counts.size());
  for (const std::uint32_t count : counts) offsets.push_back(offsets.back() + count);
}

// What the bytes that a batch may read are known by. Ranges of retained artifacts are read again: a bounce over links
// reads what the last one read. Those of the plan's own data are read once: empty.
std::string name_of(const pb::StageInput& input, const pb::Lease& lease) {
  if (!input.own_items()) return input.artifact();
  if (!input.retained()) return {};
  return input.artifact() + " " + std::to_string(lease.first()) + " + " + std::to_string(lease.count());
}

// Sizes that the coordinator says are believed where they can be: none may overflow.
void check_sizes(const pb::StageInput& input, const pb::Lease& lease) {
  constexpr std::uint64_t most = std::uint64_t{1} << 60;
  const bool has_items = input.record_bytes() > 0;
  if (has_items && input.items() > most / std::max(input.record_bytes(), 4u))
    throw inconsistent(
        input, std::to_string(input.items()) + " records of " + std::to_string(input.record_bytes()) + " bytes");
  if (input.own_items() &&
      (!has_items || lease.first() > input.items() || lease.count() > input.items() - lease.first()))
    throw inconsistent(input, "it has " + std::to_string(input.items()) + " items, and those from " +
                                  std::to_string(lease.first()) + " on are read");
}

}  // namespace

TaskInput InputLoader::load(const pb::StageInput& input, const pb::Lease& lease) {
  check_sizes(input, lease);
  const std::string name = name_of(input, lease);
  TaskInput out;
  if (CachedBytes cached; !name.empty() && (cached = cache_->find(name)).bytes) {
    out = TaskInput(cached.bytes);
    out.offsets = cached.offsets;
  } else {
    out = input.retained() ? load_parts(input, lease) : load_from_coordinator(input, lease);
    settle(out, name);
  }
  out.own_items = input.own_items();
  out.first_item = input.own_items() ? lease.first() : 0;
  out.artifact = name;
  return out;
}

void InputLoader::settle(TaskInput& input, const std::string& keep_as) {
  const std::uint64_t offset_bytes = input.offsets ? input.offsets->size() * sizeof(std::uint64_t) : 0;
  if (input.bytes() + offset_bytes > cache_->most_bytes() / 2) return;
  if (const auto* parts = dynamic_cast<const PartRecords*>(input.source.get()))
    if (auto records = parts->at_hand()) {
      input.source = std::make_shared<MemoryArtifact>(std::move(records));
      return;  // they are kept already, as a part
    }
  const auto bytes = input.load();
  input.source = std::make_shared<MemoryArtifact>(bytes);
  if (!keep_as.empty()) cache_->put(keep_as, {bytes, input.offsets});
}

TaskInput InputLoader::load_from_coordinator(const pb::StageInput& input, const pb::Lease& lease) {
  const std::uint64_t first = input.own_items() ? lease.first() : 0;
  const std::uint64_t items = input.own_items() ? lease.count() : input.items();
  TaskInput out;
  std::uint64_t offset = 0, bytes = input.bytes();
  if (input.counted()) {
    std::vector<std::uint32_t> counts(items);
    blobs_.read(input.artifact(), first * count_bytes, std::as_writable_bytes(std::span(counts)), count_bytes);
    auto offsets = std::make_shared<Offsets>();
    append_offsets(*offsets, counts);
    offset = input.items() * count_bytes + input.first_record() * input.record_bytes();
    bytes = offsets->back() * input.record_bytes();
    out.offsets = std::move(offsets);
  } else if (input.own_items()) {
    offset = first * input.record_bytes();
    bytes = items * input.record_bytes();
  }
  if (offset > input.bytes() || bytes > input.bytes() - offset)
    throw inconsistent(input, "it has " + std::to_string(input.bytes()) + " bytes, and " + std::to_string(bytes) +
                                  " from " + std::to_string(offset) + " on are read");
  out.source = std::make_shared<BlobRange>(blobs_, input.artifact(), offset, bytes, input.record_bytes());
  return out;
}

TaskInput InputLoader::load_parts(const pb::StageInput& input, const pb::Lease& lease) {
  const std::uint64_t first = input.own_items() ? lease.first() : 0;
  const std::uint64_t end = input.own_items() ? first + lease.count() : input.items();
  const std::uint64_t stride = input.record_bytes();
  auto records = std::make_shared<PartRecords>(parts_);
  auto offsets = input.counted() ? std::make_shared<Offsets>(1, 0) : nullptr;
  std::uint64_t next = first;
  for (LocatedPart& located : parts_.locate(input.artifact(), lease.epoch())) {
    const std::uint64_t begin = located.part.first(), part_end = begin + located.part.items();
    // Where the stage reads the artifact whole as well, parts of other items are among them.
    if (next == end || (part_end >= begin && part_end <= first)) continue;
    if (part_end < begin || begin > next || part_end <= next)
      throw inconsistent(input, "its parts leave a gap at item " + std::to_string(next));
    const std::uint64_t from = next - begin, to = std::min(part_end, end) - begin;  // items of this part
    next = begin + to;
    if (!input.counted()) {
      records->add(std::move(located), from * stride, (to - from) * stride);
      continue;
    }
    // The counts of the part's items before the first one tell where its records begin.
    std::vector<std::uint32_t> counts(to);
    parts_.read(located, 0, std::as_writable_bytes(std::span(counts)));
    std::uint64_t before = 0;
    for (std::uint64_t item = 0; item < from; ++item) before += counts[item];
    const std::uint64_t so_far = offsets->back();
    append_offsets(*offsets, std::span(counts).subspan(from));
    const std::uint64_t table = located.part.items() * count_bytes;
    records->add(std::move(located), table + before * stride, (offsets->back() - so_far) * stride);
  }
  if (next != end) throw inconsistent(input, "its parts end at item " + std::to_string(next));
  TaskInput out;
  out.source = std::move(records);
  out.offsets = std::move(offsets);
  return out;
}

std::shared_ptr<const scene::Bytes> InputLoader::blob(const std::string& id) {
  if (CachedBytes cached = cache_->find(id); cached.bytes) return cached.bytes;
  return blobs_.fetch(id);
}

}  // namespace gleaner::worker
