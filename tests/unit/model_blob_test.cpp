#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "model_scene.h"
#include "scene/model/blob.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using testing::HasSubstr;

std::string rejection(std::span<const std::byte> bytes) {
  try {
    parse_scene(bytes, "blob");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::bad_input);
    return error.what();
  }
  return "";
}

TEST(SceneBlob, ComesBackWhole) {
  for (const Scene& scene : {Scene{}, square(), rich_square()}) {
    const Bytes bytes = serialize(scene);
    const Scene back = parse_scene(bytes, "blob");
    EXPECT_EQ(serialize(back), bytes);
    EXPECT_EQ(back.name, scene.name);
    EXPECT_EQ(back.positions, scene.positions);
    EXPECT_EQ(back.normals, scene.normals);
    EXPECT_EQ(back.uvs, scene.uvs);
    EXPECT_EQ(back.indices, scene.indices);
    EXPECT_EQ(back.triangle_material, scene.triangle_material);
    EXPECT_EQ(back.material_names, scene.material_names);
    EXPECT_EQ(back.texels, scene.texels);
    EXPECT_EQ(back.albedo_tables, scene.albedo_tables);
    EXPECT_EQ(back.environment.width, scene.environment.width);
    EXPECT_EQ(back.environment.height, scene.environment.height);
    EXPECT_EQ(back.environment.radiance, scene.environment.radiance);
    const auto same = [](const auto& a, const auto& b) {
      return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof a[0]) == 0);
    };
    EXPECT_TRUE(same(back.materials, scene.materials));
    EXPECT_TRUE(same(back.textures, scene.textures));
    EXPECT_TRUE(same(back.lights, scene.lights));
    ASSERT_EQ(back.meshes.size(), scene.meshes.size());
    for (std::size_t i = 0; i < scene.meshes.size(); ++i) {
      EXPECT_EQ(back.meshes[i].name, scene.meshes[i].name);
      EXPECT_EQ(back.meshes[i].first_triangle, scene.meshes[i].first_triangle);
      EXPECT_EQ(back.meshes[i].triangle_count, scene.meshes[i].triangle_count);
    }
    ASSERT_EQ(back.cameras.size(), scene.cameras.size());
    for (std::size_t i = 0; i < scene.cameras.size(); ++i) {
      EXPECT_EQ(back.cameras[i].name, scene.cameras[i].name);
      EXPECT_EQ(back.cameras[i].width, scene.cameras[i].width);
      EXPECT_EQ(back.cameras[i].height, scene.cameras[i].height);
      EXPECT_EQ(back.cameras[i].aspect, scene.cameras[i].aspect);
      EXPECT_EQ(std::memcmp(&back.cameras[i].camera, &scene.cameras[i].camera, sizeof(Camera)), 0);
    }
  }
}

TEST(SceneBlob, IsTheSameBytesForTheSameScene) {
  Scene scene = rich_square();
  const Bytes bytes = serialize(scene);
  EXPECT_EQ(serialize(scene), bytes);
  scene.warnings.push_back("what a person should know does not travel");
  EXPECT_EQ(serialize(scene), bytes);
  scene.texels[1] ^= 1;
  EXPECT_NE(serialize(scene), bytes);
}

TEST(SceneBlob, SectionsAreAligned) {
  const Bytes bytes = serialize(rich_square());
  std::uint32_t sections;
  std::memcpy(&sections, bytes.data() + 12, sizeof sections);
  ASSERT_GT(sections, 0u);
  for (std::uint32_t i = 0; i < sections; ++i) {
    std::uint64_t offset;
    std::memcpy(&offset, bytes.data() + 24 + 24 * i + 8, sizeof offset);
    EXPECT_EQ(offset % 64, 0u) << i;
  }
}

TEST(SceneBlob, NoBeginningOfItIsTaken) {
  const Bytes bytes = serialize(rich_square());
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    // A copy of its own, so that reading past the end is seen by a sanitizer.
    const Bytes beginning(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
    EXPECT_NE(rejection(beginning), "") << length;
  }
  Bytes longer = bytes;
  longer.push_back(std::byte{0});
  EXPECT_NE(rejection(longer), "");
  const std::uint64_t length = longer.size();  // even where the header knows of it
  std::memcpy(longer.data() + 16, &length, sizeof length);
  EXPECT_THAT(rejection(longer), HasSubstr("end"));
}

TEST(SceneBlob, NothingElseIsTakenForOne) {
  EXPECT_THAT(rejection(serialize(Bvh{{BvhNode{}}, {}, {{GLEANER_NONE, 0, 1, 0, 0}}, 1})), HasSubstr("magic"));
  Bytes bytes = serialize(square());
  bytes[8] = std::byte{9};
  EXPECT_THAT(rejection(bytes), HasSubstr("version"));
}

// Sizes near 2^64 must not wrap around on their way to a check.
TEST(SceneBlob, SizesThatOverflowAreRefused) {
  const Bytes good = serialize(rich_square());
  for (std::uint32_t section = 0; section < 17; ++section) {
    for (const std::uint64_t value : {~0ull, ~0ull - 63, 1ull << 63, (1ull << 62) + 1, 1ull << 40}) {
      for (const std::size_t field : {8u, 16u}) {
        Bytes bytes = good;
        std::memcpy(bytes.data() + 24 + 24 * section + field, &value, sizeof value);
        EXPECT_NE(rejection(bytes), "") << section << " " << value << " " << field;
      }
    }
  }
}

// Whatever a flipped bit does, what comes out is an error or a scene that holds every promise.
TEST(SceneBlob, FlippedBitsNeverGetPastTheChecks) {
  const Bytes good = serialize(rich_square());
  std::mt19937 random(3);
  int taken = 0;
  for (int i = 0; i < 20000; ++i) {
    Bytes bytes = good;
    const int flips = 1 + i % 3;
    // Two of three hit the header and the table, where damage is worst.
    for (int f = 0; f < flips; ++f)
      bytes[random() % (i % 3 ? 24 + 17 * 24 : bytes.size())] ^= std::byte(1u << random() % 8);
    try {
      const Scene scene = parse_scene(bytes, "blob");
      ASSERT_NO_THROW(validate(scene, "blob"));
      needs_of(scene);
      ++taken;
    } catch (const Error& error) {
      ASSERT_EQ(error.kind(), ErrorKind::bad_input);
    }
  }
  EXPECT_GT(taken, 0);  // a flip in a colour is a colour
}

// --- BVH -----------------------------------------------------------------------------------------------------------

gl_uint leaf(gl_uint first, gl_uint count) { return GLEANER_BVH_LEAF | count << 27 | first; }

// A root over a leaf and a node over two leaves.
Bvh small_bvh() {
  Bvh bvh;
  bvh.nodes.resize(2);
  bvh.nodes[0].child[0] = leaf(0, 1);
  bvh.nodes[0].child[1] = 1;
  bvh.nodes[1].child[0] = leaf(1, 2);
  bvh.nodes[1].child[1] = leaf(3, 1);
  bvh.triangles = {3, 0, 1, 2};
  bvh.parts = {{GLEANER_NONE, 0, 2, 0, 4}};
  bvh.max_depth = 2;
  return bvh;
}

std::string bvh_rejection(const Bvh& bvh, std::size_t triangles = 4) {
  try {
    parse_bvh(serialize(bvh), triangles, "blob");
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

TEST(BvhBlob, ComesBackWhole) {
  const Bytes bytes = serialize(small_bvh());
  const Bvh back = parse_bvh(bytes, 4, "blob");
  EXPECT_EQ(serialize(back), bytes);
  EXPECT_EQ(back.triangles, small_bvh().triangles);
  EXPECT_EQ(back.max_depth, 2u);
  EXPECT_EQ(back.nodes.size(), 2u);
}

TEST(BvhBlob, RefusesWhatATraversalWouldTripOver) {
  EXPECT_THAT(bvh_rejection(small_bvh(), 3), HasSubstr("triangles[0]"));
  Bvh bvh = small_bvh();
  bvh.nodes[0].child[1] = 2;
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes[0]"));
  bvh = small_bvh();
  bvh.nodes[1].child[1] = 0;  // a way back to the root
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes[1]"));
  bvh = small_bvh();
  bvh.nodes[1].child[1] = 1;  // itself
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes[1]"));
  bvh = small_bvh();
  bvh.nodes[1].child[1] = leaf(3, 2);
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes[1]"));
  bvh = small_bvh();
  bvh.nodes[1].child[1] = leaf(0x07ffffff, 15);
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes[1]"));
  bvh = small_bvh();
  bvh.max_depth = 1;
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("max_depth"));
  bvh = small_bvh();
  bvh.nodes[1].upper0[2] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes[1]"));
  bvh.nodes.clear();
  EXPECT_THAT(bvh_rejection(bvh), HasSubstr("nodes"));
}

TEST(BvhBlob, NoBeginningOfItIsTaken) {
  const Bytes bytes = serialize(small_bvh());
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    const Bytes beginning(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
    EXPECT_THROW(parse_bvh(beginning, 4, "blob"), Error) << length;
  }
}

}  // namespace
}  // namespace gleaner::scene
