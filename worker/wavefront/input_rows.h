#pragma once
// An input of a stage as rows of a fixed size. It may be larger than memory: it is read, checked and copied to the
// device in pieces.

#include <cstdint>
#include <cstring>
#include <functional>
#include <span>
#include <string>

#include "worker/device/device.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

class InputRows {
 public:
  // Sees each piece before it is used: the number of its first row, and its bytes. Throws where a row is not to be had.
  using Check = std::function<void(std::uint64_t first_row, std::span<const std::byte> rows)>;

  // Throws Error::bad_input where the task lacks the input, or its bytes are no rows.
  InputRows(const StageTask& task, const std::string& name, std::size_t row_bytes);

  // Rows that the source holds: of the whole artifact, or of the batch's items.
  std::uint64_t rows() const { return input_.bytes() / row_bytes_; }
  std::size_t row_bytes() const { return row_bytes_; }
  // Throws Error::bad_input for another number of rows.
  void expect_rows(std::uint64_t expected) const;
  // Of an input with a record an item: items [first, first + count) as rows of the source. `items`: of the stage, as
  // many as the whole artifact has. Throws Error::bad_input where the source lacks them.
  std::uint64_t first_row_of(std::uint64_t first, std::uint64_t count, std::uint64_t items) const;

  // Shows rows [first, first + count) to `check`.
  void visit(std::uint64_t first, std::uint64_t count, const Check& check) const;
  // Copies rows [first, first + count) to the buffer's byte `offset`, each piece checked before. Blocks.
  void upload(cl::CommandQueue& queue, const cl::Buffer& buffer, std::size_t offset, std::uint64_t first,
              std::uint64_t count, const Check& check) const;
  // All rows in a buffer of their own, with `spare` bytes behind them (at least the last row's load of a whole line).
  cl::Buffer to_device(const Device& device, cl::CommandQueue& queue, const Check& check, std::size_t spare = 64) const;

  // Bad input that names the row: "stage vpl_shade, input lights[17].table: expected ..., found ...".
  [[noreturn]] void fail(std::uint64_t row, const std::string& field, const std::string& expected,
                         const std::string& found) const;

 private:
  std::string where_, name_;
  const TaskInput& input_;
  std::size_t row_bytes_;
};

// Word `word` of the row that begins at `row`.
template <typename T>
T row_word(const std::byte* row, unsigned word) {
  static_assert(sizeof(T) == 4);
  T value;
  std::memcpy(&value, row + std::size_t{word} * 4, 4);
  return value;
}

}  // namespace gleaner::worker
