#pragma once
// A frame over an artifact of any size that stays with the workers, as large blocks of hashes. Stage "blocks" makes
// them; "shuffled" reads them in another order, so that most of what a batch reads lies with other workers; "digest",
// on one worker, reads all of them in order. The plan settles on the SHA-256 of the whole artifact.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/plan/graph.h"
#include "proto/sha256.h"
#include "tests/farm/fake_frame.h"
#include "worker/agent/runner.h"

namespace gleaner::test {

inline constexpr std::uint32_t block_bytes = 64 << 10;

inline void fill_block(std::uint64_t seed, std::uint64_t block, std::span<std::byte> out) {
  for (std::size_t i = 0; i < block_bytes / sizeof(std::uint64_t); ++i) {
    const std::uint64_t hash = hash_of(seed, block * (block_bytes / sizeof(std::uint64_t)) + i);
    std::memcpy(out.data() + i * sizeof hash, &hash, sizeof hash);
  }
}

// Which block the item of "shuffled" reads: each is read once, neighbours lie far from each other.
inline std::uint64_t shuffled_block(std::uint64_t item, std::uint64_t blocks) {
  constexpr std::uint64_t stride = 2654435761u;  // a prime above any number of blocks that tests use
  return (item * stride + 1) % blocks;
}

// What a frame of so many blocks must come to, computed without a farm.
struct BlockDigests {
  std::string artifact;  // SHA-256 of all blocks, hexadecimal
  std::string shuffled;  // ... of the SHA-256 sums of the shuffled blocks
};

inline BlockDigests block_digests(std::uint64_t seed, std::uint64_t blocks) {
  Bytes block(block_bytes);
  std::vector<std::string> sums(blocks);
  Sha256 all;
  for (std::uint64_t i = 0; i < blocks; ++i) {
    fill_block(seed, i, block);
    all.update(block);
    Sha256 one;
    one.update(block);
    sums[i] = one.raw();
  }
  Sha256 shuffled;
  for (std::uint64_t i = 0; i < blocks; ++i) shuffled.update(std::as_bytes(std::span(sums[shuffled_block(i, blocks)])));
  return {all.hex(), shuffled.hex()};
}

// A frame of width * height blocks.
class BlockPlan final : public coordinator::Plan {
 public:
  BlockPlan(coordinator::FrameSettings settings, const coordinator::SceneSummary& scene)
      : settings_(std::move(settings)), graph_(scene.lineage) {}

  coordinator::Step next(const coordinator::FinishedStage* finished) override {
    if (finished)
      graph_.finish(*finished);
    else
      begin();
    coordinator::Step step = graph_.take_step();
    step.done = !digests_.artifact.empty();
    return step;
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return {}; }
  Film film() const override {
    Film film{.width = 1, .height = 1, .channels = {}};
    for (const char* name : {"R", "G", "B"}) film.channel(name).values = {0.5f};
    return film;
  }
  std::vector<coordinator::Skip> skips() const override { return {}; }
  std::string parameters_json() const override {
    return R"({"artifact": ")" + digests_.artifact + R"(", "shuffled": ")" + digests_.shuffled + R"("})";
  }
  std::vector<std::string> outline() const override { return {"blocks", "shuffled", "digest"}; }

 private:
  void begin() {
    using namespace coordinator;
    StageSpec stage;
    stage.name = "blocks";
    stage.kind = "block-make";
    stage.items = std::uint64_t{settings_.width} * settings_.height;
    stage.output = {.record_bytes = block_bytes, .placement = Placement::retain};
    const std::uint64_t items = stage.items;
    const Graph::Artifact blocks = graph_.add(stage, settings_.seed);
    stage.name = "shuffled";
    stage.kind = "block-shuffled";
    stage.output = {.record_bytes = 32};
    const Graph::Artifact shuffled = graph_.add(stage, items, {{"blocks", blocks}});
    graph_.when({shuffled}, [this, blocks, shuffled] {
      StageSpec last;
      last.name = "digest";
      last.kind = "block-digest";
      last.items = 1;
      last.solo = true;
      last.output = {.record_bytes = 32};
      const Graph::Artifact digest = graph_.add(last, std::uint64_t{0}, {{"blocks", blocks}});
      Sha256 hash;
      hash.update(shuffled.records());
      digests_.shuffled = hash.hex();
      graph_.when({digest}, [this, digest] {
        const auto raw = values_of<char>(digest.records());
        digests_.artifact = to_hex(std::string(raw.begin(), raw.end()));
      });
    });
  }

  coordinator::FrameSettings settings_;
  coordinator::Graph graph_;
  BlockDigests digests_;
};

inline std::unique_ptr<coordinator::Plan> make_block_plan(const coordinator::FrameSettings& settings,
                                                          const coordinator::SceneSummary& scene) {
  return std::make_unique<BlockPlan>(settings, scene);
}

// The device of a worker that makes and reads blocks.
class BlockRunner final : public worker::Runner {
 public:
  BlockRunner() {
    info_.name = "arithmetic";
    info_.tracer = "none";
  }
  const worker::DeviceInfo& info() const override { return info_; }
  bool needs_bvh() const override { return false; }
  bool holds_scene(const std::string& id) const override { return scenes_.contains(id); }
  void load_scene(const std::string& id, std::shared_ptr<const scene::Scene>,
                  std::shared_ptr<const scene::Bvh>) override {
    scenes_.insert(id);
  }
  bool holds_base(const std::string& id) const override { return scenes_.contains(id); }
  void load_base(const std::string& id, std::shared_ptr<const scene::Scene>,
                 std::shared_ptr<const scene::Bvh>) override {
    scenes_.insert(id);
  }
  worker::MotionReport load_frame(const std::string& id, const std::string&,
                                  const std::optional<scene::FrameState>&) override {
    scenes_.insert(id);
    return {};
  }

  worker::BatchResult run(const worker::StageTask& task, std::uint64_t first, std::uint64_t count) override {
    worker::BatchResult result;
    if (task.kind == "block-make") {
      result.records.resize(count * block_bytes);
      const std::uint64_t seed = values_of<std::uint64_t>(task.parameters).at(0);
      for (std::uint64_t i = 0; i < count; ++i)
        fill_block(seed, first + i, std::span(result.records).subspan(i * block_bytes, block_bytes));
    } else if (task.kind == "block-shuffled") {
      const std::uint64_t blocks = values_of<std::uint64_t>(task.parameters).at(0);
      for (std::uint64_t i = first; i < first + count; ++i)
        append(result.records,
               digest_of(*task.inputs.at("blocks").source, shuffled_block(i, blocks) * block_bytes, block_bytes));
    } else {
      const worker::ArtifactSource& blocks = *task.inputs.at("blocks").source;
      append(result.records, digest_of(blocks, 0, blocks.bytes()));
    }
    return result;
  }

 private:
  // SHA-256 of a range, which is read in pieces.
  static std::string digest_of(const worker::ArtifactSource& source, std::uint64_t offset, std::uint64_t bytes) {
    constexpr std::uint64_t piece_bytes = std::uint64_t{4} << 20;
    Bytes piece(std::min(bytes, piece_bytes));
    Sha256 hash;
    for (std::uint64_t at = 0; at < bytes; at += piece.size()) {
      piece.resize(std::min(piece_bytes, bytes - at));
      source.read(offset + at, piece);
      hash.update(piece);
    }
    return hash.raw();
  }
  static void append(Bytes& to, const std::string& raw) {
    const auto bytes = std::as_bytes(std::span(raw));
    to.insert(to.end(), bytes.begin(), bytes.end());
  }

  worker::DeviceInfo info_;
  std::set<std::string> scenes_;
};

}  // namespace gleaner::test
