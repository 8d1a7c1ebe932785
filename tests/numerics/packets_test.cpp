// Blocks of 16 rays of which only some ask: these are answered as if each were alone, the others are left as they were,
// with whatever instructions Embree traces.

#include <cmath>
#include <random>

#include "scene/library/library.h"
#include "tests/numerics/tracing.h"

namespace gleaner::test {
namespace {

// What Embree is told of the instructions that it may use; empty: all that there are.
std::vector<std::string> instructions() {
  std::vector<std::string> names = {""};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("sse4.2")) names.emplace_back("sse4.2");
  if (__builtin_cpu_supports("avx2")) names.emplace_back("avx2");
#endif
  return names;
}

constexpr std::uint32_t kAsked = 1000;  // not a multiple of 16
constexpr std::size_t kFloats = (kAsked + RAY_BLOCK) / RAY_BLOCK * RAY_BLOCK * std::size_t{RAY_HIT_ROWS};

float& at(std::vector<float>& block, std::size_t ray, unsigned row) {
  return block[ray / RAY_BLOCK * (RAY_BLOCK * RAY_HIT_ROWS) + RAY_BLOCK * row + ray % RAY_BLOCK];
}
std::uint32_t word(std::vector<float>& block, std::size_t ray, unsigned row) {
  std::uint32_t word;
  std::memcpy(&word, &at(block, ray, row), sizeof word);
  return word;
}
void set_word(std::vector<float>& block, std::size_t ray, unsigned row, std::uint32_t word) {
  std::memcpy(&at(block, ray, row), &word, sizeof word);
}

// Memory that nobody has written: numbers of all sizes, NaN and negative ones among them.
std::vector<float> junk(std::mt19937& random) {
  std::vector<float> values(kFloats);
  for (float& value : values) {
    const auto bits = static_cast<std::uint32_t>(random());
    std::memcpy(&value, &bits, sizeof bits);
  }
  return values;
}

// Rays in all directions from places near the middle of the unit cube; every third asks nothing, and of these every
// other one looks like a ray but for where it ends.
struct Rays {
  std::vector<float> block;
  std::vector<bool> asks;
};
Rays make_rays(std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(-1, 1);
  Rays rays{junk(random), std::vector<bool>(kFloats / (RAY_BLOCK * RAY_HIT_ROWS) * RAY_BLOCK)};
  for (std::size_t i = 0; i < rays.asks.size(); ++i) {
    rays.asks[i] = i < kAsked && i % 3 != 0;
    // Behind the last one some look as if they asked.
    if (rays.asks[i] || i % 2 == 0) {
      for (unsigned k = 0; k < 3; ++k) {
        at(rays.block, i, ROW_ORIGIN + k) = 0.4f * unit(random) + (k == 1 ? 0.5f : 0.0f);
        at(rays.block, i, ROW_DIRECTION + k) = unit(random);
      }
      at(rays.block, i, ROW_NEAR) = at(rays.block, i, ROW_TIME) = 0;
      at(rays.block, i, ROW_FAR) = kInfinity;
      set_word(rays.block, i, ROW_MASK, 0xffffffffu);
      set_word(rays.block, i, ROW_SOURCE, GLEANER_NONE);
      set_word(rays.block, i, ROW_FLAGS, GLEANER_NONE);
      set_word(rays.block, i, ROW_GEOMETRY, GLEANER_NONE);
    }
    if (!rays.asks[i] && i < kAsked) at(rays.block, i, ROW_FAR) = i % 2 ? -kInfinity : 0.0f;
  }
  return rays;
}

class Packets : public testing::TestWithParam<std::tuple<std::string, std::string>> {
 protected:
  void SetUp() override {
    device_ = open_device(worker::TraceKind::embree);
    if (!device_) GTEST_SKIP() << "NOT TESTED: no OpenCL device here traces with Embree";
    queue_ = device_->make_queue();
    buffer_ = device_->make_buffer(sizeof(float) * kFloats);
    tracer_ = worker::make_embree_tracer(scene_, 1, std::get<1>(GetParam()));
  }

  std::vector<float> answered(const std::vector<float>& rays, Packing packing, bool any) {
    queue_.enqueueWriteBuffer(buffer_, CL_TRUE, 0, sizeof(float) * kFloats, rays.data());
    worker::RayRange range{.rows = RAY_HIT_ROWS};
    (packing == Packing::single ? range.incoherent : range.coherent_count) = kAsked;
    any ? tracer_->any(queue_, buffer_, range) : tracer_->closest(queue_, buffer_, range);
    std::vector<float> answers(kFloats);
    queue_.enqueueReadBuffer(buffer_, CL_TRUE, 0, sizeof(float) * kFloats, answers.data());
    return answers;
  }

  // Rays that asked nothing and have another bit than before.
  static std::size_t touched(Rays& rays, std::vector<float>& answers) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < rays.asks.size(); ++i) {
      if (rays.asks[i]) continue;
      bool same = true;
      for (unsigned row = 0; row < RAY_HIT_ROWS; ++row) same &= word(rays.block, i, row) == word(answers, i, row);
      count += !same;
    }
    return count;
  }

  scene::Scene scene_ = scene::make_scene(std::get<0>(GetParam()));
  std::unique_ptr<worker::Device> device_;
  cl::CommandQueue queue_;
  cl::Buffer buffer_;
  std::unique_ptr<worker::Tracer> tracer_;
};

TEST_P(Packets, AnswerThoseThatAskAndLeaveTheOthersAlone) {
  TracedScene traced(*device_, scene_);  // by all instructions, each ray in a place where all ask
  for (const Packing packing : {Packing::single, Packing::packets}) {
    Rays rays = make_rays(7);
    std::vector<float> hits = answered(rays.block, packing, false), blocked = answered(rays.block, packing, true);
    EXPECT_EQ(touched(rays, hits), 0u) << "closest hits";
    EXPECT_EQ(touched(rays, blocked), 0u) << "any hits";

    std::vector<std::size_t> asking;
    for (std::size_t i = 0; i < rays.asks.size(); ++i)
      if (rays.asks[i]) asking.push_back(i);
    const auto make = [&](std::size_t k) {
      Ray ray{.source_instance = GLEANER_NONE};
      for (unsigned axis = 0; axis < 3; ++axis) {
        ray.origin[axis] = at(rays.block, asking[k], ROW_ORIGIN + axis);
        ray.direction[axis] = at(rays.block, asking[k], ROW_DIRECTION + axis);
      }
      return ray;
    };
    std::size_t found = 0, wrong = 0, odd = 0;
    traced.closest(asking.size(), make, [&](std::size_t k, const Ray&, const Hit& hit) {
      const std::size_t i = asking[k];
      const bool is_hit = word(hits, i, ROW_GEOMETRY) != GLEANER_NONE;
      found += is_hit;
      // By distance: where surfaces touch, either may be hit. Without FMA it is less exact.
      wrong +=
          is_hit != hit.found() || (is_hit && std::fabs(at(hits, i, ROW_FAR) - hit.t) > 1e-4f * std::max(hit.t, 0.1f));
      odd += (at(blocked, i, ROW_FAR) == -kInfinity) != is_hit;
    });
    EXPECT_GT(found, kAsked / 3) << "a test of rays that miss";
    EXPECT_EQ(wrong, 0u) << "closest hits";
    EXPECT_EQ(odd, 0u) << "any hits";
  }
}

INSTANTIATE_TEST_SUITE_P(Instructions, Packets,
                         testing::Combine(testing::Values("cornell-box", "stack"), testing::ValuesIn(instructions())),
                         [](const auto& chosen) {
                           std::string name = std::get<0>(chosen.param) + "_" + std::get<1>(chosen.param);
                           std::ranges::replace_if(
                               name, [](char c) { return !std::isalnum(static_cast<unsigned char>(c)); }, '_');
                           return name;
                         });

}  // namespace
}  // namespace gleaner::test
