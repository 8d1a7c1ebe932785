// Stages of method `vpl` on workers' hosts: what they keep, and what they refuse.

#include "worker/stages/vpl/host_stages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <set>

#include "kernels/vpl_host_records.h"
#include "scene/model/error.h"
#include "tests/unit/vpl_frame.h"

namespace gleaner::coordinator {
namespace {

using testing::AllOf;
using testing::HasSubstr;

using Rows = std::map<std::string, std::vector<float>>;

template <typename Parameters>
worker::StageTask task_of(const char* kind, const Parameters& parameters, const Rows& inputs) {
  worker::StageTask task;
  task.kind = kind;
  task.parameters.resize(sizeof parameters);
  std::memcpy(task.parameters.data(), &parameters, sizeof parameters);
  for (const auto& [name, rows] : inputs)
    task.inputs[name] = worker::TaskInput(std::make_shared<const Bytes>(bytes_of_floats(rows)));
  return task;
}

template <typename Facts>
Facts facts_of(const worker::BatchResult& result) {
  Facts facts;
  EXPECT_EQ(result.facts.size(), sizeof facts);
  std::memcpy(&facts, result.facts.data(), sizeof facts);
  return facts;
}

template <typename Call>
std::string refusal(Call call) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::bad_input);
    return error.what();
  }
  return "accepted";
}

// VPLs strewn over a square metre, of very unequal flux.
std::vector<float> lights(std::size_t count) {
  std::vector<float> rows(count * VPL_WORDS, 0.0f);
  for (std::size_t i = 0; i < count; ++i) {
    float* row = &rows[i * VPL_WORDS];
    row[VPL_POSITION] = static_cast<float>(unit(3 * i));
    row[VPL_POSITION + 1] = static_cast<float>(unit(3 * i + 1));
    row[VPL_NORMAL + 2] = 1;
    for (unsigned k = 0; k < 3; ++k) row[VPL_FLUX + k] = static_cast<float>(std::exp(6 * unit(3 * i + 2)));
    row[VPL_COUNT] = 1;
  }
  return rows;
}

double flux(const std::vector<float>& rows) {
  double sum = 0;
  for (std::size_t at = 0; at < rows.size(); at += VPL_WORDS) sum += rows[at + VPL_FLUX];
  return sum;
}

TEST(VplResample, KeepsTheFluxAndTellsTheDensity) {
  const auto made = lights(4000);
  for (const std::uint32_t count : {500u, 4000u, 9000u}) {
    const auto result = worker::resample_lights(
        task_of("vpl_resample", kernels::VplResampleParameters{.paths = 100, .count = count}, {{"paths", made}}));
    const auto facts = facts_of<kernels::VplResampleFacts>(result);
    const auto rows = floats_of(result.records);
    EXPECT_EQ(facts.made, 4000u);
    EXPECT_EQ(facts.kept, rows.size() / VPL_WORDS);
    EXPECT_EQ(result.counts, std::vector<std::uint32_t>{static_cast<std::uint32_t>(facts.kept)});
    EXPECT_LE(facts.kept, count);
    EXPECT_NEAR(flux(rows), flux(made) / 100, 0.003 * flux(made) / 100) << count;
    // Bright ones lie no closer together than others: so many a square metre.
    EXPECT_NEAR(facts.density / static_cast<double>(facts.kept), 1, 0.35) << count;
  }
}

TEST(VplResample, PassesDrawOthers) {
  const auto made = lights(1000);
  std::set<std::vector<float>> drawn;
  for (std::uint32_t pass = 0; pass < 4; ++pass)
    drawn.insert(
        floats_of(worker::resample_lights(
                      task_of("vpl_resample", kernels::VplResampleParameters{.paths = 1, .count = 100, .pass = pass},
                              {{"paths", made}}))
                      .records));
  EXPECT_EQ(drawn.size(), 4u);
}

TEST(VplResample, RefusesFluxThatIsNotFinite) {
  auto made = lights(20);
  made[7 * VPL_WORDS + VPL_FLUX + 1] = std::numeric_limits<float>::infinity();
  EXPECT_THAT(refusal([&] {
                worker::resample_lights(task_of("vpl_resample", kernels::VplResampleParameters{.paths = 1, .count = 10},
                                                {{"paths", made}}));
              }),
              AllOf(HasSubstr("stage vpl_resample"), HasSubstr("paths[7]")));
}

// Clusters of lights: `members` of each, the first of them its representative.
std::vector<float> clusters_of(const std::vector<float>& rows, std::uint32_t clusters) {
  std::vector<float> records(rows.begin(), rows.begin() + clusters * VPL_WORDS);
  const std::size_t count = rows.size() / VPL_WORDS;
  for (std::uint32_t k = 0; k < clusters; ++k) records[k * VPL_WORDS + VPL_RADIUS] = 1;
  records.resize((clusters + (count + VPL_WORDS - 1) / VPL_WORDS) * VPL_WORDS);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t cluster = i % clusters;
    std::memcpy(&records[std::size_t{clusters} * VPL_WORDS + i], &cluster, 4);
  }
  return records;
}

TEST(VplOrder, DealsLightsOutToSlicesAndPutsMembersBehindThem) {
  const auto rows = lights(300);
  for (const std::uint32_t slices : {1u, 4u, 16u}) {
    const auto result =
        worker::order_lights(task_of("vpl_order", kernels::VplOrderParameters{.slices = slices, .clusters = 90},
                                     {{"lights", rows}, {"clusters", clusters_of(rows, 90)}}));
    const auto facts = facts_of<kernels::VplOrderFacts>(result);
    const auto table = floats_of(result.records);
    EXPECT_EQ(facts.clusters, 90u);
    EXPECT_EQ(facts.members, 300u);
    EXPECT_EQ(facts.rows % (32 * slices), 0u);
    ASSERT_EQ(table.size(), (facts.rows + facts.members) * VPL_WORDS);
    std::size_t seen = 0;
    const std::uint64_t width = facts.rows / slices;
    for (std::uint64_t row = 0; row < facts.rows; ++row) {
      const float* light = &table[row * VPL_WORDS];
      if (!(light[VPL_FLUX] > 0)) continue;
      ++seen;
      // Each slice has its share, from its start on.
      EXPECT_LT(row % width, (90 + slices - 1) / slices);
      std::uint32_t first = 0;
      std::memcpy(&first, light + VPL_FIRST, 4);
      ASSERT_GE(first, facts.rows);
      for (std::uint32_t k = 0; k < 3; ++k) {
        std::uint32_t back = 0;
        std::memcpy(&back, &table[(first + k) * VPL_WORDS + VPL_FIRST], 4);
        EXPECT_EQ(back, row);
      }
    }
    EXPECT_EQ(seen, 90u);
  }
}

TEST(VplOrder, RefusesClustersThatAreNone) {
  const auto rows = lights(300);
  const auto order = [&](const std::vector<float>& clusters) {
    return refusal([&] {
      worker::order_lights(task_of("vpl_order", kernels::VplOrderParameters{.slices = 4, .clusters = 90},
                                   {{"lights", rows}, {"clusters", clusters}}));
    });
  };
  const auto good = clusters_of(rows, 90);
  EXPECT_EQ(order(good), "accepted");
  // What a broken worker sends: nothing but zeros.
  EXPECT_THAT(order(std::vector<float>(good.size(), 0.0f)), AllOf(HasSubstr("vpl_order"), HasSubstr("light 0")));
  EXPECT_THAT(order(std::vector<float>(90 * VPL_WORDS, 0.0f)), HasSubstr("90 clusters of 300 lights"));
  auto beyond = good;
  const std::uint32_t cluster = 90;
  std::memcpy(&beyond[90 * VPL_WORDS + 17], &cluster, 4);
  EXPECT_THAT(order(beyond), HasSubstr("light 17"));
  auto nowhere = good;
  nowhere[5 * VPL_WORDS + VPL_POSITION] = std::nanf("");
  EXPECT_THAT(order(nowhere), HasSubstr("light 5"));
}

TEST(VplSamplePoints, TakesOneOfEachPart) {
  std::vector<float> points(1000 * POINT_WORDS, 0.0f);
  for (std::size_t i = 0; i < 1000; ++i) points[i * POINT_WORDS] = static_cast<float>(i);
  const auto rows =
      floats_of(worker::sample_points(task_of("vpl_sample_points", kernels::VplSamplePointsParameters{.count = 100},
                                              {{"points", points}}))
                    .records);
  ASSERT_EQ(rows.size(), 100u * POINT_WORDS);
  for (std::size_t k = 0; k < 100; ++k) {
    EXPECT_GE(rows[k * POINT_WORDS], 10.0f * static_cast<float>(k));
    EXPECT_LT(rows[k * POINT_WORDS], 10.0f * static_cast<float>(k + 1));
  }
}

TEST(VplHostStages, RefuseMalformedTasks) {
  const auto rows = lights(4);
  const Bytes nothing;
  for (const auto& [kind, program] : std::map<std::string, worker::BatchResult (*)(const worker::StageTask&)>{
           {"vpl_resample", worker::resample_lights},
           {"vpl_order", worker::order_lights},
           {"vpl_sample_points", worker::sample_points},
           {"vpl_merge_points", worker::merge_points},
           {"vpl_skipped", worker::count_skipped_queries},
           {"vpl_pilot", worker::measure_pilot},
           {"vpl_pilot_points", worker::choose_pilot_points},
           {"vpl_pilot_lights", worker::choose_pilot_lights}}) {
    worker::StageTask task;
    task.kind = kind;
    EXPECT_THAT(refusal([&] { program(task); }), AllOf(HasSubstr("stage " + kind), HasSubstr("parameters"))) << kind;
    task.parameters.resize(kind == "vpl_resample" || kind == "vpl_pilot" ? 32 : 16);
    const std::uint32_t some = 2;
    std::memcpy(task.parameters.data(), &some, 4);
    if (kind == "vpl_resample") std::memcpy(task.parameters.data() + 4, &some, 4);
    EXPECT_THAT(refusal([&] { program(task); }), AllOf(HasSubstr("stage " + kind), HasSubstr("input"))) << kind;
  }
}

}  // namespace
}  // namespace gleaner::coordinator
