// A figure that walks: limbs are tubes that share one skin; each follows two joints, blended where they meet.

#include <cmath>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

enum Joint : std::uint16_t {
  hips,
  left_thigh,
  left_shin,
  right_thigh,
  right_shin,
  left_arm,
  left_forearm,
  right_arm,
  right_forearm,
  joints
};

struct JointPlace {
  const char* name;
  std::int32_t parent;
  std::array<float, 3> pivot;
};
constexpr JointPlace places[joints] = {
    {"hips", -1, {0, 0.9375f, 0}},
    {"left thigh", hips, {0.109375f, 0.9375f, 0}},
    {"left shin", left_thigh, {0.109375f, 0.5f, 0}},
    {"right thigh", hips, {-0.109375f, 0.9375f, 0}},
    {"right shin", right_thigh, {-0.109375f, 0.5f, 0}},
    {"left arm", hips, {0.234375f, 1.4375f, 0}},
    {"left forearm", left_arm, {0.234375f, 1.15625f, 0}},
    {"right arm", hips, {-0.234375f, 1.4375f, 0}},
    {"right forearm", right_arm, {-0.234375f, 1.15625f, 0}},
};

// From top to bottom, rounded at both ends but for a tip that keeps its triangles from being empty.
struct Limb {
  Vec top;
  double length, radius;
  Joint upper, lower;  // equal: one joint carries it
};
constexpr Limb limbs[] = {
    {{0, 1.78, 0}, 0.24, 0.1, hips, hips},    // head
    {{0, 1.53, 0}, 0.65, 0.175, hips, hips},  // trunk
    {{0.109375, 0.98, 0}, 0.96, 0.075, left_thigh, left_shin},
    {{-0.109375, 0.98, 0}, 0.96, 0.075, right_thigh, right_shin},
    {{0.234375, 1.48, 0}, 0.68, 0.05, left_arm, left_forearm},
    {{-0.234375, 1.48, 0}, 0.68, 0.05, right_arm, right_forearm},
};

// The share of the lower joint: from 0 to 1 within 6 cm about its pivot, an eighth at a time, which sums exactly.
double lower_share(const Limb& limb, double y) {
  if (limb.upper == limb.lower) return 0;
  const double t = std::min(1.0, std::max(0.0, (places[limb.lower].pivot[1] + 0.06 - y) / 0.12));
  return std::round(8 * t) / 8;
}

void add_limb(SceneBuilder& b, const Limb& limb, std::uint32_t around, std::uint32_t material, MotionSkin& skin) {
  const std::uint32_t along = 2 * around;
  b.grid(around, along,
         [&](std::uint32_t i, std::uint32_t j) {
           const double t = 1 - 2.0 * j / along, angle = 2 * pi * i / around;
           const double radius = limb.radius * std::sqrt(1 - 0.999 * t * t * t * t);
           const Vec at = limb.top + Vec{radius * std::sin(angle), -limb.length * j / along, radius * std::cos(angle)};
           // Vertices are asked for once, in the order in which the scene has them.
           const auto share = static_cast<float>(lower_share(limb, at.y));
           skin.influences.push_back({{limb.upper, limb.lower}, {1 - share, share}});
           return at;
         },
         material, {.closed_u = true});
}

// About x: from +y towards +z.
void turn(Keys& keys, double time, double radians_about_x) {
  keys.times.push_back(static_cast<float>(time));
  for (const double x : {std::sin(radians_about_x / 2), 0.0, 0.0, std::cos(radians_about_x / 2)})
    keys.values.push_back(static_cast<float>(x));
}

// Two steps a second, of 0.65 m. All angles are 0 at time 0.
void add_gait(std::vector<MotionNode>& nodes, std::uint32_t steps) {
  constexpr std::uint32_t keys_a_step = 8;
  for (std::uint32_t k = 0; k <= steps * keys_a_step; ++k) {
    const double time = 0.5 * k / keys_a_step, phase = 2 * pi * time, lifted = std::sin(phase) * std::sin(phase);
    Keys& way = nodes[hips].moved;
    way.times.push_back(static_cast<float>(time));
    for (const double x : {0.0, -0.02 * lifted, 1.3 * time}) way.values.push_back(static_cast<float>(x));
    for (const bool left : {true, false}) {
      const double forward = (left ? 1 : -1) * std::sin(phase);
      turn(nodes[left ? left_thigh : right_thigh].turned, time, radians(-26) * forward);
      turn(nodes[left ? left_shin : right_shin].turned, time, radians(forward < 0 ? 42 : 16) * lifted);
      turn(nodes[left ? left_arm : right_arm].turned, time, radians(22) * forward);
      turn(nodes[left ? left_forearm : right_forearm].turned, time, radians(-20) * lifted);
    }
  }
}

}  // namespace

AnimatedScene walking_figure(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  MotionSkin skin;
  b.mesh("figure");
  const std::uint32_t skin_material = b.material("figure", dielectric({0.5, 0.22, 0.12}, 0.5));
  for (const Limb& limb : limbs) add_limb(b, limb, values.count("around"), skin_material, skin);
  b.mesh("floor");
  const std::uint32_t floor = b.material("floor", lambert({0.3, 0.34, 0.4}));
  b.quad({-2, 0, 5}, {2.5, 0, 5}, {2.5, 0, -1.5}, {-2, 0, -1.5}, floor);
  b.mesh("wall");
  b.quad({-2, 0, 5}, {-2, 0, -1.5}, {-2, 3, -1.5}, {-2, 3, 5}, b.material("wall", lambert({0.7, 0.68, 0.64})));
  b.mesh("light");
  b.quad({1, 3, 3}, {1, 3, 0}, {2, 2.7, 0}, {2, 2.7, 3}, b.material("light", emitter({12, 12, 11})));
  b.camera("camera", {4.5, 1.5, 1.9}, {0, 0.9, 1.2}, 42, 512, 384);

  AnimatedScene made{b.finish(), {}};
  for (std::uint32_t j = 0; j < joints; ++j) {
    made.motion.nodes.push_back({.name = places[j].name, .parent = places[j].parent, .pivot = places[j].pivot});
    skin.joints.push_back(j);
  }
  add_gait(made.motion.nodes, values.count("steps"));
  made.motion.skins[0] = std::move(skin);
  return made;
}

}  // namespace gleaner::scene
