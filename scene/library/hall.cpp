// A vaulted hall with as many triangles as asked for: a nave between two arcades, aisles, tall windows that glow.

#include <cmath>
#include <cstdint>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

constexpr double bay = 4;            // length of a bay, m
constexpr double nave = 3;           // half the distance of the column axes
constexpr double wall_half = 0.3;    // half the arcade wall's thickness
constexpr double outer = 6;          // half the hall's width
constexpr double springing = 4;      // where the arches begin
constexpr double eaves = 6.6;        // where the vault begins
constexpr double arch_radius = 1.6;  // the rest of a bay is the capitals' width

// How finely the hall is made: bays along it, and steps along every curve. Detail 0 has plain square pillars.
struct Level {
  std::uint32_t bays, detail;

  std::uint64_t around() const { return detail == 0 ? 4 : 4 * detail + 4; }
  std::uint64_t along_column() const { return detail == 0 ? 1 : 5 * detail; }
  std::uint64_t along_arch() const { return 2 * std::uint64_t{detail} + 2; }
  std::uint64_t across_vault() const { return detail == 0 ? 2 : 4 * std::uint64_t{detail}; }
  std::uint64_t along_vault() const { return detail == 0 ? 1 : 2 * std::uint64_t{bays} * detail; }

  // Everything but the floor.
  std::uint64_t triangles() const {
    const std::uint64_t shell = 4 + 4 + 4;  // aisle walls, end walls, aisle ceilings
    const std::uint64_t windows = 2 * std::uint64_t{bays} * 2;
    const std::uint64_t columns = 2 * std::uint64_t{bays - 1} * 2 * around() * along_column();
    const std::uint64_t arcades = 2 * std::uint64_t{bays} * 3 * 2 * along_arch() * detail;
    return shell + windows + columns + arcades + 2 * across_vault() * along_vault();
  }
};

// The finest level that leaves the floor at least a tenth.
Level level_for(std::uint64_t triangles) {
  Level best{2, 0};
  for (const Level coarse : {Level{2, 1}, Level{3, 1}, Level{4, 1}, Level{6, 1}})
    if (10 * coarse.triangles() <= 9 * triangles) best = coarse;
  if (best.bays == 6)
    while (10 * Level{6, best.detail + 1}.triangles() <= 9 * triangles) ++best.detail;
  return best;
}

struct FloorGrid {
  std::uint64_t across, along;
};

// At least `triangles` with as few more as can be had from cells that are not too long.
FloorGrid floor_grid(std::uint64_t triangles, double length) {
  const std::uint64_t cells = (triangles + 1) / 2;
  const auto square = static_cast<std::uint64_t>(std::sqrt(static_cast<double>(cells) * 2 * outer / length));
  FloorGrid best{1, cells};
  std::uint64_t least = UINT64_MAX;
  for (std::uint64_t across = square / 2 + 1; across <= 2 * square + 1; ++across) {
    const std::uint64_t along = (cells + across - 1) / across;
    const std::uint64_t excess = across * along - cells;
    if (excess < least) {
      least = excess;
      best = {across, along};
    }
  }
  return best;
}

// Radius of a column at height y: base, a shaft with a slight swelling, capital.
double column_radius(double y) {
  const double t = y / springing;
  if (t < 0.06) return 0.36;
  if (t < 0.1) return 0.36 - 0.08 * (t - 0.06) / 0.04;
  if (t < 0.9) return 0.28 - 0.05 * (t - 0.1) * (t - 0.1) / 0.64;
  return 0.23 + 0.15 * (t - 0.9) / 0.1;
}

void add_column(SceneBuilder& b, const Level& level, double x, double z, std::uint32_t material) {
  const auto around = static_cast<std::uint32_t>(level.around()),
             rows = static_cast<std::uint32_t>(level.along_column());
  // Without arches the pillars reach the ceiling.
  const double top = level.detail == 0 ? eaves : springing;
  b.grid(around, rows,
         [&](std::uint32_t i, std::uint32_t j) {
           const double y = top * j / rows, phi = 2 * pi * (i + 0.5) / around;
           const double r = level.detail == 0 ? 0.35 : column_radius(y);
           return Vec{x + r * std::sin(phi), y, z + r * std::cos(phi)};
         },
         material, {.closed_u = true, .smooth = level.detail > 0});
}

// One bay of an arcade wall: two faces that reach from the arch to the eaves, and the soffit between them.
void add_arch(SceneBuilder& b, const Level& level, double x, double z0, std::uint32_t wall, std::uint32_t soffit) {
  const auto steps = static_cast<std::uint32_t>(level.along_arch());
  // The lower edge: flat over the capitals, a half circle between. t runs along z.
  const auto edge = [&](std::uint32_t i) -> Vec {
    if (i == 0) return {0, springing, z0};
    if (i == steps) return {0, springing, z0 + bay};
    const double angle = pi * (i - 1) / (steps - 2);
    return {0, springing + arch_radius * std::sin(angle), z0 + bay / 2 - arch_radius * std::cos(angle)};
  };
  for (const double side : {-1.0, 1.0})
    b.grid(steps, level.detail,
           [&](std::uint32_t i, std::uint32_t j) {
             const Vec low = edge(side < 0 ? i : steps - i);
             return Vec{x + side * wall_half, low.y + (eaves - low.y) * j / level.detail, low.z};
           },
           wall, {.smooth = false});
  b.grid(steps, level.detail,
         [&](std::uint32_t i, std::uint32_t j) {
           const Vec low = edge(i);
           return Vec{x + wall_half * (1 - 2.0 * j / level.detail), low.y, low.z};
         },
         soffit, {.smooth = false});
}

}  // namespace

Scene hall(const std::string& name, const Values& values) {
  const std::uint64_t wanted = values.count("triangles");
  const Level level = level_for(wanted);
  const double length = bay * level.bays, half_length = length / 2;
  SceneBuilder b(name);
  const std::uint32_t plaster = b.material("plaster", lambert({0.75, 0.72, 0.66}));
  const std::uint32_t stone = b.material("stone", lambert({0.6, 0.55, 0.47}));
  const std::uint32_t floor = b.material("floor", dielectric({0.32, 0.24, 0.18}, 0.3));
  const std::uint32_t window = b.material("window", emitter({4.5, 5, 6}));

  b.mesh("floor");
  const FloorGrid cells = floor_grid(wanted - level.triangles(), length);
  b.grid(static_cast<std::uint32_t>(cells.across), static_cast<std::uint32_t>(cells.along),
         [&](std::uint32_t i, std::uint32_t j) {
           return Vec{outer * (2.0 * i / static_cast<double>(cells.across) - 1), 0,
                      half_length * (1 - 2.0 * j / static_cast<double>(cells.along))};
         },
         floor, {.smooth = false});

  const double crown = eaves + nave - wall_half;
  b.mesh("walls");
  for (const double side : {-1.0, 1.0}) {
    b.quad({side * outer, 0, -side * half_length}, {side * outer, 0, side * half_length},
           {side * outer, eaves, side * half_length}, {side * outer, eaves, -side * half_length}, plaster);
    b.quad({side * outer, 0, side * half_length}, {-side * outer, 0, side * half_length},
           {-side * outer, crown, side * half_length}, {side * outer, crown, side * half_length}, plaster);
    const double inner = nave - wall_half;
    b.quad({side > 0 ? inner : -outer, eaves, -half_length}, {side > 0 ? outer : -inner, eaves, -half_length},
           {side > 0 ? outer : -inner, eaves, half_length}, {side > 0 ? inner : -outer, eaves, half_length}, plaster);
  }

  b.mesh("vault");
  const auto across = static_cast<std::uint32_t>(level.across_vault()),
             along = static_cast<std::uint32_t>(level.along_vault());
  b.grid(across, along,
         [&](std::uint32_t i, std::uint32_t j) {
           const double angle = pi * i / across;
           return Vec{-(nave - wall_half) * std::cos(angle), eaves + (nave - wall_half) * std::sin(angle),
                      half_length * (2.0 * j / along - 1)};
         },
         plaster, {.smooth = level.detail > 0});

  b.mesh("columns");
  for (const double side : {-1.0, 1.0})
    for (std::uint32_t i = 1; i < level.bays; ++i) add_column(b, level, side * nave, bay * i - half_length, stone);
  if (level.detail > 0) {
    b.mesh("arcades");
    for (const double side : {-1.0, 1.0})
      for (std::uint32_t i = 0; i < level.bays; ++i)
        add_arch(b, level, side * nave, bay * i - half_length, plaster, stone);
  }

  b.mesh("windows");
  for (const double side : {-1.0, 1.0})
    for (std::uint32_t i = 0; i < level.bays; ++i) {
      const double x = side * (outer - 0.02), z = bay * (i + 0.5) - half_length;
      b.quad({x, 2, z - side * 0.6}, {x, 2, z + side * 0.6}, {x, 5, z + side * 0.6}, {x, 5, z - side * 0.6}, window);
    }

  b.camera("camera", {-0.7, 1.7, half_length - 0.4}, {0.4, 3, -half_length}, 62, 960, 540);
  b.camera("aisle", {-4.6, 1.7, half_length - 0.4}, {-2.2, 2.6, -half_length}, 62, 960, 540);
  return b.finish();
}

std::vector<Recipe> hall_recipes() {
  return {{"hall",
           "a vaulted hall with columns and arches; from the wanted number of triangles to 5 % more",
           {{"triangles", 100000, 100, 20000000, true}},
           hall}};
}

}  // namespace gleaner::scene
