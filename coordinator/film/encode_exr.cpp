// OpenEXR 3.1 compresses with zlib at its default level, whatever the header asks for: 0.2 s for a frame of 640x360
// with 20 channels on two cores. libdeflate needs half of that. So the library writes the header, and the chunks that
// its ZIP compression would have made (https://openexr.com/en/latest/OpenEXRFileLayout.html) are formed here, in
// parallel.
#include "coordinator/film/encode_exr.h"

#include <ImfChannelList.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfStringAttribute.h>
#include <ImfVersion.h>
#include <libdeflate.h>

#include <algorithm>
#include <bit>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <thread>
#include <vector>

#include "scene/model/blob.h"

static_assert(std::endian::native == std::endian::little, "OpenEXR's numbers are written as they lie");

namespace gleaner::coordinator {
namespace {

using scene::Bytes;

constexpr std::size_t chunk_rows = 16;  // ZIP_COMPRESSION
constexpr int compression_level = 1;    // the bits of noise do not shrink: level 6 gains 0.4 % of the size
constexpr std::size_t most_threads = 16;
constexpr std::size_t short_name = 31;  // longer names need a flag in the version field

class MemoryStream : public Imf::OStream {
 public:
  MemoryStream() : OStream("film") {}
  void write(const char data[], int size) override {
    const auto end = position_ + static_cast<std::size_t>(size);
    if (bytes_.size() < end) bytes_.resize(end);
    std::memcpy(bytes_.data() + position_, data, static_cast<std::size_t>(size));
    position_ = end;
  }
  std::uint64_t tellp() override { return position_; }
  void seekp(std::uint64_t position) override { position_ = position; }
  const Bytes& bytes() const { return bytes_; }

 private:
  Bytes bytes_;
  std::size_t position_ = 0;
};

void append(Bytes& bytes, const void* data, std::size_t size) {
  bytes.resize(bytes.size() + size);
  std::memcpy(bytes.data() + bytes.size() - size, data, size);
}

template <class Number>
void append(Bytes& bytes, Number number) {
  append(bytes, &number, sizeof(number));
}

Bytes encode_header(const Film& film, const std::map<std::string, std::string>& metadata) {
  Imf::Header header(static_cast<int>(film.width), static_cast<int>(film.height));
  header.compression() = Imf::ZIP_COMPRESSION;
  bool long_names = false;
  for (const auto& channel : film.channels) {
    header.channels().insert(channel.name, Imf::Channel(Imf::FLOAT));
    long_names |= channel.name.size() > short_name;
  }
  for (const auto& [name, value] : metadata) {
    header.insert(name, Imf::StringAttribute(value));
    long_names |= name.size() > short_name;
  }
  header.sanityCheck();
  MemoryStream stream;
  header.writeTo(stream);

  Bytes bytes;
  append(bytes, std::int32_t{Imf::MAGIC});
  append(bytes, std::int32_t{Imf::EXR_VERSION | (long_names ? Imf::LONG_NAMES_FLAG : 0)});
  append(bytes, stream.bytes().data(), stream.bytes().size());
  return bytes;
}

// Bytes of like significance side by side, each as its difference from the last: what deflate can shrink.
Bytes predict(const Bytes& rows) {
  Bytes result(rows.size());
  const std::size_t half = (rows.size() + 1) / 2;
  for (std::size_t i = 0; i < rows.size(); ++i) result[i / 2 + (i % 2 ? half : 0)] = rows[i];
  auto last = std::to_integer<unsigned>(result[0]);
  for (std::size_t i = 1; i < result.size(); ++i) {
    const auto value = std::to_integer<unsigned>(result[i]);
    result[i] = static_cast<std::byte>(value - last + 128);
    last = value;
  }
  return result;
}

// `channels` in the file's order: by name. The chunk begins with its first row's number and its data's size.
Bytes encode_chunk(const Film& film, const std::vector<const Channel*>& channels, std::size_t first_row,
                   libdeflate_compressor* compressor) {
  const std::size_t end_row = std::min<std::size_t>(first_row + chunk_rows, film.height);
  Bytes rows;
  rows.reserve((end_row - first_row) * channels.size() * film.width * sizeof(float));
  for (std::size_t y = first_row; y < end_row; ++y)
    for (const Channel* channel : channels)
      append(rows, channel->values.data() + y * film.width, film.width * sizeof(float));
  const Bytes predicted = predict(rows);
  Bytes packed(rows.size());
  const std::size_t size =
      libdeflate_zlib_compress(compressor, predicted.data(), predicted.size(), packed.data(), packed.size());
  // 0: it would not fit. Data that did not shrink stand as they were; readers tell by the size.
  if (size > 0 && size < rows.size())
    packed.resize(size);
  else
    packed = std::move(rows);

  Bytes chunk;
  chunk.reserve(2 * sizeof(std::int32_t) + packed.size());
  append(chunk, static_cast<std::int32_t>(first_row));
  append(chunk, static_cast<std::int32_t>(packed.size()));
  append(chunk, packed.data(), packed.size());
  return chunk;
}

// Chunks on their way from the threads that form them to the file, in whose order they are written.
class ChunkQueue {
 public:
  ChunkQueue(std::size_t chunks, std::size_t most_ahead) : chunks_(chunks), most_ahead_(most_ahead) {}

  // The next chunk to form; none: all are taken, or somebody failed. Waits while too many wait to be written.
  std::optional<std::size_t> claim() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return error_ || next_ == chunks_ || next_ < written_ + most_ahead_; });
    if (error_ || next_ == chunks_) return std::nullopt;
    return next_++;
  }
  void put(std::size_t number, Bytes chunk) {
    std::lock_guard lock(mutex_);
    formed_[number] = std::move(chunk);
    changed_.notify_all();
  }
  // The next chunk to write.
  Bytes take() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return error_ || formed_.count(written_); });
    if (error_) std::rethrow_exception(error_);
    Bytes chunk = std::move(formed_.extract(written_++).mapped());
    changed_.notify_all();
    return chunk;
  }
  void fail(std::exception_ptr error) {
    std::lock_guard lock(mutex_);
    if (!error_) error_ = std::move(error);
    changed_.notify_all();
  }

 private:
  const std::size_t chunks_, most_ahead_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::size_t next_ = 0, written_ = 0;
  std::map<std::size_t, Bytes> formed_;
  std::exception_ptr error_;
};

void form_chunks(const Film& film, const std::vector<const Channel*>& channels, ChunkQueue& queue) {
  try {
    const std::unique_ptr<libdeflate_compressor, decltype(&libdeflate_free_compressor)> compressor(
        libdeflate_alloc_compressor(compression_level), &libdeflate_free_compressor);
    if (!compressor) throw std::bad_alloc();
    while (const auto number = queue.claim())
      queue.put(*number, encode_chunk(film, channels, *number * chunk_rows, compressor.get()));
  } catch (...) {
    queue.fail(std::current_exception());
  }
}

}  // namespace

void encode_exr(const Film& film, const std::map<std::string, std::string>& metadata, AtomicFile& file) {
  std::vector<const Channel*> channels;
  for (const auto& channel : film.channels) channels.push_back(&channel);
  std::ranges::sort(channels, {}, [](const Channel* channel) { return channel->name; });
  const std::size_t chunks = (film.height + chunk_rows - 1) / chunk_rows;

  const Bytes header = encode_header(film, metadata);
  std::vector<std::uint64_t> offsets(chunks, 0);
  file.append(header);
  file.append(std::as_bytes(std::span(offsets)));  // they are known at the end
  const std::size_t threads =
      std::min<std::size_t>({std::max(1u, std::thread::hardware_concurrency()), chunks, most_threads});
  ChunkQueue queue(chunks, 2 * threads + 2);
  std::vector<std::jthread> helpers;
  try {
    while (helpers.size() < threads) helpers.emplace_back([&] { form_chunks(film, channels, queue); });
    std::uint64_t end = header.size() + chunks * sizeof(std::uint64_t);
    for (std::uint64_t& offset : offsets) {
      const Bytes chunk = queue.take();
      file.append(chunk);
      offset = end;
      end += chunk.size();
    }
  } catch (...) {
    queue.fail(std::current_exception());  // the threads end before what they read does
    throw;
  }
  file.write_at(header.size(), std::as_bytes(std::span(offsets)));
}

}  // namespace gleaner::coordinator
