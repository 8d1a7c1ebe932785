#pragma once
// A scene as flat arrays, in world space but for instanced meshes: what importers make, the blob carries and the device
// library loads.

#include <array>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "scene/model/records.h"
#include "scene/model/rig.h"

namespace gleaner::scene {

struct NamedCamera {
  std::string name;
  Camera camera{};
  std::uint32_t width = 0, height = 0;  // pixels: the film that the file asks for (extras), 0 = unspecified
  float aspect = 0;                     // width / height that the file asks for, 0 = unspecified
};

// Lat-long environment, linear RGB radiance, row 0 at the top (+y). A direction is
// d = (sin t sin p, cos t, -sin t cos p) with p = 2 pi u, t = pi v.
struct Environment {
  std::uint32_t width = 0, height = 0;
  std::vector<float> radiance;  // 3 * width * height
  bool empty() const { return width == 0; }
};

struct Mesh {
  std::string name;
  std::uint32_t first_triangle = 0, triangle_count = 0;
  // Stored once, in object space: it stands in the world by Scene::instances alone. Neither emits light nor bounds a
  // solid that light passes through (may_be_instanced).
  bool instanced = false;
  // Its vertices move from frame to frame, in world space: tracers keep a BVH of its own for it. Never instanced.
  bool deforming = false;
};

struct AnimationInfo {
  std::string name;  // may be empty
  double seconds = 0;
};

struct Scene {
  std::string name;  // the file's stem
  // Where, in the file's coordinates, the origin of this scene's lies. Does not travel: who reads or writes the file's
  // coordinates adds or takes it away.
  std::array<double, 3> origin{};
  std::vector<float> positions;                  // 3 per vertex, metres
  std::vector<float> normals;                    // 3 per vertex, unit; (0,0,0) = none: the triangle's own is used
  std::vector<float> uvs;                        // 2 per vertex; empty where no material has a texture
  std::vector<float> second_uvs;                 // 2 per vertex; empty where no texture reads them (Texture::uv_set)
  std::vector<std::uint16_t> colors;             // 4 per vertex, linear RGBA, 65535 = 1; empty: all white and opaque
  std::vector<std::uint32_t> indices;            // 3 per triangle
  std::vector<std::uint32_t> triangle_material;  // 1 per triangle
  std::vector<Mesh> meshes;                      // consecutive ranges that cover all triangles
  std::vector<Instance> instances;               // at least one of each instanced mesh
  std::vector<Material> materials;
  std::vector<std::string> material_names;
  std::vector<Texture> textures;
  std::vector<std::uint32_t> texels;  // RGBA bytes, R lowest
  std::vector<float> albedo_tables;   // see Material::albedo_table
  std::vector<Light> lights;
  std::vector<NamedCamera> cameras;
  Environment environment;
  // What moves, where anything does: the arrays above show it at rest. A scene with a rig is the base of FrameStates.
  Rig rig;
  // What the importer wants a person to know. Like `origin`, these do not travel.
  std::vector<std::string> warnings;
  std::string light_units;  // what a file's candela and lux were taken for, and why; empty: it has none
  std::vector<AnimationInfo> animations;
  std::vector<std::string> variants;  // material variants that the file offers

  // Triangles are stored once; effective ones count once for each place in the world.
  std::uint64_t effective_triangle_count() const;
  std::size_t vertex_count() const { return positions.size() / 3; }
  std::size_t triangle_count() const { return indices.size() / 3; }
};

// What a scene needs of a renderer. What is false never enters a plan, a kernel or a buffer.
struct SceneNeeds {
  bool specular = false;            // a perfect mirror lobe
  bool glossy = false;              // a rough specular lobe
  bool metallic = false;            // any metallic lobe
  bool transmissive = false;        // glass, thin or solid
  bool rough_transmissive = false;  // glass that blurs
  bool attenuation = false;         // absorption inside solids
  bool alpha = false;               // surfaces that are not opaque
  bool unlit = false;
  bool textures = false;           // any texture
  bool material_textures = false;  // any texture but base colour's
  bool normal_maps = false;
  bool smooth_normals = false;  // any vertex normal that differs from its triangle's own
  bool punctual_lights = false;
  bool emissive_triangles = false;
  bool environment = false;
  bool deforming = false;           // meshes whose vertices move from frame to frame
  bool vertex_colors = false;       // any vertex colour but opaque white
  bool texture_transforms = false;  // a texture with coordinates of its own: Texture::transform
  bool second_uvs = false;          // a texture that reads the second coordinates
  bool two_sided_emitters = false;  // emissive triangles that shine from both faces
  bool panes = false;               // thin glass that light passes straight, shadow rays included
  bool refractive = false;          // smooth solid glass: no shadow ray finds its way through
  bool media = false;               // solids that absorb or may lie in one another: paths keep what they are in
  bool clearcoat = false;
  bool sheen = false;
  bool anisotropy = false;            // specular lobes that are longer one way
  bool iridescence = false;           // thin films
  bool instances = false;             // meshes stored once that stand in several places, or move as a whole
  bool diffuse_transmission = false;  // sheets that light shines through (transmissive and rough_transmissive as well)

  std::uint32_t bits() const;  // one bit a field, in the order above
};

SceneNeeds needs_of(const Scene& scene);
// What of a scene's light no method carries: sentences for people.
std::vector<std::string> lost_light(const SceneNeeds& needs);
// The names of the fields, in the order of bits().
const std::vector<std::string>& need_names();

struct Bounds {
  std::array<float, 3> lower{}, upper{};
};
Bounds bounds_of(const Scene& scene);

// Whether two arrays of records are the same to the bit.
template <typename Record>
bool same_bytes(const std::vector<Record>& a, const std::vector<Record>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(Record)) == 0);
}

// White and rough, of no specular lobe and without textures; alpha 1, cutoff 0.5, ior 1.5.
Material blank_material();

// The fields of a material that name textures.
const std::vector<gl_uint Material::*>& texture_slots();

// A texture without an image yet: it repeats, and is read at the vertices' uvs as they are.
Texture plain_texture();

// Fills in what is derived from what was read: f0, attenuation, albedo tables. Importers and the scene library call it
// last.
void finish_materials(Scene& scene);

// Throws Error::bad_input naming `file` and the element: non-finite vertices, indices and materials out of range,
// arrays of the wrong length, too many triangles (2^27) or texels (2^32).
void validate(const Scene& scene, const std::string& file);
// The parts of it that ask after what a frame may change: so many vertices; where an instance stands, with the box
// about its mesh; the lights; the materials, with what their meshes may not be made of.
void validate_vertices(const Scene& scene, std::size_t first, std::size_t count, const std::string& file);
void validate_placement(const Scene& scene, std::size_t instance, const Bounds& box, const std::string& file);
void validate_lights(const Scene& scene, const std::string& file);
void validate_materials(const Scene& scene, const std::string& file);
// The part of it that asks after the scene's rig.
void validate_rig(const Scene& scene, const std::string& file);

// A camera that frames the scene's bounds from the front, for files without one.
NamedCamera framing_camera(const Scene& scene);
// A perspective camera at `eye` that looks at `target`; yfov in radians. Throws Error::usage where they coincide.
NamedCamera look_at(const std::array<float, 3>& eye, const std::array<float, 3>& target, float yfov_radians);

}  // namespace gleaner::scene
