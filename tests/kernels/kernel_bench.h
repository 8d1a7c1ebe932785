#pragma once
// Runs kernels of a test's own against the headers that the product's kernels are made of, with as many lanes as asked.

#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "scene/bvh/build.h"
#include "worker/device/device.h"
#include "worker/device/kernel_sources.h"
#include "worker/stages/device_scene.h"

namespace gleaner::test {

class KernelBench {
 public:
  explicit KernelBench(unsigned lanes) : device_(choice()), queue_(device_.make_queue()), lanes_(lanes) {}

  unsigned lanes() const { return lanes_; }
  const worker::Device& device() const { return device_; }
  cl::CommandQueue& queue() { return queue_; }

  // `text` may #include the kernels' headers. Options of a DeviceScene select its variant; LANES is the bench's.
  cl::Program build(const std::string& text, std::string options = {}) const {
    const std::string told = "-D LANES=" + std::to_string(device_.lanes());
    if (const auto at = options.find(told); at != std::string::npos) options.erase(at, told.size());
    std::set<std::string> seen;
    std::string flat;
    flatten(text, seen, flat);
    cl::Program program(device_.context(), flat);
    try {
      program.build(std::vector<cl::Device>{device_.device()},
                    ("-cl-std=CL1.2 -D LANES=" + std::to_string(lanes_) + " " + options).c_str());
    } catch (const cl::Error&) {
      throw std::runtime_error(program.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device_.device()));
    }
    return program;
  }

  template <typename T>
  cl::Buffer buffer(const std::vector<T>& values) {
    cl::Buffer made = device_.make_buffer(values.size() * sizeof(T));
    if (!values.empty()) queue_.enqueueWriteBuffer(made, CL_TRUE, 0, values.size() * sizeof(T), values.data());
    return made;
  }
  template <typename T>
  std::vector<T> read(const cl::Buffer& from, std::size_t count) {
    std::vector<T> values(count);
    queue_.enqueueReadBuffer(from, CL_TRUE, 0, count * sizeof(T), values.data());
    return values;
  }
  cl::Buffer space(std::size_t floats) const { return device_.make_buffer(floats * 4); }

  // `count` values of a lane each, a multiple of 16.
  void run(cl::Kernel& kernel, std::size_t count) {
    queue_.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange(count / lanes_), cl::NDRange(1));
    queue_.finish();
  }

  // The scene's tables on this device.
  worker::DeviceScene hold(const std::shared_ptr<const scene::Scene>& scene) const {
    const scene::Bvh bvh = scene::build_bvh(*scene);
    return worker::DeviceScene(device_, scene, &bvh);
  }

 private:
  static worker::DeviceChoice choice() {
    worker::DeviceChoice c;
    c.threads = 1;
    return c;
  }
  static void flatten(const std::string& text, std::set<std::string>& seen, std::string& out) {
    std::istringstream lines(text);
    std::string line;
    while (std::getline(lines, line)) {
      if (!line.starts_with("#include \"")) {
        if (!line.starts_with("#include <")) out += line + "\n";
        continue;
      }
      const std::string file = line.substr(10, line.find('"', 10) - 10);
      if (!seen.insert(file).second) continue;
      bool found = false;
      for (const auto& source : worker::kernel_sources())
        if (source.path == file) {
          found = true;
          flatten(std::string(source.text), seen, out);
        }
      if (!found) throw std::runtime_error("no kernel source named " + file);
    }
  }

  worker::Device device_;
  cl::CommandQueue queue_;
  unsigned lanes_;
};

// Sets arguments from `first` on.
template <typename... T>
void set_arguments(cl::Kernel& kernel, unsigned first, const T&... values) {
  (kernel.setArg(first++, values), ...);
}

}  // namespace gleaner::test
