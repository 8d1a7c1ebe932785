// What a worker holds of artifacts: parts in memory and in files, their sums, and the cache of what it fetched.

#include "worker/artifacts/part_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <limits>

#include "scene/model/error.h"
#include "tests/farm/fake_frame.h"
#include "worker/artifacts/byte_cache.h"
#include "worker/artifacts/part_image.h"

namespace gleaner::worker {
namespace {

using scene::Bytes;
const std::string photons(64, 'a'), links(64, 'b');

Bytes noise(std::size_t size, unsigned seed = 1) {
  Bytes bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::byte>((i + seed) * 2654435761u >> 13);
  return bytes;
}

Bytes read(const StoredPart& part, std::uint64_t offset, std::size_t length) {
  Bytes bytes(length);
  part.read(offset, bytes);
  return bytes;
}

TEST(PartImage, EveryPieceIsBoundByTheDigest) {
  for (const std::size_t size : {std::size_t{0}, std::size_t{1}, summed_piece_bytes - 1, summed_piece_bytes,
                                 summed_piece_bytes + 1, 3 * summed_piece_bytes + 17}) {
    const Bytes image = noise(size);
    const std::span<const std::byte> all = image;
    const Bytes sums = piece_sums({all});
    ASSERT_EQ(sums.size(), pieces_of(size) * sum_bytes) << size;
    // However the image is cut into segments.
    EXPECT_EQ(piece_sums({all.first(size / 3), {}, all.subspan(size / 3)}), sums);
    for (std::uint64_t piece = 0; piece < pieces_of(size); ++piece) {
      Bytes bytes(all.begin() + static_cast<long>(piece * summed_piece_bytes),
                  all.begin() + static_cast<long>(std::min<std::uint64_t>(size, (piece + 1) * summed_piece_bytes)));
      EXPECT_TRUE(piece_matches(sums, piece, bytes));
      EXPECT_FALSE(piece_matches(sums, piece + 1, bytes));
      bytes.back() ^= std::byte{1};
      EXPECT_FALSE(piece_matches(sums, piece, bytes));
      bytes.back() ^= std::byte{1};
      bytes.push_back(std::byte{0});
      EXPECT_FALSE(piece_matches(sums, piece, bytes));
    }
    Bytes other = sums;
    if (!other.empty()) {
      other.back() ^= std::byte{1};
      EXPECT_NE(digest_of_sums(other), digest_of_sums(sums));
    }
  }
  EXPECT_FALSE(piece_matches({}, std::numeric_limits<std::uint64_t>::max(), {}));
}

TEST(PartStore, AnImageReadsTheSameFromMemoryAndFromAFile) {
  const std::vector<std::uint32_t> counts = {2, 0, 3};
  const Bytes records = noise(5 * 8);
  Bytes image = test::bytes_of(counts);
  image.insert(image.end(), records.begin(), records.end());
  PartStore memory(1 << 20), files(0);
  auto in_memory = memory.put(1, photons, 7, 3, counts, records),
       in_file = files.put(1, photons, 7, 3, counts, records);
  EXPECT_EQ(memory.memory_bytes(), image.size());
  EXPECT_EQ(memory.file_bytes(), 0u);
  EXPECT_EQ(files.memory_bytes(), 0u);
  EXPECT_EQ(files.file_bytes(), image.size());
  EXPECT_EQ(in_memory->digest(), in_file->digest());
  EXPECT_EQ(*in_memory->records_in_memory(), records);
  EXPECT_EQ(in_file->records_in_memory(), nullptr);
  for (const auto& part : {in_memory, in_file}) {
    EXPECT_EQ(part->bytes(), image.size());
    EXPECT_EQ(part->items(), 3u);
    for (std::size_t begin = 0; begin <= image.size(); begin += 3)
      for (std::size_t length = 0; begin + length <= image.size(); length += 5)
        EXPECT_EQ(read(*part, begin, length),
                  Bytes(image.begin() + static_cast<long>(begin), image.begin() + static_cast<long>(begin + length)));
    constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
    for (const std::uint64_t offset : {std::uint64_t{image.size()}, most}) EXPECT_THROW(read(*part, offset, 1), Error);
    EXPECT_THROW(read(*part, 1, image.size()), Error);
  }
}

TEST(PartStore, WhatDoesNotFitIntoMemoryLiesInFilesWithoutNames) {
  test::TemporaryFolder folder;
  PartStore store(1000, folder.path());
  std::vector<std::shared_ptr<const StoredPart>> parts;
  for (unsigned i = 0; i < 20; ++i) parts.push_back(store.put(1, photons, i * 40, 40, {}, noise(320, i)));
  EXPECT_LE(store.memory_bytes(), 1000u);
  EXPECT_EQ(store.memory_bytes() + store.file_bytes(), 6400u);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path())) << "nothing is left behind, whatever ends the process";
  for (unsigned i = 0; i < 20; ++i) EXPECT_EQ(read(*parts[i], 0, 320), noise(320, i)) << i;
  store.drop(1, photons);
  EXPECT_EQ(store.memory_bytes() + store.file_bytes(), 0u);
  EXPECT_EQ(store.find(photons, 0, parts[0]->digest()), nullptr);
  EXPECT_EQ(read(*parts[19], 0, 320), noise(320, 19)) << "who reads it at the moment can go on";
}

TEST(PartStore, VersionsAreToldApartAndDroppedAlone) {
  PartStore store(1 << 20);
  auto one = store.put(1, photons, 0, 10, {}, noise(80, 1)), two = store.put(1, photons, 0, 10, {}, noise(80, 2));
  auto other = store.put(1, links, 0, 10, {}, noise(80, 1));
  EXPECT_NE(one->digest(), two->digest());
  EXPECT_EQ(one->digest(), other->digest());
  store.drop(1, photons, 0, one->digest());
  EXPECT_EQ(store.find(photons, 0, one->digest()), nullptr);
  EXPECT_EQ(store.find(photons, 0, two->digest()), two);
  EXPECT_EQ(store.find(links, 0, one->digest()), other);
  EXPECT_EQ(store.find(photons, 1, two->digest()), nullptr);
  store.drop(1, photons, 0, std::string(32, 'x'));
  store.drop(1, photons);
  EXPECT_EQ(store.find(links, 0, one->digest()), other);
  EXPECT_EQ(store.memory_bytes(), 80u);
}

TEST(PartStore, WorkersOfOneProcessDropTheirOwnAlone) {
  for (const std::uint64_t memory : {1 << 20, 0}) {
    PartStore store(memory);
    const auto ada = store.new_owner(), bob = store.new_owner();
    auto both = store.put(ada, photons, 0, 10, {}, noise(80)), of_bob = store.put(bob, photons, 10, 10, {}, noise(80));
    EXPECT_EQ(store.put(bob, photons, 0, 10, {}, noise(80)), both);
    EXPECT_EQ(store.memory_bytes() + store.file_bytes(), 160u);
    // She was told late that an artifact is released, which he makes anew.
    store.drop(ada, photons);
    store.drop(ada, photons, 10, of_bob->digest());
    store.clear(ada);
    EXPECT_EQ(store.find(photons, 0, both->digest()), both);
    EXPECT_EQ(store.find(photons, 10, of_bob->digest()), of_bob);
    store.put(bob, photons, 0, 10, {}, noise(80));
    store.drop(bob, photons, 0, both->digest());
    EXPECT_EQ(store.find(photons, 0, both->digest()), both) << "he has made it twice";
    store.drop(bob, photons, 0, both->digest());
    EXPECT_EQ(store.find(photons, 0, both->digest()), nullptr);
    store.clear(bob);
    EXPECT_EQ(store.memory_bytes() + store.file_bytes(), 0u);
  }
}

TEST(PartStore, AFullDiskIsAnErrorAndLeavesNothing) {
  PartStore store(0, "/proc");  // where no file can be made
  EXPECT_THROW(store.put(1, photons, 0, 10, {}, noise(80)), Error);
  EXPECT_EQ(store.file_bytes(), 0u);
}

TEST(ByteCache, AllKindsShareOneBoundTheLastUsedStay) {
  ByteCache cache(1000);
  const auto of = [](std::size_t bytes) { return CachedBytes{std::make_shared<const Bytes>(bytes)}; };
  cache.put("scene", of(400));
  cache.put("photons", of(400));
  EXPECT_TRUE(cache.find("scene").bytes);
  cache.put("links", of(300));
  EXPECT_EQ(cache.find("photons").bytes, nullptr);
  EXPECT_TRUE(cache.find("scene").bytes);
  EXPECT_TRUE(cache.find("links").bytes);
  EXPECT_EQ(cache.bytes(), 700u);
  cache.put("enormous", of(1001));
  EXPECT_EQ(cache.find("enormous").bytes, nullptr);
  EXPECT_EQ(cache.bytes(), 700u) << "what can never fit displaces nothing";
  cache.put("counted", {std::make_shared<const Bytes>(10), std::make_shared<const std::vector<std::uint64_t>>(100)});
  EXPECT_EQ(cache.bytes(), 10u + 800u) << "the offsets count too: all others had to go";
}

}  // namespace
}  // namespace gleaner::worker
