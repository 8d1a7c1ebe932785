// The path filter (kernels/path_filter.h): its four classes are all indirect light and no light twice, so that a
// partner that computes some of them and the path tracer that computes the rest give the whole picture.

#include <cmath>
#include <cstdio>
#include <limits>

#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

constexpr std::uint32_t kClasses[] = {PATH_CLASS_DIFFUSE, PATH_CLASS_CAUSTIC, PATH_CLASS_MIXED, PATH_CLASS_GLOSSY};
constexpr const char* kNames[] = {"diffuse", "caustic", "mixed", "glossy"};

// Means over the picture, a value a chunk.
struct Means {
  std::vector<double> direct, indirect;
};

Means means_without(const Shot& shot, std::uint32_t classes) {
  worker::Executor& on = executor(shot.trace);
  const std::uint64_t pixels = std::uint64_t{shot.width} * shot.height, items = pixels * shot.chunks;
  kernels::PathParameters p = parameters_of(shot);
  p.filter = classes;
  p.clamp = std::numeric_limits<float>::infinity();  // the partner lacks nothing
  worker::StageTask task = task_of(p, load(on, shot.scene));
  task.inputs["items"] = list_of(shot);
  const worker::BatchResult result = on.run(task, 0, items);
  EXPECT_EQ(result.counters.nonfinite, 0u);
  const std::size_t stride = sizeof(kernels::PathRecord) + (classes ? 12 : 0);
  Means means{std::vector<double>(shot.chunks), std::vector<double>(shot.chunks)};
  for (std::uint64_t i = 0; i < items; ++i) {
    kernels::PathRecord record;
    std::memcpy(&record, result.records.data() + i * stride, sizeof record);
    for (int k = 0; k < 3; ++k) {
      means.direct[i / pixels] += record.direct[k];
      means.indirect[i / pixels] += record.indirect[k];
    }
  }
  for (auto* values : {&means.direct, &means.indirect})
    for (double& value : *values) value /= 3.0 * shot.samples * static_cast<double>(pixels);
  return means;
}

// Bare metals are made mirrors: the filter sees through metals of any sharp lobe as through mirrors, but the layers
// count what it sees there as indirect.
Shot shot_of(const std::string& name) {
  Shot shot;
  Scene scene = scene::make_scene(name, {});
  for (auto& material : scene.materials)
    if (material.metallic == 1) material.roughness = 0;
  shot.scene = std::make_shared<const Scene>(std::move(scene));
  shot.camera = camera_of(*shot.scene);
  shot.width = shot.height = 24;
  shot.samples = 16;
  shot.chunks = 32;
  return shot;
}

class PathFilter : public testing::TestWithParam<const char*> {};

TEST_P(PathFilter, WithoutAllClassesNothingIndirectIsLeft) {
  const Shot shot = shot_of(GetParam());
  const Means whole = means_without(shot, 0), left = means_without(shot, PATH_CLASSES);
  Sample indirect, direct, off;
  for (std::uint32_t c = 0; c < shot.chunks; ++c) {
    EXPECT_EQ(left.indirect[c], 0.0);
    indirect.add(whole.indirect[c]);
    direct.add(whole.direct[c]);
    off.add(left.direct[c] - whole.direct[c]);
  }
  EXPECT_GT(indirect.mean, 10 * indirect.standard_error()) << "the scene has no indirect light";
  // Parts are drawn at random and made up for: roundings are left where each pixel's numbers are the same.
  const double p =
      student_p(std::max(0.0, std::abs(off.mean) - 1e-6 * direct.mean) / off.standard_error(), shot.chunks - 1.0);
  std::printf("  direct light, with the filter - without: %.8f +- %.8f of %.6f, p = %.4f\n", off.mean,
              off.standard_error(), direct.mean, p);
  EXPECT_GE(p, 1e-4);
}

TEST_P(PathFilter, ClassesAddUp) {
  const Shot shot = shot_of(GetParam());
  const Means whole = means_without(shot, 0);
  std::vector<double> sum(shot.chunks);
  Sample indirect, off;
  for (double value : whole.indirect) indirect.add(value);
  for (std::size_t k = 0; k < std::size(kClasses); ++k) {
    const Means left = means_without(shot, kClasses[k]);
    Sample one;
    for (std::uint32_t c = 0; c < shot.chunks; ++c) {
      one.add(whole.indirect[c] - left.indirect[c]);
      sum[c] += whole.indirect[c] - left.indirect[c];
    }
    std::printf("  %-8s %.6f +- %.6f of %.6f\n", kNames[k], one.mean, one.standard_error(), indirect.mean);
    EXPECT_GT(one.mean, 4 * one.standard_error()) << kNames[k] << ": the scene has none of it";
  }
  for (std::uint32_t c = 0; c < shot.chunks; ++c) off.add(sum[c] - whole.indirect[c]);
  const double p = student_p(std::abs(off.mean) / off.standard_error(), shot.chunks - 1.0);
  std::printf("  their sum - all: %.6f +- %.6f, p = %.4f\n", off.mean, off.standard_error(), p);
  EXPECT_GE(p, 1e-4);
  EXPECT_LT(off.standard_error(), 0.03 * indirect.mean) << "too noisy to prove anything";
}

// Where all surfaces are diffuse layers and rough lobes, a cache of incoming radiance takes all indirect light; of
// irradiance, what leaves by layers.
TEST(PathFilterCaches, TakeIndirectLight) {
  Shot shot = shot_of("cornell-glossy");
  Scene scene = *shot.scene;
  for (auto& material : scene.materials)
    if (material.roughness < 1) material.roughness = 0.5f;
  scene::finish_materials(scene);
  shot.scene = std::make_shared<const Scene>(std::move(scene));
  const Means whole = means_without(shot, 0), layers = means_without(shot, PATH_CLASS_IRRADIANCE),
              both = means_without(shot, PATH_CLASS_RADIANCE);
  Sample left, lobes, direct;
  for (std::uint32_t c = 0; c < shot.chunks; ++c) {
    EXPECT_EQ(both.indirect[c], 0.0);
    left.add(layers.indirect[c] / whole.indirect[c]);
    lobes.add(layers.indirect[c]);
    direct.add(both.direct[c] - whole.direct[c]);
  }
  std::printf("  lobes send %.4f of indirect light\n", left.mean);
  EXPECT_GT(lobes.mean, 10 * lobes.standard_error());
  EXPECT_LT(left.mean, 0.5);
  EXPECT_LT(std::abs(direct.mean), 5 * direct.standard_error() + 1e-6 * whole.direct[0]);
}

INSTANTIATE_TEST_SUITE_P(Scenes, PathFilter, testing::Values("cornell-glossy"), [](const auto& scene) {
  std::string name = scene.param;
  std::erase(name, '-');
  return name;
});

TEST(PathFilterParameters, UnknownClassesAreRefused) {
  Shot shot = shot_of("cornell-box");
  worker::Executor& on = executor(shot.trace);
  kernels::PathParameters p = parameters_of(shot);
  p.clamp = 1;
  // RADIOSITY, SAMPLED_RADIOSITY, METAL_RADIOSITY, IRRADIANCE and RADIANCE are no part of other classes; LAYER
  // and LOBE are the photon maps' alone.
  for (const std::uint32_t classes :
       {PATH_CLASS_RADIOSITY | PATH_CLASS_DIFFUSE, PATH_CLASS_IRRADIANCE | PATH_CLASS_DIFFUSE,
        PATH_CLASS_RADIANCE | PATH_CLASS_DIFFUSE, PATH_CLASS_RADIANCE | PATH_CLASS_IRRADIANCE, PATH_CLASS_LAYER,
        PATH_CLASS_LAYER | PATH_CLASS_DIFFUSE, PATH_CLASS_SAMPLED_RADIOSITY | PATH_CLASS_DIFFUSE,
        PATH_CLASS_METAL_RADIOSITY | PATH_CLASS_RADIOSITY, PATH_CLASS_LOBE, PATH_CLASS_LOBE | PATH_CLASS_DIFFUSE,
        2 * PATH_CLASS_LOBE}) {
    p.filter = classes;
    const worker::StageTask task = task_of(p, load(on, shot.scene));
    EXPECT_THROW(on.run(task, 0, 1), Error) << classes;
  }
}

}  // namespace
}  // namespace gleaner::test
