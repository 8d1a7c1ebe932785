// Against converged pictures of an independent renderer, with both renderers' noise: pixel by pixel, block by block,
// and the whole.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "coordinator/film/read.h"
#include "scene/import/import.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 0.01;

std::filesystem::path shared() {
  if (const char* folder = std::getenv("GLEANER_SHARED")) return folder;
  return GLEANER_SHARED_DIR;
}

// The reference, averaged down over squares of pixels; its standard error likewise.
struct Reference {
  std::uint32_t width = 0, height = 0;
  std::vector<double> mean[3], error[3];

  Reference(const std::string& name, std::uint32_t factor) {
    const auto picture = coordinator::read_exr((shared() / "references" / (name + ".exr")).string());
    const auto noise = coordinator::read_exr((shared() / "references" / (name + ".stderr.exr")).string());
    width = picture.width / factor;
    height = picture.height / factor;
    EXPECT_EQ(width * factor, picture.width);
    EXPECT_EQ(noise.width, picture.width);
    for (int k = 0; k < 3; ++k) {
      const std::string channel(1, "RGB"[k]);
      const auto &values = picture.find(channel)->values, &errors = noise.find(channel)->values;
      mean[k].resize(std::size_t{width} * height);
      error[k].resize(mean[k].size());
      for (std::size_t y = 0; y < picture.height; ++y)
        for (std::size_t x = 0; x < picture.width; ++x) {
          const std::size_t from = y * picture.width + x, to = y / factor * width + x / factor;
          mean[k][to] += values[from] / (factor * factor);
          error[k][to] += std::pow(double{errors[from]} / (factor * factor), 2);
        }
      for (double& e : error[k]) e = std::sqrt(e);
    }
  }
};

struct Compared {
  const char *file, *name;
  // Mirrors and glass gather the lamp's light in rare, bright paths: no affordable number of samples makes a pixel's
  // mean normal, and its standard error is too small wherever none has come yet. Blocks and the whole are compared.
  bool heavy_tails = false;
};
void PrintTo(const Compared& compared, std::ostream* out) { *out << compared.file; }

class References : public ::testing::TestWithParam<Compared> {};
INSTANTIATE_TEST_SUITE_P(
    Pictures, References,
    ::testing::Values(Compared{"cornell-box/cornell-box.gltf", "cornell-box"},
                      Compared{"cornell-mcguire/CornellBox-Original.gltf", "CornellBox-Original"},
                      Compared{"cornell-mcguire/CornellBox-Glossy.gltf", "CornellBox-Glossy"},
                      Compared{"cornell-mcguire/CornellBox-Mirror.gltf", "CornellBox-Mirror", true},
                      Compared{"cornell-mcguire/CornellBox-Sphere.gltf", "CornellBox-Sphere", true}),
    [](const auto& p) {
      std::string name = p.param.name;
      std::erase(name, '-');
      return name;
    });

TEST_P(References, AgreesWithinTheNoise) {
  const auto& [file, listed, heavy_tails] = GetParam();
  const std::string name = listed;
  if (!std::filesystem::exists(shared() / "references"))
    GTEST_SKIP() << "NOTHING WAS COMPARED: no reference pictures in " << shared() / "references"
                 << " (set GLEANER_SHARED)";
  const Reference reference(name, 8);
  Shot shot{.scene = std::make_shared<const Scene>(scene::import_scene((shared() / "scenes" / file).string()))};
  shot.camera = shot.scene->cameras.at(0).camera;
  shot.width = reference.width;
  shot.height = reference.height;
  // Chunks of many samples, so that their means are nearly normal; enough chunks to tell their spread.
  shot.samples = 64;
  shot.chunks = 32;
  const Picture picture = shoot(shot);

  const std::size_t values = 3 * picture.pixels();
  const double critical = student_critical(sidak(kFamily, values), shot.chunks - 1);
  std::size_t passed = 0;
  Sample z;
  double worst = 0, squares = 0;
  for (int k = 0; k < 3; ++k)
    for (std::size_t i = 0; i < picture.pixels(); ++i) {
      const Sample seen = picture.pixel(i, k);
      const double expected = reference.mean[k][i], off = std::abs(seen.mean - expected);
      const double noise = std::hypot(seen.standard_error(), reference.error[k][i]);
      // A pixel that sees the lamp alone, or nothing, has no noise to speak of and must be the same.
      if (noise <= 5e-4 * expected) {
        passed += off <= 1e-3 * expected;
        continue;
      }
      const double t = (seen.mean - expected) / noise;
      passed += std::abs(t) <= critical;
      z.add(t);
      squares += t * t;
      worst = std::max(worst, std::abs(t));
    }
  const double share = static_cast<double>(passed) / static_cast<double>(values);
  squares /= static_cast<double>(z.count);
  std::printf(
      "  %s: %.4f %% of the values within %.2f standard errors, worst %.2f; z has mean %.4f, mean square %.3f\n",
      name.c_str(), 100 * share, critical, worst, z.mean, squares);
  if (!heavy_tails) {
    EXPECT_GE(share, 0.9975);
    // Noise that is told truly: were it too small or too large by an eighth, nothing above would say so.
    EXPECT_NEAR(squares, 1, 0.25);
  }

  constexpr std::uint32_t block = 8;
  const std::size_t blocks = std::size_t{3} * (picture.width / block) * (picture.height / block);
  const double block_critical = student_critical(sidak(kFamily, blocks), shot.chunks - 1);
  double worst_block = 0;
  for (int k = 0; k < 3; ++k)
    for (std::uint32_t y = 0; y + block <= picture.height; y += block)
      for (std::uint32_t x = 0; x + block <= picture.width; x += block) {
        Sample seen;
        picture.add_means(seen, x, y, x + block, y + block, k);
        double expected = 0, variance = 0;
        for (std::uint32_t j = y; j < y + block; ++j)
          for (std::uint32_t i = x; i < x + block; ++i) {
            expected += reference.mean[k][j * picture.width + i] / (block * block);
            variance += std::pow(reference.error[k][j * picture.width + i] / (block * block), 2);
          }
        const double t = (seen.mean - expected) / std::sqrt(std::pow(seen.standard_error(), 2) + variance);
        // Light leaves two renderers' room corners alike to a thousandth.
        if (std::abs(seen.mean - expected) > 1e-3 * expected) worst_block = std::max(worst_block, std::abs(t));
      }
  std::printf("  %s: worst of %zu blocks %.2f standard errors of %.2f allowed\n", name.c_str(), blocks, worst_block,
              block_critical);
  EXPECT_LE(worst_block, block_critical);

  for (int k = 0; k < 3; ++k) {
    double expected = 0, variance = 0;
    for (const double v : reference.mean[k]) expected += v / static_cast<double>(picture.pixels());
    for (const double e : reference.error[k]) variance += std::pow(e / static_cast<double>(picture.pixels()), 2);
    const Sample seen = picture.mean(k);
    std::printf("  %s %c: mean %.6f +- %.6f, reference %.6f: %+.3f %%\n", name.c_str(), "RGB"[k], seen.mean,
                seen.standard_error(), expected, 100 * (seen.mean / expected - 1));
    EXPECT_NEAR(seen.mean, expected, 5e-4 * expected + 3.5 * std::sqrt(std::pow(seen.standard_error(), 2) + variance));
  }
  if (HasFailure()) keep_failure(picture, name);
}

}  // namespace
}  // namespace gleaner::test
