#include "worker/stages/stage.h"

#include "scene/model/error.h"

namespace gleaner::worker {

cl::Buffer StageRun::parameter_buffer(cl::CommandQueue& queue) const {
  cl::Buffer buffer = workspace.take("parameters", task.parameters.size());
  queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, task.parameters.size(), task.parameters.data());
  return buffer;
}

std::string StageRun::path_of(std::string_view file) const {
  for (const std::string_view program : programs)
    if (program.substr(program.rfind('/') + 1) == file) return std::string(program);
  throw Error::failed(where() + ": its row in stage_table.cpp names no program " + std::string(file));
}

Program StageRun::build(std::string_view file, const std::string& options) const {
  return device.build(path_of(file), (reads_light ? scene.kernel_options() : scene.surface_options()) + options);
}

Program StageRun::build_plain(std::string_view file, const std::string& options) const {
  return device.build(path_of(file), plain_options(device) + options);
}

std::string plain_options(const Device& device) { return "-D LANES=" + std::to_string(device.lanes()); }

void StageRun::check_parameter_bytes(std::size_t expected) const {
  if (task.parameters.size() != expected)
    throw Error::bad_input(where(), "parameters", std::to_string(expected) + " bytes",
                           std::to_string(task.parameters.size()));
}

void StageRun::check_range(std::uint64_t total) const {
  if (first + count < first || first + count > total)
    throw Error::bad_input(where(), "items", "a range below " + std::to_string(total),
                           std::to_string(first) + " + " + std::to_string(count));
}

void StageRun::check_film(const scene::Camera& camera, std::uint32_t width, std::uint32_t height) const {
  const std::uint64_t pixels = std::uint64_t{width} * height;
  if (pixels == 0 || pixels > (std::uint64_t{1} << 28))
    throw Error::bad_input(where(), "size", "1 to 2^28 pixels", std::to_string(width) + "x" + std::to_string(height));
  scene::Scene with_camera;
  with_camera.cameras.push_back({"camera", camera});
  scene::validate(with_camera, where());
}

}  // namespace gleaner::worker
