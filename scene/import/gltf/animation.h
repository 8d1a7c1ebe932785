#pragma once
// Animations of a glTF file (section 3.11, KHR_animation_pointer), played by putting the values of a time into the
// document: whatever reads it afterwards reads that pose.

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/files/warnings.h"
#include "scene/import/gltf/accessor.h"
#include "scene/import/gltf/document.h"
#include "scene/model/scene.h"

namespace gleaner::scene::gltf {

// One channel's keys and values.
class Sampler {
 public:
  // `components`: of a value that is animated; 0: as many as the output has for each key (morph weights, pointers to
  // arrays). Throws Error::bad_input where times do not rise, counts do not fit, or a number is not finite.
  Sampler(const Document& document, const Element& sampler, std::size_t components, bool rotation);

  // Holds the first and the last value outside of the keys. Rotations are unit quaternions.
  std::vector<double> at(double seconds) const;
  std::size_t components() const { return components_; }
  // Whether no component comes as near to 0 as `least` at any time. May say no where none does.
  bool stays_off_zero(double least) const;

 private:
  enum class Interpolation { step, linear, cubic_spline };
  std::vector<double> value(std::size_t key, std::size_t part) const;
  std::vector<double> linear(std::size_t key, double part) const;
  std::vector<double> cubic(std::size_t key, double part, double span) const;

  Interpolation interpolation_ = Interpolation::linear;
  bool rotation_;
  std::size_t components_;
  std::vector<double> times_;
  std::vector<double> values_;  // components_ each; cubic splines: in-tangent, value, out-tangent of each key
};

class Animations {
 public:
  // Reads those that `wanted` names: a name, a number, or "all". Throws Error::bad_input for one that is not there.
  Animations(const Document& document, const std::string& wanted, Warnings& warnings);

  // All of the file's, by name and length.
  const std::vector<AnimationInfo>& list() const { return list_; }

  // Whether any channel of those that were read moves something that is rendered.
  bool moves() const { return !channels_.empty(); }
  // Whether a channel animates the value that the JSON pointer leads to, or one within it.
  bool animates(const std::string& pointer) const;
  // Whether a value that is animated may come as near to 0 as `least`, in a component.
  bool may_vanish(const std::string& pointer, double least) const;
  // Whether they animate what changes a scene's topology or its textures: no pose of one base shows that.
  bool needs_own_scenes() const;

  // Puts their values at that time into the document.
  void pose(double seconds, Document& document) const;

 private:
  struct Channel {
    nlohmann::json::json_pointer target;
    std::string text;  // of the target
    bool scalar = false;
    Sampler sampler;
  };
  void read(const Document& document, std::size_t index, Warnings& warnings);
  void add(const Document& document, const Element& animation, const Element& channel, Warnings& warnings);

  std::vector<AnimationInfo> list_;
  std::vector<Channel> channels_;
  std::map<std::string, std::size_t> channel_of_;  // by the target's text
};

}  // namespace gleaner::scene::gltf
