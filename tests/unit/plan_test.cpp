#include "coordinator/plan/plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <set>

#include "coordinator/plan/allocation.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/radiometry/statistics.h"
#include "tests/unit/plan_frame.h"

namespace gleaner::coordinator {
namespace {

using test::Sample;
using test::student_critical;
using test::student_p;

FrameSettings settings(std::uint32_t width, std::uint32_t height, std::uint32_t spp, std::uint64_t seed = 1) {
  FrameSettings s;
  s.width = width;
  s.height = height;
  s.spp = spp;
  s.seed = seed;
  return s;
}

// Half of the picture nearly noiseless, the rest of heavy tails: now and then a sample of many times the mean.
Truth uneven(std::uint32_t pixels) {
  Truth truth;
  for (std::uint32_t i = 0; i < pixels; ++i) truth.mean.push_back(0.3 + unit(i ^ 0xabcdef));
  auto sample = [mean = truth.mean, pixels](std::uint32_t pixel, double u) {
    if (pixel < pixels / 2) return mean[pixel] * (0.95 + 0.1 * u);
    // A power law u^(-1/4) - of mean 4/3 and variance 2/9 - beside rare bursts of 30 times the mean.
    if (u < 0.005) return mean[pixel] * 30;
    const double rest = (u - 0.005) / 0.995;
    return mean[pixel] * (1 - 0.005 * 30) / 0.995 * 0.75 * std::pow(rest, -0.25);
  };
  truth.sample = sample;
  return truth;
}

// Exponential noise everywhere, of a pixel's own strength.
Truth exponential(std::uint32_t pixels) {
  Truth truth;
  for (std::uint32_t i = 0; i < pixels; ++i) truth.mean.push_back(0.5 + unit(i ^ 0x1234));
  truth.sample = [mean = truth.mean](std::uint32_t pixel, double u) {
    const double strength = pixel % 7 == 0 ? 1.0 : 0.3;
    return mean[pixel] * (1 - strength + strength * -std::log(u));
  };
  return truth;
}

double squared_error(const Film& film, const Truth& truth) {
  double sum = 0;
  const char* names[] = {"R", "G", "B"};
  for (int k = 0; k < 3; ++k) {
    const auto& values = film.find(names[k])->values;
    for (std::size_t i = 0; i < values.size(); ++i) sum += std::pow(values[i] - truth.mean[i] * Truth::tint[k], 2);
  }
  return sum / (3 * static_cast<double>(truth.mean.size()));
}

TEST(PathPlan, SpendsExactlyWhatItMay) {
  for (const auto& [width, height] : {std::pair{1u, 1u}, {7u, 5u}, {16u, 9u}, {1u, 33u}})
    for (std::uint32_t spp = 1; spp <= 70; ++spp) {
      const Truth truth = uneven(width * height);
      PlannedFrame frame(settings(width, height, spp), truth);
      frame.run();
      const std::string what =
          std::to_string(width) + "x" + std::to_string(height) + ", " + std::to_string(spp) + " spp";
      ASSERT_EQ(frame.samples(), std::uint64_t{width} * height * spp) << what;
      const Film film = frame.plan().film();
      double told = 0;
      for (const float n : film.find("samples.Y")->values) {
        told += n;
        ASSERT_GE(n, 1) << what;
      }
      ASSERT_EQ(told, static_cast<double>(frame.samples())) << what;

      // Chunks of a pixel are handed out once each, from 0 on.
      std::vector<std::set<std::uint32_t>> chunks(std::size_t{width} * height);
      std::size_t items = 0;
      std::set<std::string> names;
      for (const StageRun& run : frame.runs()) {
        kernels::PathParameters p;
        ASSERT_EQ(run.spec.parameters.size(), sizeof p);
        std::memcpy(&p, run.spec.parameters.data(), sizeof p);
        ASSERT_TRUE(names.insert(run.spec.name).second) << what;
        ASSERT_EQ(run.spec.tile, std::max(1u, 16 / p.samples_per_item)) << what;
        ASSERT_EQ(std::uint64_t{p.items_high} << 32 | p.items_low, run.spec.items) << what;
        ASSERT_GE(p.last_item_samples, 1u) << what;
        ASSERT_LE(p.last_item_samples, p.samples_per_item) << what;
        ASSERT_EQ(p.features, run.spec.name == "path.0" ? 1u : 0u) << what;
        ASSERT_EQ(run.spec.output.record_bytes,
                  p.features ? sizeof(kernels::PathFeatureRecord) : sizeof(kernels::PathRecord));
        for (const auto& item : run.items) ASSERT_TRUE(chunks[item.pixel].insert(item.chunk).second) << what;
        items += run.items.size();
      }
      std::size_t counted = 0;
      for (const auto& one : chunks) {
        counted += one.size();
        ASSERT_EQ(*one.rbegin() + 1, one.size()) << what << ": a chunk was passed over";
      }
      ASSERT_EQ(counted, items);
    }
}

TEST(PathPlan, IsTheSameEveryTime) {
  const Truth truth = uneven(60);
  std::vector<float> first;
  for (int k = 0; k < 2; ++k) {
    PlannedFrame frame(settings(10, 6, 40), truth);
    frame.run();
    const auto values = frame.plan().film().find("G")->values;
    if (first.empty()) first = values;
    EXPECT_EQ(values, first);
  }
}

TEST(PathPlan, LayersSumToThePicture) {
  const Truth truth = uneven(96);
  PlannedFrame frame(settings(12, 8, 37), truth);
  frame.run();
  const Film film = frame.plan().film();
  for (const char* channel : {"R", "G", "B"})
    for (std::size_t i = 0; i < 96; ++i) {
      const float direct = film.find(std::string("direct.") + channel)->values[i];
      const float indirect = film.find(std::string("indirect.") + channel)->values[i];
      EXPECT_EQ(film.find(channel)->values[i], direct + indirect);
      EXPECT_NEAR(direct, 3 * indirect, 1e-4 * direct);
    }
}

// Where the counts follow the noise seen, a pixel that began dark must not stay dark: no bias in any pixel or in the
// mean, however heavy the tails.
TEST(PathPlan, AdaptingDoesNotBias) {
  constexpr std::uint32_t width = 10, height = 8, pixels = width * height;
  const Truth truth = uneven(pixels);
  Sample mean;
  std::vector<Sample> each(pixels);
  for (std::uint64_t run = 0; run < 1000; ++run) {
    PlannedFrame frame(settings(width, height, 32, run), truth);
    frame.run();
    const Film film = frame.plan().film();
    double sum = 0;
    for (std::uint32_t i = 0; i < pixels; ++i) {
      const double off = film.find("R")->values[i] - truth.mean[i];
      each[i].add(off);
      sum += off / pixels;
    }
    mean.add(sum);
  }
  double worst = 0;
  for (const Sample& one : each) worst = std::max(worst, std::abs(one.mean) / one.standard_error());
  std::printf("  bias of the mean %.5f +- %.5f (%.2f sigma); worst pixel %.2f sigma\n", mean.mean,
              mean.standard_error(), mean.mean / mean.standard_error(), worst);
  EXPECT_LT(std::abs(mean.mean), student_critical(1e-3, 999) * mean.standard_error());
  EXPECT_LT(worst, student_critical(test::sidak(1e-3, pixels), 999));
}

// Half of the picture needs next to nothing: the rest may have half as much again, beyond the first two chunks. (Noise
// that two chunks seldom show, as the bursts above, or that the neighbours do not share, tells nobody where to go.)
TEST(PathPlan, AdaptingPays) {
  constexpr std::uint32_t width = 20, height = 16, pixels = width * height;
  Truth truth;
  for (std::uint32_t i = 0; i < pixels; ++i) truth.mean.push_back(0.5 + unit(i ^ 0x1234));
  truth.sample = [mean = truth.mean](std::uint32_t pixel, double u) {
    return mean[pixel] * (pixel < pixels / 2 ? 0.95 + 0.1 * u : 0.5 - 0.5 * std::log(u));
  };
  Sample adaptive;
  for (std::uint64_t run = 0; run < 100; ++run) {
    PlannedFrame frame(settings(width, height, 32, run), truth);
    frame.run();
    adaptive.add(squared_error(frame.plan().film(), truth));
  }
  // Evenly spent, a sample's variance over 32: from the distribution itself.
  double evenly = 0;
  for (std::uint32_t i = 0; i < pixels; ++i) {
    double square = 0;
    constexpr int steps = 20000;
    for (int s = 0; s < steps; ++s) square += std::pow(truth.sample(i, (s + 0.5) / steps) - truth.mean[i], 2) / steps;
    for (const double tint : Truth::tint) evenly += square * tint * tint / 32 / (3.0 * pixels);
  }
  std::printf("  squared error %.5f +- %.5f, evenly %.5f\n", adaptive.mean, adaptive.standard_error(), evenly);
  EXPECT_LT(adaptive.mean, 0.85 * evenly);
}

// The variance layer is that of the pixel's mean: over many frames it is the squared error that they have.
TEST(PathPlan, VarianceIsToldTruly) {
  constexpr std::uint32_t width = 12, height = 10;
  const Truth truth = exponential(width * height);
  Sample told, seen;
  for (std::uint64_t run = 0; run < 4000; ++run) {
    PlannedFrame frame(settings(width, height, 64, run), truth);
    frame.run();
    const Film film = frame.plan().film();
    double sum = 0;
    for (const char* channel : {"variance.R", "variance.G", "variance.B"})
      for (const float v : film.find(channel)->values) {
        ASSERT_GE(v, 0);
        sum += v / (3.0 * width * height);
      }
    told.add(sum);
    seen.add(squared_error(film, truth));
  }
  const double ratio = told.mean / seen.mean;
  const double error = ratio * std::hypot(told.standard_error() / told.mean, seen.standard_error() / seen.mean);
  std::printf("  variance told %.3e, squared error seen %.3e: ratio %.4f +- %.4f\n", told.mean, seen.mean, ratio,
              error);
  EXPECT_NEAR(ratio, 1, 4 * error);
  EXPECT_LT(error, 0.01) << "too noisy to prove anything";
}

// The error that was promised holds in at least 95 % of the frames, though the plan looks after every stage and ends at
// the first that looks good enough.
TEST(PathPlan, TargetErrorHolds) {
  constexpr std::uint32_t width = 24, height = 16, runs = 400;
  const Truth truth = exponential(width * height);
  double mean = 0;
  for (const double m : truth.mean) mean += m * (1 + 0.5 + 0.25) / (3.0 * width * height);
  for (const double target : {0.08, 0.03}) {
    int held = 0;
    Sample error, samples;
    for (std::uint64_t run = 0; run < runs; ++run) {
      FrameSettings s = settings(width, height, 64, run);
      s.target_error = target;
      PlannedFrame frame(s, truth);
      frame.run();
      const double e = std::sqrt(squared_error(frame.plan().film(), truth)) / mean;
      held += e <= target;
      error.add(e);
      samples.add(static_cast<double>(frame.samples()) / (width * height));
    }
    std::printf("  target %.3f: held in %.1f %%, mean error %.4f, %.1f samples a pixel\n", target, 100.0 * held / runs,
                error.mean, samples.mean);
    EXPECT_GE(held, 0.95 * runs) << "target " << target;
    // Not by doing many times too much.
    EXPECT_GT(error.mean, 0.7 * target);
  }
}

TEST(PathPlan, TargetErrorOfABlackPictureEnds) {
  Truth truth;
  truth.mean.assign(12, 0.0);
  truth.sample = [](std::uint32_t, double) { return 0.0; };
  FrameSettings s = settings(4, 3, 64);
  s.target_error = 0.01;
  PlannedFrame frame(s, truth);
  frame.run();
  EXPECT_EQ(frame.runs().size(), 1u);
}

TEST(PathPlan, RefusesWhatItDidNotAskFor) {
  const Truth truth = uneven(12);
  PlannedFrame frame(settings(4, 3, 16), truth);
  const Step step = frame.plan().next(nullptr);
  FinishedStage good = frame.finish(step);
  FinishedStage other = good, empty = good, shorter = good;
  other.name = "path.7";
  empty.records = nullptr;
  shorter.records = std::make_shared<Bytes>(good.records->size() - 1);
  for (const auto* bad : {&other, &empty, &shorter}) EXPECT_THROW(frame.plan().next(bad), Error);
  EXPECT_FALSE(frame.next(&good).done);
}

// A stage's list of items is large: the next one is made when the farm has dropped it.
TEST(PathPlan, MakesAListWhenTheOneBeforeIsReleased) {
  const Truth truth = uneven(40);
  PlannedFrame frame(settings(8, 5, 64), truth);
  FinishedStage finished = frame.finish(frame.next(nullptr));
  const Step second = frame.next(&finished);
  ASSERT_EQ(second.artifacts.size(), 1u);
  const std::weak_ptr<const Bytes> list = second.artifacts.begin()->second;
  finished = frame.finish(second);
  Step third = frame.plan().next(&finished);
  ASSERT_TRUE(third.again);
  EXPECT_FALSE(third.done);
  EXPECT_THAT(third.released, ::testing::Contains(second.artifacts.begin()->first));
  EXPECT_TRUE(third.stages.empty() && third.artifacts.empty());
  EXPECT_EQ(list.use_count(), 1);  // `second` alone has it
  third = frame.plan().next(nullptr);
  EXPECT_FALSE(third.again);
  EXPECT_EQ(third.artifacts.size(), 1u);
}

// The live preview: batches in any order, and the whole once all have come.
TEST(PathPlan, PreviewBecomesThePicture) {
  const Truth truth = uneven(40);
  PlannedFrame frame(settings(8, 5, 3), truth);
  Step step = frame.next(nullptr);
  while (!step.done) {
    const FinishedStage finished = frame.finish(step);
    const StageSpec& spec = frame.runs().back().spec;
    for (const std::uint64_t first : {spec.items / 2, std::uint64_t{0}}) {
      const std::uint64_t end = first ? spec.items : spec.items / 2;
      frame.plan().preview(
          spec.name, first, end - first,
          Bytes(finished.records->begin() + static_cast<std::ptrdiff_t>(first * spec.output.record_bytes),
                finished.records->begin() + static_cast<std::ptrdiff_t>(end * spec.output.record_bytes)));
    }
    step = frame.next(&finished);
  }
  const Film film = frame.plan().film(), preview = frame.plan().preview_film();
  for (std::size_t i = 0; i < 40; ++i)
    EXPECT_NEAR(preview.find("R")->values[i], film.find("R")->values[i], 1e-5 * film.find("R")->values[i]);
  // What no stage is called, or does not fit, changes nothing.
  frame.plan().preview("path.9", 0, 1, Bytes(24));
  frame.plan().preview("path.0", 0, 1000, Bytes(24));
  EXPECT_EQ(frame.plan().preview_film().find("R")->values, preview.find("R")->values);
}

TEST(MakePlan, RefusesMalformedSettings) {
  const auto refused = [](const std::function<void(FrameSettings&)>& change, const std::string& word) {
    FrameSettings s = settings(4, 4, 4);
    change(s);
    try {
      make_plan(s, {});
      ADD_FAILURE() << "accepted: " << word;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::usage) << word;
      EXPECT_THAT(error.what(), ::testing::HasSubstr(word));
    }
  };
  refused([](FrameSettings& s) { s.width = 0; }, "--size");
  refused([](FrameSettings& s) { s.width = s.height = 1u << 15; }, "--size");
  refused([](FrameSettings& s) { s.spp = 0; }, "--spp");
  refused([](FrameSettings& s) { s.spp = (1u << 20) + 1; }, "--spp");
  refused([](FrameSettings& s) { s.target_error = -1; }, "--target-error");
  refused([](FrameSettings& s) { s.target_error = std::nan(""); }, "--target-error");
  refused([](FrameSettings& s) { s.method = "magic"; }, "--method");
  refused([](FrameSettings& s) { s.set["vpl.size"] = "3"; }, "vpl.size");
  for (const char* value : {"", "x", "-1", "1.5", "3 ", "99999999999"})
    refused([&](FrameSettings& s) { s.set["depth"] = value; }, "depth");
}

TEST(MakePlan, TellsTheStagesBeforehand) {
  FrameSettings s = settings(20, 10, 64);
  s.set["depth"] = "3";
  const auto plan = make_plan(s, summarize(scene::make_scene("cornell-box")));
  const auto lines = plan->outline();
  ASSERT_EQ(lines.size(), 2u);
  // The predicted first stage is the one that comes.
  const Step step = plan->next(nullptr);
  EXPECT_THAT(lines[0],
              ::testing::HasSubstr(step.stages[0].name + ": " + std::to_string(step.stages[0].items) + " items"));
  kernels::PathParameters p;
  std::memcpy(&p, step.stages[0].parameters.data(), sizeof p);
  EXPECT_EQ(p.depth, 3u);
  const std::uint64_t rest = 20 * 10 * 64 - step.stages[0].items * p.samples_per_item;
  EXPECT_THAT(lines[1], ::testing::HasSubstr(std::to_string(rest) + " samples"));
  const auto json = nlohmann::json::parse(plan->parameters_json());
  EXPECT_EQ(json["spp"], 64);
  EXPECT_EQ(json["depth"], 3);
  std::set<std::string> left_out;
  for (const Skip& skip : plan->skips()) {
    EXPECT_FALSE(skip.why.empty());
    left_out.insert(skip.what);
  }
  // A Lambert box with a lamp.
  EXPECT_TRUE(left_out.contains("punctual lights") && left_out.contains("environment light") &&
              left_out.contains("transmission") && left_out.contains("specular lobe"));
  EXPECT_FALSE(left_out.contains("light samples on triangles"));
}

TEST(Allocation, IsExactAndNearlyBest) {
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const std::size_t n = 1 + mixed(seed) % 40;
    std::vector<float> variance(n);
    std::vector<std::uint32_t> chunks(n);
    for (std::size_t i = 0; i < n; ++i) {
      const double u = unit(seed * 1000 + i);
      variance[i] = u < 0.2 ? 0.0f : static_cast<float>(std::exp(8 * u - 4));
      chunks[i] = 1 + static_cast<std::uint32_t>(mixed(seed * 77 + i) % 5);
    }
    const std::uint64_t extra = mixed(seed + 5) % 500;
    const auto more = allocate_chunks(variance, chunks, extra);
    EXPECT_EQ(allocate_chunks(variance, chunks, extra), more);
    std::uint64_t given = 0;
    for (const std::uint32_t m : more) given += m;
    ASSERT_EQ(given, extra) << "seed " << seed;

    // The best there is: one chunk after the other to where it takes most off (variance / chunks is convex).
    const auto error = [&](const std::vector<std::uint32_t>& add) {
      double sum = 0;
      for (std::size_t i = 0; i < n; ++i) sum += variance[i] / (chunks[i] + double(add[i]));
      return sum;
    };
    std::vector<std::uint32_t> best(n);
    for (std::uint64_t k = 0; k < extra; ++k) {
      std::size_t at = 0;
      double most = -1;
      for (std::size_t i = 0; i < n; ++i) {
        const double c = chunks[i] + double(best[i]), gain = variance[i] / c - variance[i] / (c + 1);
        if (gain > most) most = gain, at = i;
      }
      ++best[at];
    }
    EXPECT_LE(error(more), error(best) * 1.002) << "seed " << seed << ", " << n << " pixels, " << extra << " chunks";
  }
}

// Emission of 1e25 is legal, and its square no float.
TEST(PathPlan, VeryBrightLightIsNoTrap) {
  for (const double brightness : {1e-12, 1.0, 1e19, 1e25, 1e34}) {
    Truth truth;
    truth.mean.assign(48, brightness);
    truth.sample = [brightness](std::uint32_t pixel, double u) { return brightness * (pixel % 5 ? 1.0 : 2 * u); };
    PlannedFrame frame(settings(8, 6, 24), truth);
    frame.run();
    EXPECT_EQ(frame.samples(), 48u * 24) << brightness;
    const Film film = frame.plan().film();
    for (const float value : film.find("R")->values) {
      EXPECT_GT(value, 0.3 * brightness);
      EXPECT_LT(value, 2 * brightness);
    }
  }
}

TEST(PathPlan, RefusesRecordsThatAreNotFinite) {
  const Truth truth = uneven(12);
  for (const float bad : {std::numeric_limits<float>::infinity(), std::nanf("")}) {
    PlannedFrame frame(settings(4, 3, 16), truth);
    const FinishedStage good = frame.finish(frame.plan().next(nullptr));
    auto records = std::make_shared<Bytes>(*good.records);
    std::memcpy(records->data() + 7 * sizeof(kernels::PathFeatureRecord) + 4, &bad, sizeof bad);
    const FinishedStage finished{good.name, records, 0, {}};
    try {
      frame.plan().next(&finished);
      ADD_FAILURE() << "accepted " << bad;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), ::testing::HasSubstr("stage path.0, item 7: "));
    }
  }
}

// A chunk's sums: direct and indirect light. A function of its own: GCC 12 drops the rounding to float where it is
// inlined into the loop that adds the values up.
[[gnu::noinline]] std::array<float, 6> chunk_sums(std::uint32_t pixel, std::uint32_t chunk, std::uint32_t samples) {
  std::array<float, 6> sums;
  for (std::uint32_t k = 0; k < 3; ++k) {
    sums[k] = static_cast<float>(samples * unit(1000 * pixel + 10 * chunk + k));
    sums[3 + k] = static_cast<float>(pixel * unit(7777 + 1000 * pixel + 10 * chunk + k));
  }
  return sums;
}

// What is known of a chunk's noise is Welford's sum over the whole chunks' means, and short chunks count as chunks.
TEST(Accumulator, SumsAreThoseOfTheTextbook) {
  const std::uint32_t width = 5, height = 3, samples = 8;
  Accumulator film(width, height);
  std::vector<std::vector<std::array<double, 3>>> means(width * height);
  std::vector<std::array<double, 6>> sums(width * height);
  for (std::uint32_t chunk = 0; chunk < 7; ++chunk)
    for (std::uint32_t pixel = 0; pixel < width * height; ++pixel) {
      if (chunk > 2 + pixel % 5) continue;
      const std::array<float, 6> added = chunk_sums(pixel, chunk, samples);
      std::array<double, 3> mean{};
      for (std::uint32_t k = 0; k < 3; ++k) mean[k] = (double{added[k]} + added[3 + k]) / samples;
      for (std::uint32_t k = 0; k < 6; ++k) sums[pixel][k] += added[k];
      film.add(pixel, chunk, added.data(), added.data() + 3, samples, true);
      means[pixel].push_back(mean);
    }
  const float one[3] = {1, 2, 3};
  film.add(4, 7, one, one, 3, false);
  EXPECT_THROW(film.add(4, 8, one, one, samples + 1, true), Error) << "a whole chunk of another size";
  const PixelNoise noise = film.noise();
  for (std::uint32_t pixel = 0; pixel < width * height; ++pixel) {
    const std::size_t n = means[pixel].size();
    EXPECT_EQ(noise.chunks[pixel], n + (pixel == 4 ? 1 : 0));
    double variance = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      double mean = 0, square = 0;
      for (const auto& chunk : means[pixel]) mean += chunk[k] / static_cast<double>(n);
      for (const auto& chunk : means[pixel]) square += (chunk[k] - mean) * (chunk[k] - mean);
      variance += square / (3 * static_cast<double>(n - 1));
    }
    EXPECT_NEAR(noise.chunk_variance[pixel], variance, 1e-6 * variance) << "pixel " << pixel;
  }
  const Film copy = film.film(), taken = film.take_film();
  ASSERT_EQ(copy.channels.size(), taken.channels.size());
  for (std::size_t i = 0; i < copy.channels.size(); ++i) {
    EXPECT_EQ(copy.channels[i].name, taken.channels[i].name);
    EXPECT_EQ(copy.channels[i].values, taken.channels[i].values);
  }
  for (std::uint32_t pixel = 0; pixel < width * height; ++pixel) {
    if (pixel == 4) continue;
    const double count = samples * static_cast<double>(means[pixel].size());
    EXPECT_EQ(taken.find("direct.G")->values[pixel], static_cast<float>(sums[pixel][1] / count));
    EXPECT_EQ(taken.find("indirect.B")->values[pixel], static_cast<float>(sums[pixel][5] / count));
    EXPECT_EQ(taken.find("samples.Y")->values[pixel], count);
  }
  EXPECT_EQ(film.film().find("R")->values[0], 0) << "a film that was taken leaves nothing";
}

// Sums of samples, of short chunks, of passes and of what is seen directly.
TEST(Accumulator, APictureIsTheFilmsRgb) {
  constexpr std::uint32_t kWidth = 5, kHeight = 3;
  for (const int passes : {0, 1, 3})
    for (const bool halves : {false, true}) {
      Accumulator film(kWidth, kHeight);
      if (halves) film.keep_halves();
      std::mt19937 random(static_cast<unsigned>(passes));
      std::uniform_real_distribution<float> light(0, 3);
      const auto color = [&] { return std::array<float, 3>{light(random), light(random), light(random)}; };
      for (std::uint32_t pixel = 0; pixel < kWidth * kHeight; ++pixel)
        for (std::uint32_t chunk = 0; chunk < 3; ++chunk) {
          const bool whole = chunk < 2;
          film.add(pixel, chunk, color().data(), color().data(), whole ? 4 : 1, whole);
          if (pixel % 4 == 0) film.add_seen(pixel, chunk, color().data());
        }
      for (int pass = 0; pass < passes; ++pass) {
        std::vector<float> rgb(3 * kWidth * kHeight);
        for (float& value : rgb) value = light(random);
        film.add_pass(rgb);
      }
      const Film layers = film.film(), picture = film.take_picture();
      for (const char* channel : {"R", "G", "B"})
        EXPECT_EQ(picture.find(channel)->values, layers.find(channel)->values) << channel << ", " << passes;
      EXPECT_EQ(picture.channels.size() == 3, !halves) << "a denoiser reads halves";
    }
}

TEST(Allocation, RefusesWhatIsNoVariance) {
  for (const float bad : {std::numeric_limits<float>::infinity(), std::nanf(""), -1.0f})
    EXPECT_THROW(allocate_chunks({1, bad, 2}, {2, 2, 2}, 10), Error) << bad;
  // The widest range that floats have.
  const auto more = allocate_chunks({1e-38f, 3e38f, 1e-38f}, {2, 2, 2}, 10);
  EXPECT_EQ(more, (std::vector<std::uint32_t>{0, 10, 0}));
}

TEST(Allocation, ErrorOfASampleIsThatOfItsBestUse) {
  constexpr std::size_t kPixels = 5000;
  PixelNoise noise{std::vector<float>(kPixels, 4.0f), std::vector<std::uint32_t>(kPixels, 2), 100, 50};
  noise.chunk_samples = 9;
  EXPECT_NEAR(sample_error(noise, 3), 6, 1e-3);
  // Half of the picture is quiet, and gets no samples.
  std::fill_n(noise.chunk_variance.begin(), kPixels / 2, 0.0f);
  EXPECT_NEAR(sample_error(noise, 3), 3, 0.2);
  noise.chunk_variance[4000] = 1e5f;
  EXPECT_LT(sample_error(noise, 3), 5) << "one pixel does not decide";
  noise.chunks[5] = 1;
  EXPECT_EQ(sample_error(noise, 3), 0) << "one chunk has no variance";
}

TEST(Allocation, NothingNoisyIsServedEvenly) {
  const auto more = allocate_chunks(std::vector<float>(7, 0.0f), std::vector<std::uint32_t>(7, 2), 23);
  std::uint64_t sum = 0;
  for (const std::uint32_t m : more) {
    sum += m;
    EXPECT_GE(m, 3u);
    EXPECT_LE(m, 4u);
  }
  EXPECT_EQ(sum, 23u);
}

// No pixel's samples say how many more it gets: neither through its neighbours nor through what they leave over.
TEST(Allocation, NoPixelDecidesForItself) {
  for (const auto& [width, height] : {std::pair{2u, 1u}, {7u, 5u}, {12u, 9u}}) {
    PixelNoise noise{{}, {}, width, height};
    for (std::uint32_t i = 0; i < width * height; ++i) noise.chunk_variance.push_back(static_cast<float>(unit(i)));
    noise.chunks.assign(noise.chunk_variance.size(), 2);
    for (std::uint32_t i = 0; i < width * height; ++i) noise.mean.push_back(static_cast<float>(10 * unit(i + 1000)));
    for (const std::uint64_t extra : {1u, 10u, 77u, 1000u}) {
      const auto before = allocate_by_noise(noise, extra, 3).more;
      std::uint64_t given = 0, moved = 0;
      for (const std::uint32_t more : before) given += more;
      ASSERT_EQ(given, extra);
      for (std::size_t i = 0; i < before.size(); ++i) {
        PixelNoise louder = noise;
        louder.chunk_variance[i] *= 1000;
        louder.mean[i] += 100;
        const auto after = allocate_by_noise(louder, extra, 3).more;
        ASSERT_EQ(after[i], before[i]) << width << "x" << height << ", pixel " << i << " of " << extra << " chunks";
        moved += after != before;
      }
      if (width > 2 && extra > 10) {
        EXPECT_EQ(moved, before.size()) << "its neighbours do not see a pixel's noise";
      }
    }
  }
}

// A lamp's edge that few samples met: no pixel looks noisy, and yet those beside it may hold a part of it.
TEST(Allocation, EdgesDrawSamplesThoughTheyLookQuiet) {
  const std::uint32_t width = 16, height = 12, row = 5;
  PixelNoise noise{std::vector<float>(width * height, 1e-4f), std::vector<std::uint32_t>(width * height, 2), width,
                   height};
  noise.chunk_samples = 4;
  for (std::uint32_t i = 0; i < width * height; ++i) noise.mean.push_back(i / width < row ? 17.0f : 0.2f);
  const auto edges = edge_variance(noise);
  const auto more = allocate_by_noise(noise, width * height, 3).more;
  for (std::uint32_t y = 0; y < height; ++y)
    for (std::uint32_t x = 1; x + 1 < width; ++x) {
      const std::size_t i = std::size_t{y} * width + x;
      const bool beside = y == row || y + 1 == row;
      // One neighbour of four across the edge: 3/16 of the step's square, over the chunk's samples.
      EXPECT_NEAR(edges[i], beside ? 16.8 * 16.8 * 3 / 16 / 4 : 0.0, 1e-4) << x << ", " << y;
      EXPECT_EQ(more[i] > 2, beside) << x << ", " << y << ": " << more[i];
    }
  noise.mean.clear();
  for (const float variance : edge_variance(noise)) EXPECT_EQ(variance, 0.0f);
}

TEST(Allocation, NeighboursAreOfTheOtherColour) {
  for (const auto& [width, height] : {std::pair{1u, 1u}, {2u, 1u}, {7u, 5u}, {12u, 9u}}) {
    PixelNoise noise{{}, {}, width, height};
    for (std::uint32_t i = 0; i < width * height; ++i) {
      noise.chunk_variance.push_back(static_cast<float>(std::exp(10 * unit(i))));
      noise.chunks.push_back(2);
    }
    for (const int radius : {1, 2}) {
      const auto means = neighbours_variance(noise, radius);
      ASSERT_EQ(means.size(), std::size_t{width} * height);
      for (int y = 0; y < static_cast<int>(height); ++y)
        for (int x = 0; x < static_cast<int>(width); ++x) {
          double sum = 0;
          int count = 0;
          for (int j = std::max(y - radius, 0); j <= std::min(y + radius, static_cast<int>(height) - 1); ++j)
            for (int i = std::max(x - radius, 0); i <= std::min(x + radius, static_cast<int>(width) - 1); ++i) {
              if ((i + j + x + y) % 2 == 0) continue;
              sum += noise.chunk_variance[static_cast<std::size_t>(j) * width + static_cast<std::size_t>(i)];
              ++count;
            }
          const std::size_t at = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
          if (count) {
            EXPECT_NEAR(means[at], sum / count, 1e-5 * sum / count) << x << ", " << y;
          } else {
            EXPECT_GT(means[at], 0) << "a picture of one pixel";
          }
        }
    }
  }
}

}  // namespace
}  // namespace gleaner::coordinator
