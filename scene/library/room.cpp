// A living room in the morning: the sun through a window with bars, wood, cloth, ceramics, books. A picture that people
// want to look at, and what denoisers are for: most of its light has been reflected several times.

#include <array>
#include <cmath>
#include <functional>
#include <string>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

// The room is [0, room_width] x [0, room_height] x [0, room_depth], m. The window is in the wall x = 0, the camera near
// z = room_depth.
constexpr double room_width = 5, room_height = 2.7, room_depth = 4.6;
constexpr double window_from = 1.0, window_to = 3.0, sill = 0.75, lintel = 2.35;

std::uint8_t byte(double value) {
  return static_cast<std::uint8_t>(std::lround(255 * std::fmin(1, std::fmax(0, value))));
}
Texel texel(Rgb colour) { return {byte(colour.r), byte(colour.g), byte(colour.b)}; }

Material textured(Material material, std::uint32_t texture) {
  material.base_color_texture = texture;
  return material;
}

// Between two corners.
void block(SceneBuilder& b, Vec low, Vec high, std::uint32_t material) {
  b.box(0.5 * (low + high), 0.5 * (high - low), 0, material);
}

// A box whose edges are round: a superellipsoid.
void cushion(SceneBuilder& b, Vec centre, Vec half, std::uint32_t material, double yaw = 0, double lean = 0) {
  constexpr std::uint32_t around = 64, up = 32;
  constexpr double power = 0.45;
  const auto bent = [](double value) { return std::copysign(std::pow(std::abs(value), power), value); };
  b.grid(
      around, up,
      [&](std::uint32_t i, std::uint32_t j) {
        // Poles would be vertices of many normals: the grid ends just before them, where its hole is smaller than a
        // thread.
        const double phi = 2 * pi * i / around, theta = pi * (j - up / 2.0) / (up + 1e-4);
        const Vec p{half.x * bent(std::cos(theta)) * bent(std::cos(phi)), half.y * bent(std::sin(theta)),
                    -half.z * bent(std::cos(theta)) * bent(std::sin(phi))};
        const Vec leant{p.x, p.y * std::cos(lean) + p.z * std::sin(lean), p.z * std::cos(lean) - p.y * std::sin(lean)};
        return centre + rotate_y(leant, yaw);
      },
      material, {.closed_u = true});
}

// Turned on a lathe: radius by height over `foot`. Rings of no radius would be triangles of no area.
void turned(SceneBuilder& b, Vec foot, double tall, const std::function<double(double)>& radius, std::uint32_t material,
            bool smooth = true) {
  constexpr std::uint32_t around = 64, up = 48;
  b.grid(around, up,
         [&](std::uint32_t i, std::uint32_t j) {
           const double t = static_cast<double>(j) / up, phi = 2 * pi * i / around, r = std::fmax(radius(t), 5e-4);
           return foot + Vec{r * std::cos(phi), tall * t, -r * std::sin(phi)};
         },
         material, {.closed_u = true, .smooth = smooth});
}

std::uint32_t planks(SceneBuilder& b) {
  return b.texture(1024, 1024, true, [](std::uint32_t x, std::uint32_t y) {
    const std::uint32_t plank = y / 64, along = (x + 389 * plank) % 1024, board = plank * 4 + along / 512;
    const bool seam = y % 64 < 2 || along % 512 < 2;
    const double tone = 0.75 + 0.35 * hash_unit(board, 1);
    const double grain =
        0.06 * std::sin(y * 0.7 + 5 * std::sin(x * 0.008 + board)) + 0.05 * hash_unit(x / 24 + 997 * y, 2);
    return texel((seam ? 0.35 : tone + grain) * Rgb{0.66, 0.47, 0.31});
  });
}

std::uint32_t weave(SceneBuilder& b) {
  return b.texture(256, 256, true, [](std::uint32_t x, std::uint32_t y) {
    const int ring = static_cast<int>(std::fmin(std::fmin(x, 255 - x), std::fmin(y, 255 - y))) / 12;
    const bool diamond = (std::abs(static_cast<int>(x % 64) - 32) + std::abs(static_cast<int>(y % 64) - 32)) < 18;
    const double thread = 0.9 + 0.1 * hash_unit(x + 256 * y, 3);
    return texel(thread * (ring % 4 == 1 ? Rgb{0.75, 0.7, 0.6}
                           : diamond     ? Rgb{0.3, 0.38, 0.5}
                                         : Rgb{0.72, 0.36, 0.27}));
  });
}

std::uint32_t painting(SceneBuilder& b) {
  return b.texture(256, 192, true, [](std::uint32_t x, std::uint32_t y) {
    const double u = x / 255.0, v = y / 191.0, hill = 0.6 + 0.1 * std::sin(7 * u) + 0.05 * std::sin(19 * u + 1);
    const double sun = std::hypot(u - 0.7, 0.75 * (v - 0.3));
    if (sun < 0.09) return texel({0.95, 0.75, 0.4});
    if (v < hill) return texel({0.9 - 0.5 * v, 0.75 - 0.2 * v, 0.6 + 0.2 * v});
    return texel(v < hill + 0.15 ? Rgb{0.25, 0.42, 0.38} : Rgb{0.16, 0.28, 0.3});
  });
}

void shell(SceneBuilder& b) {
  const std::uint32_t white = b.material("white plaster", lambert({0.78, 0.76, 0.72}));
  const std::uint32_t green = b.material("green plaster", lambert({0.42, 0.5, 0.45}));
  const std::uint32_t wood = b.material("floor", textured(dielectric(grey(1), 0.35), planks(b)));
  b.mesh("floor");
  // The texture twice: planks of 14 cm.
  for (int i = 0; i < 2; ++i) {
    const double z0 = room_depth * i / 2, z1 = room_depth * (i + 1) / 2;
    b.quad({0, 0, z1}, {room_width, 0, z1}, {room_width, 0, z0}, {0, 0, z0}, wood);
  }
  b.mesh("walls");
  b.quad({0, 0, 0}, {room_width, 0, 0}, {room_width, room_height, 0}, {0, room_height, 0}, green);
  b.quad({room_width, 0, 0}, {room_width, 0, room_depth}, {room_width, room_height, room_depth},
         {room_width, room_height, 0}, white);
  b.quad({room_width, 0, room_depth}, {0, 0, room_depth}, {0, room_height, room_depth},
         {room_width, room_height, room_depth}, white);
  b.quad({0, room_height, 0}, {room_width, room_height, 0}, {room_width, room_height, room_depth},
         {0, room_height, room_depth}, white);
  constexpr double out = -0.22;
  block(b, {out, 0, 0}, {0, room_height, window_from}, white);
  block(b, {out, 0, window_to}, {0, room_height, room_depth}, white);
  block(b, {out, 0, window_from}, {0, sill, window_to}, white);
  block(b, {out, lintel, window_from}, {0, room_height, window_to}, white);
  b.mesh("skirting");
  const std::uint32_t paint = b.material("paint", dielectric(grey(0.8), 0.3));
  block(b, {0, 0, 0}, {room_width, 0.1, 0.015}, paint);
  block(b, {room_width - 0.015, 0, 0}, {room_width, 0.1, room_depth}, paint);
  b.mesh("window");
  constexpr double bar = 0.045, inner = -0.16, outer = -0.1;
  for (int i = 0; i <= 3; ++i) {
    const double z = window_from + (window_to - window_from - bar) * i / 3;
    block(b, {inner, sill, z}, {outer, lintel, z + bar}, paint);
  }
  for (int i = 0; i <= 2; ++i) {
    const double y = sill + (lintel - sill - bar) * i / 2;
    block(b, {inner + 0.005, y, window_from}, {outer - 0.005, y + bar, window_to}, paint);
  }
  block(b, {-0.1, sill - 0.04, window_from - 0.08}, {0.16, sill + 0.005, window_to + 0.08}, paint);
}

void daylight(SceneBuilder& b) {
  // Low enough for the sun to shine over it.
  b.mesh("sky");
  b.quad({-3, -1, 9}, {-3, -1, -5}, {-3, 3, -5}, {-3, 3, 9}, b.material("sky", emitter({3.0, 3.9, 5.2})));
  b.directional_light({1, -0.75, -0.22}, {46, 39, 30});
}

void curtains(SceneBuilder& b) {
  b.mesh("curtains");
  const std::uint32_t cloth = b.material("curtain", lambert({0.75, 0.68, 0.55}));
  for (const auto& [from, to] :
       {std::array{window_from - 0.38, window_from - 0.02}, {window_to + 0.02, window_to + 0.38}})
    b.grid(320, 8,
           [&, from = from, to = to](std::uint32_t i, std::uint32_t j) {
             const double t = i / 320.0, down = j / 8.0;
             return Vec{0.09 + (0.025 + 0.015 * down) * std::sin(14 * pi * t + 0.6 * down), 2.5 - 2.44 * down,
                        from + (to - from) * t};
           },
           cloth, {});
  b.mesh("rail");
  block(b, {0.07, 2.5, window_from - 0.45}, {0.1, 2.53, window_to + 0.45},
        b.material("brass", metal({0.8, 0.6, 0.32}, 0.3)));
}

void sofa(SceneBuilder& b) {
  const std::uint32_t linen = b.material("linen", lambert({0.5, 0.47, 0.42}));
  const std::uint32_t rust = b.material("rust", lambert({0.6, 0.24, 0.12})),
                      teal = b.material("teal", lambert({0.12, 0.32, 0.36}));
  const std::uint32_t oak = b.material("oak", dielectric({0.4, 0.26, 0.15}, 0.4));
  b.mesh("sofa");
  for (int i = 0; i < 3; ++i) {
    const double x = 1.75 + 0.72 * i;
    cushion(b, {x, 0.42, 0.62}, {0.37, 0.12, 0.42}, linen);
    cushion(b, {x, 0.72, 0.25}, {0.36, 0.26, 0.13}, linen, 0, 0.16);
  }
  cushion(b, {2.47, 0.26, 0.55}, {1.18, 0.09, 0.47}, linen);
  for (const double x : {1.28, 3.66}) cushion(b, {x, 0.42, 0.55}, {0.13, 0.25, 0.48}, linen);
  for (const double x : {1.35, 3.59})
    for (const double z : {0.2, 0.92}) block(b, {x - 0.03, 0, z - 0.03}, {x + 0.03, 0.2, z + 0.03}, oak);
  b.mesh("pillows");
  cushion(b, {1.58, 0.68, 0.52}, {0.22, 0.2, 0.08}, rust, 0.35, 0.3);
  cushion(b, {1.9, 0.66, 0.5}, {0.2, 0.18, 0.08}, teal, -0.15, 0.35);
  cushion(b, {3.3, 0.68, 0.52}, {0.22, 0.2, 0.08}, teal, -0.4, 0.3);
}

void table(SceneBuilder& b) {
  b.mesh("rug");
  const double x0 = 1.2, x1 = 3.7, z0 = 1.0, z1 = 2.8;
  b.quad({x0, 0.012, z1}, {x1, 0.012, z1}, {x1, 0.012, z0}, {x0, 0.012, z0},
         b.material("rug", textured(lambert(grey(1)), weave(b))));
  const std::uint32_t walnut = b.material("walnut", dielectric({0.3, 0.17, 0.09}, 0.25));
  const std::uint32_t steel = b.material("steel", metal(grey(0.35), 0.25));
  b.mesh("table");
  turned(
      b, {2.5, 0.36, 1.85}, 0.04, [](double t) { return 0.55 * std::sqrt(std::fmax(0, 1 - std::pow(2 * t - 1, 8))); },
      walnut, false);
  for (int i = 0; i < 3; ++i) {
    const double phi = 2 * pi * (i + 0.2) / 3;
    turned(
        b, {2.5 + 0.36 * std::cos(phi), 0.012, 1.85 + 0.36 * std::sin(phi)}, 0.36,
        [](double t) { return 0.014 + 0.01 * t; }, steel);
  }
  b.mesh("on the table");
  turned(
      b, {2.32, 0.4, 1.75}, 0.34,
      [](double t) { return 0.035 + 0.075 * std::pow(std::sin(pi * std::pow(t, 0.75)), 2) + 0.02 * std::pow(t, 6); },
      b.material("glaze", dielectric({0.06, 0.16, 0.28}, 0.08)));
  // Inside and outside, for a bowl is seen from both.
  turned(
      b, {2.72, 0.4, 1.98}, 0.11,
      [](double t) { return 0.05 + 0.13 * (t < 0.5 ? std::sqrt(2 * t) : 0.97 * std::sqrt(std::fmax(0, 2 - 2 * t))); },
      b.material("copper", metal({0.93, 0.55, 0.38}, 0.18)), false);
  for (int i = 0; i < 3; ++i)
    b.sphere({2.69 + 0.05 * std::cos(2.1 * i), 0.5 + 0.012 * i, 1.98 + 0.05 * std::sin(2.1 * i)}, 0.042, 32,
             b.material("fruit " + std::to_string(i + 1),
                        dielectric(i == 1 ? Rgb{0.5, 0.55, 0.1} : Rgb{0.75, 0.3, 0.05}, 0.35)));
  b.box({2.5, 0.415, 2.15}, {0.11, 0.014, 0.15}, 0.5, b.material("book below", lambert({0.15, 0.2, 0.35})));
  b.box({2.5, 0.441, 2.14}, {0.1, 0.012, 0.14}, 0.25, b.material("book above", lambert({0.75, 0.7, 0.6})));
}

void shelves(SceneBuilder& b) {
  const std::uint32_t oak = b.material("pale oak", dielectric({0.5, 0.36, 0.22}, 0.45));
  constexpr double x0 = 4.05, x1 = 4.95, deep = 0.3;
  b.mesh("shelves");
  for (int i = 0; i <= 5; ++i) block(b, {x0, 0.05 + 0.36 * i, 0.02}, {x1, 0.075 + 0.36 * i, deep}, oak);
  for (const double x : {x0 - 0.025, x1}) block(b, {x, 0, 0.02}, {x + 0.025, 1.9, deep}, oak);
  b.mesh("books");
  const std::array spines = {Rgb{0.55, 0.15, 0.1}, Rgb{0.1, 0.2, 0.35}, Rgb{0.2, 0.32, 0.2}, Rgb{0.7, 0.62, 0.45},
                             Rgb{0.25, 0.2, 0.2}};
  std::array<std::uint32_t, spines.size()> cloth{};
  for (std::size_t i = 0; i < spines.size(); ++i)
    cloth[i] = b.material("spine " + std::to_string(i + 1), dielectric(spines[i], 0.6));
  std::uint32_t book = 0;
  for (int shelf = 0; shelf < 5; ++shelf)
    for (double x = x0 + 0.02; x < x1 - 0.06 - 0.3 * hash_unit(static_cast<std::uint64_t>(shelf), 7); ++book) {
      const double thick = 0.018 + 0.03 * hash_unit(book, 4), tall = 0.2 + 0.11 * hash_unit(book, 5);
      block(b, {x, 0.075 + 0.36 * shelf, 0.05},
            {x + thick, 0.075 + 0.36 * shelf + tall, 0.2 + 0.05 * hash_unit(book, 6)},
            cloth[static_cast<std::size_t>(5 * hash_unit(book, 8))]);
      x += thick + 0.002;
    }
}

void wall_and_lamp(SceneBuilder& b) {
  b.mesh("picture");
  const std::uint32_t frame = b.material("frame", dielectric({0.05, 0.04, 0.04}, 0.3));
  block(b, {1.9, 1.3, 0.0}, {3.1, 2.15, 0.025}, frame);
  b.quad({1.94, 1.34, 0.026}, {3.06, 1.34, 0.026}, {3.06, 2.11, 0.026}, {1.94, 2.11, 0.026},
         b.material("painting", textured(lambert(grey(1)), painting(b))));
  const std::uint32_t brass = b.material("lamp's brass", metal({0.8, 0.6, 0.32}, 0.2));
  const std::uint32_t shade = b.material("lampshade", lambert({0.8, 0.74, 0.62}));
  b.mesh("lamp");
  const Vec foot{0.72, 0, 0.5};
  turned(
      b, foot, 0.03, [](double t) { return 0.14 * std::sqrt(std::fmax(0, 1 - std::pow(t, 4))); }, brass, false);
  turned(
      b, foot, 1.45, [](double) { return 0.011; }, brass);
  turned(
      b, foot + Vec{0, 1.35, 0}, 0.28, [](double t) { return 0.21 - 0.08 * t; }, shade);
}

Scene sunlit_room(const std::string& name, const Values&) {
  SceneBuilder b(name);
  shell(b);
  daylight(b);
  curtains(b);
  sofa(b);
  table(b);
  shelves(b);
  wall_and_lamp(b);
  b.camera("camera", {4.35, 1.45, 4.45}, {1.95, 0.88, 0.75}, 42, 960, 640);
  return b.finish();
}

}  // namespace

std::vector<Recipe> room_recipes() {
  return {{"sunlit-room",
           "a living room in the morning, lit by the sun and the sky through a window with bars",
           {},
           sunlit_room}};
}

}  // namespace gleaner::scene
