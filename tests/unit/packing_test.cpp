// Bytes as they travel (proto/packing.h).
#include "proto/packing.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "scene/model/error.h"

namespace gleaner {
namespace {

// Records of three floats that are near each other, as a pixel's sums and its neighbours' are.
scene::Bytes some_records(std::size_t bytes) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> about_one(0.5f, 1.5f);
  std::vector<float> floats(bytes / 4 + 1);
  for (std::size_t i = 0; i < floats.size(); ++i) floats[i] = i % 3 == 2 ? 0 : about_one(random);
  const auto all = std::as_bytes(std::span(floats));
  return scene::Bytes(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(bytes));
}

scene::Bytes noise(std::size_t bytes) {
  std::mt19937 random(6);
  scene::Bytes all(bytes);
  for (std::byte& byte : all) byte = static_cast<std::byte>(random());
  return all;
}

TEST(Packing, BringsTheSameBytes) {
  for (const std::size_t bytes : {256, 257, 1000, 12345, 1 << 20})
    for (const std::uint32_t stride : {1, 2, 7, 12, 68, 5000}) {
      const scene::Bytes records = some_records(bytes);
      const std::string packed = pack(records, stride);
      ASSERT_FALSE(packed.empty()) << bytes << " bytes, stride " << stride;
      EXPECT_LT(packed.size(), records.size());
      EXPECT_EQ(unpack(packed, stride, bytes), records) << bytes << " bytes, stride " << stride;
    }
}

TEST(Packing, RecordsAreSmallerWithTheirStride) {
  const scene::Bytes records = some_records(120000);
  const std::size_t plain = pack(records, 1).size(), known = pack(records, 12).size();
  std::printf("120000 bytes: %zu packed, %zu as records\n", plain, known);
  EXPECT_LT(known, plain * 19 / 20);
}

TEST(Packing, WhatSavesNothingIsNotPacked) {
  EXPECT_EQ(pack({}, 4), "");
  EXPECT_EQ(pack(some_records(24), 12), "");
  EXPECT_EQ(pack(noise(100000), 1), "");
  EXPECT_EQ(pack(noise(100000), 12), "");
}

TEST(Packing, OtherBytesAreRefused) {
  const scene::Bytes records = some_records(1 << 20);
  const std::string packed = pack(records, 12);
  const auto refused = [](const std::string& bytes, std::uint32_t stride, std::size_t most, const char* what) {
    EXPECT_THROW(unpack(bytes, stride, most), Error) << what;
  };
  refused("", 12, 1 << 20, "nothing");
  refused(std::string(1000, 'x'), 12, 1 << 20, "no frame");
  refused(packed.substr(0, packed.size() / 2), 12, 1 << 20, "half a frame");
  refused(packed + packed, 12, 1 << 20, "two frames");
  refused(packed, 12, (1 << 20) - 1, "more than may be");
  refused(packed, 0, 1 << 20, "records of no bytes");
  // The frame says its size, and memory is taken for that: 64 MiB of zeros are refused before.
  const std::string bomb = pack(scene::Bytes(std::size_t{64} << 20), 1);
  ASSERT_FALSE(bomb.empty());
  refused(bomb, 1, 1 << 20, "a bomb");
}

}  // namespace
}  // namespace gleaner
