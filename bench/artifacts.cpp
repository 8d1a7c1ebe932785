// A retained artifact over workers that are processes, read by two stages, while one of its holders is killed.
//
//   bench_artifacts [MIB [WORKERS [peers|relay [kill|calm [RETAINED_MIB [CACHE_MIB]]]]]]
//     4096 MiB over 4 workers that reach each other, one killed; each keeps at most 64 MiB of parts in memory, the
//     others in $TMPDIR, and 64 MiB of what it fetched. Prints one JSON: whether the bytes are those that are computed
//     without a farm, what was computed again, bytes moved, and the peak resident memory of each process.

#include <cstdio>
#include <nlohmann/json.hpp>

#include "tests/farm/block_farm.h"

namespace {

using namespace gleaner;

int run(const std::vector<std::string>& words) {
  const auto word = [&](std::size_t at, const char* otherwise) {
    return at < words.size() ? words[at] : std::string(otherwise);
  };
  constexpr std::uint64_t mebibyte = std::uint64_t{1} << 20;
  test::BlockFarmSettings settings;
  settings.worker = GLEANER_BLOCK_WORKER;
  settings.bytes = std::stoull(word(0, "4096")) * mebibyte;
  settings.workers = static_cast<unsigned>(std::stoul(word(1, "4")));
  settings.peers = word(2, "peers") == "peers";
  settings.kill = word(3, "kill") == "kill";
  settings.retained_bytes = std::stoull(word(4, "64")) * mebibyte;
  settings.cache_bytes = std::stoull(word(5, "64")) * mebibyte;
  settings.patience = 3600;
  const test::BlockFarmOutcome outcome = test::run_block_farm(settings);
  const auto right = test::block_digests(test::fake_settings().seed, settings.bytes / test::block_bytes);
  const bool same = outcome.digests.artifact == right.artifact && outcome.digests.shuffled == right.shuffled;

  nlohmann::json peaks;
  for (const auto& [process, bytes] : outcome.peak_bytes) peaks[process] = static_cast<double>(bytes) / mebibyte;
  const nlohmann::json json = {
      {"artifact_bytes", settings.bytes},
      {"workers", settings.workers},
      {"peers", settings.peers},
      {"state", outcome.state},
      {"message", outcome.message},
      {"killed", outcome.killed},
      {"same_sha256", same},
      {"artifact_sha256", outcome.digests.artifact},
      {"seconds", outcome.seconds},
      {"stage_items", outcome.stage_items},
      {"bytes", {{"uploaded", outcome.uploaded}, {"downloaded", outcome.downloaded}, {"peers", outcome.peers}}},
      {"peak_mib", peaks}};
  std::printf("%s\n", json.dump(2).c_str());
  return same && outcome.killed == settings.kill ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run({argv + 1, argv + argc});
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
