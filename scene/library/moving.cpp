// Scenes that move: nodes that turn and travel, morph targets, a camera on rails. Each shows one kind of motion, so
// that tests know what changes from frame to frame.

#include <cmath>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

constexpr Rgb plaster{0.7, 0.68, 0.64}, brick{0.55, 0.2, 0.13}, slate{0.22, 0.3, 0.42};

// A floor and a back wall, 4 m wide.
void add_backdrop(SceneBuilder& b) {
  const std::uint32_t wall = b.material("wall", lambert(plaster)), floor = b.material("floor", lambert(slate));
  b.mesh("floor");
  b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -1.5}, {-2, 0, -1.5}, floor);
  b.mesh("back wall");
  b.quad({-2, 0, -1.5}, {2, 0, -1.5}, {2, 3, -1.5}, {-2, 3, -1.5}, wall);
}

// Above and in front, shining down and back.
void add_softbox(SceneBuilder& b) {
  const std::uint32_t light = b.material("light", emitter({14, 13, 11}));
  b.mesh("light");
  b.quad({-0.7, 2.9, 0.6}, {0.7, 2.9, 0.6}, {0.7, 2.6, 1.4}, {-0.7, 2.6, 1.4}, light);
}

void append(std::vector<float>& to, std::initializer_list<double> values) {
  for (const double value : values) to.push_back(static_cast<float>(value));
}

// A swing about z: angle a(t) = a0 sin(2 pi t / period). Keys are quaternions (0, 0, sin a/2, cos a/2) and their
// derivatives in time.
Keys swing(double degrees, double period) {
  constexpr int keys = 16;
  Keys result{Interpolation::cubic_spline, {}, {}};
  for (int k = 0; k <= keys; ++k) {
    const double phase = 2 * pi * k / keys, half = radians(degrees) / 2 * std::sin(phase);
    const double rate = radians(degrees) / 2 * std::cos(phase) * 2 * pi / period;
    append(result.times, {period * k / keys});
    for (const bool value : {false, true, false}) {
      if (value)
        append(result.values, {0, 0, std::sin(half), std::cos(half)});
      else
        append(result.values, {0, 0, rate * std::cos(half), -rate * std::sin(half)});
    }
  }
  return result;
}

AnimatedScene swinging_lamp(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  const std::uint32_t shade = b.material("shade", lambert(brick)), bulb = b.material("bulb", emitter({90, 75, 50}));
  b.mesh("lamp");
  b.box({0, 1.95, 0}, {0.01, 0.45, 0.01}, 0, shade);
  b.grid(32, 4,
         [](std::uint32_t i, std::uint32_t j) {
           const double angle = 2 * pi * i / 32, radius = 0.08 + 0.055 * j;
           return Vec{radius * std::sin(angle), 1.5 - 0.06 * j, radius * std::cos(angle)};
         },
         shade, {.closed_u = true});
  b.mesh("bulb");
  b.sphere({0, 1.36, 0}, 0.06, 16, bulb);
  add_backdrop(b);
  b.mesh("box");
  b.box({0.5, 0.3, -0.4}, {0.3, 0.3, 0.3}, radians(20), b.material("box", lambert(plaster)));
  b.camera("camera", {0, 1.5, 4.5}, {0, 1.15, 0}, 38, 512, 384);

  AnimatedScene made{b.finish(), {}};
  MotionNode hook{.name = "hook", .pivot = {0, 2.375f, 0}};
  hook.turned = swing(values.number("degrees"), values.number("seconds"));
  made.motion.nodes = {hook};
  made.motion.meshes = {{0, 0}, {1, 0}};
  return made;
}

// One turn about y in quarters.
AnimatedScene turntable(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  b.mesh("table");
  const std::uint32_t wood = b.material("table", lambert(plaster)), centre = b.vertex({0, 0.25, 0});
  for (int i = 0; i < 48; ++i) {
    const double angle = 2 * pi * i / 48;
    b.vertex({0.9 * std::sin(angle), 0.25, 0.9 * std::cos(angle)});
  }
  for (std::uint32_t i = 0; i < 48; ++i) b.triangle(centre, centre + 1 + i, centre + 1 + (i + 1) % 48, wood);
  b.mesh("ring");
  b.torus({0.1, 0.42, 0.1}, 0.45, 0.16, values.count("segments"), b.material("ring", dielectric(brick, 0.25)));
  b.mesh("post");
  b.box({-0.35, 0.6, -0.4}, {0.12, 0.35, 0.12}, radians(30), b.material("post", metal({0.9, 0.75, 0.45}, 0.3)));
  add_backdrop(b);
  add_softbox(b);
  b.camera("camera", {0, 1.6, 3.6}, {0, 0.6, 0}, 40, 512, 384);

  AnimatedScene made{b.finish(), {}};
  MotionNode axle{.name = "axle", .pivot = {0, 0.25f, 0}};
  for (int quarter = 0; quarter <= 4; ++quarter) {
    const double half = pi * quarter / 4;
    append(axle.turned.times, {values.number("seconds") * quarter / 4});
    append(axle.turned.values, {0, std::sin(half), 0, std::cos(half)});
  }
  made.motion.nodes = {axle};
  made.motion.meshes = {{0, 0}, {1, 0}, {2, 0}};
  return made;
}

// A wave z = h(y) sin(k x - w t) on a cloth that hangs from y = 2: a sum of two standing waves, each a morph target.
AnimatedScene waving_cloth(const std::string& name, const Values& values) {
  const std::uint32_t cells = values.count("cells");
  constexpr double wave = 2 * pi / 0.9;
  SceneBuilder b(name);
  b.mesh("cloth");
  const std::uint32_t cloth = b.material("cloth", lambert(brick));
  MotionMorph morph{{{}, {}}, {{}, {}}, {}};
  for (std::uint32_t j = 0; j <= cells; ++j)
    for (std::uint32_t i = 0; i <= cells; ++i) {
      const double x = 1.6 * i / cells - 0.8, y = 2 - 1.4 * j / cells;
      const double height = 0.09 * (2 - y), sine = std::sin(wave * x), cosine = std::cos(wave * x);
      // Normals before they are made unit: (-dz/dx, -dz/dy, 1), linear in z, so that they morph as z does.
      const Vec normal{-height * wave * cosine, 0.09 * sine, 1};
      const double length = std::sqrt(dot(normal, normal));
      b.vertex({x, y, height * sine}, (1 / length) * normal, double(i) / cells, double(j) / cells);
      append(morph.positions[0], {0, 0, height * sine});
      append(morph.normals[0], {normal.x / length, normal.y / length, 0});
      append(morph.positions[1], {0, 0, -height * cosine});
      append(morph.normals[1], {-height * wave * sine / length, -0.09 * cosine / length, 0});
    }
  for (std::uint32_t j = 0; j < cells; ++j)
    for (std::uint32_t i = 0; i < cells; ++i) {
      const std::uint32_t a = j * (cells + 1) + i, below = a + cells + 1;
      b.triangle(a, below, below + 1, cloth);
      b.triangle(a, below + 1, a + 1, cloth);
    }
  add_backdrop(b);
  add_softbox(b);
  b.camera("camera", {0.6, 1.5, 3.6}, {0, 1.3, 0}, 40, 512, 384);

  constexpr int keys = 24;
  for (int k = 0; k <= keys; ++k) {
    const double phase = 2 * pi * k / keys;
    append(morph.weights.times, {values.number("seconds") * k / keys});
    append(morph.weights.values, {std::cos(phase) - 1, std::sin(phase)});
  }
  AnimatedScene made{b.finish(), {}};
  made.motion.morphs[0] = std::move(morph);
  return made;
}

AnimatedScene dolly(const std::string& name, const Values& values) {
  AnimatedScene made{hall(name, values), {}};
  MotionNode rails{.name = "rails"};
  append(rails.moved.times, {0, values.number("seconds")});
  append(rails.moved.values, {0, 0, 0, 0, 0, -values.number("metres")});
  made.motion.nodes = {rails};
  made.motion.cameras = {{0, 0}};
  return made;
}

}  // namespace

std::vector<Recipe> moving_recipes() {
  return {{"swinging-lamp",
           "moves: a lamp that swings from the ceiling, its bulb the only light",
           {{"degrees", 35, 0, 80}, {"seconds", 2, 0.1, 1000}},
           nullptr,
           swinging_lamp},
          {"turntable",
           "moves: rigid objects on a table that turns once",
           {{"segments", 48, 8, 2000, true}, {"seconds", 4, 0.1, 1000}},
           nullptr,
           turntable},
          {"waving-cloth",
           "moves: a cloth in the wind, by two morph targets; two triangles a cell",
           {{"cells", 48, 2, 2000, true}, {"seconds", 1, 0.1, 1000}},
           nullptr,
           waving_cloth},
          {"walking-figure",
           "moves: a figure that walks, one skin over nine joints",
           {{"around", 16, 4, 512, true}, {"steps", 4, 1, 100, true}},
           nullptr,
           walking_figure},
          {"dolly",
           "moves: the camera alone, through the hall",
           {{"triangles", 100000, 100, 20000000, true}, {"metres", 6, 0, 100}, {"seconds", 4, 0.1, 1000}},
           nullptr,
           dolly}};
}

}  // namespace gleaner::scene
