#pragma once
// One primitive of a mesh: its triangles, and its vertices as they stand in the mesh's own space, morph targets
// applied.

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/import/gltf/accessor.h"
#include "scene/import/gltf/compression.h"
#include "scene/import/gltf/document.h"
#include "scene/import/gltf/transform.h"

namespace gleaner::scene::gltf {

// What a primitive will add to a scene, from counts alone: sizes are known before memory is taken. Zero triangles where
// there is nothing to draw.
struct PrimitiveSize {
  std::size_t triangles = 0, vertices = 0;
};
PrimitiveSize size_of(const Document& document, const Element& primitive);

// Primitives that are Draco's, decoded once.
using DracoMeshes = std::map<std::string, std::shared_ptr<const DracoMesh>>;

class Primitive {
 public:
  // `weights`: of the morph targets, missing ones are 0. The primitive has triangles (size_of).
  Primitive(const Document& document, const Element& element, const std::vector<double>& weights, DracoMeshes& decoded,
            Warnings& warnings);

  const Element& element() const { return element_; }
  std::size_t vertices() const { return position_.size(); }
  std::size_t triangles() const;
  // Corners in the order that shows the front. Throws where the file names a vertex that is not there.
  std::array<std::uint32_t, 3> triangle(std::size_t i) const;

  Vector position(std::size_t v) const;
  bool has_normals() const { return normal_.has_value(); }
  Vector normal(std::size_t v) const;
  bool has_colors() const { return color_.has_value(); }
  std::array<float, 4> color(std::size_t v) const;  // linear RGBA
  // Texture coordinates of a set; nothing where the primitive lacks it.
  std::optional<FloatView> uvs(std::size_t set) const;
  void morph_uv(std::size_t set, std::size_t v, float (&uv)[2]) const;

  // The same without morph targets.
  Vector rest_position(std::size_t v) const;
  Vector rest_normal(std::size_t v) const;
  std::size_t targets() const;
  // Differences of a morph target ("POSITION", "NORMAL"), whatever its weight; nothing where it has none.
  std::optional<FloatView> deltas(std::size_t target, const char* key) const;
  // Whether a morph target changes colours or texture coordinates.
  bool morphs_looks() const;

  bool has_joints() const { return !influences_.empty(); }
  std::size_t influences() const { return 4 * influences_.size(); }  // of a vertex
  // Calls with(joint, weight) for all of them, those of weight 0 as well.
  template <typename With>
  void each_influence(std::size_t v, const With& with) const {
    for (const Influence& influence : influences_) {
      float weight[4];
      influence.weights.load(v, weight);
      for (std::size_t k = 0; k < 4; ++k) with(influence.joints.at(v, k), weight[k]);
    }
  }
  // Calls with(joint, weight) for what moves a vertex.
  template <typename With>
  void each_joint(std::size_t v, const With& with) const {
    each_influence(v, [&](std::uint32_t joint, float weight) {
      if (weight != 0) with(joint, double(weight));
    });
  }

 private:
  struct Influence {
    IndexView joints;
    FloatView weights;
  };
  struct Target {
    double weight;
    std::optional<FloatView> position, normal, color;
    std::map<std::size_t, FloatView> uvs;
  };

  std::optional<FloatView> attribute(const Element& attributes, const std::string& key,
                                     std::initializer_list<const char*> types) const;
  void read_joints(const Element& attributes);
  void read_targets(const std::vector<double>& weights);
  void load_draco(DracoMeshes& decoded);

  const Document& document_;
  Element element_;
  Warnings& warnings_;
  std::shared_ptr<const DracoMesh> draco_;
  std::uint64_t mode_ = 4;
  std::optional<IndexView> indices_;
  FloatView position_;
  std::optional<FloatView> normal_, color_;
  std::vector<Influence> influences_;
  std::vector<Target> targets_;
};

}  // namespace gleaner::scene::gltf
