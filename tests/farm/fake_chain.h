#pragma once
// A frame of three stages whose records may stay with the workers: "hashes" makes one for each item, "spread" makes of
// each 0 to 3 records (most of the first items none), "sums" adds up a pixel's records and reads the plan's own numbers
// beside. Every value can be computed without a farm.

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/plan/graph.h"
#include "tests/farm/fake_frame.h"

namespace gleaner::test {

inline constexpr std::uint32_t most_spread = 3;

inline std::uint32_t spread_count(std::uint64_t hash, std::uint64_t item) {
  return item < 40 ? 0 : static_cast<std::uint32_t>(hash >> 13) % (most_spread + 1);
}

// Counts and records of items [first, first + hashes.size()).
inline std::pair<std::vector<std::uint32_t>, Bytes> fake_spread(const std::vector<std::uint64_t>& hashes,
                                                                std::uint64_t first) {
  std::vector<std::uint32_t> counts;
  std::vector<std::uint64_t> records;
  for (std::uint64_t i = 0; i < hashes.size(); ++i) {
    counts.push_back(spread_count(hashes[i], first + i));
    for (std::uint32_t j = 0; j < counts.back(); ++j) records.push_back(hash_of(hashes[i], j));
  }
  return {counts, bytes_of(records)};
}

// One float a pixel; `offsets` and `records` are those of all items, `numbers` those of these pixels.
inline Bytes fake_sums(const std::vector<std::uint64_t>& offsets, const std::vector<std::uint64_t>& records,
                       const std::vector<std::uint32_t>& numbers, std::uint64_t first, std::uint64_t count) {
  std::vector<float> sums(count);
  for (std::uint64_t i = 0; i < count; ++i) {
    sums[i] = static_cast<float>(numbers.at(i));
    for (std::uint64_t at = offsets.at((first + i) * items_a_pixel); at < offsets.at((first + i + 1) * items_a_pixel);
         ++at)
      sums[i] += static_cast<float>(records.at(at) >> 44);
  }
  return bytes_of(sums);
}

inline std::vector<std::uint32_t> fake_numbers(std::uint64_t pixels) {
  std::vector<std::uint32_t> numbers(pixels);
  for (std::uint64_t i = 0; i < pixels; ++i) numbers[i] = static_cast<std::uint32_t>(hash_of(77, i) >> 50);
  return numbers;
}

// All of what the stages make.
struct FakeChain {
  explicit FakeChain(const coordinator::FrameSettings& settings)
      : pixels(std::uint64_t{settings.width} * settings.height),
        hashes(values_of<std::uint64_t>(fake_scatter(settings.seed, 0, pixels * items_a_pixel))) {
    auto [counted, bytes] = fake_spread(hashes, 0);
    counts = std::move(counted);
    records = values_of<std::uint64_t>(bytes);
    offsets = {0};
    for (const std::uint32_t c : counts) offsets.push_back(offsets.back() + c);
    sums = fake_sums(offsets, records, fake_numbers(pixels), 0, pixels);
  }

  // The image of a batch of "spread": counts, then records.
  Bytes spread_image(std::uint64_t first, std::uint64_t count) const {
    Bytes image = bytes_of(std::vector<std::uint32_t>(counts.begin() + static_cast<long>(first),
                                                      counts.begin() + static_cast<long>(first + count)));
    const Bytes of_items =
        bytes_of(std::vector<std::uint64_t>(records.begin() + static_cast<long>(offsets[first]),
                                            records.begin() + static_cast<long>(offsets[first + count])));
    image.insert(image.end(), of_items.begin(), of_items.end());
    return image;
  }

  std::string pixels_sha256(std::uint32_t width, std::uint32_t height) const {
    Film film{.width = width, .height = height, .channels = {}};
    for (const char* name : {"R", "G", "B"}) film.channel(name).values = values_of<float>(sums);
    return coordinator::pixels_sha256(film);
  }

  std::uint64_t pixels;
  std::vector<std::uint64_t> hashes;
  std::vector<std::uint32_t> counts;
  std::vector<std::uint64_t> offsets, records;
  Bytes sums;
};

inline std::string fake_chain_sha256(const coordinator::FrameSettings& settings) {
  return FakeChain(settings).pixels_sha256(settings.width, settings.height);
}

// --set place=collect: all records go to the coordinator. --set reusable=1: later frames may read "hashes" and
// "spread".
// --set spread=solo: it runs whole on one worker, and reads all hashes.
class FakeChainPlan final : public coordinator::Plan {
 public:
  FakeChainPlan(coordinator::FrameSettings settings, const coordinator::SceneSummary& scene)
      : settings_(std::move(settings)), graph_(scene.lineage) {}

  coordinator::Step next(const coordinator::FinishedStage* finished) override {
    if (finished)
      graph_.finish(*finished);
    else
      begin();
    coordinator::Step step = graph_.take_step();
    step.done = film_ != nullptr;
    return step;
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return {}; }
  Film film() const override { return *film_; }
  std::vector<coordinator::Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {"hashes", "spread", "sums"}; }

 private:
  void begin() {
    using namespace coordinator;
    using Artifact = Graph::Artifact;
    const std::uint64_t pixels = std::uint64_t{settings_.width} * settings_.height;
    const auto set = [&](const char* key) {
      return settings_.set.contains(key) ? settings_.set.at(key) : std::string();
    };
    StageSpec stage;
    stage.name = "hashes";
    stage.kind = "fake-scatter";
    stage.items = pixels * items_a_pixel;
    stage.tile = 4;
    stage.output = {.record_bytes = 8};
    stage.output.placement = set("place") == "collect" ? Placement::collect : Placement::retain;
    stage.output.reusable = !set("reusable").empty();
    Artifact hashes = graph_.add(stage, settings_.seed);
    stage.name = "spread";
    stage.kind = "fake-spread";
    stage.tile = 1;
    stage.solo = set("spread") == "solo";
    stage.output.counted = true;
    stage.output.most_records = most_spread;
    Artifact spread =
        graph_.add(stage, settings_.seed, {{"hashes", hashes, stage.solo ? Extent::whole : Extent::own_items}});
    hashes = {};  // nothing else reads them
    Artifact numbers = graph_.data(fake_numbers(pixels));
    StageSpec last;
    last.name = "sums";
    last.kind = "fake-sums";
    last.items = pixels;
    last.output.record_bytes = 4;
    Artifact sums = graph_.add(last, settings_.seed, {{"spread", spread}, {"numbers", numbers, Extent::own_items}});
    graph_.when({sums}, [this, sums] {
      film_ = std::make_unique<Film>(Film{.width = settings_.width, .height = settings_.height, .channels = {}});
      for (const char* name : {"R", "G", "B"}) film_->channel(name).values = values_of<float>(sums.records());
    });
  }

  coordinator::FrameSettings settings_;
  coordinator::Graph graph_;
  std::unique_ptr<Film> film_;
};

inline std::unique_ptr<coordinator::Plan> make_fake_chain(const coordinator::FrameSettings& settings,
                                                          const coordinator::SceneSummary& scene) {
  return std::make_unique<FakeChainPlan>(settings, scene);
}

}  // namespace gleaner::test
