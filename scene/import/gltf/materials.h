#pragma once
// Materials with their textures.

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "scene/import/gltf/document.h"
#include "scene/import/texture_table.h"
#include "scene/model/scene.h"

namespace gleaner::scene::gltf {

// Where texture coordinates come from: a set of the mesh, and KHR_texture_transform.
struct UvSource {
  std::size_t set = 0;
  double offset[2] = {0, 0}, rotation = 0, scale[2] = {1, 1};

  auto key() const { return std::tuple(set, offset[0], offset[1], rotation, scale[0], scale[1]); }
  bool operator==(const UvSource& other) const { return key() == other.key(); }
  bool is_plain() const { return offset[0] == 0 && offset[1] == 0 && rotation == 0 && scale[0] == 1 && scale[1] == 1; }
  // Rows of the 2 x 3 matrix that is applied to the set's coordinates.
  std::array<double, 6> matrix() const;
};

// What the vertices of a material's triangles carry: one or two sets of the mesh, each transformed beforehand where all
// that read it agree.
struct MaterialUvs {
  std::array<std::optional<UvSource>, 2> channels;
  bool operator==(const MaterialUvs&) const = default;
};

class Materials {
 public:
  Materials(const Document& document, Scene& scene, Warnings& warnings)
      : document_(document), scene_(scene), warnings_(warnings) {}

  // All materials of the file, in order; then the images.
  void read(std::uint64_t most_texels);
  void read_without_images();
  // Whether images, their coordinates and the slots that show them are those of `other`.
  bool lays_on_textures_as(const Materials& other) const;

  // The scene's number of the material that `primitive` names, directly or by a variant (its number in the file).
  std::uint32_t material_of(const Element& primitive, std::optional<std::size_t> variant);
  const MaterialUvs& uvs(std::uint32_t material) const { return uvs_[material]; }
  // Whether any texture reads the channel.
  bool needs_channel(std::size_t channel) const;

 private:
  struct PendingTexture {
    gl_uint Material::*slot;
    UvSource uv;
    TextureUse use;
    std::string name;
  };

  void add(const Element& element);
  void add_specular(const Element& element, Material& m);
  void add_transmission(const Element& element, Material& m);
  void add_volume(const Element& volume, Material& m);
  void add_diffuse_transmission(const Element& element, Material& m);
  void add_layers(const Element& element, Material& m);
  void add_film(const Element& film, Material& m);
  void add_alpha(const Element& element, Material& m);
  void add_emission(const Element& element, Material& m);
  void texture(const Element& owner, const char* key, bool is_srgb, gl_uint Material::*slot);
  std::optional<Element> image_of(const Element& texture);
  UvSource uv_source(const Element& info) const;
  void lay_on(Material& m);
  std::size_t image(const Element& element);

  const Document& document_;
  Scene& scene_;
  Warnings& warnings_;
  TextureTable textures_;
  std::vector<MaterialUvs> uvs_;
  std::size_t in_file_ = 0;
  std::vector<std::pair<gl_uint Material::*, gl_uint>> slots_;  // textures of all materials, in their order
  std::vector<PendingTexture> pending_;                         // of the material that is being read
  std::map<std::string, std::size_t> image_by_element_;
  std::vector<std::vector<std::byte>> embedded_;
  std::optional<std::uint32_t> default_material_;
};

}  // namespace gleaner::scene::gltf
