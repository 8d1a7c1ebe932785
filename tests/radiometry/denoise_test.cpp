// Denoised frames by the real library: nearer to the truth than what was sampled, by an error that they know.

#include <sys/stat.h>

#include <cmath>
#include <cstdlib>

#include "coordinator/film/write.h"
#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"
#include "worker/denoise/denoiser.h"

namespace gleaner::test {
namespace {

using coordinator::Denoise;

class DenoisedFrames : public testing::Test {
 protected:
  void SetUp() override {
    if (struct stat found; ::stat(GLEANER_BUILT_OIDN, &found) == 0) ::setenv("GLEANER_OIDN", GLEANER_BUILT_OIDN, 0);
    try {
      std::printf("  Open Image Denoise %s\n", worker::denoiser_version().c_str());
    } catch (const Error& error) {
      GTEST_SKIP() << error.what();
    }
  }
};

Frame frame_of(const std::string& method, std::uint32_t spp, Denoise denoise) {
  Frame frame = square_frame(method, scene::make_scene("cornell-box", {}), {}, 64, spp, {});
  frame.settings.denoise = denoise;
  return frame;
}

const Film& truth() {
  static const Film film = [] {
    Frame frame = frame_of("path", 4096, Denoise::off);
    frame.settings.seed = 99;
    return render(frame).film;
  }();
  return film;
}

// Mean over pixels and channels.
double squared_error(const Film& film, const std::string& layer, const Film& expected = truth()) {
  double sum = 0;
  for (const char* color : {"R", "G", "B"}) {
    const std::vector<float>&is = film.find(layer + color)->values, &should = expected.find(color)->values;
    for (std::size_t i = 0; i < is.size(); ++i) sum += std::pow(double{is[i]} - should[i], 2);
  }
  return sum / (3.0 * film.width * film.height);
}

TEST_F(DenoisedFrames, AreNearerToTheTruthAndKnowHowNear) {
  for (const char* method : {"path", "vpl"})
    for (const std::uint32_t spp : {8u, 64u}) {
      double raw = 0, denoised = 0, told = 0;
      constexpr unsigned kSeeds = 4;
      for (unsigned seed = 1; seed <= kSeeds; ++seed) {
        Frame frame = frame_of(method, spp, Denoise::high);
        frame.settings.seed = seed;
        const Film film = render(frame).film;
        raw += squared_error(film, "noisy.") / kSeeds;
        denoised += squared_error(film, "") / kSeeds;
        told += mean_of(film, "error.Y") / kSeeds;
      }
      std::printf("  %s, %u samples: raw %.4f, denoised %.4f, told %.4f (roots)\n", method, spp, std::sqrt(raw),
                  std::sqrt(denoised), std::sqrt(told));
      EXPECT_LT(std::sqrt(denoised), (std::string(method) == "path" ? 0.5 : 1.0) * std::sqrt(raw)) << method;
      EXPECT_NEAR(std::log(told / denoised), 0, std::log(2.25)) << method;  // a factor of 1.5 in the error
    }
}

TEST_F(DenoisedFrames, RepeatTheirBitsAndKeepTheSamples) {
  const Rendered first = render(frame_of("path", 8, Denoise::fast)),
                 second = render(frame_of("path", 8, Denoise::fast));
  EXPECT_EQ(coordinator::pixels_sha256(first.film), coordinator::pixels_sha256(second.film));
  // The middle of the picture, where no lamp is seen: its emission would have rays of its own.
  const auto middle = [](Denoise denoise) {
    Frame frame = frame_of("path", 8, denoise);
    frame.settings.camera.half_width = frame.settings.camera.half_height *= 0.5f;
    return render(frame).film;
  };
  const Film denoised = middle(Denoise::fast), raw = middle(Denoise::off);
  EXPECT_FALSE(denoised.find("emission.R"));
  for (const char* color : {"R", "G", "B"})
    EXPECT_EQ(denoised.find(std::string("noisy.") + color)->values, raw.find(color)->values);
  EXPECT_EQ(first.parameters["denoise"]["quality"], "fast");
  EXPECT_EQ(first.parameters["denoise"]["library"], "Open Image Denoise " + worker::denoiser_version());
}

TEST_F(DenoisedFrames, ATargetErrorIsTheDenoisedPictures) {
  // Large enough for the first looks to be sure of something.
  Frame frame = frame_of("path", 64, Denoise::fast);
  frame.settings.width = frame.settings.height = 128;
  frame.settings.target_error = 0.02;
  const Rendered denoised = render(frame);
  frame.settings.denoise = Denoise::off;
  const Rendered raw = render(frame);
  frame.settings.target_error = 0;
  frame.settings.spp = 1024;
  frame.settings.seed = 99;
  frame.settings.denoise = Denoise::high;
  const Film true_film = render(frame).film;
  const double mean = (mean_of(true_film, "R") + mean_of(true_film, "G") + mean_of(true_film, "B")) / 3;
  // Less what the reference is off by itself.
  const double error = std::sqrt(squared_error(denoised.film, "", true_film) - mean_of(true_film, "error.Y")) / mean;
  std::printf("  %.4f of the mean, with %.3g of the samples\n", error,
              denoised.parameters["samples"].get<double>() / raw.parameters["samples"].get<double>());
  EXPECT_LT(error, 0.02);
  EXPECT_LT(denoised.parameters["samples"].get<double>(), 0.5 * raw.parameters["samples"].get<double>());
}

// --- Emission seen directly: with or without the library ---

// `wide`: times the usual field of view, in which the room and its lamp are smaller.
Rendered lamp_of(std::uint32_t size, std::uint32_t spp, std::uint64_t seed, const std::string& method = "path",
                 float wide = 1) {
  Frame frame = frame_of(method, spp, Denoise::fast);
  frame.settings.width = frame.settings.height = size;
  frame.settings.seed = seed;
  frame.settings.camera.half_width = frame.settings.camera.half_height *= wide;
  return render(frame);
}

// Red emission a pixel by the first samples alone.
std::vector<float> sampled_emission(const Rendered& frame) {
  constexpr std::size_t kSeenAt = sizeof(kernels::PathFeatureRecord) / 4, kWords = kSeenAt + 3;
  const std::vector<float> words = frame.floats("path.0");
  const std::size_t pixels = std::size_t{frame.film.width} * frame.film.height, items = words.size() / kWords;
  const auto samples = static_cast<float>(items / pixels * frame.parameters["samples_per_chunk"].get<std::size_t>());
  std::vector<float> emission(pixels);
  for (std::size_t item = 0; item < items; ++item) emission[item % pixels] += words[item * kWords + kSeenAt] / samples;
  return emission;
}

double deviation(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += std::pow(double{a[i]} - b[i], 2);
  return std::sqrt(sum / static_cast<double>(a.size()));
}

TEST(SeenEmission, EdgesOfLampsFlickerLessThanTheirSamples) {
  const Rendered one = lamp_of(64, 8, 1), other = lamp_of(64, 8, 2);
  const double own = deviation(one.film.find("emission.R")->values, other.film.find("emission.R")->values),
               sampled = deviation(sampled_emission(one), sampled_emission(other));
  std::printf("  a lamp in frames of other seeds: %.4f, by its samples %.4f\n", own, sampled);
  // 1,024 rays for 4 samples: by chance alone it were 1/16; these fill the pixel evenly.
  EXPECT_LT(own, 0.04 * sampled);
  // No more of them than half of the samples, or than 8 a pixel.
  EXPECT_LE(one.specs.at("path.seen").items * 64, 8u * 64 * 64);
}

// With it the raw picture is what is rendered without a denoiser, also where paths read a map.
TEST(SeenEmission, IsPartOfThePicture) {
  for (const char* method : {"path", "photon"}) {
    const Rendered frame = lamp_of(32, 64, 1, method);
    double seen = 0, raw = 0, whole = 0;
    for (const char* color : {"R", "G", "B"}) {
      seen += mean_of(frame.film, std::string("emission.") + color) / 3;
      raw += mean_of(frame.film, std::string("noisy.") + color) / 3;
      whole += mean_of(truth(), color) / 3;
    }
    std::printf("  %s: seen %.4f of %.4f, truth %.4f\n", method, seen, raw, whole);
    EXPECT_NEAR(raw / whole, 1, 0.02) << method;
    EXPECT_GT(seen / whole, 0.1) << method;
  }
}

// A lamp smaller than a pixel, by two samples: most pictures' samples see nothing of it. Whether rays are sent must not
// depend on the samples that they replace, or the lamp would be too dark on average.
TEST(SeenEmission, SmallLampsKeepTheirMean) {
  constexpr unsigned kFrames = 600;
  double sum = 0, squares = 0;
  for (unsigned seed = 1; seed <= kFrames; ++seed) {
    const Rendered frame = lamp_of(16, 2, seed, "path", 4);
    const double seen = frame.film.find("emission.R") ? mean_of(frame.film, "emission.R") : 0;
    sum += seen / kFrames;
    squares += seen * seen / kFrames;
  }
  const double expected = mean_of(lamp_of(16, 4096, 1, "path", 4).film, "emission.R"),
               deviation = std::sqrt((squares - sum * sum) / kFrames);
  std::printf("  mean of %u frames %.4f +- %.4f, expected %.4f\n", kFrames, sum, deviation, expected);
  EXPECT_NEAR(sum, expected, 4 * deviation);
  EXPECT_LT(deviation, 0.12 * expected) << "too few frames to tell";
}

TEST_F(DenoisedFrames, WhatIsConcludedIsDenoised) {
  const Frame frame = frame_of("path", 64, Denoise::fast);
  worker::Executor& on = executor(frame.trace);
  const std::string id = load(on, frame.scene);
  auto plan = coordinator::make_plan(frame.settings, coordinator::summarize(*frame.scene));
  std::vector<coordinator::CutStage> cut;
  // The second stage is asked for, and brings nothing.
  EXPECT_FALSE(cli::run_frame(*plan, on, id, [&](const coordinator::StageSpec& stage, const worker::StageTask&) {
    if (stage.name != "path.1") return true;
    cut.push_back({{stage.name, nullptr}, {}});
    return false;
  }));
  ASSERT_TRUE(plan->conclude(cut));
  const coordinator::Step step = plan->after_conclude();
  ASSERT_FALSE(step.done);
  ASSERT_EQ(step.stages.size(), 1u);
  EXPECT_EQ(step.stages[0].kind, "denoise");
  EXPECT_TRUE(step.stages[0].denoises);
  EXPECT_FALSE(plan->conclude({})) << "a picture that is being denoised is finished";
}

}  // namespace
}  // namespace gleaner::test
