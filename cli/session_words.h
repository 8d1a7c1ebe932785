#pragma once
// What people say to a session, a line each, as changes of the scene.

#include <map>
#include <string>
#include <variant>

#include "coordinator/plan/plan.h"
#include "gleaner/v1/farm.pb.h"
#include "scene/model/scene.h"

namespace gleaner::cli {

// Waits until all changes so far are shown, or until the last, finest picture of them is.
enum class SessionPause { shown, settled };
struct SessionEnd {};

class SessionWords {
 public:
  // `objects`: numbers of matrices by names of meshes.
  SessionWords(const scene::Scene& scene, const coordinator::FrameSettings& settings,
               std::map<std::string, std::uint32_t> objects);

  using Meaning = std::variant<std::monostate, gleaner::v1::SessionChange, SessionPause, SessionEnd>;
  // An empty line and a comment (#) mean nothing. Throws Error::usage for words that are none, Error::bad_input for
  // what the scene lacks.
  Meaning read(const std::string& line) const;

  static const char* help();

 private:
  std::uint32_t material(const std::string& word) const;

  coordinator::FrameSettings settings_;
  scene::Scene names_;  // of the scene: materials, origin, and as many lights
  std::map<std::string, std::uint32_t> objects_;
};

}  // namespace gleaner::cli
