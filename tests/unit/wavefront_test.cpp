// What stages stand on: items claimed by threads, buffers and tables that stay between batches, inputs in pieces.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "scene/model/error.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/joined_records.h"
#include "worker/wavefront/kept_tables.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;
using worker::InputRows;
using worker::KeptTables;
using worker::StageTask;
using worker::TaskInput;
using worker::WorkQueue;
using worker::Workspace;

TEST(WorkQueue, EveryItemOnceInAlignedBlocks) {
  for (const std::uint64_t total : {0u, 1u, 15u, 16u, 17u, 1000u, 100000u})
    for (const unsigned threads : {1u, 2u, 7u})
      for (const std::uint64_t least : {0u, 1024u}) {
        WorkQueue work(total, threads, least);
        std::vector<std::vector<WorkQueue::Block>> claimed(threads);
        worker::run_threads(threads, [&](unsigned k) {
          while (const WorkQueue::Block block = work.claim(4096)) claimed[k].push_back(block);
        });
        std::vector<int> seen(total, 0);
        for (const auto& blocks : claimed)
          for (const auto& block : blocks) {
            EXPECT_EQ(block.first % WorkQueue::kAlignment, 0u);
            EXPECT_LE(block.count, 4096u);
            for (std::uint64_t i = 0; i < block.count; ++i) ++seen.at(block.first + i);
          }
        EXPECT_EQ(std::accumulate(seen.begin(), seen.end(), std::uint64_t{0}), total);
        EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), static_cast<std::ptrdiff_t>(total));
      }
}

TEST(WorkQueue, OneThreadTakesAllThatFits) {
  WorkQueue work(100000, 1, 1024);
  EXPECT_EQ(work.claim(1u << 20).count, 100000u);
  EXPECT_FALSE(work.claim(1u << 20));
}

TEST(WorkQueue, GivesNothingAfterAThreadFailed) {
  WorkQueue work(100000, 2);
  EXPECT_TRUE(work.claim(16));
  work.stop();
  EXPECT_FALSE(work.claim(16));
}

// Item k yields k % 5 bytes; threads end in any order.
TEST(JoinedRecords, AreInTheItemsOrder) {
  constexpr std::uint64_t total = 10000;
  scene::Bytes expected;
  const auto yield = [](scene::Bytes& bytes, std::uint64_t item) {
    bytes.insert(bytes.end(), item % 5, static_cast<std::byte>(item));
  };
  for (std::uint64_t k = 0; k < total; ++k) yield(expected, k);
  for (const unsigned threads : {1u, 3u}) {
    WorkQueue work(total, threads);
    worker::JoinedRecords joined(total);
    worker::run_threads(threads, [&](unsigned) {
      std::vector<WorkQueue::Block> held;  // two blocks a turn, the later one first
      for (;;) {
        held = {work.claim(48), work.claim(48)};
        for (auto block = held.rbegin(); block != held.rend(); ++block) {
          if (!*block) continue;
          scene::Bytes records;
          for (std::uint64_t k = 0; k < block->count; ++k) yield(records, block->first + k);
          joined.add(block->first, block->count, records);
        }
        if (!held[0]) return;
      }
    });
    EXPECT_EQ(joined.take(), expected) << threads;
  }
}

class OnDevice : public testing::Test {
 protected:
  void SetUp() override {
    if (worker::list_devices().empty()) GTEST_SKIP() << "NOT TESTED: there is no OpenCL device";
    device_ = std::make_unique<worker::Device>(worker::DeviceChoice{.device = -1, .threads = 1});
  }
  std::unique_ptr<worker::Device> device_;
};

using WorkspaceTest = OnDevice;

TEST_F(WorkspaceTest, OneNameIsOneBufferThatGrows) {
  Workspace workspace(*device_, 1u << 20);
  const cl::Buffer first = workspace.take("paths", 1000);
  EXPECT_EQ(workspace.take("paths", 500)(), first());
  EXPECT_EQ(workspace.take("paths", 1000)(), first());
  EXPECT_EQ(workspace.bytes(), 1000u);
  EXPECT_NE(workspace.take("paths", 2000)(), first());
  EXPECT_EQ(workspace.bytes(), 2000u);
  workspace.take("shadows", 300);
  EXPECT_EQ(workspace.bytes(), 2300u);
}

TEST_F(WorkspaceTest, StaysWithinItsBoundBetweenBatches) {
  Workspace workspace(*device_, 1000);
  workspace.take("old", 600);
  workspace.end_batch();
  workspace.take("new", 900);
  EXPECT_EQ(workspace.bytes(), 1500u) << "a batch gets what it asks for";
  workspace.end_batch();
  EXPECT_EQ(workspace.bytes(), 900u) << "what was used last stays";
  workspace.take("huge", 5000);
  workspace.end_batch();
  EXPECT_LE(workspace.bytes(), 1000u);
}

TEST_F(WorkspaceTest, GivesBackWhatBatchesNoLongerUse) {
  Workspace workspace(*device_, 1u << 30);
  workspace.take("once", 1u << 20);
  workspace.take("shrinks", 1u << 20);
  for (int batch = 0; batch < 200; ++batch) {
    workspace.end_batch();
    workspace.take("shrinks", 1000);
  }
  EXPECT_EQ(workspace.bytes(), 1000u);
}

// Threads of a batch take buffers whenever they need some. Without a lock the map of names breaks.
TEST_F(WorkspaceTest, ThreadsTakeBuffersAtOnce) {
  constexpr unsigned kThreads = 4, kNames = 200;
  Workspace workspace(*device_, 0);
  for (int batch = 0; batch < 5; ++batch) {
    {
      std::vector<std::jthread> threads;
      for (unsigned k = 0; k < kThreads; ++k)
        threads.emplace_back([&, k] {
          for (unsigned name = 0; name < kNames; ++name)
            workspace.take(std::to_string(name) + "." + std::to_string(k), 64 + name);
        });
    }
    EXPECT_EQ(workspace.bytes(), kThreads * (kNames * 64 + kNames * (kNames - 1) / 2));
    workspace.end_batch();
    EXPECT_EQ(workspace.bytes(), 0u);
  }
}

StageTask task_of(const std::string& parameters, const std::string& artifact) {
  StageTask task;
  task.kind = "kind";
  task.scene = "scene";
  for (const char c : parameters) task.parameters.push_back(static_cast<std::byte>(c));
  TaskInput input(std::make_shared<scene::Bytes>(4));
  input.artifact = artifact;
  task.inputs["lights"] = input;
  return task;
}

struct SomeTables {
  int number = 0;
  std::size_t size = 100;
  std::size_t bytes() const { return size; }
};

TEST(KeptTablesTest, AreMadeOnceForTheSameInputsAndParameters) {
  KeptTables kept(1000);
  int made = 0;
  const auto get = [&](const StageTask& task) {
    return kept.get<SomeTables>(task, [&] { return SomeTables{++made}; })->number;
  };
  EXPECT_EQ(get(task_of("p", "a")), 1);
  EXPECT_EQ(get(task_of("p", "a")), 1) << "the id says that the bytes are the same";
  EXPECT_EQ(get(task_of("p", "b")), 2);
  EXPECT_EQ(get(task_of("q", "a")), 3);
  StageTask other = task_of("p", "a");
  other.scene = "other scene";
  EXPECT_EQ(get(other), 4);
  EXPECT_EQ(get(task_of("p", "a")), 1) << "the tables of several stages are kept beside each other";
  const StageTask unnamed = task_of("p", "");
  EXPECT_EQ(get(unnamed), 5);
  EXPECT_EQ(get(unnamed), 5) << "the same bytes in memory";
  EXPECT_EQ(get(task_of("p", "")), 6) << "other bytes without an id";
}

TEST(KeptTablesTest, LeastRecentlyUsedGoFirst) {
  KeptTables kept(250);
  int made = 0;
  const auto get = [&](const char* artifact, std::size_t size = 100) {
    return kept.get<SomeTables>(task_of("p", artifact), [&] { return SomeTables{++made, size}; });
  };
  get("a");
  get("b");
  get("a");
  get("c");
  EXPECT_EQ(kept.bytes(), 200u);
  EXPECT_EQ(get("a")->number, 1);
  const auto held = get("c");
  EXPECT_EQ(get("b")->number, 4) << "b went";
  get("large", 1000);
  EXPECT_EQ(kept.bytes(), 1000u) << "what is in use is kept whatever its size";
  EXPECT_EQ(held->number, 3) << "who holds tables keeps them";
}

// An artifact that is nowhere in memory: its words count up.
class CountingSource final : public worker::ArtifactSource {
 public:
  explicit CountingSource(std::uint64_t bytes) : bytes_(bytes) {}
  std::uint64_t bytes() const override { return bytes_; }
  void read(std::uint64_t offset, std::span<std::byte> out) const override {
    ASSERT_LE(offset + out.size(), bytes_);
    largest = std::max(largest, out.size());
    for (std::size_t at = 0; at < out.size(); at += 4) {
      const auto word = static_cast<std::uint32_t>((offset + at) / 4);
      std::memcpy(&out[at], &word, 4);
    }
  }
  mutable std::size_t largest = 0;

 private:
  std::uint64_t bytes_;
};

class InputRowsTest : public OnDevice {
 protected:
  StageTask task_with(std::uint64_t bytes) {
    source_ = std::make_shared<CountingSource>(bytes);
    StageTask task;
    task.kind = "kind";
    task.inputs["points"].source = source_;
    return task;
  }
  std::string message(const std::function<void()>& call) {
    try {
      call();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      return error.what();
    }
    return "nothing was thrown";
  }
  std::shared_ptr<CountingSource> source_;
};

TEST_F(InputRowsTest, AreCopiedToTheDeviceInPieces) {
  constexpr std::uint64_t rows = 300000;
  const StageTask task = task_with(rows * 64);
  const InputRows input(task, "points", 64);
  EXPECT_EQ(input.rows(), rows);
  std::uint64_t next = 0;
  cl::CommandQueue queue = device_->make_queue();
  const cl::Buffer buffer = input.to_device(*device_, queue, [&](std::uint64_t row, std::span<const std::byte> piece) {
    EXPECT_EQ(row, next);
    next += piece.size() / 64;
  });
  EXPECT_EQ(next, rows) << "every row is shown once";
  EXPECT_LE(source_->largest, std::size_t{8} << 20) << "never the whole";
  std::vector<std::uint32_t> words(rows * 16);
  queue.enqueueReadBuffer(buffer, CL_TRUE, 0, words.size() * 4, words.data());
  for (std::uint32_t k = 0; k < words.size(); ++k) ASSERT_EQ(words[k], k);
  EXPECT_GE(buffer.getInfo<CL_MEM_SIZE>(), rows * 64 + 64) << "the last row's load of a whole line";
}

TEST_F(InputRowsTest, AnErrorNamesInputAndRow) {
  const StageTask task = task_with(640);
  const InputRows input(task, "points", 64);
  EXPECT_THAT(message([&] { input.fail(7, "triangle", "below 3", "9"); }),
              HasSubstr("stage kind: input points[7].triangle: expected below 3, found 9"));
  EXPECT_THAT(message([&] { input.expect_rows(11); }), HasSubstr("11 rows of 64 bytes"));
  EXPECT_THAT(message([&] { InputRows(task, "lights", 64); }), HasSubstr("input lights: expected an artifact"));
  EXPECT_THAT(message([&] { InputRows(task, "points", 60); }), HasSubstr("rows of 60 bytes"));
}

TEST_F(InputRowsTest, OwnItemsHoldTheBatchAlone) {
  StageTask task = task_with(640);
  task.inputs["points"].own_items = true;
  task.inputs["points"].first_item = 100;
  const InputRows input(task, "points", 64);
  EXPECT_EQ(input.first_row_of(100, 10, 1000), 0u);
  EXPECT_EQ(input.first_row_of(104, 6, 1000), 4u);
  EXPECT_THAT(message([&] { input.first_row_of(96, 4, 1000); }), HasSubstr("records of items 96 + 4"));
  EXPECT_THAT(message([&] { input.first_row_of(104, 7, 1000); }), HasSubstr("records of items 104 + 7"));
  task.inputs["points"].own_items = false;
  const InputRows whole(task, "points", 64);
  EXPECT_EQ(whole.first_row_of(4, 6, 10), 4u);
  EXPECT_THAT(message([&] { whole.first_row_of(4, 6, 11); }), HasSubstr("11 rows"));
}

}  // namespace
}  // namespace gleaner::test
