#pragma once
// Puts a Scene together from shapes. Everything is computed in double precision and rounded to float once, so that the
// scenes do not depend on how a compiler orders or contracts float operations.
//
// Winding: seen from its front, a face's corners run counterclockwise. Closed shapes face outward unless `inward` is
// said.

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

struct Vec {
  double x = 0, y = 0, z = 0;
};
inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec operator*(double s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
Vec normalize(Vec a);                 // (0,0,0) stays
Vec rotate_y(Vec a, double radians);  // counterclockwise seen from above

inline constexpr double pi = 3.14159265358979323846;
inline double radians(double degrees) { return degrees * pi / 180; }

// A number in [0, 1) that depends on its arguments alone (splitmix64's mixing function).
double hash_unit(std::uint64_t item, std::uint32_t dimension);

struct Rgb {
  double r = 0, g = 0, b = 0;
};
inline Rgb operator*(double s, Rgb a) { return {s * a.r, s * a.g, s * a.b}; }
inline Rgb grey(double value) { return {value, value, value}; }

// Materials before their textures. Colours are linear.
Material lambert(Rgb base_color);
Material dielectric(Rgb base_color, double roughness, double ior = 1.5);
Material metal(Rgb base_color, double roughness);
Material solid_glass(double ior, double roughness = 0);
Material emitter(Rgb radiance);  // black where it is not emitting

struct Texel {
  std::uint8_t r = 0, g = 0, b = 0, a = 255;
};

class SceneBuilder {
 public:
  explicit SceneBuilder(std::string name) { scene_.name = std::move(name); }

  std::uint32_t material(const std::string& name, const Material& material);
  // Row 0 is the top, v = 0; repeats in both directions. Returns the texture's number.
  std::uint32_t texture(std::uint32_t width, std::uint32_t height, bool srgb,
                        const std::function<Texel(std::uint32_t x, std::uint32_t y)>& texel);

  // What is added from here on belongs to a mesh of this name, until the next one begins.
  void mesh(const std::string& name);

  // The same of a mesh that is stored in its own space: it stands where instance() puts it.
  void instanced_mesh(const std::string& name);
  // The last instanced mesh, with its axes at x, y and z (of any length, not in one plane) and its origin at `origin`.
  void instance(Vec x, Vec y, Vec z, Vec origin);

  std::uint32_t vertex(Vec position, Vec normal = {}, double u = 0, double v = 0);
  void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t material);

  // Flat shapes, with zero normals. A quad's corners get the texture coordinates (0,1) (1,1) (1,0) (0,0).
  void quad(Vec a, Vec b, Vec c, Vec d, std::uint32_t material);
  // Each face has the whole texture, times `repeat`. `yaw` turns it about its own vertical axis.
  void box(Vec centre, Vec half, double yaw_radians, std::uint32_t material, bool inward = false);

  // Grid of nu x nv cells over position(i, j), i in 0..nu, j in 0..nv; the front is where du x dv points. A closed
  // direction joins its last row to its first. Smooth: normals are area-weighted means over the cells around a vertex.
  struct GridOptions {
    bool closed_u = false, closed_v = false, smooth = true;
  };
  void grid(std::uint32_t nu, std::uint32_t nv, const std::function<Vec(std::uint32_t i, std::uint32_t j)>& position,
            std::uint32_t material, GridOptions options);

  // Latitude-longitude sphere, one vertex a pole: 2 * segments * (segments / 2 - 1) triangles, segments >= 4. Smooth;
  // but flat where it faces inward, because a furnace is exact only with the normals of its polyhedron.
  void sphere(Vec centre, double radius, std::uint32_t segments, std::uint32_t material, bool inward = false);
  // Around a vertical axis.
  void torus(Vec centre, double ring_radius, double tube_radius, std::uint32_t segments, std::uint32_t material);

  // The picture is width x height pixels; yfov in degrees.
  void camera(const std::string& name, Vec eye, Vec target, double yfov_degrees, std::uint32_t width,
              std::uint32_t height);
  // Looks along `forward` with `up` on top, at a rectangle of 2 * half_width x 2 * half_height metres.
  void orthographic_camera(const std::string& name, Vec origin, Vec forward, Vec up, double half_width,
                           double half_height, std::uint32_t width, std::uint32_t height);

  void point_light(Vec position, Rgb intensity);
  // Full intensity within inner_radians of the axis, none beyond outer_radians.
  void spot_light(Vec position, Vec direction, Rgb intensity, double inner_radians, double outer_radians);
  void directional_light(Vec direction, Rgb irradiance);

  // Radiance by direction, meant over 8 x 8 points of each texel; height = width / 2.
  void environment(std::uint32_t width, const std::function<Rgb(Vec direction)>& radiance);

  // Finished and validated. The builder is empty afterwards.
  Scene finish();

 private:
  Scene scene_;
};

}  // namespace gleaner::scene
