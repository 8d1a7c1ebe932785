// Who holds what: parts arrive, workers leave, copies differ.

#include "coordinator/artifacts/registry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <random>

namespace gleaner::coordinator {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

const ArtifactId photons(64, 'a'), links(64, 'b');
constexpr ArtifactLayout fixed{.items = 100, .record_bytes = 8, .counted = false, .most_records = 1};
constexpr ArtifactLayout counted{.items = 100, .record_bytes = 8, .counted = true, .most_records = 3};

std::string digest(char of) { return std::string(32, of); }

Part part(std::uint64_t first, std::uint64_t count, char bytes = 'x', const std::string& kind = "cpu") {
  return {{first, count}, count * 8, count, digest(bytes), kind};
}

std::vector<std::pair<std::uint64_t, std::uint64_t>> ranges(const std::vector<Gap>& gaps) {
  std::vector<std::pair<std::uint64_t, std::uint64_t>> all;
  for (const Gap& gap : gaps) all.emplace_back(gap.items.first, gap.items.count);
  return all;
}
using Range = std::pair<std::uint64_t, std::uint64_t>;

class Registry : public testing::Test {
 protected:
  Registry() { registry.add(photons, fixed); }
  PartVerdict accept(const Part& what, WorkerId who) { return registry.accept(photons, what, who).verdict; }
  std::map<ArtifactId, std::vector<Range>> lost(WorkerId who) {
    std::map<ArtifactId, std::vector<Range>> all;
    for (const auto& [id, items] : registry.worker_lost(who))
      for (const ItemRange& range : items) all[id].emplace_back(range.first, range.count);
    return all;
  }
  ArtifactRegistry registry;
};

TEST_F(Registry, AnArtifactIsWholeWhenAllItsItemsExist) {
  EXPECT_FALSE(registry.whole(photons));
  EXPECT_THAT(ranges(registry.gaps(photons)), ElementsAre(Range{0, 100}));
  EXPECT_EQ(accept(part(20, 30), 1), PartVerdict::added);
  EXPECT_EQ(accept(part(70, 30), 2), PartVerdict::added);
  EXPECT_THAT(ranges(registry.gaps(photons)), ElementsAre(Range{0, 20}, Range{50, 20}));
  EXPECT_THAT(ranges(registry.gaps(photons, {10, 50})), ElementsAre(Range{10, 10}, Range{50, 10}));
  EXPECT_TRUE(registry.exists(photons, {25, 20}));
  EXPECT_FALSE(registry.exists(photons, {25, 26}));
  EXPECT_TRUE(registry.exists(photons, {60, 0}));
  EXPECT_EQ(accept(part(0, 20), 1), PartVerdict::added);
  EXPECT_EQ(accept(part(50, 20), 3), PartVerdict::added);
  EXPECT_TRUE(registry.whole(photons));
  EXPECT_THAT(registry.gaps(photons), IsEmpty());
  EXPECT_EQ(registry.bytes(photons), 800u);
}

TEST_F(Registry, AnArtifactWithoutItemsIsWhole) {
  registry.add(links, {.items = 0, .record_bytes = 4, .counted = false, .most_records = 1});
  EXPECT_TRUE(registry.whole(links));
  EXPECT_FALSE(registry.whole(ArtifactId(64, 'f'))) << "one that nobody knows is not";
  EXPECT_FALSE(registry.exists(ArtifactId(64, 'f'), {0, 0}));
}

TEST_F(Registry, RefusesPartsThatTheLayoutDoesNotAllow) {
  constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
  registry.add(links, counted);
  struct {
    const char* what;
    Part part;
    ArtifactId id;
  } const attacks[] = {
      {"no items", part(0, 0), photons},
      {"behind the end", part(100, 1), photons},
      {"over the end", part(90, 11), photons},
      {"an end that overflows", part(50, most - 10), photons},
      {"a short digest", {{0, 10}, 80, 10, "abc", "cpu"}, photons},
      {"too few bytes", {{0, 10}, 79, 10, digest('x'), "cpu"}, photons},
      {"more records than items", {{0, 10}, 88, 11, digest('x'), "cpu"}, photons},
      {"no counts", {{0, 10}, 80, 10, digest('x'), "cpu"}, links},
      {"too many records", {{0, 10}, 40 + 31 * 8, 31, digest('x'), "cpu"}, links},
      {"records and bytes that differ", {{0, 10}, 40 + 8, 2, digest('x'), "cpu"}, links},
  };
  for (const auto& [what, bad, id] : attacks)
    EXPECT_EQ(registry.accept(id, bad, 1).verdict, PartVerdict::wrong_shape) << what;
  EXPECT_EQ(registry.accept(links, {{0, 10}, 40, 0, digest('x'), "cpu"}, 1).verdict, PartVerdict::added);
  EXPECT_EQ(registry.accept(links, {{10, 10}, 40 + 240, 30, digest('x'), "cpu"}, 1).verdict, PartVerdict::added);
  EXPECT_EQ(registry.accept(ArtifactId(64, 'f'), part(0, 10), 1).verdict, PartVerdict::unknown);
}

TEST_F(Registry, PartsNeverOverlap) {
  ASSERT_EQ(accept(part(20, 20), 1), PartVerdict::added);
  for (const auto& [first, count] : {Range{10, 11}, {20, 10}, {20, 21}, {19, 21}, {25, 5}, {39, 2}, {0, 100}})
    EXPECT_EQ(accept(part(first, count), 2), PartVerdict::overlaps) << first << ", " << count;
  EXPECT_EQ(accept(part(10, 10), 2), PartVerdict::added);
  EXPECT_EQ(accept(part(40, 1), 2), PartVerdict::added);
}

TEST_F(Registry, ALostWorkerReopensJustWhatNobodyElseHolds) {
  registry.add(links, fixed);
  accept(part(0, 40), 1);
  accept(part(40, 40), 2);
  accept(part(80, 20), 1);
  EXPECT_EQ(accept(part(80, 20), 3), PartVerdict::copy);
  registry.accept(links, part(0, 100), 2);
  EXPECT_THAT(registry.worker_lost(9), IsEmpty());
  EXPECT_EQ(lost(1), (std::map<ArtifactId, std::vector<Range>>{{photons, {{0, 40}}}}));
  EXPECT_THAT(ranges(registry.gaps(photons)), ElementsAre(Range{0, 40}));
  EXPECT_TRUE(registry.whole(links));
  EXPECT_THAT(registry.parts(photons, {80, 20}).at(0).holders, ElementsAre(3));
  EXPECT_THAT(registry.worker_lost(1), IsEmpty());
  EXPECT_EQ(lost(2), (std::map<ArtifactId, std::vector<Range>>{{photons, {{40, 40}}}, {links, {{0, 100}}}}));
  EXPECT_THAT(ranges(registry.gaps(links)), ElementsAre(Range{0, 100}));
}

TEST_F(Registry, ACopyFromTheSameWorkerIsNoSecondHolder) {
  accept(part(0, 100), 1);
  EXPECT_EQ(accept(part(0, 100), 1), PartVerdict::copy);
  EXPECT_EQ(lost(1).size(), 1u);
  EXPECT_FALSE(registry.whole(photons));
}

TEST_F(Registry, CopiesThatDifferCountBothAsNothingAndAThirdDecides) {
  for (const auto& [third, liar] : {std::pair<char, WorkerId>{'x', 2}, {'y', 1}}) {
    ArtifactRegistry fresh;
    fresh.add(photons, fixed);
    fresh.accept(photons, part(0, 40, 'x'), 1);
    const PartOutcome outcome = fresh.accept(photons, part(0, 40, 'y'), 2);
    EXPECT_EQ(outcome.verdict, PartVerdict::disputed);
    ASSERT_EQ(outcome.claims.size(), 2u);
    EXPECT_EQ(outcome.claims[0].worker, 1u);
    EXPECT_EQ(outcome.claims[1].worker, 2u);
    EXPECT_EQ(outcome.claims[1].digest, digest('y'));
    const auto gaps = fresh.gaps(photons);
    ASSERT_THAT(ranges(gaps), ElementsAre(Range{0, 40}, Range{40, 60}));
    EXPECT_TRUE(gaps[0].in_one_piece);
    EXPECT_THAT(gaps[0].avoid, UnorderedElementsAre(1, 2));
    EXPECT_FALSE(gaps[1].in_one_piece);
    const PartOutcome settled = fresh.accept(photons, part(0, 40, third), 3);
    EXPECT_EQ(settled.verdict, PartVerdict::added);
    EXPECT_THAT(settled.outvoted, ElementsAre(liar));
    EXPECT_THAT(fresh.parts(photons, {0, 40}).at(0).holders, ElementsAre(3)) << "the first two have dropped theirs";
  }
}

TEST_F(Registry, ThreeCopiesOfWhichNoTwoAgreeSettleNothing) {
  accept(part(0, 40, 'x'), 1);
  accept(part(0, 40, 'y'), 2);
  const PartOutcome outcome = registry.accept(photons, part(0, 40, 'z'), 3);
  EXPECT_EQ(outcome.verdict, PartVerdict::disputed);
  EXPECT_EQ(outcome.claims.size(), 3u);
  EXPECT_EQ(ranges(registry.gaps(photons)).at(0), (Range{0, 40}));
  EXPECT_THAT(registry.accept(photons, part(0, 40, 'y'), 4).outvoted, UnorderedElementsAre(1, 3));
}

TEST_F(Registry, AWorkerCannotOutvoteOthersByAnsweringTwice) {
  accept(part(0, 40, 'x'), 1);
  accept(part(0, 40, 'y'), 2);
  const PartOutcome again = registry.accept(photons, part(0, 40, 'y'), 2);
  EXPECT_EQ(again.verdict, PartVerdict::disputed);
  EXPECT_EQ(again.claims.size(), 2u);
  EXPECT_EQ(again.rounds, 2u) << "so that it ends some time";
  EXPECT_EQ(registry.accept(photons, part(0, 40, 'z'), 1).rounds, 3u);
}

TEST_F(Registry, DevicesOfOtherKindsMayRoundOtherwise) {
  accept(part(0, 40, 'x', "cpu"), 1);
  EXPECT_EQ(accept(part(0, 40, 'y', "gpu"), 2), PartVerdict::other_kind);
  EXPECT_THAT(registry.parts(photons, {0, 40}).at(0).holders, ElementsAre(1));
  registry.worker_lost(1);
  EXPECT_EQ(accept(part(0, 40, 'y', "gpu"), 2), PartVerdict::added)
      << "what a lost one said of it binds its kind alone";
}

TEST_F(Registry, WhoComputesALostPartAgainMustComeToTheSame) {
  accept(part(0, 40, 'x'), 1);
  registry.worker_lost(1);
  EXPECT_EQ(accept(part(0, 40, 'y'), 2), PartVerdict::disputed);
  EXPECT_EQ(accept(part(0, 40, 'x'), 3), PartVerdict::added);
  registry.worker_lost(3);
  EXPECT_EQ(accept(part(0, 10, 'q'), 2), PartVerdict::added) << "another cut has another digest";
  EXPECT_EQ(accept(part(10, 30, 'q'), 2), PartVerdict::added);
}

TEST_F(Registry, ACopyThatTurnsOutWrongIsDropped) {
  accept(part(0, 40), 1);
  accept(part(0, 40), 2);
  EXPECT_FALSE(registry.drop_copy(photons, 0, digest('y'), 1)) << "another version of the part";
  EXPECT_FALSE(registry.drop_copy(photons, 1, digest('x'), 1));
  EXPECT_FALSE(registry.drop_copy(photons, 0, digest('x'), 3));
  EXPECT_FALSE(registry.drop_copy(photons, 0, digest('x'), 1)) << "worker 2 has it still";
  EXPECT_TRUE(registry.exists(photons, {0, 40}));
  EXPECT_TRUE(registry.drop_copy(photons, 0, digest('x'), 2));
  const auto gaps = registry.gaps(photons);
  ASSERT_THAT(ranges(gaps), ElementsAre(Range{0, 40}, Range{40, 60}));
  EXPECT_THAT(gaps[0].avoid, ElementsAre(2)) << "it would hand out the same again";
  EXPECT_FALSE(gaps[0].in_one_piece);
  EXPECT_FALSE(registry.drop_copy(photons, 0, digest('x'), 2));
}

TEST_F(Registry, RecordsAreNumberedOverTheParts) {
  registry.add(links, counted);
  const auto of = [](std::uint64_t first, std::uint64_t count, std::uint64_t records) {
    return Part{{first, count}, count * 4 + records * 8, records, digest('x'), "cpu"};
  };
  registry.accept(links, of(60, 40, 0), 1);
  registry.accept(links, of(0, 10, 7), 1);
  registry.accept(links, of(10, 50, 100), 1);
  auto parts = registry.parts(links, {9, 52});
  ASSERT_EQ(parts.size(), 3u);
  EXPECT_EQ(parts[0].records_before, 0u);
  EXPECT_EQ(parts[1].records_before, 7u);
  EXPECT_EQ(parts[2].records_before, 107u);
  EXPECT_EQ(registry.parts(links, {10, 50}).size(), 1u);
  EXPECT_EQ(registry.records(links), 107u);
  registry.drop_copy(links, 0, digest('x'), 1);
  registry.accept(links, of(0, 10, 9), 2);
  EXPECT_EQ(registry.parts(links, {60, 1}).at(0).records_before, 109u);
}

TEST_F(Registry, WhatIsReleasedIsForgottenAndItsHoldersAreTold) {
  registry.add(links, fixed);
  accept(part(0, 40), 1);
  accept(part(40, 60), 2);
  registry.accept(links, part(0, 100), 2);
  EXPECT_THAT(registry.release(photons), UnorderedElementsAre(1, 2));
  EXPECT_FALSE(registry.has(photons));
  EXPECT_THAT(registry.release(photons), IsEmpty());
  EXPECT_EQ(accept(part(0, 40), 1), PartVerdict::unknown);
  EXPECT_THAT(registry.worker_lost(1), IsEmpty());
  EXPECT_EQ(lost(2), (std::map<ArtifactId, std::vector<Range>>{{links, {{0, 100}}}}));
}

TEST_F(Registry, KeepsWhatFitsTheLastUsedFirst) {
  const ArtifactId third(64, 'c');
  registry.add(links, fixed);
  registry.add(third, fixed);
  for (const ArtifactId& id : {photons, links, third}) registry.accept(id, part(0, 100), 1);
  EXPECT_THAT(registry.keep(photons, 1600), IsEmpty());
  EXPECT_THAT(registry.keep(links, 1600), IsEmpty());
  EXPECT_THAT(registry.keep(photons, 1600), IsEmpty());
  EXPECT_THAT(registry.keep(third, 1600), ElementsAre(links));
  registry.release(links);
  EXPECT_TRUE(registry.take(photons)) << "in use again: it does not count";
  EXPECT_FALSE(registry.take(photons));
  registry.add(links, fixed);
  registry.accept(links, part(0, 100), 1);
  EXPECT_THAT(registry.keep(links, 1600), IsEmpty());
  registry.worker_lost(1);
  EXPECT_THAT(registry.keep(photons, 1600), UnorderedElementsAre(photons, links, third))
      << "what has lost a part is computed again by who needs it, not kept";
}

TEST_F(Registry, KnowsWhoHoldsMost) {
  registry.add(links, fixed);
  EXPECT_THAT(registry.hold_most({photons, links}), IsEmpty());
  accept(part(0, 60), 1);
  accept(part(60, 40), 2);
  EXPECT_THAT(registry.hold_most({photons}), ElementsAre(1));
  registry.accept(links, part(0, 30), 2);
  EXPECT_THAT(registry.hold_most({photons, links}), ElementsAre(2));
  registry.accept(links, part(30, 10), 1);
  EXPECT_THAT(registry.hold_most({photons, links}), ElementsAre(1, 2));
}

// Whatever happens in whatever order, items exist exactly where somebody holds them.
TEST(RegistryAudit, HoldersAndGapsAgreeUnderRandomEvents) {
  std::mt19937_64 random(7);
  for (int round = 0; round < 200; ++round) {
    ArtifactRegistry registry;
    registry.add(photons, fixed);
    for (int step = 0; step < 60; ++step) {
      const WorkerId worker = 1 + random() % 5;
      const std::uint64_t first = random() % 10 * 10, count = 10 * (1 + random() % 3);
      switch (random() % 4) {
        case 0:
          registry.worker_lost(worker);
          break;
        case 1:
          registry.drop_copy(photons, first, digest('x'), worker);
          break;
        default:
          registry.accept(photons, part(first, count, random() % 6 ? 'x' : 'y'), worker);
      }
      std::vector<int> covered(100);
      std::uint64_t bytes = 0;
      for (const HeldPart& held : registry.parts(photons, {0, 100})) {
        ASSERT_FALSE(held.holders.empty());
        bytes += held.bytes;
        for (std::uint64_t i = 0; i < held.items.count; ++i) ++covered[held.items.first + i];
      }
      for (const Gap& gap : registry.gaps(photons))
        for (std::uint64_t i = 0; i < gap.items.count; ++i) ++covered[gap.items.first + i];
      ASSERT_EQ(covered, std::vector<int>(100, 1)) << "round " << round << ", step " << step;
      ASSERT_EQ(registry.bytes(photons), bytes);
      ASSERT_EQ(registry.whole(photons), registry.gaps(photons).empty());
    }
    for (WorkerId worker = 1; worker <= 5; ++worker) registry.worker_lost(worker);
    ASSERT_TRUE(registry.parts(photons, {0, 100}).empty());
  }
}

}  // namespace
}  // namespace gleaner::coordinator
