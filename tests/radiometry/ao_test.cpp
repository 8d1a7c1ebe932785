// Method `ao`: form factors, the path tracer under a white sky, radius, alpha, and bits that do not depend on batches.

#include <cmath>

#include "kernels/ao_records.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;

// The shot's task as stage "ao" runs it.
worker::StageTask ao_task(const Shot& shot, float radius, std::uint32_t rays) {
  worker::Executor& on = executor(shot.trace);
  worker::StageTask task = task_of(parameters_of(shot), load(on, shot.scene));
  task.kind = "ao";
  task.inputs["items"] = list_of(shot);
  const kernels::AoParameters p{parameters_of(shot), radius, rays, {}};
  task.parameters.resize(sizeof p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  return task;
}

Picture ao(const Shot& shot, float radius, std::uint32_t rays = 4) { return run(shot, ao_task(shot, radius, rays)); }

Shot shot_of(scene::Scene scene, std::uint32_t size = 16, std::uint32_t chunks = 16) {
  Shot shot;
  shot.scene = std::make_shared<const Scene>(std::move(scene));
  shot.camera = camera_of(*shot.scene);
  shot.width = shot.height = size;
  shot.chunks = chunks;
  return shot;
}

// What a square does not see of the sky is its form factor to the square that hides it (Howell's catalogue, C-11 and
// C-14; closed_form_test.cpp has the formulas).
TEST(Ao, SquaresHideTheirFormFactor) {
  for (const auto trace : {worker::TraceKind::embree, worker::TraceKind::opencl})
    for (const auto& [name, factor] : {std::pair{"parallel-squares", 0.199825}, {"perpendicular-squares", 0.200044}}) {
      Shot shot = shot_of(scene::make_scene(name, {}));
      shot.trace = trace;
      expect_mean(ao(shot, 0).mean(), 1 - factor, name, sidak(kFamily, 4), 2e-3, 1e-6);
    }
}

// The squares are 1 m apart, and at most sqrt(3) m from corner to corner.
TEST(Ao, OnlyWhatIsWithinTheRadiusHides) {
  const Shot shot = shot_of(scene::make_scene("parallel-squares", {}));
  EXPECT_EQ(ao(shot, 0.999f).mean().mean, 1.0);
  const double near = ao(shot, 1.2f).mean().mean, far = ao(shot, 1.8f).mean().mean, any = ao(shot, 0).mean().mean;
  EXPECT_LT(near, 0.95);
  EXPECT_LT(far, near);
  EXPECT_EQ(far, any);
}

TEST(Ao, AlphaHidesInProportion) {
  scene::Scene scene = scene::make_scene("parallel-squares", {});
  for (auto& material : scene.materials)
    if (material.emission[0] > 0) {
      material.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
      material.alpha = 0.25f;
    }
  for (const auto trace : {worker::TraceKind::embree, worker::TraceKind::opencl}) {
    Shot shot = shot_of(scene);
    shot.trace = trace;
    expect_mean(ao(shot, 0).mean(), 1 - 0.25 * 0.199825, "a quarter of a square", sidak(kFamily, 4), 2e-3, 1e-6);
    expect_mean(ao(shot, 3).mean(), 1 - 0.25 * 0.199825, "within 3 m", sidak(kFamily, 4), 2e-3, 1e-6);
  }
}

// A white Lambert scene under a sky of radiance 1 shows its ambient occlusion in direct light. Smooth normals, normal
// maps and alpha are those of the scene.
TEST(Ao, IsDirectLightOfAWhiteSky) {
  for (const char* name : {"cornell-textured", "glossy-range"}) {
    scene::Scene scene = scene::make_scene(name, {});
    scene::Scene white = scene;
    white.lights.clear();
    for (auto& material : white.materials) {
      for (int k = 0; k < 3; ++k) material.base_color[k] = 1, material.emission[k] = 0;
      material.metallic = material.transmission = material.specular = 0;
      material.roughness = 1;
      material.base_color_texture = material.alpha < 1 || (material.flags & GLEANER_MATERIAL_ALPHA_MASK)
                                        ? material.base_color_texture
                                        : GLEANER_NONE;
      material.metallic_roughness_texture = material.emission_texture = GLEANER_NONE;
    }
    finish_materials(white);
    white.environment = {8, 4, std::vector<float>(3 * 8 * 4, 1.0f)};
    Shot shot = shot_of(white, 32, 16);
    shot.depth = 1;
    const Picture path = shoot(shot), share = ao(shot_of(scene, 32, 16), 0);
    Sample difference;
    for (std::uint32_t c = 0; c < shot.chunks; ++c) {
      double sum = 0;
      for (std::size_t i = 0; i < path.pixels(); ++i)
        sum += path.direct[(c * path.pixels() + i) * 3 + 1] - share.at(c, i, 1);
      difference.add(1 + sum / static_cast<double>(path.pixels()));
    }
    if (!expect_mean(difference, 1, name, sidak(kFamily, 2), 2e-3)) keep_failure(share, name);
  }
}

TEST(Ao, RecordsDoNotDependOnBatches) {
  worker::Executor two({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic});
  const Shot shot = shot_of(scene::make_scene("cornell-textured", {}), 24, 2);
  worker::StageTask task = ao_task(shot, 0.5f, 3);
  const std::uint64_t items = std::uint64_t{24} * 24 * 2;
  const auto whole = executor(shot.trace).run(task, 0, items);
  two.load_scene("two", shot.scene, nullptr);
  task.scene = "two";
  const std::size_t stride = sizeof(kernels::PathRecord);
  for (std::uint64_t first = 0; first < items; first += 96) {
    const auto part = two.run(task, first, 96);
    ASSERT_EQ(std::memcmp(part.records.data(), whole.records.data() + first * stride, 96 * stride), 0) << first;
  }
}

TEST(Ao, RefusesWhatIsOutOfRange) {
  const Shot shot = shot_of(scene::make_scene("parallel-squares", {}));
  for (const float radius : {-1.0f, NAN, INFINITY})
    EXPECT_THROW(executor(shot.trace).run(ao_task(shot, radius, 1), 0, 1), Error) << radius;
  EXPECT_THROW(executor(shot.trace).run(ao_task(shot, 1, 0), 0, 1), Error);
}

}  // namespace
}  // namespace gleaner::test
