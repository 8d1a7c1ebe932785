// The blob store: ranges, single flight, and bytes that are not those of their names.

#include "coordinator/blobs/store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <barrier>
#include <fstream>
#include <limits>
#include <set>
#include <thread>

#include "scene/model/error.h"
#include "tests/farm/fake_frame.h"

namespace gleaner::coordinator {
namespace {

using testing::HasSubstr;

Bytes noise(std::size_t size) {
  Bytes bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::byte>(i * 2654435761u >> 13);
  return bytes;
}

Bytes part(const Bytes& all, std::size_t offset, std::size_t length) {
  return {all.begin() + static_cast<long>(offset), all.begin() + static_cast<long>(offset + length)};
}

void expect_ranges(const BlobSource& source, const Bytes& all) {
  ASSERT_EQ(source.bytes(), all.size());
  for (const auto& [offset, length] : {std::pair<std::size_t, std::size_t>{0, all.size()},
                                       {0, 0},
                                       {all.size(), 0},
                                       {all.size() - 1, 1},
                                       {3, 5},
                                       {999, 3}}) {
    Bytes read(length);
    source.read(offset, read);
    EXPECT_EQ(read, part(all, offset, length)) << length << " from " << offset;
  }
  Bytes one(1);
  constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
  for (const std::uint64_t offset : {std::uint64_t{all.size()}, most, most - 1})
    EXPECT_THROW(source.read(offset, one), Error) << offset;
  Bytes more(all.size());
  EXPECT_THROW(source.read(1, more), Error);
}

TEST(BlobStore, RangesComeFromFilesAndFromMemory) {
  const Bytes all = noise(2000000);
  test::TemporaryFolder folder;
  BlobStore files(folder.path()), memory;
  const std::string id = files.put(all);
  EXPECT_EQ(memory.put(all), id);
  expect_ranges(*files.source(id), all);
  expect_ranges(*memory.source(id), all);
  EXPECT_EQ(files.source(std::string(64, 'a')), nullptr);
  EXPECT_EQ(files.source("../../etc/passwd"), nullptr);
}

TEST(BlobStore, LentSegmentsReadAsOneUntilTheirOwnerReleasesOne) {
  const Bytes all = noise(2000);
  const std::string id(64, 'e');  // named by what makes it, not by its bytes
  BlobStore store;
  auto counts = std::make_shared<const Bytes>(part(all, 0, 1000)), none = std::make_shared<const Bytes>(),
       records = std::make_shared<const Bytes>(part(all, 1000, 1000));
  store.lend(id, {counts, none, records});
  expect_ranges(*store.source(id), all);
  EXPECT_EQ(*store.get(id), all);
  EXPECT_FALSE(store.has(id));
  records.reset();
  EXPECT_EQ(store.source(id), nullptr);
  store.lend(id, {counts});
  EXPECT_EQ(store.source(id)->bytes(), 1000u);
}

TEST(BlobStore, TwentyReadersOfABlobCheckItOnce) {
  constexpr int readers = 20;
  const Bytes all = noise(8 << 20);
  test::TemporaryFolder folder;
  const std::string id = BlobStore(folder.path()).put(all);
  BlobStore store(folder.path());
  std::barrier start(readers);
  std::vector<Blob> wholes(readers);
  std::vector<std::thread> threads;
  for (int i = 0; i < readers; ++i)
    threads.emplace_back([&, i] {
      start.arrive_and_wait();
      EXPECT_EQ(store.source(id)->bytes(), all.size());
      start.arrive_and_wait();
      wholes[static_cast<std::size_t>(i)] = store.get(id);
    });
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(store.bytes_checked(), all.size());
  EXPECT_EQ(std::set<Blob>(wholes.begin(), wholes.end()).size(), 1u) << "one copy in memory for all who ask";
  EXPECT_EQ(*wholes[0], all);
}

TEST(BlobStore, ADamagedFileIsRefusedByAllWhoAskAndCanBeSentAgain) {
  const Bytes all = noise(4 << 20);
  test::TemporaryFolder folder;
  const std::string id = BlobStore(folder.path()).put(all);
  {
    std::fstream file(folder.path() / id.substr(0, 2) / id, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(3 << 20);
    file.put('\x7f');
  }
  BlobStore store(folder.path());
  std::atomic<int> refused{0}, absent{0};
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i)
    threads.emplace_back([&] {
      try {
        if (!store.source(id)) ++absent;
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), HasSubstr("not those of its name"));
        ++refused;
      }
    });
  for (auto& thread : threads) thread.join();
  EXPECT_GE(refused, 1);
  EXPECT_EQ(refused + absent, 8) << "nobody gets damaged bytes";
  store.put(all);
  expect_ranges(*store.source(id), all);
}

TEST(BlobStore, AnUploadThatAnotherClientMakesIsWaitedFor) {
  const Bytes all = noise(1000);
  const std::string id = sha256_hex(all);
  test::TemporaryFolder folder;
  BlobStore store(folder.path());
  auto first = store.begin_upload(id, all.size());
  ASSERT_TRUE(first);
  std::atomic<int> waited{0};
  std::vector<std::thread> others;
  for (int i = 0; i < 5; ++i)
    others.emplace_back([&] {
      EXPECT_FALSE(store.begin_upload(id, all.size(), 60)) << "the store has it when the first upload has ended";
      ++waited;
    });
  first->append(part(all, 0, 500));
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(waited, 0);
  first->append(part(all, 500, 500));
  first->commit();
  first.reset();
  for (auto& other : others) other.join();
  EXPECT_EQ(waited, 5);
}

// MiB of this process.
double resident() {
  std::ifstream file("/proc/self/statm");
  std::uint64_t size = 0, pages = 0;
  file >> size >> pages;
  return static_cast<double>(pages) * 4096 / (1 << 20);
}

TEST(BlobStore, ManyUploadsOfWrongBytesTakeLittleMemory) {
  test::TemporaryFolder folder;
  BlobStore store(folder.path());
  constexpr std::size_t piece = 1 << 20, pieces = 24;
  const Bytes bytes = noise(piece);
  const double before = resident();
  std::vector<std::thread> clients;
  std::atomic<int> refused{0};
  for (int i = 0; i < 20; ++i)
    clients.emplace_back([&, i] {
      auto upload = store.begin_upload(std::string(63, 'a') + "0123456789abcdefghij"[i % 16], pieces * piece, 0);
      if (!upload) return;
      for (std::size_t at = 0; at < pieces; ++at) upload->append(bytes);
      EXPECT_THROW(upload->commit(), Error);
      ++refused;
    });
  for (std::thread& client : clients) client.join();
  EXPECT_GE(refused, 16);
  EXPECT_LT(resident() - before, 64) << "of 480 MiB that were sent";
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder.path()))
    EXPECT_FALSE(entry.is_regular_file()) << entry.path() << " stays";
}

TEST(BlobStore, AnUploadThatEndsWithoutItsBlobLetsTheNextOneBegin) {
  const Bytes all = noise(1000);
  const std::string id = sha256_hex(all);
  BlobStore store;
  auto first = store.begin_upload(id, all.size());
  std::thread other([&] {
    auto second = store.begin_upload(id, all.size(), 60);
    ASSERT_TRUE(second);
    second->append(all);
    second->commit();
  });
  first.reset();  // the client has gone
  other.join();
  EXPECT_TRUE(store.has(id));
}

TEST(BlobStore, AnUploadThatStandsStillHoldsUpNobody) {
  const Bytes all = noise(1000);
  const std::string id = sha256_hex(all);
  BlobStore store;
  auto stuck = store.begin_upload(id, all.size());
  stuck->append(part(all, 0, 10));
  auto second = store.begin_upload(id, all.size(), 0.05);
  ASSERT_TRUE(second);
  second->append(all);
  second->commit();
  second.reset();
  EXPECT_TRUE(store.has(id));
  EXPECT_FALSE(store.begin_upload(id, all.size(), 0.05));
}

// Frames that run side by side may have equal lists of items.
TEST(BlobStore, WhatTwoLendIsThereUntilBothHaveTakenItBack) {
  BlobStore store;
  auto first = std::make_shared<const Bytes>(Bytes(8, std::byte{7}));
  auto second = std::make_shared<const Bytes>(*first);
  const std::string id = store.lend(first);
  ASSERT_EQ(store.lend(second), id);
  second.reset();
  ASSERT_NE(store.source(id), nullptr);
  first.reset();
  EXPECT_EQ(store.source(id), nullptr);
}

}  // namespace
}  // namespace gleaner::coordinator
