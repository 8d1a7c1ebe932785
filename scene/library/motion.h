#pragma once
// How a scene of the library moves: nodes that carry meshes, cameras and lights, and the keys of an animation. The
// scene's arrays show it at time 0, where every node stands at its pivot, unturned, and every morph weight is 0.

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

enum class Interpolation { linear, cubic_spline };

// Values over time: of a cubic spline an in-tangent, a value and an out-tangent a key, else one value.
struct Keys {
  Interpolation interpolation = Interpolation::linear;
  std::vector<float> times;  // seconds, rising
  std::vector<float> values;
};

struct MotionNode {
  std::string name;
  std::int32_t parent = -1;         // a node before this one; -1: none
  std::array<float, 3> pivot = {};  // in the scene's space, multiples of 1/64 m: their differences are exact
  Keys moved = {};                  // metres from the pivot, 3 a value; without times: stands still
  Keys turned = {};                 // about the pivot: unit quaternions x y z w; alike
};

// Linear blend skinning of a mesh by two joints a vertex.
struct MotionSkin {
  struct Influence {
    std::array<std::uint16_t, 2> joints;  // of the skin's
    std::array<float, 2> weights;         // their sum is 1
  };
  std::vector<std::uint32_t> joints;  // nodes
  std::vector<Influence> influences;  // of the mesh's vertices, in the scene's order
};

struct MotionMorph {
  std::vector<std::vector<float>> positions, normals;  // by target: 3 floats a vertex of the mesh
  Keys weights;                                        // one a target and key
};

struct Motion {
  std::vector<MotionNode> nodes;
  // By a mesh's or camera's number in the scene: the node that carries it. These stand before all others in the scene.
  std::map<std::size_t, std::uint32_t> meshes, cameras;
  std::map<std::size_t, MotionSkin> skins;    // by mesh: joints carry it, no node does
  std::map<std::size_t, MotionMorph> morphs;  // by mesh

  bool empty() const { return nodes.empty() && morphs.empty(); }
};

struct AnimatedScene {
  Scene scene;
  Motion motion;
};

}  // namespace gleaner::scene
