#include "scene/import/sequence.h"

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::scene {

namespace fs = std::filesystem;

namespace {

// All but where the vertices are and how they face.
bool same_mesh(const Scene& a, const Scene& b) {
  const auto same_meshes = [&] {
    return std::equal(a.meshes.begin(), a.meshes.end(), b.meshes.begin(), b.meshes.end(),
                      [](const Mesh& m, const Mesh& n) {
                        return m.first_triangle == n.first_triangle && m.triangle_count == n.triangle_count;
                      });
  };
  return a.positions.size() == b.positions.size() && a.indices == b.indices &&
         a.triangle_material == b.triangle_material && a.uvs == b.uvs && a.colors == b.colors && same_meshes() &&
         same_bytes(a.materials, b.materials) && same_bytes(a.textures, b.textures) && a.texels == b.texels;
}

}  // namespace

std::string file_of_frame(const std::string& pattern, std::uint32_t frame) {
  const fs::path path(pattern);
  const std::string name = path.filename().string(), number = std::to_string(frame);
  std::string out;
  for (std::size_t at = 0; at < name.size();) {
    if (name[at] != '#') {
      out += name[at++];
      continue;
    }
    const std::size_t end = std::min(name.find_first_not_of('#', at), name.size());
    out += std::string(end - at - std::min(end - at, number.size()), '0') + number;
    at = end;
  }
  return (path.parent_path() / out).string();
}

bool is_sequence(const std::string& path) {
  std::error_code code;
  return fs::path(path).filename().string().find('#') != std::string::npos && !fs::exists(path, code);
}

Sequence::Sequence(const std::string& pattern, const FrameNumbers& frames) : pattern_(pattern), frames_(frames) {
  for (std::uint64_t i = 0; i < frames.count(); ++i) {
    std::error_code code;
    if (const std::string file = file_of(frames.at(i)); !fs::is_regular_file(file, code))
      throw Error::bad_input(
          file, "", "a file for each frame of " + pattern + " (frame " + std::to_string(frames.at(i)) + " has none)");
  }
}

void Sequence::make_rig(Scene& base, const Scene& first, const std::function<Scene(const std::string&)>& read) {
  const std::uint64_t frames = frames_.count(), values = first.positions.size();
  if (values == 0 || frames > kMostTargets || frames * values > kMostRigBytes / (2 * sizeof(float))) return;
  Rig rig;
  rig.deltas.reserve(2 * values * frames);
  for (std::uint64_t i = 0; i < frames; ++i) {
    Scene own;
    if (i > 0) own = read(file_of(frames_.at(i)));
    const Scene& shown = i == 0 ? first : own;
    if (!same_mesh(first, shown)) return;
    const auto at = static_cast<gl_uint>(rig.deltas.size());
    rig.targets.push_back({.positions = at, .normals = static_cast<gl_uint>(at + values)});
    rig.deltas.insert(rig.deltas.end(), shown.positions.begin(), shown.positions.end());
    rig.deltas.insert(rig.deltas.end(), shown.normals.begin(), shown.normals.end());
  }
  rig.positions.assign(values, 0.0f);
  rig.normals.assign(values, 0.0f);
  rig.matrices = 1;
  rig.morph_weights = static_cast<std::uint32_t>(frames);
  PosedMesh mesh{};
  mesh.vertex_count = static_cast<gl_uint>(values / 3);
  mesh.triangle_count = static_cast<gl_uint>(first.triangle_count());
  mesh.target_count = static_cast<gl_uint>(frames);
  mesh.matrix_count = 1;
  rig.meshes = {mesh};
  base.rig = std::move(rig);
  // Groups of a file share vertices, posed meshes do not: all of it is one.
  base.meshes = {{.name = fs::path(pattern_).stem().string(),
                  .first_triangle = 0,
                  .triangle_count = static_cast<std::uint32_t>(first.triangle_count())}};
  mark_deforming(base);
  rigged_ = true;
}

std::optional<FrameState> Sequence::state_of(std::uint32_t frame) const {
  const auto place = frames_.place_of(frame);
  if (!place) throw Error::usage(pattern_ + ": frame " + std::to_string(frame) + " is none of --frames");
  if (!rigged_) return std::nullopt;
  FrameState state;
  state.matrices = {Placement{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
  state.morph_weights.assign(frames_.count(), 0.0);
  state.morph_weights[*place] = 1;
  return state;
}

}  // namespace gleaner::scene
