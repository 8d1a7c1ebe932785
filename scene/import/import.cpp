#include "scene/import/import.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <set>

#include "scene/import/formats.h"
#include "scene/import/gltf/file.h"
#include "scene/import/placement.h"
#include "scene/import/sequence.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::scene {
namespace {

std::string lower_case_extension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

// `--camera NAME` must mean one camera.
void make_camera_names_unique(std::vector<NamedCamera>& cameras) {
  std::set<std::string> taken;
  for (NamedCamera& camera : cameras) {
    std::string name = camera.name;
    for (int n = 2; !taken.insert(name).second; ++n) name = camera.name + " " + std::to_string(n);
    camera.name = name;
  }
}

bool is_gltf(const std::string& path) {
  const std::string extension = lower_case_extension(path);
  return extension == ".gltf" || extension == ".glb";
}

Scene read(const std::string& path, const ImportOptions& options, Warnings& warnings) {
  const std::string extension = lower_case_extension(path);
  if (extension == ".obj") return read_obj(path, options, warnings);
  if (extension == ".ply") return read_ply(path, warnings);
  if (extension == ".stl") return read_stl(path, warnings);
  throw Error::bad_input(path, "", "a file whose name ends in .gltf, .glb, .obj, .ply or .stl");
}

// What every format needs, and the checks of the whole.
void finish(Scene& scene, const std::string& path, const ImportOptions& options, Warnings& warnings) {
  scene.name = std::filesystem::path(path).stem().string();
  finish_materials(scene);
  if (scene.triangle_count() == 0) warnings.add("the scene has no triangles");
  if (scene.cameras.empty() && options.needs_camera)
    warnings.add("the scene has no camera: one was added that frames it from the front (+z); --look-at sets another");
  if (scene.cameras.empty()) scene.cameras.push_back(framing_camera(scene));
  make_camera_names_unique(scene.cameras);
  validate(scene, path);
  warn_of_coarse_meshes(scene, warnings);
  scene.warnings = warnings.list();
  if (options.strict && !scene.warnings.empty()) {
    std::string all;
    for (const std::string& warning : scene.warnings) all += (all.empty() ? "" : "; ") + warning;
    throw Error::bad_input(path, "--strict", "a file without warnings", all);
  }
}

}  // namespace

LightUnits parse_light_units(const std::string& word) {
  if (word == "auto") return LightUnits::automatic;
  if (word == "radiometric") return LightUnits::radiometric;
  if (word == "photometric") return LightUnits::photometric;
  throw Error::usage("--light-units: expected auto, radiometric or photometric, found \"" + word + "\"");
}

Material grey_material() {
  constexpr float reflectance = 0.8f;
  Material m = blank_material();
  std::fill(m.base_color, m.base_color + 3, reflectance);
  return m;
}

struct MovingScene::Impl {
  std::string path;
  ImportOptions options;
  Warnings warnings;
  std::unique_ptr<gltf::File> file;    // where the scene moves
  std::unique_ptr<Sequence> sequence;  // or is one of files
  Scene base;

  void open_sequence();
};

MovingScene::MovingScene(const std::string& path, const ImportOptions& options)
    : impl_(std::make_unique<Impl>(path, options, Warnings{}, nullptr, nullptr, Scene{})) {
  if (scene::is_sequence(path)) {
    impl_->open_sequence();
    return;
  }
  if (is_gltf(path)) {
    impl_->file = std::make_unique<gltf::File>(path, options, impl_->warnings);
    impl_->base = impl_->file->moves() ? impl_->file->read_base() : impl_->file->read_at(0);
    if (!impl_->file->moves()) impl_->file.reset();
    mark_deforming(impl_->base);
  } else {
    impl_->base = read(path, options, impl_->warnings);
  }
  finish(impl_->base, path, options, impl_->warnings);
}

void MovingScene::Impl::open_sequence() {
  if (lower_case_extension(path) != ".obj")
    throw Error::usage(path + ": a file a frame: expected a name that ends in .obj");
  if (!options.frames) throw Error::usage(path + ": a file a frame: --frames A-B must say which");
  sequence = std::make_unique<Sequence>(path, *options.frames);
  const Scene first = read_obj(sequence->file_of(options.frames->first), options, warnings);
  options.origin = first.origin;  // all frames have the first one's
  base = first;
  sequence->make_rig(base, first, [&](const std::string& of_frame) { return read_obj(of_frame, options, warnings); });
  finish(base, path, options, warnings);
}

MovingScene::~MovingScene() = default;
bool MovingScene::moves() const { return impl_->file != nullptr || impl_->sequence != nullptr; }
bool MovingScene::is_sequence() const { return impl_->sequence != nullptr; }
Scene& MovingScene::base() { return impl_->base; }

std::optional<ShownFrame> MovingScene::at(double seconds) {
  if (!moves()) return ShownFrame{{}, impl_->base.cameras};
  if (impl_->sequence) {
    std::optional<FrameState> state = impl_->sequence->state_of(static_cast<std::uint32_t>(seconds));
    if (!state) return std::nullopt;
    return ShownFrame{std::move(*state), {}};  // the first frame's camera sees all
  }
  std::optional<ShownFrame> frame = impl_->file->at(seconds, impl_->base);
  if (frame) make_camera_names_unique(frame->cameras);
  return frame;
}

Scene MovingScene::scene_at(double seconds) {
  if (!moves()) return impl_->base;
  if (const std::optional<ShownFrame> frame = at(seconds)) {
    Scene scene = posed(impl_->base, frame->state, impl_->path);
    if (!frame->cameras.empty()) scene.cameras = frame->cameras;
    return scene;
  }
  Warnings warnings;
  if (impl_->sequence) {
    const std::string file = impl_->sequence->file_of(static_cast<std::uint32_t>(seconds));
    Scene scene = read_obj(file, impl_->options, warnings);
    scene.cameras = impl_->base.cameras;
    finish(scene, file, impl_->options, warnings);
    scene.environment = impl_->base.environment;
    return scene;
  }
  Scene scene = gltf::File(impl_->path, impl_->options, warnings).read_at(seconds);
  finish(scene, impl_->path, impl_->options, warnings);
  scene.environment = impl_->base.environment;
  return scene;
}

Scene import_scene(const std::string& path, const ImportOptions& options) {
  MovingScene file(path, options);
  return file.moves() ? file.scene_at(options.seconds) : std::move(file.impl_->base);
}

}  // namespace gleaner::scene
