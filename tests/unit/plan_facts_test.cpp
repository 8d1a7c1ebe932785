// What workers say of stages that are done (facts) is checked before a plan computes with it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <limits>
#include <string>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/methods.h"
#include "kernels/links_records.h"
#include "kernels/photon_records.h"
#include "kernels/splat_records.h"
#include "kernels/vpl_host_records.h"
#include "scene/library/library.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const double kNan = std::numeric_limits<double>::quiet_NaN();

FrameSettings frame(const std::string& method, std::map<std::string, std::string> set = {}) {
  FrameSettings settings;
  settings.method = method;
  settings.width = settings.height = 32;
  settings.spp = 16;
  settings.set = std::move(set);
  return settings;
}

// What a stage of a kind says once it is done.
struct Said {
  std::uint64_t records = 0;
  Bytes facts;
};
template <typename Facts>
Said said(std::uint64_t records, const Facts& facts) {
  return {records, bytes_of(facts)};
}

// What the plan says of a frame of cornell-glass whose stages are done at once, those of these kinds with these words.
std::string answer(const FrameSettings& settings, const std::map<std::string, Said>& words) {
  const auto plan = make_plan(settings, summarize(scene::make_scene("cornell-glass")));
  Step step = plan->next(nullptr);
  std::deque<StageSpec> waiting(step.stages.begin(), step.stages.end());
  std::size_t heard = 0;
  while (!waiting.empty()) {
    const StageSpec stage = waiting.front();
    waiting.pop_front();
    if (stage.output.placement != Placement::retain) continue;  // nothing else waits for these
    FinishedStage finished{stage.name, nullptr, stage.items, {}};
    if (const auto known = words.find(stage.kind); known != words.end()) {
      ++heard;
      finished.record_count = known->second.records;
      finished.facts = known->second.facts;
    }
    try {
      step = plan->next(&finished);
    } catch (const Error& error) {
      const std::string what = error.what();
      // Of a later stage, of which this test has nothing to say.
      return heard >= words.size() && what.find(": 0 bytes of facts") != std::string::npos ? "accepted" : what;
    }
    waiting.insert(waiting.end(), step.stages.begin(), step.stages.end());
  }
  return heard >= words.size() ? "accepted" : "not all of these stages were asked for";
}

TEST(PlanFacts, OfVirtualPointLights) {
  const FrameSettings settings =
      frame("vpl", {{"vpl.count", "100"}, {"vpl.clusters", "10"}, {"vpl.point_clusters", "10"}});
  kernels::VplResampleFacts facts{.made = 400, .kept = 100, .density = 3};
  EXPECT_EQ(answer(settings, {{"vpl_resample", said(100, facts)}}), "accepted");
  EXPECT_THAT(answer(settings, {{"vpl_resample", said(7, facts)}}),
              AllOf(HasSubstr("stage vpl.resample"), HasSubstr("100 VPLs")));
  facts.density = kNan;
  EXPECT_THAT(answer(settings, {{"vpl_resample", said(100, facts)}}), HasSubstr("facts that cannot be"));
}

TEST(PlanFacts, OfMergedPoints) {
  FrameSettings settings = frame("vpl");
  settings.trajectory.resize(2);
  settings.trajectory[1].origin[0] = 1;
  const Said lights = said(100, kernels::VplResampleFacts{.made = 400, .kept = 100, .density = 3});
  kernels::VplMergePointsFacts facts{.points = 50, .most_of_a_camera = 40};
  EXPECT_EQ(answer(settings, {{"vpl_resample", lights}, {"vpl_merge_points", said(50, facts)}}), "accepted");
  EXPECT_THAT(answer(settings, {{"vpl_resample", lights}, {"vpl_merge_points", said(49, facts)}}),
              HasSubstr("50 points"));
  facts.most_of_a_camera = 51;
  EXPECT_THAT(answer(settings, {{"vpl_resample", lights}, {"vpl_merge_points", said(50, facts)}}),
              HasSubstr("51 of a camera"));
  facts = {.points = std::numeric_limits<std::uint64_t>::max(), .most_of_a_camera = 1};
  EXPECT_THAT(answer(settings, {{"vpl_resample", lights}, {"vpl_merge_points", said(50, facts)}}),
              HasSubstr("facts that cannot be"));
}

TEST(PlanFacts, OfCacheRecords) {
  // Where rays are set they do not wait for paths, which have no records here.
  const std::map<std::string, std::string> rays = {{"splat.gather_rays", "64"}};
  kernels::SplatSelectFacts facts{.points = 900, .records = 20, .rounds = 3, .probes = 0, .accuracy = 0.15};
  EXPECT_EQ(answer(frame("splat", rays), {{"splat_select", said(20, facts)}}), "accepted");
  EXPECT_THAT(answer(frame("splat", rays), {{"splat_select", said(19, facts)}}), HasSubstr("20 records"));
  for (const double accuracy : {kNan, -1.0, std::numeric_limits<double>::infinity()}) {
    facts.accuracy = accuracy;
    EXPECT_THAT(answer(frame("splat", rays), {{"splat_select", said(20, facts)}}), HasSubstr("facts that cannot be"))
        << accuracy;
  }
  // Each camera begins with the places of those before it.
  FrameSettings settings = frame("splat", rays);
  settings.trajectory.resize(2);
  const Said first = said(20, kernels::SplatSelectFacts{.points = 900, .records = 20, .accuracy = 0.15});
  EXPECT_THAT(answer(settings, {{"splat_extend", first}}), HasSubstr("20 records, 0 of them given"));
  settings.trajectory.resize(1);
  const auto then = [](std::uint64_t given) {
    return said(25, kernels::SplatSelectFacts{.points = 900, .records = 25, .given = given, .accuracy = 0.15});
  };
  EXPECT_EQ(answer(settings, {{"splat_extend", first}, {"splat_select", then(20)}}), "accepted");
  EXPECT_THAT(answer(settings, {{"splat_extend", first}, {"splat_select", then(19)}}), HasSubstr("19 of them given"));
}

TEST(PlanFacts, OfPhotonMaps) {
  kernels::PhotonMapFacts facts{.photons = 9, .nodes = 3, .power = {1, 1, 1}, .radius = 0.1};
  EXPECT_EQ(answer(frame("photon"), {{"photon_map", said(12, facts)}}), "accepted");
  for (const double radius : {kNan, -1.0, std::numeric_limits<double>::infinity()}) {
    facts.radius = radius;
    EXPECT_THAT(answer(frame("photon"), {{"photon_map", said(12, facts)}}), HasSubstr("facts that cannot be"))
        << radius;
  }
  facts.radius = 0.1;
  facts.power[1] = kNan;
  EXPECT_THAT(answer(frame("photon"), {{"photon_map", said(12, facts)}}), HasSubstr("facts that cannot be"));
}

TEST(PlanFacts, OfEmissionGuides) {
  const FrameSettings settings = frame("photon", {{"photon.guide", "1000"}});
  kernels::PhotonGuideFacts facts{.useful = 200, .cells = 3, .most = 2};
  EXPECT_EQ(answer(settings, {{"photon_guide", said(5, facts)}}), "accepted");
  facts.useful = 1001;
  EXPECT_THAT(answer(settings, {{"photon_guide", said(5, facts)}}), HasSubstr("1001 useful paths"));
  facts.useful = 200;
  facts.most = kNan;
  EXPECT_THAT(answer(settings, {{"photon_guide", said(5, facts)}}), HasSubstr("facts that cannot be"));
}

// Each camera begins with the sample points of those before it.
TEST(PlanFacts, OfShadingClusters) {
  FrameSettings settings = frame("photon", {{"photon.cut", "0"}, {"photon.caustics", "0"}});
  settings.trajectory.resize(1);
  const Said map = said(12, kernels::PhotonMapFacts{.photons = 9, .nodes = 3, .power = {1, 1, 1}, .radius = 0.1});
  const auto clusters = [](std::uint64_t places, std::uint64_t given) {
    return said(20, kernels::PhotonClusterFacts{.points = 90, .places = places, .given = given});
  };
  const auto kinds = [&](const Said& first, const Said& then) {
    return answer(settings, {{"photon_map", map}, {"photon_extend", first}, {"photon_cluster", then}});
  };
  EXPECT_EQ(kinds(clusters(20, 0), clusters(20, 20)), "accepted");
  EXPECT_THAT(kinds(clusters(19, 0), clusters(20, 20)), HasSubstr("19 places"));
  EXPECT_THAT(kinds(clusters(20, 3), clusters(20, 20)), HasSubstr("3 of them given"));
  EXPECT_THAT(kinds(clusters(20, 0), clusters(20, 0)), HasSubstr("0 of them given"));
}

TEST(PlanFacts, OfTheMeshOfLinks) {
  kernels::LinksMeshFacts facts{};
  facts.vertices = 12;
  for (const char* refine : {"0", "1"}) {
    EXPECT_EQ(answer(frame("links", {{"links.refine", refine}}), {{"links_mesh", said(40, facts)}}), "accepted");
    facts.vertices = 0x80000001u;
    facts.divided = 1;
    EXPECT_THAT(answer(frame("links", {{"links.refine", refine}}), {{"links_mesh", said(40, facts)}}),
                HasSubstr("2147483649 vertices"));
    facts = {};
    facts.vertices = 12;
  }
}

}  // namespace
}  // namespace gleaner::coordinator
