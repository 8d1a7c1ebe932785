// What a scene is made of, as the kernels read it. Compiled by OpenCL C and by C++.
// Radiometry throughout: radiance in W/(sr m^2), radiant intensity in W/sr, irradiance in W/m^2, linear Rec.709 RGB.
#ifndef GLEANER_SCENE_MODEL_RECORDS_H
#define GLEANER_SCENE_MODEL_RECORDS_H

#ifdef __OPENCL_VERSION__
#include "scene/model/device_types.h"
#else
#include "scene/model/device_types.h"
namespace gleaner::scene {
#endif

#define GLEANER_NONE 0xffffffffu

// Glass of a lesser alpha (roughness^2) is taken for smooth: it blurs by less than a tenth of a degree.
#define GLEANER_SMOOTH_GLASS_ALPHA 1e-3f

// Nodes of a table of directional albedos: mu = (i + 0.5) / GLEANER_ALBEDO_NODES.
#define GLEANER_ALBEDO_NODES 128
// Rows of such a table where the roughness comes from a texture: roughness = row / (rows - 1).
#define GLEANER_ALBEDO_ROWS 33
// Where coats, sheen or a film vary over a surface, so many such sets of rows: of level (set / (levels - 1)) of them.
#define GLEANER_ALBEDO_LEVELS 17

// A lobe with a grain has at least this alpha across it.
#define GLEANER_LEAST_GRAINED_ALPHA 1e-3f

// Sheen of a lesser alpha (roughness^2) is taken for one of this; its table holds E / GLEANER_SHEEN_SCALE.
#define GLEANER_SHEEN_ALPHA 0.005f
#define GLEANER_SHEEN_SCALE 4.0f

// Material::flags
#define GLEANER_MATERIAL_SOLID 1u        // transmission refracts into a solid (KHR_materials_volume); else a thin sheet
#define GLEANER_MATERIAL_UNLIT 2u        // emits base_color, scatters nothing (KHR_materials_unlit)
#define GLEANER_MATERIAL_ALPHA_BLEND 4u  // opacity = alpha; what is not opaque lets light go on unbent
#define GLEANER_MATERIAL_ALPHA_MASK 8u   // opacity = alpha >= alpha_cutoff
#define GLEANER_MATERIAL_ATTENUATES 16u  // a solid with a finite attenuation distance
#define GLEANER_MATERIAL_DOUBLE_SIDED 32u  // emits from both faces

// glTF 2.0 metallic-roughness with KHR_materials_{specular,ior,transmission,volume,emissive_strength,unlit,clearcoat,
// sheen,anisotropy,iridescence,diffuse_transmission}. Textures are indices into the texture records, or GLEANER_NONE.
// 256 bytes.
typedef struct {
  gl_float base_color[3];  // linear, in [0, 1]
  gl_float alpha;          // baseColorFactor[3]
  // Radiance: emissiveFactor * emissiveStrength, times the opacity where the surface is not opaque. It leaves the
  // front face, and the back face too where the material is double-sided.
  gl_float emission[3];
  gl_float alpha_cutoff;
  gl_float specular_color[3];  // specularColorFactor
  gl_float specular;           // specularFactor
  gl_float f0[3];              // min(((1-ior)/(1+ior))^2 * specular_color, 1), derived
  gl_float ior;
  gl_float attenuation[3];  // absorption coefficient in 1/m: -log(attenuationColor) / attenuationDistance, derived
  gl_float metallic;
  gl_float roughness;     // perceptual; alpha of GGX = roughness^2
  gl_float transmission;  // in [0, 1]
  gl_float normal_scale;
  gl_uint flags;
  gl_uint base_color_texture;          // sRGB, alpha linear
  gl_uint metallic_roughness_texture;  // linear, G roughness, B metallic
  gl_uint normal_texture;              // linear, tangent space
  gl_uint emission_texture;            // sRGB
  gl_uint transmission_texture;        // linear, R
  gl_uint specular_texture;            // linear, A specular
  gl_uint specular_color_texture;      // sRGB
  // First float, in the albedo tables, of this material's table of what lies above the diffuse layer leaves to it: rows
  // of {1 - E((i + 0.5)/NODES) for i < NODES, then 1 - M}, where E is the directional albedo of specular lobe, coat and
  // sheen together and M its mean. albedo_rows is 1 or GLEANER_ALBEDO_ROWS (by roughness), times GLEANER_ALBEDO_LEVELS
  // where a texture says how much coat, sheen or film there is. GLEANER_NONE where nothing is taken.
  gl_uint albedo_table;
  gl_uint albedo_rows;
  gl_float clearcoat;  // in [0, 1]
  gl_float clearcoat_roughness;
  gl_float clearcoat_normal_scale;
  gl_float sheen_color[3];  // in [0, 1]
  gl_float sheen_roughness;
  gl_float anisotropy;                    // strength in [0, 1]
  gl_float anisotropy_rotation;           // radians, from the tangent (dp/du) towards the bitangent
  gl_float iridescence;                   // in [0, 1]
  gl_float iridescence_ior;               // of the film
  gl_float iridescence_minimum;           // nm, thickness of the film where its texture is 0
  gl_float iridescence_maximum;           // nm, where it is 1, or there is none
  gl_uint clearcoat_texture;              // linear, R
  gl_uint clearcoat_roughness_texture;    // linear, G
  gl_uint clearcoat_normal_texture;       // linear, tangent space
  gl_uint sheen_color_texture;            // sRGB
  gl_uint sheen_roughness_texture;        // linear, A
  gl_uint anisotropy_texture;             // linear, RG direction in [-1, 1], B strength
  gl_uint iridescence_texture;            // linear, R
  gl_uint iridescence_thickness_texture;  // linear, G
  // As albedo_table, of the whole coat alone, and of white sheen alone (then E / GLEANER_SHEEN_SCALE): 1 row, or
  // GLEANER_ALBEDO_ROWS where the roughness has a texture.
  gl_uint clearcoat_table;
  gl_uint sheen_table;
  gl_float diffuse_transmission;  // in [0, 1]: share of the diffuse layer's light that leaves it on the far side
  gl_float diffuse_transmission_color[3];      // of that light, in [0, 1]
  gl_uint diffuse_transmission_texture;        // linear, A
  gl_uint diffuse_transmission_color_texture;  // sRGB
  gl_uint reserved[2];
} Material;
GLEANER_SIZE(Material, 256);

// Texture::flags
#define GLEANER_TEXTURE_SRGB 1u  // RGB bytes are decoded from sRGB before they are filtered; alpha never is
#define GLEANER_WRAP_REPEAT 0u
#define GLEANER_WRAP_CLAMP 1u
#define GLEANER_WRAP_MIRROR 2u

// One image with a sampler, and how it is laid on: it is read at (t[0] u + t[1] v + t[2], t[3] u + t[4] v + t[5]).
// Texels are RGBA bytes, row 0 at v = 0 (glTF: the top). 64 bytes.
typedef struct {
  gl_uint first_texel;  // index of the first 4-byte texel
  gl_uint width, height;
  gl_uint wrap_u, wrap_v;
  gl_uint flags;
  gl_uint uv_set;         // 0: the vertices' uvs, 1: their second_uvs
  gl_float transform[6];  // t
  gl_uint reserved[3];
} Texture;
GLEANER_SIZE(Texture, 64);

#define GLEANER_LIGHT_POINT 0u
#define GLEANER_LIGHT_SPOT 1u
#define GLEANER_LIGHT_DIRECTIONAL 2u

// KHR_lights_punctual, in world space. 64 bytes.
typedef struct {
  gl_float position[3];
  gl_uint type;
  gl_float direction[3];  // unit, the way the light travels (glTF: the node's -Z)
  gl_float range;         // metres; 0 = without end
  gl_float intensity[3];  // point, spot: W/sr; directional: W/m^2
  gl_float cos_inner;
  gl_float cos_outer;
  gl_uint reserved[3];
} Light;
GLEANER_SIZE(Light, 64);

// A mesh that is stored in object space, placed in the world: x = transform[0] X + transform[1] Y + transform[2] Z +
// transform[3], and likewise y from the second four and z from the third. 64 bytes.
typedef struct {
  gl_float transform[12];
  gl_uint mesh;  // of Scene::meshes, an instanced one
  gl_uint reserved[3];
} Instance;
GLEANER_SIZE(Instance, 64);

#define GLEANER_CAMERA_PERSPECTIVE 0u
#define GLEANER_CAMERA_ORTHOGRAPHIC 1u

// Pinhole or orthographic camera; axes are unit, right-handed, the camera looks along `forward`. 64 bytes.
typedef struct {
  gl_float origin[3];
  gl_uint type;
  gl_float right[3];
  gl_float half_width;  // perspective: tan(xfov / 2) = half_height * aspect; orthographic: xmag (metres)
  gl_float up[3];
  gl_float half_height;  // perspective: tan(yfov / 2); orthographic: ymag
  gl_float forward[3];
  gl_float reserved;
} Camera;
GLEANER_SIZE(Camera, 64);

// Node of the wide-free binary BVH the OpenCL tracer walks: the boxes of both children. A child index with the top bit
// set is a leaf: bits 0..26 first triangle slot, bits 27..30 count (1..15; 0 where a scene is too small for two
// leaves). 64 bytes.
#define GLEANER_BVH_LEAF 0x80000000u
typedef struct {
  gl_float lower0[3], upper0[3];
  gl_float lower1[3], upper1[3];
  gl_uint child[2];
  gl_uint reserved[2];
} BvhNode;
GLEANER_SIZE(BvhNode, 64);

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::scene
#endif

#endif
