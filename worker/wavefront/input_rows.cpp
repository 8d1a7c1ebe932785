#include "worker/wavefront/input_rows.h"

#include <algorithm>
#include <vector>

#include "scene/model/error.h"

namespace gleaner::worker {
namespace {

constexpr std::size_t kPieceBytes = std::size_t{4} << 20;

const TaskInput& find_input(const StageTask& task, const std::string& name) {
  const auto found = task.inputs.find(name);
  if (found == task.inputs.end() || !found->second.source)
    throw Error::bad_input("stage " + task.kind, "input " + name, "an artifact", "none");
  return found->second;
}

}  // namespace

InputRows::InputRows(const StageTask& task, const std::string& name, std::size_t row_bytes)
    : where_("stage " + task.kind), name_("input " + name), input_(find_input(task, name)), row_bytes_(row_bytes) {
  if (input_.bytes() % row_bytes != 0)
    throw Error::bad_input(where_, name_, "rows of " + std::to_string(row_bytes) + " bytes",
                           std::to_string(input_.bytes()) + " bytes");
}

void InputRows::expect_rows(std::uint64_t expected) const {
  if (rows() != expected)
    throw Error::bad_input(where_, name_,
                           std::to_string(expected) + " rows of " + std::to_string(row_bytes_) + " bytes",
                           std::to_string(input_.bytes()) + " bytes");
}

std::uint64_t InputRows::first_row_of(std::uint64_t first, std::uint64_t count, std::uint64_t items) const {
  if (!input_.own_items) {
    expect_rows(items);
    return first;
  }
  if (input_.first_item > first || first + count - input_.first_item > rows())
    throw Error::bad_input(where_, name_, "records of items " + std::to_string(first) + " + " + std::to_string(count),
                           std::to_string(input_.first_item) + " + " + std::to_string(rows()));
  return first - input_.first_item;
}

void InputRows::visit(std::uint64_t first, std::uint64_t count, const Check& check) const {
  const std::uint64_t piece = std::max<std::uint64_t>(1, kPieceBytes / row_bytes_);
  const std::span<const std::byte> whole = input_.in_memory();
  scene::Bytes copy;
  for (std::uint64_t done = 0; done < count; done += piece) {
    const std::uint64_t offset = (first + done) * row_bytes_;
    const std::size_t bytes = std::min(piece, count - done) * row_bytes_;
    if (!whole.empty()) {
      check(first + done, whole.subspan(offset, bytes));
    } else {
      copy.resize(bytes);
      input_.source->read(offset, copy);
      check(first + done, copy);
    }
  }
}

void InputRows::upload(cl::CommandQueue& queue, const cl::Buffer& buffer, std::size_t offset, std::uint64_t first,
                       std::uint64_t count, const Check& check) const {
  visit(first, count, [&](std::uint64_t row, std::span<const std::byte> piece) {
    if (check) check(row, piece);
    queue.enqueueWriteBuffer(buffer, CL_TRUE, offset + (row - first) * row_bytes_, piece.size(), piece.data());
  });
}

cl::Buffer InputRows::to_device(const Device& device, cl::CommandQueue& queue, const Check& check,
                                std::size_t spare) const {
  // Kernels count words in 32 bits.
  if (input_.bytes() / 4 > std::uint64_t{0xffffffff} - spare / 4)
    throw Error::bad_input(where_, name_, "fewer than 2^32 words", std::to_string(input_.bytes()) + " bytes");
  cl::Buffer buffer = device.make_buffer(input_.bytes() + spare);
  upload(queue, buffer, 0, 0, rows(), check);
  return buffer;
}

void InputRows::fail(std::uint64_t row, const std::string& field, const std::string& expected,
                     const std::string& found) const {
  throw Error::bad_input(where_, name_ + "[" + std::to_string(row) + "]" + (field.empty() ? "" : "." + field), expected,
                         found);
}

}  // namespace gleaner::worker
