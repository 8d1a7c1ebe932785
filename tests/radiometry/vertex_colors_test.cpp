// What triangles show where their vertices have colours, a second set of texture coordinates, or textures that are laid
// on by a transform of their own: read off an unlit square in front of an orthographic camera, by both tracers.

#include <gtest/gtest.h>

#include "scene/library/builder.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

using scene::Texel;
using scene::Vec;

scene::Material unlit_material() {
  scene::Material m = scene::lambert({1, 1, 1});
  m.flags |= GLEANER_MATERIAL_UNLIT;
  m.specular = 0;
  return m;
}

// The square from (-1, -1) to (1, 1) in z = 0; corners' uvs are (0,1) (1,1) (1,0) (0,0).
Scene square(const scene::Material& material, scene::SceneBuilder& builder) {
  builder.mesh("square");
  builder.quad({-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}, builder.material("m", material));
  builder.orthographic_camera("front", {0, 0, 2}, {0, 0, -1}, {0, 1, 0}, 1, 1, 16, 16);
  return builder.finish();
}

double pixel(const Picture& picture, std::uint32_t x, std::uint32_t y, int channel) {
  return picture.pixel(std::size_t{y} * picture.width + x, channel).mean;
}

class VertexColors : public testing::TestWithParam<worker::TraceKind> {
 protected:
  Picture shot_of(Scene scene) {
    validate(scene, "test");
    Shot shot;
    shot.scene = std::make_shared<const Scene>(std::move(scene));
    shot.camera = camera_of(*shot.scene);
    shot.width = shot.height = 16;
    shot.chunks = 2;
    shot.trace = GetParam();
    return shoot(shot);
  }
};

TEST_P(VertexColors, AreInterpolatedAndMultiply) {
  scene::SceneBuilder builder("colours");
  scene::Material m = unlit_material();
  m.base_color[1] = 0.5f;
  Scene scene = square(m, builder);
  // Red grows to the right, green is whole, blue grows upwards.
  for (std::size_t v = 0; v < scene.vertex_count(); ++v)
    for (const double c : {scene.positions[3 * v] / 2 + 0.5, 1.0, scene.positions[3 * v + 1] / 2 + 0.5, 1.0})
      scene.colors.push_back(static_cast<std::uint16_t>(std::lround(c * 65535)));
  const Picture picture = shot_of(scene);
  for (std::uint32_t y = 0; y < 16; ++y)
    for (std::uint32_t x = 0; x < 16; ++x) {
      EXPECT_NEAR(pixel(picture, x, y, 0), (x + 0.5) / 16, 0.01);
      EXPECT_NEAR(pixel(picture, x, y, 1), 0.5, 1e-4);
      EXPECT_NEAR(pixel(picture, x, y, 2), 1 - (y + 0.5) / 16, 0.01);
    }
}

TEST_P(VertexColors, AlphaLetsThroughWhatIsBehind) {
  scene::SceneBuilder builder("alpha");
  scene::Material m = unlit_material();
  m.flags |= GLEANER_MATERIAL_ALPHA_MASK;
  Scene scene = square(m, builder);
  for (std::size_t v = 0; v < scene.vertex_count(); ++v)  // alpha grows to the right; the cutoff is in the middle
    for (const int c : {65535, 65535, 65535, scene.positions[3 * v] > 0 ? 65535 : 0})
      scene.colors.push_back(static_cast<std::uint16_t>(c));
  ASSERT_TRUE(needs_of(scene).alpha);
  const Picture picture = shot_of(scene);
  EXPECT_NEAR(pixel(picture, 3, 8, 0), 0, 1e-6);
  EXPECT_NEAR(pixel(picture, 12, 8, 0), 1, 1e-5);
}

TEST_P(VertexColors, TexturesHaveSetsAndTransformsOfTheirOwn) {
  scene::SceneBuilder builder("textures");
  // Left half black, right half white; linear.
  const auto halves = builder.texture(16, 16, false, [](std::uint32_t x, std::uint32_t) {
    return x < 8 ? Texel{0, 0, 0} : Texel{255, 255, 255};
  });
  scene::Material m = unlit_material();
  m.base_color_texture = halves;
  Scene scene = square(m, builder);
  EXPECT_NEAR(pixel(shot_of(scene), 12, 3, 0), 1, 1e-5);
  EXPECT_NEAR(pixel(shot_of(scene), 3, 12, 0), 0, 1e-5);
  // Turned by a quarter: u is read from v, which grows downwards.
  const float turned[6] = {0, 1, 0, 1, 0, 0};
  std::copy(turned, turned + 6, scene.textures[0].transform);
  EXPECT_NEAR(pixel(shot_of(scene), 12, 3, 0), 0, 1e-5);
  EXPECT_NEAR(pixel(shot_of(scene), 3, 12, 0), 1, 1e-5);
  // The second set is mirrored: there white is on the left.
  scene.textures[0] = scene::plain_texture();
  scene.textures[0].width = scene.textures[0].height = 16;
  scene.textures[0].uv_set = 1;
  for (std::size_t v = 0; v < scene.vertex_count(); ++v) {
    scene.second_uvs.push_back(1 - scene.uvs[2 * v]);
    scene.second_uvs.push_back(scene.uvs[2 * v + 1]);
  }
  EXPECT_NEAR(pixel(shot_of(scene), 12, 3, 0), 0, 1e-5);
  EXPECT_NEAR(pixel(shot_of(scene), 3, 12, 0), 1, 1e-5);
}

INSTANTIATE_TEST_SUITE_P(Tracers, VertexColors,
                         testing::Values(worker::TraceKind::automatic, worker::TraceKind::opencl),
                         [](const auto& test) {
                           return test.param == worker::TraceKind::opencl ? "OpenCl" : "Automatic";
                         });

}  // namespace
}  // namespace gleaner::test
