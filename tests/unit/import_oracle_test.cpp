// Where the vertices of animated files stand, against an evaluation of the file's own JSON and bytes in double
// precision that shares nothing with the importer: points go up the nodes one by one, and rotations are applied to
// points as quaternions.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <span>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/library/library.h"
#include "scene/model/frame_state.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using Doubles = std::vector<double>;
using Point = std::array<double, 3>;

class Oracle {
 public:
  explicit Oracle(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    const std::string all{std::istreambuf_iterator<char>(file), {}};
    std::uint32_t length = 0;
    std::memcpy(&length, all.data() + 12, 4);
    json_ = json::parse(all.substr(20, length));
    binary_ = all.substr(20 + length + 8);
    parents_.assign(json_["nodes"].size(), -1);
    for (std::size_t n = 0; n < parents_.size(); ++n)
      for (const std::size_t child : json_["nodes"][n].value("children", std::vector<std::size_t>{}))
        parents_[child] = static_cast<int>(n);
  }

  double length() const {
    double last = 0;
    for (const json& sampler : json_["animations"][0]["samplers"])
      last = std::max(last, numbers(sampler["input"]).back());
    return last;
  }

  // All vertices, by the nodes that have meshes, as the scene's nodes are walked.
  std::vector<std::vector<Point>> vertices(double seconds) {
    pose(seconds);
    std::vector<std::vector<Point>> all;
    for (const std::size_t root : json_["scenes"][0]["nodes"]) walk(root, all);
    return all;
  }

 private:
  Doubles numbers(std::size_t accessor) const {
    const json& a = json_["accessors"][accessor];
    const std::map<std::string, std::size_t> widths = {{"SCALAR", 1}, {"VEC3", 3}, {"VEC4", 4}, {"MAT4", 16}};
    const std::size_t count = a["count"].get<std::size_t>() * widths.at(a["type"]);
    const char* at = binary_.data() + json_["bufferViews"][a["bufferView"].get<std::size_t>()].value("byteOffset", 0);
    Doubles result(count);
    for (std::size_t i = 0; i < count; ++i) {
      float f = 0;
      std::uint16_t u = 0;
      if (a["componentType"] == 5126)
        std::memcpy(&f, at + 4 * i, 4);
      else
        std::memcpy(&u, at + 2 * i, 2);
      result[i] = a["componentType"] == 5126 ? f : u;
    }
    return result;
  }

  // A channel's value, by the formulas of glTF 2.0, appendix C.
  Doubles value(const json& sampler, double seconds, bool rotation) const {
    const Doubles times = numbers(sampler["input"]), values = numbers(sampler["output"]);
    const std::string how = sampler.value("interpolation", "LINEAR");
    const bool spline = how == "CUBICSPLINE";
    const std::size_t width = values.size() / times.size() / (spline ? 3 : 1);
    const auto key = [&](std::size_t k, std::size_t part) {
      const auto first = values.begin() + static_cast<std::ptrdiff_t>((spline ? 3 * k + part : k) * width);
      return Doubles(first, first + static_cast<std::ptrdiff_t>(width));
    };
    if (seconds <= times.front()) return key(0, 1);
    if (seconds >= times.back()) return key(times.size() - 1, 1);
    std::size_t k = 0;
    while (times[k + 1] <= seconds) ++k;
    const double d = times[k + 1] - times[k], t = (seconds - times[k]) / d;
    const Doubles a = key(k, 1), b = key(k + 1, 1);
    if (how == "STEP") return a;
    Doubles result(width);
    if (spline) {
      const Doubles out = key(k, 2), in = key(k + 1, 0);
      for (std::size_t i = 0; i < width; ++i)
        result[i] = (2 * t * t * t - 3 * t * t + 1) * a[i] + d * (t * t * t - 2 * t * t + t) * out[i] +
                    (-2 * t * t * t + 3 * t * t) * b[i] + d * (t * t * t - t * t) * in[i];
      return result;
    }
    double cosine = 0;
    for (std::size_t i = 0; i < width; ++i) cosine += a[i] * b[i];
    const double angle = std::acos(std::min(1.0, std::abs(cosine))), sign = cosine < 0 ? -1 : 1;
    const bool slerp = rotation && angle > 1e-6;
    const double of_a = slerp ? std::sin((1 - t) * angle) / std::sin(angle) : 1 - t;
    const double of_b = slerp ? sign * std::sin(t * angle) / std::sin(angle) : rotation ? sign * t : t;
    for (std::size_t i = 0; i < width; ++i) result[i] = of_a * a[i] + of_b * b[i];
    return result;
  }

  void pose(double seconds) {
    for (const json& animation : json_["animations"])
      for (const json& channel : animation["channels"]) {
        const std::string path = channel["target"]["path"];
        json_["nodes"][channel["target"]["node"].get<std::size_t>()][path] =
            value(animation["samplers"][channel["sampler"].get<std::size_t>()], seconds, path == "rotation");
      }
  }

  // From the node's space to that of its parent.
  Point placed(const json& node, Point p) const {
    if (node.contains("matrix")) return by_matrix(node["matrix"].get<Doubles>(), p);
    const Doubles s = node.value("scale", Doubles{1, 1, 1}), t = node.value("translation", Doubles{0, 0, 0});
    Doubles q = node.value("rotation", Doubles{0, 0, 0, 1});
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (double& x : q) x /= norm;
    for (std::size_t c = 0; c < 3; ++c) p[c] *= s[c];
    // v + 2 w (u x v) + 2 u x (u x v)
    const Point once = {q[1] * p[2] - q[2] * p[1], q[2] * p[0] - q[0] * p[2], q[0] * p[1] - q[1] * p[0]};
    const Point twice = {q[1] * once[2] - q[2] * once[1], q[2] * once[0] - q[0] * once[2],
                         q[0] * once[1] - q[1] * once[0]};
    for (std::size_t c = 0; c < 3; ++c) p[c] += 2 * (q[3] * once[c] + twice[c]) + t[c];
    return p;
  }
  static Point by_matrix(const Doubles& m, const Point& p) {
    Point q;
    for (std::size_t c = 0; c < 3; ++c) q[c] = m[c] * p[0] + m[4 + c] * p[1] + m[8 + c] * p[2] + m[12 + c];
    return q;
  }
  Point in_world(std::size_t node, Point p) const {
    for (int n = static_cast<int>(node); n >= 0; n = parents_[static_cast<std::size_t>(n)])
      p = placed(json_["nodes"][static_cast<std::size_t>(n)], p);
    return p;
  }

  void walk(std::size_t index, std::vector<std::vector<Point>>& all) const {
    const json& node = json_["nodes"][index];
    if (node.contains("mesh")) {
      all.emplace_back();
      for (const json& primitive : json_["meshes"][node["mesh"].get<std::size_t>()]["primitives"])
        add(index, node, primitive, all.back());
    }
    for (const std::size_t child : node.value("children", std::vector<std::size_t>{})) walk(child, all);
  }

  void add(std::size_t index, const json& node, const json& primitive, std::vector<Point>& all) const {
    Doubles rest = numbers(primitive["attributes"]["POSITION"]);
    const Doubles weights =
        node.value("weights", json_["meshes"][node["mesh"].get<std::size_t>()].value("weights", Doubles{}));
    for (std::size_t t = 0; t < weights.size() && primitive.contains("targets"); ++t) {
      const Doubles deltas = numbers(primitive["targets"][t]["POSITION"]);
      for (std::size_t i = 0; i < rest.size(); ++i) rest[i] += weights[t] * deltas[i];
    }
    Doubles joints, shares, binds;
    const json* skin = node.contains("skin") ? &json_["skins"][node["skin"].get<std::size_t>()] : nullptr;
    if (skin) {
      joints = numbers(primitive["attributes"]["JOINTS_0"]);
      shares = numbers(primitive["attributes"]["WEIGHTS_0"]);
      binds = numbers((*skin)["inverseBindMatrices"]);
    }
    for (std::size_t v = 0; v < rest.size() / 3; ++v) {
      const Point p = {rest[3 * v], rest[3 * v + 1], rest[3 * v + 2]};
      Point sum{};
      for (std::size_t k = 4 * v; skin && k < 4 * v + 4; ++k) {
        const auto joint = static_cast<std::size_t>(joints[k]);
        const auto bind = binds.begin() + static_cast<std::ptrdiff_t>(16 * joint);
        const Point moved =
            in_world((*skin)["joints"][joint].get<std::size_t>(), by_matrix(Doubles(bind, bind + 16), p));
        for (std::size_t c = 0; c < 3; ++c) sum[c] += shares[k] * moved[c];
      }
      all.push_back(skin ? sum : in_world(index, p));
    }
  }

  json json_;
  std::string binary_;
  std::vector<int> parents_;
};

// Where a mesh's vertices stand, as `transform` has them.
std::vector<Point> placed(const Scene& scene, const Mesh& mesh, const gl_float (&transform)[12]) {
  const auto corners = std::span(scene.indices).subspan(std::size_t{3} * mesh.first_triangle, 3 * mesh.triangle_count);
  const auto [least, most] = std::minmax_element(corners.begin(), corners.end());
  std::vector<Point> all;
  for (std::size_t v = *least; v <= *most; ++v) {
    const float* p = &scene.positions[3 * v];
    Point& at = all.emplace_back();
    for (std::size_t c = 0; c < 3; ++c) {
      const gl_float* row = transform + 4 * c;
      at[c] = double{row[0]} * p[0] + double{row[1]} * p[1] + double{row[2]} * p[2] + row[3] + scene.origin[c];
    }
  }
  return all;
}

// The largest distance of a vertex from where it should be, relative to its distance from the world's origin, or from
// things of a tenth of a metre.
double largest_error(const std::vector<Point>& found, const std::vector<Point>& wanted) {
  if (found.size() != wanted.size()) return INFINITY;
  double largest = 0;
  for (std::size_t v = 0; v < wanted.size(); ++v) {
    double error = 0, norm = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      error += std::pow(found[v][c] - wanted[v][c], 2);
      norm += std::pow(wanted[v][c], 2);
    }
    largest = std::max(largest, std::sqrt(error) / std::max(0.1, std::sqrt(norm)));
  }
  return largest;
}

// The scene has a mesh or an instance for each of the wanted, both in their order.
double largest_error(const Scene& scene, const std::vector<std::vector<Point>>& wanted) {
  std::vector<std::vector<Point>> copies, instances;
  constexpr gl_float unmoved[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
  for (const Mesh& mesh : scene.meshes)
    if (!mesh.instanced) copies.push_back(placed(scene, mesh, unmoved));
  for (const Instance& instance : scene.instances)
    instances.push_back(placed(scene, scene.meshes[instance.mesh], instance.transform));
  if (copies.size() + instances.size() != wanted.size()) return INFINITY;
  auto copy = copies.begin(), instance = instances.begin();
  double largest = 0;
  for (const std::vector<Point>& mesh : wanted) {
    const double of_copy = copy == copies.end() ? INFINITY : largest_error(*copy, mesh);
    const double of_instance = instance == instances.end() ? INFINITY : largest_error(*instance, mesh);
    largest = std::max(largest, std::min(of_copy, of_instance));
    if (std::isinf(largest)) return largest;
    if (of_copy <= of_instance)
      ++copy;
    else
      ++instance;
  }
  return largest;
}

// Both ways to a frame's scene: the base in a state, and the file at that time.
void compare_at_ten_times(const std::string& path, bool instances) {
  Oracle oracle(path);
  ImportOptions options;
  options.instances = instances;
  MovingScene file(path, options);
  ASSERT_TRUE(file.moves());
  if (!instances) {
    ASSERT_TRUE(file.base().instances.empty());
  }
  double worst = 0;
  for (int i = 0; i < 10; ++i) {
    const double seconds = oracle.length() * (i * 0.1373 - 0.05);
    const std::vector<std::vector<Point>> wanted = oracle.vertices(seconds);
    const std::optional<ShownFrame> shown = file.at(seconds);
    ASSERT_TRUE(shown) << seconds << " s";
    const Scene base = file.base();
    const double of_state = largest_error(posed(base, shown->state, "state"), wanted);
    const double of_scene = largest_error(file.scene_at(seconds), wanted);
    EXPECT_LE(of_state, 1e-5) << seconds << " s";
    EXPECT_LE(of_scene, 1e-5) << seconds << " s";
    worst = std::max({worst, of_state, of_scene});
  }
  testing::Test::RecordProperty("largest_error", std::to_string(worst));
  std::cout << path.substr(path.rfind('/') + 1) << ": largest relative error " << worst << '\n';
}

class MovingLibrary : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Import, MovingLibrary,
                         testing::Values("swinging-lamp", "turntable", "waving-cloth", "walking-figure"),
                         [](const auto& scene_name) {
                           std::string name = scene_name.param;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

TEST_P(MovingLibrary, VerticesStandWhereTheFileSays) {
  const Folder folder;
  const std::string path = folder.path(std::string(GetParam()) + ".glb");
  write_glb(make_animated_scene(GetParam()), path);
  for (const bool instances : {true, false}) compare_at_ten_times(path, instances);
}

// A skin of two joints with a morph target, and a mesh under two animated nodes: all paths by all interpolations.
GltfFile everything_moves(const std::string& interpolation) {
  GltfFile f;
  const std::vector<float> corners = {0, 0, 0, 1, 0, 0, 0, 1, 0}, deltas = {0, 0, 1, 0.5f, 0, 0, 0, -0.25f, 2};
  const auto matrix = [](float x) {
    return std::vector<float>{1, 0, 0, 0, 0, 0.5f, 0.5f, 0, 0, -0.5f, 0.5f, 0, x, 1, 2, 1};
  };
  std::vector<float> binds = matrix(3);
  const std::vector<float> second = matrix(-2);
  binds.insert(binds.end(), second.begin(), second.end());
  f.primitive()["attributes"] = {{"POSITION", f.add(corners, 5126, "VEC3")}};
  json skinned = f.primitive();
  skinned["attributes"]["JOINTS_0"] =
      f.add(std::vector<std::uint16_t>{0, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0}, 5123, "VEC4");
  skinned["attributes"]["WEIGHTS_0"] =
      f.add(std::vector<float>{1, 0, 0, 0, 0.75f, 0.25f, 0, 0, 0.5f, 0.5f, 0, 0}, 5126, "VEC4");
  skinned["targets"] = {{{"POSITION", f.add(deltas, 5126, "VEC3")}}};
  f.json["meshes"].push_back({{"primitives", {skinned}}, {"weights", {0.5}}});
  f.json["skins"] = {{{"joints", {2, 3}}, {"inverseBindMatrices", f.add(binds, 5126, "MAT4")}}};
  f.json["nodes"] = {{{"children", {1}}, {"scale", {1, 2, 0.5}}},
                     {{"mesh", 0}, {"translation", {0, 1, 0}}},
                     {{"children", {3}}, {"rotation", {0.6, 0, 0, 0.8}}},
                     {{"translation", {0, 0, 3}}},
                     {{"mesh", 1}, {"skin", 0}}};
  f.json["scenes"] = {{{"nodes", {0, 2, 4}}}};
  const std::vector<float> times = {0.25f, 0.5f, 1.5f, 2};
  json animation = {{"channels", json::array()}, {"samplers", json::array()}};
  unsigned salt = 1;
  const auto animate = [&](std::size_t node, const std::string& path, std::size_t width) {
    const std::size_t parts = interpolation == "CUBICSPLINE" ? 3 : 1;
    std::vector<float> values;
    for (std::size_t k = 0; k < times.size(); ++k)
      for (std::size_t part = 0; part < parts; ++part) {
        double norm = 0;
        std::vector<double> value(width);
        for (double& x : value) x = std::sin(12.9898 * salt++), norm += x * x;
        for (double& x : value) {
          if (path == "rotation" && (parts == 1 || part == 1)) x /= std::sqrt(norm);
          if (path == "scale") x = (parts == 1 || part == 1) ? 1 + 0.4 * x : 0.1 * x;  // never through 0
          values.push_back(static_cast<float>(x));
        }
      }
    const std::string type = width == 1 ? "SCALAR" : width == 3 ? "VEC3" : "VEC4";
    animation["channels"].push_back(
        {{"sampler", animation["samplers"].size()}, {"target", {{"node", node}, {"path", path}}}});
    const std::size_t input = f.add(times, 5126, "SCALAR"), output = f.add(values, 5126, type);
    animation["samplers"].push_back({{"input", input}, {"output", output}, {"interpolation", interpolation}});
  };
  for (const std::size_t node : {0, 1, 2, 3}) {
    animate(node, "translation", 3);
    animate(node, "rotation", 4);
    animate(node, "scale", 3);
  }
  animate(4, "weights", 1);
  f.json["animations"] = {animation};
  return f;
}

class Interpolated : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Import, Interpolated, testing::Values("STEP", "LINEAR", "CUBICSPLINE"),
                         [](const auto& how) { return std::string(how.param); });

TEST_P(Interpolated, VerticesStandWhereTheFileSays) {
  const Folder folder;
  for (const bool instances : {true, false})
    compare_at_ten_times(folder.write("everything.glb", everything_moves(GetParam()).glb()), instances);
}

}  // namespace
}  // namespace gleaner::scene
