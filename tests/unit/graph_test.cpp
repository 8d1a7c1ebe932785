// The graph of a plan: what is asked for when, what runs once, what is released.

#include "coordinator/plan/graph.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "coordinator/artifacts/artifact_id.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

struct Numbers {
  std::uint32_t value = 0;
};

StageSpec stage(const std::string& name, std::uint64_t items = 2, Placement placement = Placement::retain) {
  StageSpec spec;
  spec.name = name;
  spec.kind = "kind";
  spec.items = items;
  spec.output.record_bytes = 4;
  spec.output.placement = placement;
  return spec;
}

FinishedStage finished(const StageSpec& spec, std::uint32_t fact = 0) {
  FinishedStage result{spec.name, nullptr, spec.items, {}};
  if (spec.output.placement == Placement::collect)
    result.records = std::make_shared<Bytes>(spec.items * spec.output.record_bytes);
  if (fact) result.facts = bytes_of(Numbers{fact});
  return result;
}

std::vector<std::string> names(const Step& step) {
  std::vector<std::string> list;
  for (const StageSpec& spec : step.stages) list.push_back(spec.name);
  return list;
}

template <typename Call>
std::string message_of(Call call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST(Graph, AStageIsAskedForOnceItsInputsExist) {
  Graph graph("scene");
  const auto a = graph.add(stage("a"), Numbers{1}), b = graph.add(stage("b"), Numbers{2});
  const auto c = graph.add(stage("c"), Numbers{3}, {{"first", a}, {"second", b, Extent::own_items}});
  const Step first = graph.take_step();
  EXPECT_THAT(names(first), ElementsAre("a", "b"));
  graph.finish(finished(first.stages[1]));
  EXPECT_THAT(names(graph.take_step()), IsEmpty());
  graph.finish(finished(first.stages[0]));
  const Step second = graph.take_step();
  ASSERT_THAT(names(second), ElementsAre("c"));
  const StageSpec& spec = second.stages[0];
  ASSERT_EQ(spec.inputs.size(), 2u);
  EXPECT_EQ(spec.inputs[0].artifact, a.id());
  EXPECT_EQ(spec.inputs[1].extent, Extent::own_items);
  EXPECT_EQ(spec.parameters, bytes_of(Numbers{3}));
  // Known before it runs, by what makes it.
  EXPECT_EQ(c.id(), artifact_id("scene", spec));
  EXPECT_THAT(names(graph.take_step()), IsEmpty());
}

TEST(Graph, AContinuationRunsOnceWhateverFinishesFirst) {
  std::vector<std::size_t> order = {0, 1, 2};
  do {
    Graph graph("scene");
    std::vector<Graph::Artifact> all;
    for (const char* name : {"a", "b", "c"}) all.push_back(graph.add(stage(name), Numbers{}));
    int both = 0, one = 0;
    std::uint32_t sum = 0;
    graph.when({all[0], all[2]}, [&, all] {
      ++both;
      sum = all[0].facts<Numbers>().value + all[2].facts<Numbers>().value;
      graph.add(stage("d"), Numbers{}, {{"in", all[1]}});
    });
    graph.when({all[1]}, [&] { ++one; });
    const Step step = graph.take_step();
    std::vector<std::string> asked;
    for (const std::size_t k : order) {
      graph.finish(finished(step.stages[k], static_cast<std::uint32_t>(k) + 1));
      for (const std::string& name : names(graph.take_step())) asked.push_back(name);
    }
    EXPECT_EQ(both, 1);
    EXPECT_EQ(one, 1);
    EXPECT_EQ(sum, 4u);
    EXPECT_THAT(asked, ElementsAre("d"));
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST(Graph, AContinuationOfWhatHasFinishedRunsBeforeTheNextStep) {
  Graph graph("scene");
  const auto a = graph.add(stage("a"), Numbers{});
  const Step step = graph.take_step();
  graph.finish(finished(step.stages[0]));
  int runs = 0;
  graph.when({a, graph.data(std::vector<int>{1})}, [&] {
    ++runs;
    // One that adds another, which is ready at once.
    graph.when({a}, [&] { ++runs; });
  });
  EXPECT_EQ(runs, 0);
  graph.take_step();
  EXPECT_EQ(runs, 2);
}

TEST(Graph, AnEventIsAnnouncedOnce) {
  Graph graph("scene");
  const auto event = graph.event();
  int runs = 0;
  graph.when({event}, [&] { ++runs; });
  graph.take_step();
  EXPECT_EQ(runs, 0);
  graph.announce(event);
  graph.take_step();
  EXPECT_EQ(runs, 1);
  EXPECT_THAT(message_of([&] { graph.announce(event); }), HasSubstr("twice"));
}

TEST(Graph, RefusesWhatWasNotAskedForOrCameBefore) {
  Graph graph("scene");
  graph.add(stage("a"), Numbers{});
  const Step step = graph.take_step();
  EXPECT_THAT(message_of([&] { graph.finish({"b", nullptr, 2, {}}); }), HasSubstr("stage b: was not asked for"));
  FinishedStage few = finished(step.stages[0]);
  few.record_count = 1;
  EXPECT_THAT(message_of([&] { graph.finish(few); }), HasSubstr("stage a: 1 records, expected 2"));
  graph.finish(finished(step.stages[0]));
  EXPECT_THAT(message_of([&] { graph.finish(finished(step.stages[0])); }), HasSubstr("stage a: has finished before"));
  EXPECT_THAT(message_of([&] { graph.add(stage("a"), Numbers{}); }), HasSubstr("stage a: was asked for twice"));
}

TEST(Graph, RefusesRecordsThatAreNotAsManyAsItems) {
  Graph graph("scene");
  StageSpec counted = stage("counted", 3, Placement::collect);
  counted.output.counted = true;
  counted.output.most_records = 2;
  const auto a = graph.add(counted, Numbers{});
  graph.add(stage("fixed", 3, Placement::collect), Numbers{});
  graph.take_step();
  const auto records = [](const char* name, std::size_t bytes) {
    return FinishedStage{name, std::make_shared<Bytes>(bytes), 0, {}};
  };
  for (const std::size_t bytes : {8u, 11u, 16u})
    EXPECT_THAT(message_of([&] { graph.finish(records("fixed", bytes)); }), HasSubstr("stage fixed: ")) << bytes;
  EXPECT_THAT(message_of([&] { graph.finish({"fixed", nullptr, 3, {}}); }), HasSubstr("without its records"));
  EXPECT_THAT(message_of([&] { graph.finish(records("counted", 28)); }), HasSubstr("7 records, expected at most 6"));
  graph.finish(records("counted", 20));
  EXPECT_EQ(a.record_count(), 5u);
  graph.finish(records("fixed", 12));
}

TEST(Graph, FactsAreOfTheirSize) {
  Graph graph("scene");
  const auto a = graph.add(stage("a"), Numbers{});
  const Step step = graph.take_step();
  EXPECT_THAT(message_of([&] { a.facts<Numbers>(); }), HasSubstr("stage a: was read before it finished"));
  graph.finish(finished(step.stages[0]));
  EXPECT_THAT(message_of([&] { a.facts<Numbers>(); }), HasSubstr("stage a: 0 bytes of facts, expected 4"));
  EXPECT_THAT(message_of([&] { a.records(); }), HasSubstr("stay with the workers"));
}

// Bytes that lie here travel with the first stage that reads them, and not again.
TEST(Graph, DataIsProvidedOnce) {
  Graph graph("scene");
  const std::vector<std::uint32_t> values = {1, 2, 3};
  const auto data = graph.data(values), same = graph.data(values);
  EXPECT_EQ(data.id(), same.id());
  EXPECT_EQ(data.id(), data_id(*bytes_of(values)));
  EXPECT_TRUE(graph.take_step().artifacts.empty());
  graph.add(stage("a"), Numbers{1}, {{"in", data}});
  const Step first = graph.take_step();
  ASSERT_TRUE(first.artifacts.contains(data.id()));
  EXPECT_EQ(*first.artifacts.at(data.id()), *bytes_of(values));
  graph.add(stage("b"), Numbers{2}, {{"in", same}});
  EXPECT_TRUE(graph.take_step().artifacts.empty());
}

TEST(Graph, ReleasedOnceNobodyMayReadIt) {
  Graph graph("scene");
  auto data = graph.data(std::vector<std::uint32_t>{7});
  auto a = graph.add(stage("a"), Numbers{1}, {{"in", data}});
  const ArtifactId data_of = data.id(), a_of = a.id();
  const Step first = graph.take_step();
  data = {};
  EXPECT_THAT(graph.take_step().released, IsEmpty()) << "a stage that reads it has not finished";
  graph.finish(finished(first.stages[0]));
  EXPECT_THAT(graph.take_step().released, ElementsAre(data_of));
  auto copy = a;
  graph.add(stage("b"), Numbers{2}, {{"in", a}});
  a = {};
  const Step second = graph.take_step();
  graph.finish(finished(second.stages[0]));
  // Nobody holds b's output; a's is held.
  EXPECT_THAT(graph.take_step().released, ElementsAre(artifact_id("scene", second.stages[0])));
  copy = {};
  EXPECT_THAT(graph.take_step().released, ElementsAre(a_of));
  EXPECT_THAT(graph.take_step().released, IsEmpty());
  // Asked for anew, it is provided anew, and released anew.
  graph.add(stage("c"), Numbers{3}, {{"in", graph.data(std::vector<std::uint32_t>{7})}});
  const Step third = graph.take_step();
  EXPECT_TRUE(third.artifacts.contains(data_of));
  graph.finish(finished(third.stages[0]));
  EXPECT_THAT(graph.take_step().released, UnorderedElementsAre(data_of, artifact_id("scene", third.stages[0])));
}

// A farm takes a step's stages before it forgets what the step releases: it must not forget what they made before.
TEST(Graph, WhatAStepAsksForAgainIsNotReleased) {
  Graph graph("scene");
  auto data = graph.data(std::vector<std::uint32_t>{7});
  auto a = graph.add(stage("a"), Numbers{1}, {{"in", data}});
  graph.finish(finished(graph.take_step().stages[0]));
  a = {};
  data = {};
  auto again = graph.add(stage("again"), Numbers{1}, {{"in", graph.data(std::vector<std::uint32_t>{7})}});
  const Step step = graph.take_step();
  ASSERT_THAT(names(step), ElementsAre("again"));
  EXPECT_THAT(step.released, IsEmpty());
  graph.finish(finished(step.stages[0]));
  const ArtifactId id = again.id();
  again = {};
  EXPECT_THAT(graph.take_step().released, UnorderedElementsAre(id, step.stages[0].inputs[0].artifact));
}

// A continuation holds what it captures until it has run.
TEST(Graph, AContinuationHoldsWhatItReads) {
  Graph graph("scene");
  const auto b = graph.add(stage("b"), Numbers{2});
  ArtifactId of_a;
  {
    const auto a = graph.add(stage("a"), Numbers{1});
    of_a = a.id();
    graph.when({b}, [&graph, a] { graph.add(stage("c"), Numbers{3}, {{"in", a}}); });
  }
  const Step step = graph.take_step();
  graph.finish(finished(step.stages[1]));
  EXPECT_THAT(graph.take_step().released, IsEmpty());
  graph.finish(finished(step.stages[0]));
  const Step next = graph.take_step();
  ASSERT_THAT(names(next), ElementsAre("c"));
  EXPECT_THAT(next.released, IsEmpty());
  graph.finish(finished(next.stages[0]));
  EXPECT_THAT(graph.take_step().released, testing::Contains(of_a));
}

TEST(Graph, RecordsComeOnceAndInOrder) {
  Graph graph("scene");
  const auto streamed = graph.add(stage("streamed", 5, Placement::stream), Numbers{}),
             collected = graph.add(stage("collected", 5, Placement::collect), Numbers{});
  std::map<std::string, std::vector<std::uint64_t>> seen;
  for (const auto& artifact : {streamed, collected})
    graph.on_records(artifact, [&seen, name = artifact.stage()](auto first, auto count, const Bytes&) {
      for (std::uint64_t i = first; i < first + count; ++i) seen[name].push_back(i);
    });
  bool told = false;
  graph.when({streamed, collected}, [&] { told = seen["streamed"].size() == 5 && seen["collected"].size() == 5; });
  const Step step = graph.take_step();
  graph.take("streamed", 0, 2, Bytes(8));
  EXPECT_THAT(message_of([&] { graph.take("streamed", 1, 2, Bytes(8)); }), HasSubstr("do not follow item 2"));
  EXPECT_THAT(message_of([&] { graph.take("streamed", 2, 4, Bytes(16)); }), HasSubstr("stage streamed"));
  EXPECT_THAT(message_of([&] { graph.take("streamed", 2, 3, Bytes(8)); }), HasSubstr("8 bytes"));
  EXPECT_THAT(message_of([&] { graph.finish({"streamed", nullptr, 0, {}}); }), HasSubstr("2 records, expected 5"));
  graph.take("streamed", 2, 3, Bytes(12));
  graph.finish({"streamed", nullptr, 0, {}});
  graph.finish(finished(step.stages[1]));
  EXPECT_THAT(seen["streamed"], ElementsAre(0, 1, 2, 3, 4));
  EXPECT_THAT(seen["collected"], ElementsAre(0, 1, 2, 3, 4));
  EXPECT_TRUE(told);
}

TEST(Graph, PreviewsOfWhatDoesNotRunAreNothing) {
  Graph graph("scene");
  const auto a = graph.add(stage("a", 4, Placement::collect), Numbers{});
  std::uint64_t drawn = 0;
  graph.on_preview(a, [&](auto, auto count, const Bytes&) { drawn += count; });
  graph.preview("a", 0, 1, Bytes(4));  // not handed out yet
  const Step step = graph.take_step();
  graph.preview("a", 1, 2, Bytes(8));
  EXPECT_EQ(drawn, 2u);
  graph.preview("a", 3, 2, Bytes(8));  // beyond its end
  graph.preview("a", 0, 2, Bytes(4));  // too few
  graph.preview("b", 0, 1, Bytes(4));
  graph.finish(finished(step.stages[0]));
  graph.preview("a", 0, 1, Bytes(4));
  EXPECT_EQ(drawn, 2u);
}

}  // namespace
}  // namespace gleaner::coordinator
