#pragma once
// What the tests of journals write into them.

#include <gtest/gtest.h>

#include <functional>
#include <string>

#include "coordinator/journal/journal.h"
#include "scene/model/error.h"
#include "tests/farm/fake_frame.h"

namespace gleaner::test {

using coordinator::JournalJob;
using coordinator::JournalRange;

inline JournalJob job(const std::string& id) {
  return {.id = id,
          .state = "queued",
          .message = {},
          .submitted = 1.5e9 + 0.1,
          .request = bytes_of(std::vector<int>{4, 0, 5})};
}

inline JournalRange range(const std::string& of, const std::string& artifact, std::uint64_t first,
                          std::uint64_t frame = 0) {
  return {.job = of,
          .frame = frame,
          .artifact = artifact,
          .first = first,
          .count = 16,
          .offset = first * 8,
          .bytes = 128,
          .digest = std::string("\0\xff '\\32 bytes", 13),
          .facts = bytes_of(std::vector<int>{1})};
}

inline std::string failure_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::failed);
    return error.what();
  }
  return "nothing was thrown";
}

}  // namespace gleaner::test
