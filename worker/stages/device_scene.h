#pragma once
// A scene on a device: the tables that kernels read, the tracer, and which kernel variant the scene needs.

#include <array>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "scene/model/blob.h"
#include "scene/model/media.h"
#include "worker/device/kernel.h"
#include "worker/stages/light_clusters.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {

class DeviceScene {
 public:
  // `bvh` is needed where the device traces in OpenCL. Throws Error::failed.
  DeviceScene(const Device& device, std::shared_ptr<const scene::Scene> scene, const scene::Bvh* bvh);

  // Shows the scene as `shown` has it, which differs from the scene as loaded in lights, materials, albedo tables,
  // instances' transforms and the vertices of meshes marked Mesh::deforming alone; `deformed` are those of the meshes
  // that differ from what was shown last. Writes what has changed and lets the tracer follow. What is then traced and
  // read depends on the scene as loaded and on `shown`, but on nothing that was shown before. The caller sees to it
  // that no query and no kernel runs meanwhile.
  MotionReport show(const std::shared_ptr<const scene::Scene>& shown, std::span<const std::uint32_t> deformed);

  // Compiler options that select the variant: one NEED_... a need, and how many light clusters there are.
  const std::string& kernel_options() const { return options_; }
  // The same for programs that read no light: no lights are among them.
  const std::string& surface_options() const { return surface_options_; }
  // Behind plain_options(): those of programs that know of a scene how its paths are laid out, and nothing else.
  std::string layout_options() const;
  Tracer& tracer() { return *tracer_; }
  // Shadow rays may meet surfaces that light passes straight (kernels/path_layout.h: TRANSPARENT_SHADOWS).
  bool transparent_shadows() const { return transparent_shadows_; }
  // Rows of a block of 16 paths, and of 16 shadow rays (kernels/path_layout.h).
  unsigned path_rows() const { return path_rows_; }
  unsigned shadow_rows() const { return shadow_rows_; }
  // The solids that all of a camera's rays begin in, as kernels keep them (kernels/surface.h: Media).
  std::array<cl_uint, 2> media_of(const scene::Camera& camera) const;
  // Sets the parameters that SCENE_PARAMETERS stands for.
  void set_arguments(Kernel& kernel) const;
  // The same of a kernel whose source is not the product's: from index `first` on; returns the next one.
  unsigned set_arguments(cl::Kernel& kernel, unsigned first) const;
  // What light paths choose their lights from (kernels/scene_layout.h); zeros where nothing shines.
  const cl::Buffer& emission() const { return emission_.buffer; }
  bool shines() const { return shines_; }
  std::uint64_t triangles() const { return triangle_count_; }
  const cl::Buffer& triangle_rows() const { return triangles_; }
  // Rows of instances (kernels/scene_layout.h): one more than there are instances.
  const cl::Buffer& instance_rows() const { return instances_.buffer; }
  std::uint64_t instances() const { return instance_count_; }
  // Rows of materials (kernels/scene_layout.h), as the device has them.
  const std::vector<float>& material_table() const { return materials_.rows; }
  unsigned triangle_words() const { return triangle_words_; }  // of a row (kernels/scene_layout.h)
  // Whether an albedo table of the scene's materials begins at `table` and has this (fractional) row.
  bool has_albedo_row(std::uint32_t table, float row) const;
  std::size_t bytes() const { return bytes_; }

 private:
  // A table that frames may change, and what it holds.
  struct Table {
    cl::Buffer buffer;
    std::vector<float> rows;
  };

  cl::Buffer upload(cl::CommandQueue& queue, const void* data, std::size_t bytes);
  void load(cl::CommandQueue& queue, Table& table, std::vector<float> rows);
  LightTables load_tables(cl::CommandQueue& queue, const std::shared_ptr<const scene::Scene>& scene,
                          const scene::SceneNeeds& needs);
  void check_shown(const scene::Scene& shown, std::span<const std::uint32_t> deformed) const;

  const Device& device_;
  // Of the scene as it was loaded.
  std::size_t vertex_values_, corners_;
  std::vector<scene::Mesh> meshes_;
  std::uint64_t triangle_count_ = 0, instance_count_ = 0;

  std::string options_, surface_options_;
  std::unique_ptr<Tracer> tracer_;
  cl::Buffer triangles_, textures_, texels_, srgb_, environment_;
  Table instances_, materials_, albedo_tables_, emitters_, clusters_, emission_;
  double environment_power_ = 0;
  std::vector<std::uint32_t> triangle_emitter_;  // as the triangles' rows have it
  bool shines_ = false;
  bool transparent_shadows_ = false;
  unsigned triangle_words_ = 0, path_rows_ = 0, shadow_rows_ = 0;
  std::optional<scene::MediumFinder> media_;  // where the scene has media
  // The last camera that media_of() was asked for, and its answer: batches of a frame ask for the same one.
  mutable std::mutex media_mutex_;
  mutable std::optional<scene::Camera> media_camera_;
  mutable std::array<cl_uint, 2> camera_media_{};
  std::vector<scene::Bounds> instanced_boxes_;          // about each instanced mesh, in its own space
  std::map<std::uint32_t, std::uint32_t> albedo_rows_;  // by table
  std::size_t bytes_ = 0, written_bytes_ = 0;
};

}  // namespace gleaner::worker
