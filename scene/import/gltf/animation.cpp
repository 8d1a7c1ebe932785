#include "scene/import/gltf/animation.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include "scene/model/error.h"

namespace gleaner::scene::gltf {
namespace {

using Values = std::vector<double>;
using Pointer = nlohmann::json::json_pointer;

Values read_floats(const Document& document, const Element& reference, std::initializer_list<const char*> types) {
  const FloatView view(accessor_of(document, reference, types));
  Values values;
  values.reserve(view.size() * view.components());
  std::vector<float> one(view.components());
  for (std::size_t i = 0; i < view.size(); ++i) {
    view.load(i, one.data());
    for (const float x : one) {
      if (!std::isfinite(x)) reference.fail("finite numbers", "one of element " + std::to_string(i) + " that is not");
      values.push_back(x);
    }
  }
  return values;
}

void make_unit(Values& quaternion) {
  double squared = 0;
  for (const double x : quaternion) squared += x * x;
  if (!(squared > 0)) {
    quaternion = {0, 0, 0, 1};
    return;
  }
  for (double& x : quaternion) x /= std::sqrt(squared);
}

// Along the shorter arc between unit quaternions (glTF 2.0, appendix C.4).
Values slerp(const Values& from, Values to, double part) {
  double cosine = 0;
  for (int k = 0; k < 4; ++k) cosine += from[k] * to[k];
  if (cosine < 0) {
    cosine = -cosine;
    for (double& x : to) x = -x;
  }
  double a = 1 - part, b = part;
  // Nearly equal: the arc is a line.
  if (const double angle = std::acos(std::min(cosine, 1.0)); angle > 1e-6) {
    a = std::sin(a * angle) / std::sin(angle);
    b = std::sin(b * angle) / std::sin(angle);
  }
  Values result(4);
  for (int k = 0; k < 4; ++k) result[k] = a * from[k] + b * to[k];
  make_unit(result);
  return result;
}

// Of the mesh under a node; 0: there are none.
std::size_t morph_targets(const Document& document, const Element& node) {
  const auto mesh = node.find("mesh");
  if (!mesh) return 0;
  const Element primitives = document.item("meshes", *mesh).at("primitives");
  std::size_t most = 0;
  for (std::size_t p = 0; p < primitives.size(); ++p)
    if (const auto targets = primitives[p].find("targets")) most = std::max(most, targets->size());
  return most;
}

// What a channel of a node animates, and how many numbers that has (0: what the output says).
std::size_t components_of(const Element& path) {
  const std::string& word = path.text();
  if (word == "translation" || word == "scale") return 3;
  if (word == "rotation") return 4;
  if (word == "weights") return 0;
  path.fail("translation, rotation, scale, weights or pointer");
}

bool names_rotation(const Pointer& pointer) {
  return pointer.to_string().starts_with("/nodes/") && pointer.back() == "rotation";
}

// The file's own value that a pointer leads to, or null.
const nlohmann::json* find(const nlohmann::json& root, const Pointer& pointer) {
  return root.contains(pointer) ? &root.at(pointer) : nullptr;
}

// A pointer's number, or array of numbers. Where the file leaves it to its default, its length is unknown: 0.
std::size_t components_of(const Document& document, const Element& element, const Pointer& pointer, bool* scalar) {
  const nlohmann::json* value = find(document.root().json(), pointer);
  if (!value) return 0;
  *scalar = value->is_number();
  if (*scalar) return 1;
  if (!value->is_array() || value->empty() || !std::ranges::all_of(*value, [](const auto& x) { return x.is_number(); }))
    element.fail("a pointer to a number or an array of numbers");
  return value->size();
}

// Properties that are not in the file yet are made below an object that is.
bool has_place(const nlohmann::json& root, Pointer pointer) {
  for (pointer = pointer.parent_pointer(); !pointer.empty(); pointer = pointer.parent_pointer())
    if (const nlohmann::json* parent = find(root, pointer)) return parent->is_object();
  return false;
}

bool is_known(const std::string& pointer) {
  for (const char* root :
       {"/nodes/", "/materials/", "/cameras/", "/meshes/", "/extensions/KHR_lights_punctual/lights/"})
    if (pointer.starts_with(root)) return true;
  return false;
}

}  // namespace

Sampler::Sampler(const Document& document, const Element& sampler, std::size_t components, bool rotation)
    : rotation_(rotation), components_(components) {
  if (const auto word = sampler.find("interpolation")) {
    if (word->text() == "STEP")
      interpolation_ = Interpolation::step;
    else if (word->text() == "CUBICSPLINE")
      interpolation_ = Interpolation::cubic_spline;
    else if (word->text() != "LINEAR")
      word->fail("LINEAR, STEP or CUBICSPLINE");
  }
  const Element input = sampler.at("input"), output = sampler.at("output");
  times_ = read_floats(document, input, {"SCALAR"});
  if (times_.empty()) input.fail("at least one key", "none");
  for (std::size_t i = 0; i < times_.size(); ++i)
    if (times_[i] < 0 || (i > 0 && times_[i] <= times_[i - 1]))
      input.fail("times from 0 on that rise",
                 "element " + std::to_string(i) + " of " + std::to_string(times_[i]) + " s");
  values_ = read_floats(document, output, {"SCALAR", "VEC2", "VEC3", "VEC4"});
  const std::size_t keys = times_.size() * (interpolation_ == Interpolation::cubic_spline ? 3 : 1);
  if (components_ == 0) components_ = values_.size() / keys;
  if (components_ == 0 || values_.size() != keys * components_)
    output.fail(std::to_string(keys) + " values of " +
                    (components_ ? std::to_string(components_) : std::string("one or more")) + " numbers",
                std::to_string(values_.size()) + " numbers");
  for (std::size_t key = 0; rotation_ && key < times_.size(); ++key)
    if (std::ranges::all_of(value(key, interpolation_ == Interpolation::cubic_spline ? 1 : 0),
                            [](double x) { return x == 0; }))
      output.fail("a quaternion", "four zeros at key " + std::to_string(key));
  // What was stored as integers is not of unit length.
  if (rotation_ && interpolation_ != Interpolation::cubic_spline)
    for (std::size_t key = 0; key < times_.size(); ++key) {
      Values quaternion = value(key, 0);
      make_unit(quaternion);
      std::ranges::copy(quaternion, values_.begin() + static_cast<std::ptrdiff_t>(key * components_));
    }
}

// Of a cubic spline's key: part 0 is the in-tangent, 1 the value, 2 the out-tangent.
Values Sampler::value(std::size_t key, std::size_t part) const {
  const std::size_t parts = interpolation_ == Interpolation::cubic_spline ? 3 : 1;
  const auto begin = values_.begin() + static_cast<std::ptrdiff_t>((key * parts + part) * components_);
  return {begin, begin + static_cast<std::ptrdiff_t>(components_)};
}

Values Sampler::linear(std::size_t key, double part) const {
  const Values from = value(key, 0), to = value(key + 1, 0);
  if (rotation_) return slerp(from, to, part);
  Values result(components_);
  for (std::size_t k = 0; k < components_; ++k) result[k] = from[k] + part * (to[k] - from[k]);
  return result;
}

// Hermite's (glTF 2.0, appendix C.5): tangents are per second, `span` is the seconds between the keys.
Values Sampler::cubic(std::size_t key, double part, double span) const {
  const Values from = value(key, 1), leaving = value(key, 2), arriving = value(key + 1, 0), to = value(key + 1, 1);
  const double t = part, t2 = t * t, t3 = t2 * t;
  Values result(components_);
  for (std::size_t k = 0; k < components_; ++k)
    result[k] = (2 * t3 - 3 * t2 + 1) * from[k] + span * (t3 - 2 * t2 + t) * leaving[k] + (3 * t2 - 2 * t3) * to[k] +
                span * (t3 - t2) * arriving[k];
  return result;
}

Values Sampler::at(double seconds) const {
  const bool spline = interpolation_ == Interpolation::cubic_spline;
  const auto after = std::ranges::upper_bound(times_, seconds);
  const std::size_t next = static_cast<std::size_t>(after - times_.begin()), last = times_.size() - 1;
  Values result;
  if (next == 0 || next > last || interpolation_ == Interpolation::step) {
    result = value(next == 0 ? 0 : next - 1, spline ? 1 : 0);
  } else {
    const double span = times_[next] - times_[next - 1], part = (seconds - times_[next - 1]) / span;
    result = spline ? cubic(next - 1, part, span) : linear(next - 1, part);
  }
  if (rotation_) make_unit(result);
  return result;
}

// Between keys values lie between those of the keys; splines, between the four control points of the same curve in
// Bezier's form.
bool Sampler::stays_off_zero(double least) const {
  const bool spline = interpolation_ == Interpolation::cubic_spline;
  for (std::size_t key = 0; key < times_.size(); ++key) {
    std::vector<Values> points = {value(key, spline ? 1 : 0)};
    if (key + 1 < times_.size() && interpolation_ != Interpolation::step) {
      points.push_back(value(key + 1, spline ? 1 : 0));
      if (spline) {
        const double third = (times_[key + 1] - times_[key]) / 3;
        const Values leaving = value(key, 2), arriving = value(key + 1, 0);
        for (const double side : {1.0, -1.0}) {
          Values control = side > 0 ? points[0] : points[1];
          for (std::size_t k = 0; k < components_; ++k)
            control[k] += side * third * (side > 0 ? leaving[k] : arriving[k]);
          points.push_back(control);
        }
      }
    }
    for (std::size_t k = 0; k < components_; ++k)
      if (!std::ranges::all_of(points, [&](const Values& p) { return p[k] > least; }) &&
          !std::ranges::all_of(points, [&](const Values& p) { return p[k] < -least; }))
        return false;
  }
  return true;
}

Animations::Animations(const Document& document, const std::string& wanted, Warnings& warnings) {
  const std::size_t count = document.size("animations");
  std::string known;
  bool found = wanted == "all";
  for (std::size_t i = 0; i < count; ++i) {
    const Element animation = document.item("animations", i);
    const auto name = animation.find("name");
    list_.push_back({name ? name->text() : "", 0});
    const bool chosen = wanted == "all" || list_.back().name == wanted || std::to_string(i) == wanted;
    // Of equal names the first is meant.
    if (chosen && (wanted == "all" || !found)) {
      found = true;
      read(document, i, warnings);
    }
    known += (known.empty() ? "" : ", ") + (list_[i].name.empty() ? std::to_string(i) : "\"" + list_[i].name + "\"");
    for (std::size_t s = 0; s < animation.at("samplers").size(); ++s)
      for (const double time : read_floats(document, animation.at("samplers")[s].at("input"), {"SCALAR"}))
        list_[i].seconds = std::max(list_[i].seconds, time);
  }
  if (!found)
    throw Error::bad_input(document.file(), "animation \"" + wanted + "\"",
                           count ? "all, a number below " + std::to_string(count) + ", or one of " + known
                                 : "all: the file has no animations");
}

void Animations::read(const Document& document, std::size_t index, Warnings& warnings) {
  const Element animation = document.item("animations", index), channels = animation.at("channels");
  for (std::size_t c = 0; c < channels.size(); ++c) add(document, animation, channels[c], warnings);
}

void Animations::add(const Document& document, const Element& animation, const Element& channel, Warnings& warnings) {
  const Element target = channel.at("target"), path = target.at("path");
  Pointer pointer;
  bool scalar = false;
  std::size_t components = 0;
  if (path.text() == "pointer") {
    const auto extension = target.extension("KHR_animation_pointer");
    if (!extension) target.fail("KHR_animation_pointer beside the path \"pointer\"", "none");
    const Element word = extension->at("pointer");
    try {
      pointer = Pointer(word.text());
    } catch (const nlohmann::json::exception&) {
      word.fail("a JSON pointer");
    }
    if (!is_known(word.text())) {
      warnings.add(word.name(), "animates what is not rendered, and is passed over");
      return;
    }
    if (!has_place(document.root().json(), pointer)) word.fail("a pointer to something in this file");
    components = components_of(document, word, pointer, &scalar);
  } else {
    components = components_of(path);
    const auto node = target.find("node");
    if (!node) return;  // an extension's, which says what is animated
    const Element moved = document.item("nodes", *node);
    if (moved.find("matrix") && path.text() != "weights")
      moved.at("matrix").fail("translation, rotation and scale of a node that is animated");
    if (path.text() == "weights") components = morph_targets(document, moved);
    pointer = Pointer("/nodes/" + std::to_string(node->index(document.size("nodes"))) + "/" + path.text());
  }
  const Element samplers = animation.at("samplers");
  const Element sampler = samplers[channel.at("sampler").index(samplers.size())];
  Channel made{pointer, pointer.to_string(), scalar, Sampler(document, sampler, components, names_rotation(pointer))};
  // A default that the file leaves out is a number where one number animates it.
  if (path.text() == "pointer" && components == 0) made.scalar = made.sampler.components() == 1;
  const auto [place, is_new] = channel_of_.try_emplace(made.text, channels_.size());
  if (is_new) {
    channels_.push_back(std::move(made));
    return;
  }
  warnings.add(channel.name(), "animates what another channel animates as well; the later one is played");
  channels_[place->second] = std::move(made);
}

bool Animations::animates(const std::string& pointer) const {
  const auto within = channel_of_.lower_bound(pointer + "/");
  return channel_of_.contains(pointer) || (within != channel_of_.end() && within->first.starts_with(pointer + "/"));
}

bool Animations::may_vanish(const std::string& pointer, double least) const {
  const auto channel = channel_of_.find(pointer);
  return channel != channel_of_.end() && !channels_[channel->second].sampler.stays_off_zero(least);
}

bool Animations::needs_own_scenes() const {
  return std::ranges::any_of(channels_, [](const Channel& channel) {
    const std::string& text = channel.text;
    if (text.starts_with("/materials/")) return text.find("Texture") != std::string::npos;
    if (text.starts_with("/meshes/")) return text.find("/weights") == std::string::npos;
    if (!text.starts_with("/nodes/")) return false;
    const std::size_t path = text.find('/', std::string("/nodes/").size());
    for (const char* known : {"/translation", "/rotation", "/scale", "/weights"})
      if (path != std::string::npos && std::string_view(text).substr(path).starts_with(known)) return false;
    return true;
  });
}

void Animations::pose(double seconds, Document& document) const {
  for (const Channel& channel : channels_) {
    const Values values = channel.sampler.at(seconds);
    if (channel.scalar)
      document.put(channel.target, values.front());
    else
      document.put(channel.target, values);
  }
}

}  // namespace gleaner::scene::gltf
