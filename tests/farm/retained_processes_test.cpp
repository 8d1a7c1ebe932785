// Records that stay with workers that are processes of their own, one of which is killed: the same bytes, and bounded
// memory. bench/artifacts.cpp runs the same with gigabytes.

#include <gtest/gtest.h>

#include "tests/farm/block_farm.h"

namespace gleaner::test {
namespace {

constexpr std::uint64_t mebibyte = std::uint64_t{1} << 20;
constexpr std::uint64_t artifact_bytes = 256 * mebibyte, blocks = artifact_bytes / block_bytes;

class RetainedProcesses : public testing::Test {
 protected:
  static void SetUpTestSuite() { right_ = block_digests(fake_settings().seed, blocks); }

  static BlockFarmSettings settings() {
    BlockFarmSettings settings;
    settings.worker = GLEANER_BLOCK_WORKER;
    settings.bytes = artifact_bytes;
    settings.retained_bytes = settings.cache_bytes = 8 * mebibyte;
    settings.patience = 200;
    return settings;
  }
  static void expect_right(const BlockFarmOutcome& outcome) {
    ASSERT_EQ(outcome.state, "done") << outcome.message;
    EXPECT_EQ(outcome.digests.artifact, right_.artifact);
    EXPECT_EQ(outcome.digests.shuffled, right_.shuffled);
  }

  static BlockDigests right_;
};
BlockDigests RetainedProcesses::right_;

TEST_F(RetainedProcesses, AKilledHolderCostsTimeAndNoByte) {
  const BlockFarmOutcome outcome = run_block_farm(settings());
  ASSERT_TRUE(outcome.killed) << "INCONCLUSIVE: the frame had ended";
  expect_right(outcome);
  if (HasFatalFailure()) return;
  const std::uint64_t again = outcome.stage_items.at("blocks (again)");
  EXPECT_GT(again, blocks / 20) << "what the worker held";
  EXPECT_LT(again, blocks) << "and nothing else";
  EXPECT_GT(outcome.peers, artifact_bytes / 2);
  EXPECT_LT(outcome.uploaded + outcome.downloaded, artifact_bytes / 100) << "the coordinator sees sums alone";
#ifndef __SANITIZE_ADDRESS__
  // The two bounds, some batches of 4 MiB and gRPC's buffers: less than half of the artifact, which the one that reads
  // all of it would hold if it were not read in ranges.
  for (const auto& [process, peak] : outcome.peak_bytes) {
    RecordProperty(process + "_peak_mib", static_cast<int>(peak / mebibyte));
    EXPECT_LT(peak, 100 * mebibyte) << process;
  }
#endif
}

TEST_F(RetainedProcesses, WorkersThatCannotReachEachOtherReadThroughTheCoordinator) {
  BlockFarmSettings relayed = settings();
  relayed.peers = false;
  const BlockFarmOutcome outcome = run_block_farm(relayed);
  ASSERT_TRUE(outcome.killed) << "INCONCLUSIVE: the frame had ended";
  expect_right(outcome);
  if (HasFatalFailure()) return;
  EXPECT_EQ(outcome.peers, 0u);
  EXPECT_GT(outcome.downloaded, artifact_bytes / 2);
}

}  // namespace
}  // namespace gleaner::test
