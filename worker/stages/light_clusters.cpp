#include "worker/stages/light_clusters.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <numbers>
#include <numeric>

#include "kernels/scene_layout.h"
#include "scene/model/emission.h"
#include "worker/stages/vectors.h"

namespace gleaner::worker {
namespace {

using Vec = std::array<double, 3>;

double length(const Vec& a) { return std::sqrt(dot(a, a)); }
double luminance(const float* c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }

struct Emitter {
  std::uint32_t kind = CLUSTER_TRIANGLES;
  std::uint32_t triangle = GLEANER_NONE, light = GLEANER_NONE;
  std::array<Vec, 3> corners{};  // positional lights: all three the same
  Vec normal{};                  // zero: shines all around
  bool two_sided = false;        // shines from both faces
  Vec center{};
  double power = 0;  // irradiance at 1 m facing it (anywhere: directional)
};

struct Group {
  std::vector<std::uint32_t> members;
  std::uint32_t kind = 0;
  Vec center{};
  double radius = 0, power = 0;
  bool two_sided = false;  // its cone of normals is one of two, the other opposite
  Vec axis{0, 0, 1};
  double cosine = -1;
};

// A normal as a group of axis `axis` takes it: of emitters with two faces, the one on the axis's side.
Vec aligned(const Emitter& e, const Vec& axis) {
  return e.two_sided && dot(e.normal, axis) < 0 ? e.normal * -1 : e.normal;
}

Group bound(std::vector<std::uint32_t> members, const std::vector<Emitter>& emitters) {
  Group group;
  group.kind = emitters[members[0]].kind;
  group.two_sided = emitters[members[0]].two_sided;
  Vec lower{1e300, 1e300, 1e300}, upper{-1e300, -1e300, -1e300}, sum{};
  bool around = false;
  for (auto m : members) {
    const Emitter& e = emitters[m];
    group.power += e.power;
    for (const Vec& c : e.corners)
      for (int k = 0; k < 3; ++k) {
        lower[k] = std::min(lower[k], c[k]);
        upper[k] = std::max(upper[k], c[k]);
      }
    around = around || dot(e.normal, e.normal) == 0;
    sum = sum + aligned(e, sum) * e.power;
  }
  group.center = (lower + upper) * 0.5;
  for (auto m : members)
    for (const Vec& c : emitters[m].corners) group.radius = std::max(group.radius, length(c - group.center));
  if (!around && length(sum) > 0) {
    group.axis = sum * (1 / length(sum));
    group.cosine = 1;
    for (auto m : members) group.cosine = std::min(group.cosine, dot(group.axis, aligned(emitters[m], group.axis)));
    group.cosine = std::max(group.cosine, -1.0);
  }
  group.members = std::move(members);
  return group;
}

// What is lost by not telling a group's members apart: power times their spread in place and in direction. 0 where
// telling them apart would cost each vertex more than it saves: a filled flat light is one light, and a light small
// beside the scene need only be split by the sides it shines to.
double coarseness(const Group& group, const std::vector<Emitter>& emitters, double scene_extent) {
  if (group.members.size() < 2) return 0;
  if (group.kind == CLUSTER_DIRECTIONAL) return group.power * 1e-9;
  const bool narrow = group.cosine > 0.6 || group.kind != CLUSTER_TRIANGLES;
  const bool small = group.radius < 0.02 * scene_extent;
  if (narrow && small) return 0;
  if (group.cosine > 0.999) {
    double area = 0;
    for (auto m : group.members) {
      const auto& c = emitters[m].corners;
      area += length(cross(c[1] - c[0], c[2] - c[0])) / 2;
    }
    if (area > 0.3 * std::numbers::pi * group.radius * group.radius) return 0;
  }
  return group.power * std::max(group.radius, 0.02 * scene_extent) * (2 - group.cosine);
}

// Halves a group: by normals where their cone is wide, else along the longest axis of the centers.
std::pair<std::vector<std::uint32_t>, std::vector<std::uint32_t>> halve(const Group& group,
                                                                        const std::vector<Emitter>& emitters) {
  std::vector<std::uint32_t> order = group.members;
  Vec lower{1e300, 1e300, 1e300}, upper{-1e300, -1e300, -1e300}, normal_lower = lower, normal_upper = upper;
  for (auto m : order)
    for (int k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], emitters[m].center[k]);
      upper[k] = std::max(upper[k], emitters[m].center[k]);
      const double normal = aligned(emitters[m], group.axis)[k];
      normal_lower[k] = std::min(normal_lower[k], normal);
      normal_upper[k] = std::max(normal_upper[k], normal);
    }
  const bool by_normal = group.cosine < 0.7 && length(normal_upper - normal_lower) > 0.5;
  const Vec extent = by_normal ? normal_upper - normal_lower : upper - lower;
  const int axis = static_cast<int>(std::max_element(extent.begin(), extent.end()) - extent.begin());
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return by_normal ? aligned(emitters[a], group.axis)[axis] < aligned(emitters[b], group.axis)[axis]
                     : emitters[a].center[axis] < emitters[b].center[axis];
  });
  double half = group.power / 2, sum = 0;
  std::size_t cut = 0;
  while (cut + 1 < order.size() && (cut == 0 || sum + emitters[order[cut]].power / 2 < half))
    sum += emitters[order[cut++]].power;
  return {{order.begin(), order.begin() + static_cast<std::ptrdiff_t>(cut)},
          {order.begin() + static_cast<std::ptrdiff_t>(cut), order.end()}};
}

void set_word(std::vector<float>& table, std::size_t at, std::uint32_t value) {
  std::memcpy(&table[at], &value, sizeof value);
}

Vec corner(const scene::Scene& scene, std::uint32_t triangle, int k) {
  const float* p = &scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{triangle} + k]}];
  return {p[0], p[1], p[2]};
}

// Triangles that shine, and lights; without power neither is any.
std::vector<Emitter> emitters_of(const scene::Scene& scene) {
  std::vector<Emitter> emitters;
  const std::vector<std::array<float, 3>> means = scene::mean_emission(scene);
  for (std::uint32_t t = 0; t < scene.triangle_count(); ++t) {
    const auto& radiance = means[scene.triangle_material[t]];
    if (!(radiance[0] + radiance[1] + radiance[2] > 0)) continue;
    Emitter e;
    e.triangle = t;
    e.two_sided = scene.materials[scene.triangle_material[t]].flags & GLEANER_MATERIAL_DOUBLE_SIDED;
    for (int k = 0; k < 3; ++k) e.corners[k] = corner(scene, t, k);
    const Vec n = cross(e.corners[1] - e.corners[0], e.corners[2] - e.corners[0]);
    const double area = length(n) / 2;
    // Below it, area and power vanish in float.
    if (!(area > 1e-30)) continue;
    e.normal = n * (0.5 / area);
    e.center = (e.corners[0] + e.corners[1] + e.corners[2]) * (1.0 / 3);
    // Any colour counts, also one of no luminance to speak of.
    e.power = area * std::max(luminance(radiance.data()), 1e-3 * (double{radiance[0]} + radiance[1] + radiance[2]));
    emitters.push_back(e);
  }
  for (std::uint32_t i = 0; i < scene.lights.size(); ++i) {
    const scene::Light& light = scene.lights[i];
    Emitter e;
    e.light = i;
    e.power = std::max(luminance(light.intensity),
                       1e-3 * (double{light.intensity[0]} + light.intensity[1] + light.intensity[2]));
    if (!(e.power > 0)) continue;
    e.kind = light.type == GLEANER_LIGHT_DIRECTIONAL ? CLUSTER_DIRECTIONAL : CLUSTER_POSITIONAL;
    if (e.kind == CLUSTER_POSITIONAL) e.center = {light.position[0], light.position[1], light.position[2]};
    e.corners = {e.center, e.center, e.center};
    emitters.push_back(e);
  }
  return emitters;
}

// Up to `most` groups of emitters of one kind and as many sides.
std::vector<Group> groups_of(const std::vector<Emitter>& emitters, double scene_extent, std::size_t most) {
  std::vector<Group> groups;
  for (const auto& [kind, two_sided] : {std::pair{CLUSTER_TRIANGLES, false},
                                        {CLUSTER_TRIANGLES, true},
                                        {CLUSTER_POSITIONAL, false},
                                        {CLUSTER_DIRECTIONAL, false}}) {
    std::vector<std::uint32_t> members;
    for (std::uint32_t i = 0; i < emitters.size(); ++i)
      if (emitters[i].kind == kind && emitters[i].two_sided == two_sided) members.push_back(i);
    if (!members.empty()) groups.push_back(bound(std::move(members), emitters));
  }
  while (groups.size() < most) {
    auto widest = std::max_element(groups.begin(), groups.end(), [&](const Group& a, const Group& b) {
      return coarseness(a, emitters, scene_extent) < coarseness(b, emitters, scene_extent);
    });
    if (widest == groups.end() || coarseness(*widest, emitters, scene_extent) <= 0) break;
    auto [left, right] = halve(*widest, emitters);
    *widest = bound(std::move(left), emitters);
    groups.push_back(bound(std::move(right), emitters));
  }
  return groups;
}

class TableWriter {
 public:
  TableWriter(const scene::Scene& scene, double environment_power)
      : scene_(scene), environment_(!scene.environment.empty()), environment_power_(environment_power) {
    const scene::Bounds bounds = scene::bounds_of(scene);
    lower_ = {bounds.lower[0], bounds.lower[1], bounds.lower[2]};
    upper_ = {bounds.upper[0], bounds.upper[1], bounds.upper[2]};
    emitters_ = emitters_of(scene);
    groups_ = groups_of(emitters_, length(upper_ - lower_), MAX_CLUSTERS - (environment_ ? 1 : 0));
  }

  LightTables write() {
    tables_.triangle_emitter.assign(scene_.triangle_count(), GLEANER_NONE);
    write_clusters();
    write_emission();
    if (tables_.emitters.empty()) tables_.emitters.assign(EMITTER_WORDS, 0.0f);
    return std::move(tables_);
  }

 private:
  void write_clusters() {
    const std::size_t used = groups_.size() + (environment_ ? 1 : 0);
    for (unsigned slots : {1u, 4u, 8u, 16u, 32u, 64u})
      if (used && used <= slots) {
        tables_.cluster_slots = slots;
        break;
      }
    tables_.clusters.assign(std::size_t{tables_.cluster_slots} * CLUSTER_WORDS + 1, 0.0f);
    std::size_t largest = 1;
    for (std::size_t g = 0; g < groups_.size(); ++g) {
      write_cluster(g);
      largest = std::max(largest, groups_[g].members.size());
      write_emitters(g);
    }
    if (environment_) {
      // Always the last slot, so that kernels need not look for it.
      const std::size_t base = (std::size_t{tables_.cluster_slots} - 1) * CLUSTER_WORDS;
      tables_.clusters[base + CLUSTER_POWER] = static_cast<float>(environment_power_);
      set_word(tables_.clusters, base + CLUSTER_KIND, CLUSTER_ENVIRONMENT);
    }
    // An unused slot: far away from nothing, of power 0, never chosen.
    for (std::size_t g = groups_.size(); g + (environment_ ? 1 : 0) < tables_.cluster_slots; ++g)
      tables_.clusters[g * CLUSTER_WORDS + CLUSTER_RADIUS] = 1;
    set_word(tables_.clusters, std::size_t{tables_.cluster_slots} * CLUSTER_WORDS,
             static_cast<std::uint32_t>(std::bit_floor(largest)));
  }

  void write_cluster(std::size_t g) {
    const Group& group = groups_[g];
    const std::size_t base = g * CLUSTER_WORDS;
    float* row = &tables_.clusters[base];
    for (int k = 0; k < 3; ++k) {
      row[CLUSTER_CENTER + k] = static_cast<float>(group.center[k]);
      row[CLUSTER_AXIS + k] = static_cast<float>(group.axis[k]);
    }
    // Never of radius 0: inside its sphere a cluster's importance stays finite. Widened by the float's rounding.
    const double magnitude =
        std::max({std::abs(group.center[0]), std::abs(group.center[1]), std::abs(group.center[2]), 1e-6});
    row[CLUSTER_RADIUS] = static_cast<float>(group.radius * 1.0001 + magnitude * 1e-6);
    row[CLUSTER_COS] = static_cast<float>(std::max(group.cosine - 1e-4, -1.0));
    row[CLUSTER_SIN] = static_cast<float>(std::sqrt(std::max(0.0f, 1 - row[CLUSTER_COS] * row[CLUSTER_COS])));
    row[CLUSTER_POWER] = static_cast<float>(group.power);
    set_word(tables_.clusters, base + CLUSTER_FIRST,
             static_cast<std::uint32_t>(tables_.emitters.size() / EMITTER_WORDS));
    set_word(tables_.clusters, base + CLUSTER_COUNT, static_cast<std::uint32_t>(group.members.size()));
    set_word(tables_.clusters, base + CLUSTER_KIND, group.kind);
    set_word(tables_.clusters, base + CLUSTER_TWO_SIDED, group.two_sided);
  }

  // A cluster's rows.
  void write_emitters(std::size_t g) {
    const Group& group = groups_[g];
    double sum = 0;
    for (std::size_t i = 0; i < group.members.size(); ++i) {
      const Emitter& e = emitters_[group.members[i]];
      const std::size_t at = tables_.emitters.size();
      tables_.emitters.resize(at + EMITTER_WORDS);
      float* out = &tables_.emitters[at];
      sum += e.power / group.power;
      out[EMITTER_CDF] = i + 1 == group.members.size() ? 1.0f : static_cast<float>(std::min(sum, 1.0));
      out[EMITTER_PMF] = out[EMITTER_CDF] - (i ? tables_.emitters[at - EMITTER_WORDS + EMITTER_CDF] : 0.0f);
      set_word(tables_.emitters, at + EMITTER_TRIANGLE, e.triangle);
      set_word(tables_.emitters, at + EMITTER_CLUSTER,
               static_cast<std::uint32_t>(g) | (e.two_sided ? EMITTER_TWO_SIDED : 0));
      if (e.triangle != GLEANER_NONE) {
        tables_.triangle_emitter[e.triangle] = static_cast<std::uint32_t>(at / EMITTER_WORDS);
        write_triangle(e, out);
      } else {
        write_light(scene_.lights[e.light], out);
      }
    }
  }

  void write_triangle(const Emitter& e, float* out) const {
    const Vec e1 = e.corners[1] - e.corners[0], e2 = e.corners[2] - e.corners[0];
    for (int k = 0; k < 3; ++k) {
      out[EMITTER_P0 + k] = static_cast<float>(e.corners[0][k]);
      out[EMITTER_E1 + k] = static_cast<float>(e1[k]);
      out[EMITTER_E2 + k] = static_cast<float>(e2[k]);
      out[EMITTER_RADIANCE + k] = scene_.materials[scene_.triangle_material[e.triangle]].emission[k];
    }
  }

  static void write_light(const scene::Light& light, float* out) {
    for (int k = 0; k < 3; ++k) {
      out[EMITTER_POSITION + k] = light.position[k];
      out[EMITTER_DIRECTION + k] = light.direction[k];
      out[EMITTER_RADIANCE + k] = light.intensity[k];
    }
    out[EMITTER_COS_INNER] = light.cos_inner;
    out[EMITTER_COS_OUTER] = light.type == GLEANER_LIGHT_SPOT ? light.cos_outer : -1.0f;
    out[EMITTER_RANGE] = light.range;
  }

  // The light that an emitter sends, W. `far`: where light from afar begins, m from the scene's middle.
  double flux_of(const Emitter& e, double far) const {
    double solid = e.two_sided ? 2 * std::numbers::pi : std::numbers::pi;  // triangles: cosine-weighted over a side
    if (e.kind == CLUSTER_DIRECTIONAL) solid = std::numbers::pi * far * far;
    if (e.kind == CLUSTER_POSITIONAL) {
      const scene::Light& light = scene_.lights[e.light];
      solid = 2 * std::numbers::pi * (light.type == GLEANER_LIGHT_SPOT ? 1.0 - light.cos_outer : 2.0);
    }
    return e.power * solid;
  }

  void write_emission() {
    const Vec center = (lower_ + upper_) * 0.5;
    // Just beyond the scene's corners: light from afar begins on this sphere.
    const double radius = length(upper_ - lower_) * 0.5 * 1.0001 + length(center) * 1e-6 + 1e-6;
    std::vector<double> flux;
    for (const Group& group : groups_)
      for (const std::uint32_t m : group.members) flux.push_back(flux_of(emitters_[m], radius));
    // Its power is the irradiance of one side, a quarter of what comes from all around.
    if (environment_) flux.push_back(4 * environment_power_ * std::numbers::pi * radius * radius);
    const double all_flux = std::accumulate(flux.begin(), flux.end(), 0.0);
    if (!(all_flux > 0)) return;
    tables_.emission.assign(EMISSION_HEADER, 0.0f);
    set_word(tables_.emission, EMISSION_COUNT, static_cast<std::uint32_t>(flux.size()));
    set_word(tables_.emission, EMISSION_STEP, static_cast<std::uint32_t>(std::bit_floor(flux.size())));
    set_word(tables_.emission, EMISSION_ENVIRONMENT, environment_ ? 1 : 0);
    for (int k = 0; k < 3; ++k) tables_.emission[EMISSION_CENTER + k] = static_cast<float>(center[k]);
    tables_.emission[EMISSION_RADIUS] = static_cast<float>(radius);
    double sum = 0;
    for (double f : flux) tables_.emission.push_back(static_cast<float>(std::min(1.0, (sum += f) / all_flux)));
    tables_.emission.back() = 1;
  }

  const scene::Scene& scene_;
  const bool environment_;
  const double environment_power_;
  Vec lower_, upper_;  // of the scene
  std::vector<Emitter> emitters_;
  std::vector<Group> groups_;
  LightTables tables_;
};

}  // namespace

EnvironmentTable make_environment_table(const scene::Environment& environment) {
  EnvironmentTable table;
  if (environment.empty()) return table;
  const std::uint32_t w = environment.width, h = environment.height;
  auto& out = table.rows;
  out.resize(ENVIRONMENT_HEADER);
  set_word(out, 0, w);
  set_word(out, 1, h);
  set_word(out, 2, std::bit_floor(h));
  set_word(out, 3, std::bit_floor(w));
  out.insert(out.end(), environment.radiance.begin(), environment.radiance.end());
  std::vector<double> texel(std::size_t{w} * h), density(std::size_t{w} * h);
  for (std::size_t i = 0; i < texel.size(); ++i) texel[i] = luminance(&environment.radiance[3 * i]);
  std::vector<double> rows(h);
  double total = 0;
  for (std::uint32_t y = 0; y < h; ++y) {
    // The row's solid angle, exactly.
    const double solid =
        (std::cos(std::numbers::pi * y / h) - std::cos(std::numbers::pi * (y + 1) / h)) * 2 * std::numbers::pi / w;
    for (std::uint32_t x = 0; x < w; ++x) {
      // Radiance is interpolated between texels: a texel's square draws from its neighbours too.
      double sum = 0;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          const std::uint32_t yy =
              static_cast<std::uint32_t>(std::clamp<int>(static_cast<int>(y) + dy, 0, static_cast<int>(h) - 1));
          const std::uint32_t xx = (x + w + static_cast<std::uint32_t>(dx + static_cast<int>(w))) % w;
          sum += texel[std::size_t{yy} * w + xx] * (dx == 0 ? 6 : 1) * (dy == 0 ? 6 : 1);
        }
      density[std::size_t{y} * w + x] = sum / 64 * solid;
      rows[y] += sum / 64 * solid;
    }
    total += rows[y];
  }
  table.power = total / 4;  // a facing surface under a uniform sky gets pi L = (4 pi L) / 4
  std::vector<float> columns(texel.size()), row_cdf(h);
  double row_sum = 0;
  for (std::uint32_t y = 0; y < h; ++y) {
    double sum = 0;
    for (std::uint32_t x = 0; x < w; ++x) {
      sum += rows[y] > 0 ? density[std::size_t{y} * w + x] / rows[y] : 1.0 / w;
      columns[std::size_t{y} * w + x] = static_cast<float>(sum);
    }
    columns[std::size_t{y} * w + w - 1] = 1;
    row_sum += total > 0 ? rows[y] / total : 1.0 / h;
    row_cdf[y] = static_cast<float>(row_sum);
  }
  row_cdf[h - 1] = 1;
  out.insert(out.end(), columns.begin(), columns.end());
  out.insert(out.end(), row_cdf.begin(), row_cdf.end());
  return table;
}

LightTables make_light_tables(const scene::Scene& scene, double environment_power) {
  return TableWriter(scene, environment_power).write();
}

}  // namespace gleaner::worker
