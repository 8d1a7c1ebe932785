// Where the vertices of animated files stand, against a computation of its own in double precision: quaternions turn
// points, Bézier curves stand for Hermite's, logarithms for slerp, and no matrix is made. And what is wrong with moving
// files, said by element.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <random>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/library/bake.h"
#include "scene/model/error.h"
#include "scene/model/frame_state.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

using Floats = std::vector<float>;
using Numbers = std::vector<double>;
using Point = std::array<double, 3>;
using Quaternion = std::array<double, 4>;  // x y z w

Point operator+(const Point& a, const Point& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Point operator-(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Point operator*(double s, const Point& a) { return {s * a[0], s * a[1], s * a[2]}; }
Point cross_of(const Point& a, const Point& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
double length_of(const Point& a) { return std::hypot(a[0], a[1], a[2]); }

Quaternion multiply(const Quaternion& a, const Quaternion& b) {
  return {a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1], a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
          a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3], a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]};
}
Quaternion conjugate(const Quaternion& q) { return {-q[0], -q[1], -q[2], q[3]}; }
Quaternion unit_of(Quaternion q) {
  const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (double& x : q) x /= length;
  return q;
}
Point turn(const Quaternion& q, const Point& p) {
  const Quaternion r = multiply(multiply(q, {p[0], p[1], p[2], 0}), conjugate(q));
  return {r[0], r[1], r[2]};
}

// q to the power t: a turn about the same axis by t times the angle, which is at most half a turn.
Quaternion power(Quaternion q, double t) {
  if (q[3] < 0) q = {-q[0], -q[1], -q[2], -q[3]};
  const double sine = std::hypot(q[0], q[1], q[2]), angle = std::atan2(sine, q[3]);
  const double scale = sine > 0 ? std::sin(t * angle) / sine : 0;
  return {scale * q[0], scale * q[1], scale * q[2], std::cos(t * angle)};
}

struct Channel {
  std::size_t node = 0;
  std::string path, interpolation;
  Floats times;
  Numbers values;  // as a reader has them; cubic splines: in-tangent, value, out-tangent of each key
  std::size_t size = 3;

  Numbers key(std::size_t k, std::size_t part) const {
    const std::size_t parts = interpolation == "CUBICSPLINE" ? 3 : 1;
    const auto begin = values.begin() + static_cast<std::ptrdiff_t>((k * parts + (parts == 3 ? part : 0)) * size);
    return {begin, begin + static_cast<std::ptrdiff_t>(size)};
  }
  Numbers at(double seconds) const {
    std::size_t k = 0;
    while (k + 1 < times.size() && times[k + 1] <= seconds) ++k;
    const Numbers from = key(k, 1);
    if (interpolation == "STEP" || seconds <= times.front() || k + 1 == times.size()) return from;
    const double span = double(times[k + 1]) - times[k], t = (seconds - times[k]) / span;
    const Numbers to = key(k + 1, 1);
    Numbers result(size);
    if (interpolation == "CUBICSPLINE") {
      const Numbers leaving = key(k, 2), arriving = key(k + 1, 0);
      for (std::size_t i = 0; i < size; ++i) {
        // De Casteljau's algorithm.
        std::array<double, 4> c = {from[i], from[i] + span * leaving[i] / 3, to[i] - span * arriving[i] / 3, to[i]};
        for (int level = 3; level > 0; --level)
          for (int j = 0; j < level; ++j) c[j] = (1 - t) * c[j] + t * c[j + 1];
        result[i] = c[0];
      }
    } else if (path == "rotation") {
      const Quaternion a = unit_of({from[0], from[1], from[2], from[3]}), b = unit_of({to[0], to[1], to[2], to[3]});
      const Quaternion q = multiply(a, power(multiply(conjugate(a), b), t));
      result.assign(q.begin(), q.end());
    } else {
      for (std::size_t i = 0; i < size; ++i) result[i] = (1 - t) * from[i] + t * to[i];
    }
    return result;
  }
};

// A file of three meshes of random triangles: one on a chain of three joints, one rigid under a parent, one with two
// morph targets. All that moves them is random, in the three interpolations.
class Motion : public testing::Test {
 protected:
  static constexpr std::size_t kVertices = 60, kJoints = 3;
  enum Node : std::size_t { kSkinned, kJoint0, kJoint1, kJoint2, kParent, kRigid, kMorphed };

  Motion() {
    file_.json["materials"] = json::array({{{"doubleSided", true}}});
    file_.json["meshes"] = json::array();
    for (std::size_t m = 0; m < 3; ++m) add_mesh(m);
    json& skinned = file_.json["meshes"][0]["primitives"][0];
    std::vector<std::uint8_t> joints(4 * kVertices);
    weights_.resize(4 * kVertices);
    for (std::size_t i = 0; i < joints.size(); ++i) {
      joints[i] = static_cast<std::uint8_t>(random_() % kJoints);
      weights_[i] = number(0.05, 1);
    }
    joints_ = joints;
    skinned["attributes"]["JOINTS_0"] = file_.add(joints, 5121, "VEC4");
    skinned["attributes"]["WEIGHTS_0"] = file_.add(weights_, 5126, "VEC4");
    for (std::size_t j = 0; j < kJoints; ++j) {
      for (std::size_t i = 0; i < 16; ++i)
        binds_.push_back(i % 4 == 3 ? (i == 15) : number(-0.3, 0.3) + (i % 5 == 0 ? 1.0f : 0.0f));
    }
    file_.json["skins"] = {{{"joints", {1, 2, 3}}, {"inverseBindMatrices", file_.add(binds_, 5126, "MAT4")}}};
    for (std::size_t t = 0; t < 2; ++t) {
      deltas_[t] = numbers(3 * kVertices, -1, 1);
      file_.json["meshes"][2]["primitives"][0]["targets"].push_back(
          {{"POSITION", file_.add(deltas_[t], 5126, "VEC3")}});
    }
    file_.json["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"translation", {50, 0, 0}}},
                           {{"children", {2}}},
                           {{"children", {3}}, {"translation", {0.5, 0.25, 0}}},
                           {{"translation", {0, 1, 0}}},
                           {{"children", {5}}},
                           {{"mesh", 1}, {"translation", {1, 2, 3}}},
                           {{"mesh", 2}}};
    file_.json["scenes"][0]["nodes"] = {0, 1, 4, 6};
    file_.json["animations"] = {{{"channels", json::array()}, {"samplers", json::array()}}};
    animate(kJoint0, "rotation", "LINEAR", 4);
    animate(kJoint0, "translation", "CUBICSPLINE", 3);
    animate(kJoint1, "rotation", "CUBICSPLINE", 4);
    animate(kJoint1, "scale", "STEP", 3);
    animate(kJoint2, "translation", "LINEAR", 3);
    animate(kJoint2, "scale", "LINEAR", 3);
    animate(kParent, "translation", "STEP", 3);
    animate(kParent, "rotation", "STEP", 4);
    animate(kRigid, "rotation", "LINEAR", 4);
    animate(kRigid, "scale", "CUBICSPLINE", 3);
    animate(kMorphed, "weights", "CUBICSPLINE", 2);
    animate(kMorphed, "translation", "LINEAR", 3);
  }

  float number(double least, double most) {
    return static_cast<float>(std::uniform_real_distribution<double>(least, most)(random_));
  }
  Floats numbers(std::size_t count, double least, double most) {
    Floats all(count);
    for (float& x : all) x = number(least, most);
    return all;
  }

  void add_mesh(std::size_t m) {
    rest_[m] = numbers(3 * kVertices, -1, 1);
    normals_[m] = numbers(3 * kVertices, -1, 1);
    for (std::size_t v = 0; v < kVertices; ++v) {
      float* n = &normals_[m][3 * v];
      const auto length = static_cast<float>(std::hypot(n[0], n[1], n[2]));
      for (int c = 0; c < 3; ++c) n[c] /= length;
    }
    json attributes = {{"POSITION", file_.add(rest_[m], 5126, "VEC3")},
                       {"NORMAL", file_.add(normals_[m], 5126, "VEC3")}};
    file_.json["meshes"].push_back({{"primitives", {{{"attributes", attributes}, {"material", 0}}}}});
  }

  void animate(std::size_t node, const std::string& path, const std::string& interpolation, std::size_t size) {
    Channel channel{node, path, interpolation, {}, {}, size};
    for (float time = number(0, 0.3); channel.times.size() < 5; time += number(0.1, 0.7)) channel.times.push_back(time);
    const bool spline = interpolation == "CUBICSPLINE", rotation = path == "rotation", scale = path == "scale";
    Floats values;
    for (std::size_t k = 0; k < channel.times.size(); ++k)
      for (int part = spline ? 0 : 1; part < (spline ? 3 : 2); ++part) {
        Floats one = part == 1 && scale ? numbers(size, 0.5, 2) : numbers(size, -1, 1);
        if (part != 1)
          for (float& x : one) x *= 0.2f;
        if (part == 1 && rotation) {
          // Joints that turned further would turn the mesh between them inside out.
          if (node != kRigid) one[3] += 2;
          const Quaternion q = unit_of({one[0], one[1], one[2], one[3]});
          for (std::size_t i = 0; i < 4; ++i) one[i] = static_cast<float>(q[i]);
        }
        values.insert(values.end(), one.begin(), one.end());
      }
    channel.values.assign(values.begin(), values.end());
    json& animation = file_.json["animations"][0];
    const std::size_t sampler = animation["samplers"].size();
    animation["samplers"].push_back({{"input", file_.add(channel.times, 5126, "SCALAR")},
                                     {"output", file_.add(values, 5126,
                                                          path == "weights" ? "SCALAR"
                                                          : size == 4       ? "VEC4"
                                                                            : "VEC3")},
                                     {"interpolation", interpolation}});
    animation["channels"].push_back({{"sampler", sampler}, {"target", {{"node", node}, {"path", path}}}});
    channels_.push_back(channel);
  }

  // What a node's property is at a time: animated, or the file's.
  Numbers property(std::size_t node, const std::string& path, const Numbers& usual, double seconds) const {
    for (const Channel& channel : channels_)
      if (channel.node == node && channel.path == path) return channel.at(seconds);
    return file_.json["nodes"][node].value(path, usual);
  }
  Point local(std::size_t node, const Point& p, double seconds) const {
    const Numbers t = property(node, "translation", {0, 0, 0}, seconds),
                  s = property(node, "scale", {1, 1, 1}, seconds);
    const Numbers r = property(node, "rotation", {0, 0, 0, 1}, seconds);
    return Point{t[0], t[1], t[2]} + turn(unit_of({r[0], r[1], r[2], r[3]}), {s[0] * p[0], s[1] * p[1], s[2] * p[2]});
  }
  Point world(std::size_t node, Point p, double seconds) const {
    static const std::map<std::size_t, std::size_t> parents = {
        {kJoint1, kJoint0}, {kJoint2, kJoint1}, {kRigid, kParent}};
    for (;;) {
      p = local(node, p, seconds);
      const auto parent = parents.find(node);
      if (parent == parents.end()) return p;
      node = parent->second;
    }
  }
  // Where a point at rest, moving with a vertex, is.
  Point placed(std::size_t mesh, std::size_t vertex, Point p, double seconds) const {
    if (mesh == 1) return world(kRigid, p, seconds);
    if (mesh == 2) {
      const Numbers weights = property(kMorphed, "weights", {0, 0}, seconds);
      for (std::size_t t = 0; t < 2; ++t) {
        const float* delta = &deltas_[t][3 * vertex];
        p = p + weights[t] * Point{delta[0], delta[1], delta[2]};
      }
      return world(kMorphed, p, seconds);
    }
    Point sum{};
    double weights = 0;
    for (std::size_t i = 4 * vertex; i < 4 * vertex + 4; ++i) {
      const float* b = &binds_[16 * std::size_t{joints_[i]}];
      Point bound;
      for (std::size_t c = 0; c < 3; ++c) bound[c] = b[c] * p[0] + b[4 + c] * p[1] + b[8 + c] * p[2] + b[12 + c];
      sum = sum + weights_[i] * world(kJoint0 + joints_[i], bound, seconds);
      weights += weights_[i];
    }
    return (1 / weights) * sum;
  }

  std::mt19937_64 random_{12};
  Folder folder_;
  GltfFile file_;
  Floats rest_[3], normals_[3], deltas_[2], weights_, binds_;
  std::vector<std::uint8_t> joints_;
  std::vector<Channel> channels_;
};

// Two directions that span the plane across a normal, right-handed with it.
std::array<Point, 2> across(const Point& n) {
  const Point helper = std::abs(n[0]) < 0.6 ? Point{1, 0, 0} : Point{0, 1, 0};
  const Point first = cross_of(helper, n);
  return {first, cross_of(n, first)};
}

// What stands in the world of a mesh of the file: its vertices are those of the baked scene, in its order, since its
// triangles name one after the other.
TEST_F(Motion, VerticesStandWhereTheyShouldAtTenTimes) {
  double worst = 0, worst_normal = 0;
  for (const bool instances : {true, false}) {
    ImportOptions options;
    options.instances = instances;
    MovingScene file(folder_.write("scene.glb", file_.glb()), options);
    ASSERT_TRUE(file.moves());
    const Scene base = parse_scene(serialize(file.base()), "base");
    // What is rigid is an instance.
    ASSERT_EQ(base.rig.meshes.size(), instances ? 2u : 3u);
    ASSERT_EQ(base.rig.instances.size(), instances ? 1u : 0u);
    // Copies come before instances.
    const std::array<std::size_t, 3> order =
        instances ? std::array<std::size_t, 3>{0, 2, 1} : std::array<std::size_t, 3>{0, 1, 2};
    for (const double seconds : {-1.0, 0.0, 0.2, 0.45, 0.7, double(channels_[0].times[2]), 1.3, 1.7, 2.2, 9.0}) {
      const auto frame = file.at(seconds);
      ASSERT_TRUE(frame) << seconds;
      const Scene shown = posed(base, parse_frame_state(serialize(frame->state), "state"), "frame");
      const Scene all = baked(shown);
      ASSERT_EQ(all.vertex_count(), 3 * kVertices);
      for (std::size_t i = 0; i < all.vertex_count(); ++i) {
        const std::size_t m = order[i / kVertices], v = i % kVertices;
        const float* at = &rest_[m][3 * v];
        const Point p = {at[0], at[1], at[2]}, expected = placed(m, v, p, seconds);
        const float *found = &all.positions[3 * i], *turned = &all.normals[3 * i], *n = &normals_[m][3 * v];
        const double error = length_of(Point{found[0], found[1], found[2]} - expected) / length_of(expected);
        EXPECT_LT(error, 1e-5) << "mesh " << m << ", vertex " << v << ", " << seconds << " s";
        worst = std::max(worst, error);
        // A normal stays across the surface: the two directions across it, moved, say where it points.
        const auto [a, b] = across({n[0], n[1], n[2]});
        Point normal = cross_of(placed(m, v, p + a, seconds) - expected, placed(m, v, p + b, seconds) - expected);
        const Point along = placed(m, v, p + Point{n[0], n[1], n[2]}, seconds) - expected;
        const double side = normal[0] * along[0] + normal[1] * along[1] + normal[2] * along[2] < 0 ? -1 : 1;
        normal = (side / length_of(normal)) * normal;
        const double off = length_of(Point{turned[0], turned[1], turned[2]} - normal);
        EXPECT_LT(off, 1e-5) << "mesh " << m << ", vertex " << v << ", " << seconds << " s";
        worst_normal = std::max(worst_normal, off);
      }
      // A scene of its own is the same to the bit.
      const Scene own = file.scene_at(seconds);
      EXPECT_EQ(shown.positions, own.positions) << seconds;
      EXPECT_TRUE(same_bytes(shown.instances, own.instances)) << seconds;
    }
  }
  std::cout << "largest relative error of a position " << worst << ", of a normal " << worst_normal << "\n";
}

TEST_F(Motion, WhatIsWrongIsSaidByElement) {
  const GltfFile good = file_;
  const auto refused = [&](const std::function<void(json&)>& damage) -> std::string {
    file_ = good;
    damage(file_.json);
    try {
      MovingScene file(folder_.write("scene.glb", file_.glb()));
      file.at(0.5);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      return error.what();
    }
    return "";
  };
  ASSERT_EQ(refused([](json&) {}), "");
  const auto with_nan = [&](std::size_t count) {
    Floats values(count, 0.5f);
    values[count / 2] = NAN;
    return values;
  };
  EXPECT_THAT(refused([](json& j) { j["animations"][0]["channels"][1]["target"]["node"] = 70; }),
              AllOf(HasSubstr("animations[0].channels[1].target.node"), HasSubstr("70")));
  EXPECT_THAT(refused([](json& j) { j["animations"][0]["channels"][1]["sampler"] = 70; }),
              AllOf(HasSubstr("animations[0].channels[1].sampler"), HasSubstr("70")));
  EXPECT_THAT(refused([&](json& j) {
                j["animations"][0]["samplers"][2]["input"] = file_.add(Floats{0, 1, 1, 2, 3}, 5126, "SCALAR");
              }),
              AllOf(HasSubstr("animations[0].samplers[2].input"), HasSubstr("rise"), HasSubstr("element 2")));
  EXPECT_THAT(
      refused([&](json& j) { j["animations"][0]["samplers"][0]["output"] = file_.add(with_nan(20), 5126, "VEC4"); }),
      AllOf(HasSubstr("animations[0].samplers[0].output"), HasSubstr("finite"), HasSubstr("element 2")));
  EXPECT_THAT(refused([&](json& j) {
                j["animations"][0]["samplers"][0]["output"] = file_.add(numbers(16, 0, 1), 5126, "VEC4");
              }),
              AllOf(HasSubstr("animations[0].samplers[0].output"), HasSubstr("5 values of 4"), HasSubstr("16")));
  // As many weights as the mesh has targets.
  EXPECT_THAT(refused([&](json& j) {
                j["animations"][0]["samplers"][10]["output"] = file_.add(numbers(45, 0, 1), 5126, "SCALAR");
              }),
              AllOf(HasSubstr("animations[0].samplers[10].output"), HasSubstr("2")));
  EXPECT_THAT(refused([](json& j) { j["skins"][0]["joints"][2] = 70; }),
              AllOf(HasSubstr("skins[0].joints[2]"), HasSubstr("70")));
  EXPECT_THAT(refused([&](json& j) {
                std::vector<std::uint8_t> joints = joints_;
                joints[5] = 3;
                j["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = file_.add(joints, 5121, "VEC4");
              }),
              AllOf(HasSubstr("meshes[0].primitives[0].attributes.JOINTS_0"), HasSubstr("joints below 3")));
  EXPECT_THAT(refused([&](json& j) {
                j["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] =
                    file_.add(with_nan(4 * kVertices), 5126, "VEC4");
              }),
              AllOf(HasSubstr("meshes[0].primitives[0].attributes.WEIGHTS_0"), HasSubstr("finite")));
  EXPECT_THAT(
      refused([&](json& j) { j["skins"][0]["inverseBindMatrices"] = file_.add(with_nan(16 * kJoints), 5126, "MAT4"); }),
      AllOf(HasSubstr("skins[0].inverseBindMatrices"), HasSubstr("finite")));
  EXPECT_THAT(refused([&](json& j) {
                j["meshes"][2]["primitives"][0]["targets"][1]["POSITION"] =
                    file_.add(with_nan(3 * kVertices), 5126, "VEC3");
              }),
              AllOf(HasSubstr("meshes[2].primitives[0].targets[1].POSITION"), HasSubstr("finite")));
  EXPECT_THAT(refused([&](json& j) {
                j["meshes"][2]["primitives"][0]["targets"][1]["POSITION"] = file_.add(numbers(30, 0, 1), 5126, "VEC3");
              }),
              AllOf(HasSubstr("meshes[2].primitives[0].targets[1].POSITION"), HasSubstr("60")));
}

}  // namespace
}  // namespace gleaner::scene
