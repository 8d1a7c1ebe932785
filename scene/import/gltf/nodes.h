#pragma once
// The hierarchy of nodes, walked without recursion: files nest as deep as they like.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "scene/import/gltf/document.h"
#include "scene/import/gltf/transform.h"

namespace gleaner::scene::gltf {

class Nodes {
 public:
  // Throws where a node has two parents or is its own ancestor.
  Nodes(const Document& document, Warnings& warnings);

  // Those of the default scene (of a file without scenes: those that hang together), each before its children, in the
  // file's order.
  const std::vector<std::size_t>& in_scene() const { return in_scene_; }
  Element node(std::size_t index) const { return document_.item("nodes", index); }
  const Matrix& to_world(std::size_t index);
  std::optional<std::size_t> parent(std::size_t index) const;

 private:
  Matrix local(std::size_t index) const;
  std::vector<std::size_t> roots() const;
  void find_parents();
  void walk();

  const Document& document_;
  Warnings& warnings_;
  std::vector<std::size_t> parent_;  // kNone: a root
  std::vector<std::size_t> in_scene_;
  std::vector<Matrix> to_world_;
  std::vector<bool> has_world_;
};

}  // namespace gleaner::scene::gltf
