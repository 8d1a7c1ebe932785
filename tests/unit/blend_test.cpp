// The choice between a denoised and a raw picture, and the error that it tells, on pictures whose truth is known.

#include "worker/denoise/blend.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace gleaner::worker {
namespace {

constexpr std::uint32_t kSize = 128;
constexpr std::size_t kFloats = 3 * kSize * kSize;

// Truth 1. Both halves have noise of this deviation; what they are denoised to is off by `bias` on the right half of
// the picture, and by a quarter of their own noise, which a real denoiser would spread.
struct Case {
  std::vector<float> first, second, denoised_first, denoised_second, share;

  Case(float noise, float bias, float of_first, unsigned seed) : share(kSize * kSize, of_first) {
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    const auto half = [&](float part, std::vector<float>& raw, std::vector<float>& denoised) {
      for (std::size_t i = 0; i < kFloats; ++i) {
        const float off = noise / std::sqrt(part) * normal(random);
        raw.push_back(1 + off);
        denoised.push_back(1 + off / 4 + (right(i / 3) ? bias : 0.0f));
      }
    };
    half(of_first, first, denoised_first);
    half(1 - of_first, second, denoised_second);
  }
  static bool right(std::size_t pixel) { return pixel % kSize >= kSize / 2; }
  BlendedPicture blended() const {
    return blend({kSize, kSize, first, second, denoised_first, denoised_second, share});
  }
};

double true_error(const BlendedPicture& picture) {
  double sum = 0;
  for (const float value : picture.color) sum += (value - 1.0) * (value - 1.0);
  return sum / kFloats;
}

TEST(Blend, TellsItsErrorWithoutBias) {
  for (const float of_first : {0.5f, 0.25f})
    for (const float bias : {0.0f, 0.05f, 0.1f, 0.4f}) {
      double told = 0, is = 0;
      for (unsigned seed = 1; seed <= 8; ++seed) {
        const BlendedPicture picture = Case(0.1f, bias, of_first, seed).blended();
        told += picture.error / 8;
        is += true_error(picture) / 8;
      }
      std::printf("  share %.2f, bias %.2f: told %.3g, is %.3g\n", of_first, bias, told, is);
      EXPECT_NEAR(told / is, 1, 0.08) << "share " << of_first << ", bias " << bias;
    }
}

TEST(Blend, TakesWhatIsBetter) {
  const Case biased(0.1f, 0.4f, 0.5f, 1);
  const BlendedPicture picture = biased.blended();
  double left = 0, right = 0;  // squared errors
  for (std::size_t i = 0; i < kFloats; ++i) {
    const std::size_t x = i / 3 % kSize;
    if (x + 16 > kSize / 2 && x < kSize / 2 + 16) continue;  // beside the border both are seen
    const double off = picture.color[i] - 1.0;
    (Case::right(i / 3) ? right : left) += off * off / (kFloats * (kSize - 32.0) / kSize / 2);
  }
  EXPECT_NEAR(picture.denoised, 0.5, 0.1);
  EXPECT_LT(left, 1.05 * 0.01 / 16);  // denoised
  EXPECT_LT(right, 1.02 * 0.01);      // as it was sampled
}

TEST(Blend, KnowsHowSureItIs) {
  double square = 0, deviation = 0;
  constexpr unsigned kSeeds = 24;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    const BlendedPicture picture = Case(0.1f, 0.0f, 0.5f, seed).blended();
    square += std::pow(picture.error - true_error(picture), 2) / kSeeds;
    deviation += picture.deviation / kSeeds;
  }
  EXPECT_NEAR(deviation / std::sqrt(square), 1, 0.5);
}

// A denoiser takes specks out of both halves; in what its picture is off from the other half they stay, as large as
// they were.
TEST(Blend, AFewSpecksDoNotDecideWhatItTells) {
  for (const float speck : {1000.0f, -1000.0f, 100000.0f}) {
    Case made(0.1f, 0.05f, 0.5f, 4);
    const double before = std::sqrt(made.blended().error);
    for (const std::size_t pixel : {40 * kSize + 100, 70 * kSize + 90, 90 * kSize + 120})
      for (std::size_t k = 3 * pixel; k < 3 * pixel + 3; ++k) made.second[k] = speck;
    const BlendedPicture picture = made.blended();
    std::printf("  told %.4f without specks, %.4f with them; is %.4f\n", before, std::sqrt(picture.error),
                std::sqrt(true_error(picture)));
    EXPECT_NEAR(std::sqrt(picture.error) / std::sqrt(true_error(picture)), 1, 0.5) << speck;
  }
}

// What it tells of each place, not of the whole alone: roots within a factor of two of the truth in nearly all blocks.
// A picture with noise in it and noise on what it is denoised to, whose size differs between its halves.
TEST(Blend, TellsWhereItIsOff) {
  Case made(0.3f, 0.0f, 0.5f, 3);
  for (auto* raw : {&made.first, &made.second})
    for (std::size_t i = 0; i < kFloats; ++i)
      if (!Case::right(i / 3)) (*raw)[i] = 1 + ((*raw)[i] - 1) / 3;
  for (auto* denoised : {&made.denoised_first, &made.denoised_second})
    for (std::size_t i = 0; i < kFloats; ++i)
      if (!Case::right(i / 3)) (*denoised)[i] = 1 + ((*denoised)[i] - 1) / 6;
  const BlendedPicture picture = made.blended();
  constexpr std::uint32_t kBlock = 8, kBlocks = kSize / kBlock;
  std::size_t good = 0, seen = 0;
  for (std::uint32_t y = 0; y < kBlocks; ++y)
    for (std::uint32_t x = 0; x < kBlocks; ++x) {
      if (x + 3 > kBlocks / 2 && x < kBlocks / 2 + 2) continue;  // beside the border both are seen
      double told = 0, off = 0;
      for (std::uint32_t k = 0; k < kBlock * kBlock; ++k) {
        const std::size_t pixel = (std::size_t{y} * kBlock + k / kBlock) * kSize + x * kBlock + k % kBlock;
        told += picture.squared_error[pixel];
        for (std::size_t c = 3 * pixel; c < 3 * pixel + 3; ++c) off += std::pow(picture.color[c] - 1.0, 2) / 3;
      }
      ++seen;
      good += told > off / 4 && told < 4 * off;
    }
  std::printf("  %zu of %zu blocks\n", good, seen);
  EXPECT_GT(static_cast<double>(good), 0.95 * static_cast<double>(seen));
}

TEST(Blend, LeavesAloneWhatHasNoNoise) {
  const BlendedPicture picture = Case(0.0f, 0.1f, 0.5f, 1).blended();
  EXPECT_EQ(picture.denoised, 0);
  EXPECT_EQ(picture.error, 0);
  EXPECT_EQ(picture.color.front(), 1);
}

}  // namespace
}  // namespace gleaner::worker
