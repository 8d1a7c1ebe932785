// The scene as the kernels read it: tables of 32-bit words, derived from the blob when a device loads it. A word is
// named by its offset in a row, so that a varying row index gathers one column. Compiled by OpenCL C and by C++.
#ifndef GLEANER_KERNELS_SCENE_LAYOUT_H
#define GLEANER_KERNELS_SCENE_LAYOUT_H

#include "scene/model/records.h"

// Triangles: all that shading reads of one, in two cache lines; the second only where normals, uvs or vertex colours
// are needed, a third only in scenes with second uvs. DeviceScene::triangle_words() is the length of a row.
#define TRIANGLE_WORDS_PLAIN 32u
#define TRIANGLE_WORDS_SECOND_UVS 48u
#ifdef NEED_SECOND_UVS
#define TRIANGLE_WORDS TRIANGLE_WORDS_SECOND_UVS
#else
#define TRIANGLE_WORDS TRIANGLE_WORDS_PLAIN
#endif
#define TRIANGLE_P0 0u
#define TRIANGLE_P1 3u
#define TRIANGLE_P2 6u
#define TRIANGLE_MATERIAL 9u
#define TRIANGLE_EMITTER 10u  // row of the emitter table, or GLEANER_NONE
// Colours of the corners: two words each, 16 bits a channel, R lowest. The third does not fit into the first line.
#define TRIANGLE_COLOR0 11u
#define TRIANGLE_COLOR1 13u
#define TRIANGLE_COLOR2_RG 15u
#define TRIANGLE_COLOR2_BA 31u
#define TRIANGLE_SECOND 16u  // where the second line begins
#define TRIANGLE_N0 16u
#define TRIANGLE_N1 19u
#define TRIANGLE_N2 22u
#define TRIANGLE_UV0 25u
#define TRIANGLE_UV1 27u
#define TRIANGLE_UV2 29u
#define TRIANGLE_THIRD 32u  // where the third line begins
#define TRIANGLE_SECOND_UV0 32u
#define TRIANGLE_SECOND_UV1 34u
#define TRIANGLE_SECOND_UV2 36u

// Instances: row 0 is of what stands in the world as it is, row i + 1 of instance i. The first line places points, the
// second turns normals (the inverse transpose).
#define INSTANCE_WORDS 32u
#define INSTANCE_LINEAR 0u  // row by row
#define INSTANCE_TRANSLATION 9u
#define INSTANCE_ERROR 12u   // bound, an axis, of what placing and queries round (scene/model/instances.h)
#define INSTANCE_SIDE 15u    // -1 where the transform turns triangles inside out, else 1
#define INSTANCE_SECOND 16u  // where the second line begins
#define INSTANCE_NORMAL 16u  // row by row

// Materials: what every vertex needs in the first cache line, what few need behind it.
#define MATERIAL_WORDS 64u
#define MATERIAL_BASE_COLOR 0u
#define MATERIAL_ALPHA 3u
#define MATERIAL_METALLIC 4u
#define MATERIAL_ROUGHNESS 5u
#define MATERIAL_SPECULAR 6u
#define MATERIAL_TRANSMISSION 7u
#define MATERIAL_F0 8u
#define MATERIAL_IOR 11u
#define MATERIAL_FLAGS 12u
#define MATERIAL_BASE_COLOR_TEXTURE 13u
#define MATERIAL_ALBEDO_TABLE 14u
#define MATERIAL_ALBEDO_ROWS 15u
#define MATERIAL_ALPHA_CUTOFF 16u
#define MATERIAL_ATTENUATION 17u
#define MATERIAL_NORMAL_SCALE 20u
#define MATERIAL_METALLIC_ROUGHNESS_TEXTURE 21u
#define MATERIAL_NORMAL_TEXTURE 22u
#define MATERIAL_EMISSION_TEXTURE 23u
#define MATERIAL_TRANSMISSION_TEXTURE 24u
#define MATERIAL_SPECULAR_TEXTURE 25u
#define MATERIAL_SPECULAR_COLOR_TEXTURE 26u
#define MATERIAL_MEDIUM 27u     // rank of the solid that it bounds (scene/model/media.h), from 1; 0: none
#define MATERIAL_OF_MEDIUM 28u  // in row r: the material of the solid of rank r + 1
#define MATERIAL_CLEARCOAT 29u
#define MATERIAL_CLEARCOAT_ROUGHNESS 30u
#define MATERIAL_CLEARCOAT_NORMAL_SCALE 31u
#define MATERIAL_SHEEN_COLOR 32u
#define MATERIAL_SHEEN_ROUGHNESS 35u
#define MATERIAL_ANISOTROPY 36u
#define MATERIAL_ANISOTROPY_ROTATION 37u
#define MATERIAL_IRIDESCENCE 38u
#define MATERIAL_IRIDESCENCE_IOR 39u
#define MATERIAL_IRIDESCENCE_MINIMUM 40u
#define MATERIAL_IRIDESCENCE_MAXIMUM 41u
#define MATERIAL_CLEARCOAT_TEXTURE 42u
#define MATERIAL_CLEARCOAT_ROUGHNESS_TEXTURE 43u
#define MATERIAL_CLEARCOAT_NORMAL_TEXTURE 44u
#define MATERIAL_SHEEN_COLOR_TEXTURE 45u
#define MATERIAL_SHEEN_ROUGHNESS_TEXTURE 46u
#define MATERIAL_ANISOTROPY_TEXTURE 47u
#define MATERIAL_IRIDESCENCE_TEXTURE 48u
#define MATERIAL_IRIDESCENCE_THICKNESS_TEXTURE 49u
#define MATERIAL_CLEARCOAT_TABLE 50u
#define MATERIAL_SHEEN_TABLE 51u
#define MATERIAL_DIFFUSE_TRANSMISSION 52u
#define MATERIAL_DIFFUSE_TRANSMISSION_COLOR 53u
#define MATERIAL_DIFFUSE_TRANSMISSION_TEXTURE 56u
#define MATERIAL_DIFFUSE_TRANSMISSION_COLOR_TEXTURE 57u

// Textures: the words of gleaner::scene::Texture.
#define TEXTURE_WORDS 16u
#define TEXTURE_FIRST_TEXEL 0u
#define TEXTURE_WIDTH 1u
#define TEXTURE_HEIGHT 2u
#define TEXTURE_WRAP_U 3u
#define TEXTURE_WRAP_V 4u
#define TEXTURE_FLAGS 5u
#define TEXTURE_UV_SET 6u
#define TEXTURE_TRANSFORM 7u

// Emitters, sorted by cluster. Triangle: corner, two edges, radiance. Point and spot: position, direction, cosines,
// intensity. Directional: direction, irradiance. The environment has no row.
#define EMITTER_WORDS 16u
#define EMITTER_P0 0u
#define EMITTER_E1 3u
#define EMITTER_E2 6u
#define EMITTER_RADIANCE 9u
#define EMITTER_CDF 12u                // upper end of its share in its cluster
#define EMITTER_PMF 13u                // its share in its cluster
#define EMITTER_TRIANGLE 14u           // GLEANER_NONE for lights without one
#define EMITTER_CLUSTER 15u            // and EMITTER_TWO_SIDED
#define EMITTER_TWO_SIDED 0x80000000u  // a triangle that shines from both faces
#define EMITTER_POSITION 0u
#define EMITTER_DIRECTION 3u  // the way the light travels
#define EMITTER_COS_INNER 6u
#define EMITTER_COS_OUTER 7u
#define EMITTER_RANGE 8u

// Clusters of emitters of one kind: bounding sphere, cone of normals, power; read at uniform indices.
#define CLUSTER_WORDS 16u
#define CLUSTER_CENTER 0u
#define CLUSTER_RADIUS 3u
#define CLUSTER_AXIS 4u
#define CLUSTER_COS 7u
#define CLUSTER_SIN 8u
#define CLUSTER_POWER 9u  // irradiance it causes at distance 1 m facing it; directional, environment: anywhere
#define CLUSTER_FIRST 10u
#define CLUSTER_COUNT 11u
#define CLUSTER_KIND 12u
#define CLUSTER_TWO_SIDED 13u  // 1: its triangles shine from both faces, the cone of normals is one of two
#define CLUSTER_TRIANGLES 0u
#define CLUSTER_POSITIONAL 1u
#define CLUSTER_DIRECTIONAL 2u
#define CLUSTER_ENVIRONMENT 3u
#define MAX_CLUSTERS 64

// Environment: texels (3 words each), then the sampling density of each texel row by row (cumulated in u), then of the
// rows.
#define ENVIRONMENT_HEADER 4u  // width, height, row-search steps, column-search steps

// The lights as light paths choose them: this header, then each one's cumulated share of the scene's light, then, in
// scenes with media, the solids that each stands in (kernels/surface.h: Media, two words).
#define EMISSION_HEADER 8u
#define EMISSION_COUNT 0u
#define EMISSION_STEP 1u  // of the search: the largest power of two not above the count
#define EMISSION_CENTER 2u
#define EMISSION_RADIUS 5u
#define EMISSION_ENVIRONMENT 6u  // 1: the last entry is the environment

#endif
