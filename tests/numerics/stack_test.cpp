// A tree deeper than the traversal stack raises an error and writes nowhere else. The comb of the scene library is the
// deep tree: its boxes lie in each other, and a ray along them leaves one node a level waiting. The stack is made too
// small by a tree that understates its depth (parse_bvh() refuses such a blob).

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/numerics/rendering.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;

constexpr std::uint32_t kSmallStack = 16;

// From behind the comb's corner, in the plane of its teeth, through all of their boxes.
constexpr Ray kAlongTheComb{{-0.5f, -0.2f, 0}, {1, 0.4f, 0}};
// From aside onto a tooth, of which there are two beyond a percent of the first one's size.
Ray at_the_comb(float height, bool second) {
  const float size = second ? 0.14719601f : 1;
  return {{-0.5f, -0.2f, height}, {0.5f + 0.95f * size, 0.2f + 0.25f * size, -height}};
}
// From above the stage straight down, past the comb.
Ray past_the_comb(float aside) { return {{-1.5f + aside, 2, 1.5f}, {0, -1, 0}}; }

class Stack : public testing::Test {
 protected:
  void SetUp() override {
    device_ = open_device(worker::TraceKind::opencl);
    if (!device_) GTEST_SKIP() << "NOT TESTED: there is no OpenCL device";
    scene_ = scene::make_scene("comb");
    bvh_ = scene::build_bvh(scene_);
    ASSERT_GT(bvh_.max_depth, kSmallStack);
    understated_ = bvh_;
    understated_.max_depth = 1;
  }

  std::unique_ptr<worker::Device> device_;
  scene::Scene scene_;
  scene::Bvh bvh_, understated_;
};

// Answers of both tracers to rays along and past the comb.
TEST_F(Stack, IsDeepEnoughForTheTreesDepth) {
  auto cpu = open_device(worker::TraceKind::embree);
  if (!cpu) GTEST_SKIP() << "NOT TESTED: Embree, which says what is right, is not here";
  constexpr std::size_t kRays = 20000;
  const auto make = [&](std::size_t i) {
    const float aside = static_cast<float>(i) / kRays;
    return i % 2 ? past_the_comb(aside) : i % 4 ? kAlongTheComb : at_the_comb(0.01f + aside, i % 8);
  };
  std::vector<Hit> expected(kRays);
  TracedScene(*cpu, scene_).closest(kRays, make, [&](std::size_t i, const Ray&, const Hit& hit) { expected[i] = hit; });
  std::size_t differ = 0, hits = 0;
  TracedScene(*device_, scene_, &bvh_).closest(kRays, make, [&](std::size_t i, const Ray&, const Hit& hit) {
    hits += hit.found();
    differ += hit.found() != expected[i].found() || (hit.found() && std::fabs(hit.t - expected[i].t) > 1e-6f * hit.t);
  });
  std::printf("tree of depth %u: %zu rays, %zu hits, %zu answered otherwise by Embree\n", bvh_.max_depth, kRays, hits,
              differ);
  EXPECT_EQ(differ, 0u);
  EXPECT_EQ(hits, kRays / 4 * 3);
}

TEST_F(Stack, TooSmallIsAnErrorAndTouchesNothingElse) {
  TracedScene right(*device_, scene_, &bvh_), small(*device_, scene_, &understated_);
  constexpr std::uint32_t kRays = 96, kBlocks = 8, kWords = kBlocks * RAY_BLOCK * RAY_HIT_ROWS;
  static_assert(kRays / RAY_BLOCK < kBlocks, "blocks behind the range must stay as they are");
  const auto at = [](std::uint32_t i, unsigned row) {
    return i / RAY_BLOCK * RAY_BLOCK * RAY_HIT_ROWS + RAY_BLOCK * row + i % RAY_BLOCK;
  };
  std::vector<float> before(kWords, -7.0f);
  for (std::uint32_t i = 0; i < kRays; ++i) {
    const Ray ray = i % 3 ? past_the_comb(static_cast<float>(i) / kRays) : kAlongTheComb;
    for (unsigned k = 0; k < 3; ++k) {
      before[at(i, ROW_ORIGIN + k)] = ray.origin[k];
      before[at(i, ROW_DIRECTION + k)] = ray.direction[k];
    }
    before[at(i, ROW_NEAR)] = before[at(i, ROW_TIME)] = 0;
    before[at(i, ROW_FAR)] = i % 8 == 5 ? -1 : kInfinity;
    for (unsigned row : {ROW_SOURCE, ROW_GEOMETRY}) std::memset(&before[at(i, row)], 0xff, 4);
  }
  cl::CommandQueue queue = device_->make_queue();
  cl::Buffer buffer = device_->make_buffer(4 * kWords);
  const auto trace = [&](TracedScene& scene, std::string& error) {
    queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, 4 * kWords, before.data());
    try {
      scene.tracer().closest(queue, buffer, {.rows = RAY_HIT_ROWS, .incoherent = kRays});
    } catch (const Error& e) {
      error = e.what();
    }
    std::vector<float> after(kWords);
    queue.enqueueReadBuffer(buffer, CL_TRUE, 0, 4 * kWords, after.data());
    return after;
  };
  std::string error;
  const std::vector<float> expected = trace(right, error);
  EXPECT_EQ(error, "");
  const std::vector<float> found = trace(small, error);
  EXPECT_THAT(error, HasSubstr("traversal stack"));
  EXPECT_THAT(error, HasSubstr(" " + std::to_string(kRays / 3 - kRays / 24) + " rays"))
      << "rays along the comb that ask";
  std::size_t touched = 0;
  for (std::uint32_t word = 0; word < kWords; ++word) {
    const std::uint32_t ray = word / (RAY_BLOCK * RAY_HIT_ROWS) * RAY_BLOCK + word % RAY_BLOCK;
    const bool asked = ray < kRays && ray % 8 != 5;
    // Rays past the comb have their right answers; what did not ask, and what lies behind, is as it was.
    if (asked && ray % 3 == 0) continue;
    touched += std::memcmp(&found[word], asked ? &expected[word] : &before[word], 4) != 0;
  }
  EXPECT_EQ(touched, 0u);

  // What one batch met is not held against the next.
  std::vector<Hit> hits;
  EXPECT_NO_THROW(small.closest(
      16, [](std::size_t) { return past_the_comb(0.5f); },
      [&](std::size_t, const Ray&, const Hit& hit) { hits.push_back(hit); }));
  ASSERT_EQ(hits.size(), 16u);
  EXPECT_TRUE(hits[0].found());
  EXPECT_THROW(small.any(
                   16, [](std::size_t) { return kAlongTheComb; }, [](std::size_t, const Ray&, bool) {}),
               Error);
}

TEST_F(Stack, TooSmallFailsTheBatchAndNoOther) {
  Renderer renderer(worker::TraceKind::opencl);
  const auto shared = std::make_shared<scene::Scene>(scene_);
  renderer.executor().load_scene("small", shared, std::make_shared<scene::Bvh>(understated_));
  renderer.executor().load_scene("right", shared, std::make_shared<scene::Bvh>(bvh_));
  const Shot shot{.width = 16, .height = 16, .samples = 1, .depth = 2};
  auto parameters = path_parameters(scene::look_at({-0.5f, -0.2f, 0}, {0.5f, 0.2f, 0}, 0.5f).camera, shot);
  parameters.camera.half_width = parameters.camera.half_height = 1e-20f;
  const Picture before = renderer.run("right", parameters);
  try {
    renderer.run("small", parameters);
    ADD_FAILURE() << "a stack of " << kSmallStack << " was enough for a tree of depth " << bvh_.max_depth;
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("traversal stack"));
  }
  const Picture after = renderer.run("right", parameters);
  EXPECT_EQ(std::memcmp(before.records.data(), after.records.data(), before.records.size() * sizeof before.records[0]),
            0);
}

}  // namespace
}  // namespace gleaner::test
