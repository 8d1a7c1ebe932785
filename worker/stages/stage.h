#pragma once
// What a stage program gets to run a batch, and the checks that all of them make.

#include <cstring>
#include <span>
#include <string>
#include <string_view>

#include "worker/stages/device_scene.h"
#include "worker/wavefront/kept_tables.h"
#include "worker/wavefront/stage_task.h"
#include "worker/wavefront/workspace.h"

namespace gleaner::worker {

// Items [first, first + count) of a task, and the device that they run on.
struct StageRun {
  const Device& device;
  Workspace& workspace;
  KeptTables& tables;
  DeviceScene& scene;
  const StageTask& task;
  std::span<const std::string_view> programs;  // files of kernels, from the stage's row in stage_table.cpp
  bool reads_light = true;                     // likewise
  std::uint64_t first = 0, count = 0;

  std::string where() const { return "stage " + task.kind; }

  // The stage's parameters as the struct that its kernels read. Throws Error::bad_input for another size.
  template <typename Parameters>
  Parameters parameters() const {
    Parameters p;
    check_parameter_bytes(sizeof p);
    std::memcpy(&p, task.parameters.data(), sizeof p);
    return p;
  }
  // The parameters in a buffer, as kernels read them.
  cl::Buffer parameter_buffer(cl::CommandQueue& queue) const;

  // The stage's program whose file has this name, in the scene's variant: without lights where the stage reads none.
  // Throws Error::failed where the stage's row does not name it.
  Program build(std::string_view file, const std::string& options = {}) const;
  // The same without anything of the scene: one variant for all.
  Program build_plain(std::string_view file, const std::string& options = {}) const;

  // Throws Error::bad_input unless the batch's items are among the stage's `total`.
  void check_range(std::uint64_t total) const;
  // Throws Error::bad_input for a film of no or too many pixels, and for a camera whose rays would not be finite: these
  // end Embree and the environment's look-up alike.
  void check_film(const scene::Camera& camera, std::uint32_t width, std::uint32_t height) const;

 private:
  std::string path_of(std::string_view file) const;
  void check_parameter_bytes(std::size_t expected) const;
};

// Options of StageRun::build_plain().
std::string plain_options(const Device& device);

inline std::uint64_t wide(std::uint32_t high, std::uint32_t low) { return (std::uint64_t{high} << 32) | low; }

}  // namespace gleaner::worker
