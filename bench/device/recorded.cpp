#include "bench/device/recorded.h"

#include <algorithm>
#include <cstring>
#include <fstream>
#include <memory>

#include "scene/model/error.h"

namespace gleaner::bench {
namespace {

constexpr char kMagic[8] = {'G', 'L', 'B', 'A', 'T', 'C', 'H', '2'};

// Numbers of 64 bits; runs of bytes behind their length.
class Writer {
 public:
  void number(std::uint64_t n) { append(&n, sizeof n); }
  void run(const void* data, std::size_t size) {
    number(size);
    append(data, size);
  }
  scene::Bytes bytes;

 private:
  void append(const void* data, std::size_t size) {
    if (size == 0) return;
    const auto* first = static_cast<const std::byte*>(data);
    bytes.insert(bytes.end(), first, first + size);
  }
};

class Reader {
 public:
  Reader(const scene::Bytes& bytes, std::string file) : bytes_(bytes), file_(std::move(file)) {}
  std::uint64_t number() {
    std::uint64_t n = 0;
    std::memcpy(&n, take(sizeof n), sizeof n);
    return n;
  }
  scene::Bytes run() {
    const std::uint64_t size = number();
    const std::byte* data = take(size);
    return {data, data + size};
  }
  std::string text() {
    const scene::Bytes letters = run();
    return {reinterpret_cast<const char*>(letters.data()), letters.size()};
  }

 private:
  const std::byte* take(std::uint64_t size) {
    if (size > bytes_.size() - at_)
      throw Error::bad_input(file_, "byte " + std::to_string(at_), std::to_string(size) + " more bytes",
                             std::to_string(bytes_.size() - at_));
    at_ += size;
    return bytes_.data() + at_ - size;
  }

  const scene::Bytes& bytes_;
  std::string file_;
  std::size_t at_ = 0;
};

}  // namespace

void write_batch(const RecordedBatch& batch, const std::filesystem::path& file) {
  Writer out;
  out.run(kMagic, sizeof kMagic);
  for (const std::string& text : {batch.name, batch.task.kind, batch.task.scene}) out.run(text.data(), text.size());
  out.run(batch.task.parameters.data(), batch.task.parameters.size());
  out.number(batch.task.inputs.size());
  for (const auto& [name, input] : batch.task.inputs) {
    const auto bytes = input.load();
    out.run(name.data(), name.size());
    out.run(bytes->data(), bytes->size());
    out.number(input.own_items ? 1 : 0);
    const auto* offsets = input.offsets.get();
    out.run(offsets ? offsets->data() : nullptr, offsets ? offsets->size() * sizeof(std::uint64_t) : 0);
  }
  out.number(batch.first);
  out.number(batch.count);
  out.run(batch.records.data(), batch.records.size());
  write_file(file, out.bytes);
}

RecordedBatch read_batch(const std::filesystem::path& file) {
  const scene::Bytes bytes = read_file(file);
  Reader in(bytes, file.string());
  if (in.text() != std::string(kMagic, sizeof kMagic))
    throw Error::bad_input(file.string(), "magic", "GLBATCH2", "other bytes");
  RecordedBatch batch;
  batch.name = in.text();
  batch.task.kind = in.text();
  batch.task.scene = in.text();
  batch.task.parameters = in.run();
  for (std::uint64_t inputs = in.number(); inputs; --inputs) {
    const std::string name = in.text();
    worker::TaskInput& input = batch.task.inputs[name];
    input = worker::TaskInput(std::make_shared<scene::Bytes>(in.run()));
    input.own_items = in.number() != 0;
    if (const scene::Bytes offsets = in.run(); !offsets.empty()) {
      auto numbers = std::make_shared<std::vector<std::uint64_t>>(offsets.size() / sizeof(std::uint64_t));
      std::memcpy(numbers->data(), offsets.data(), numbers->size() * sizeof(std::uint64_t));
      input.offsets = std::move(numbers);
    }
  }
  batch.first = in.number();
  batch.count = in.number();
  batch.records = in.run();
  return batch;
}

void write_file(const std::filesystem::path& file, const scene::Bytes& bytes) {
  std::ofstream out(file, std::ios::binary);
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out) throw Error::failed("cannot write " + file.string());
}

scene::Bytes read_file(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary | std::ios::ate);
  if (!in) throw Error::failed("cannot read " + file.string());
  scene::Bytes bytes(static_cast<std::size_t>(in.tellg()));
  in.seekg(0);
  in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  if (!in) throw Error::failed("cannot read " + file.string());
  return bytes;
}

std::vector<std::filesystem::path> files_of(const std::filesystem::path& folder, const std::string& extension) {
  std::vector<std::filesystem::path> files;
  if (!std::filesystem::is_directory(folder)) throw Error::failed("no folder " + folder.string());
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.path().extension() == extension) files.push_back(entry.path());
  std::ranges::sort(files);
  return files;
}

}  // namespace gleaner::bench
