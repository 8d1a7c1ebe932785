#include "worker/device/device.h"

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <set>
#include <sstream>
#include <thread>

#include "scene/model/error.h"
#include "worker/device/compile_turn.h"
#include "worker/device/kernel_sources.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {
namespace {

constexpr const char* kPoclPlatform = "Portable Computing Language";

struct Found {
  cl::Device device;
  DeviceInfo info;
};

unsigned default_threads(const DeviceInfo& info) {
  if (info.platform == kPoclPlatform) {
    // The basic driver reports one compute unit whatever the machine; PoCL's own variable limits us as it would its
    // pool.
    if (const char* text = std::getenv("POCL_MAX_PTHREAD_COUNT")) {
      int n = std::atoi(text);
      if (n > 0) return static_cast<unsigned>(n);
    }
    return std::max(1u, std::thread::hardware_concurrency());
  }
  return std::max(1u, info.compute_units);
}

std::vector<Found> find_devices() {
  prepare_environment();
  std::vector<Found> found;
  std::vector<cl::Platform> platforms;
  try {
    cl::Platform::get(&platforms);
  } catch (const cl::Error&) {
    return found;  // the loader knows no platform
  }
  for (auto& platform : platforms) {
    std::vector<cl::Device> devices;
    try {
      platform.getDevices(CL_DEVICE_TYPE_ALL, &devices);
    } catch (const cl::Error&) {
      continue;  // CL_DEVICE_NOT_FOUND
    }
    for (auto& device : devices) {
      Found one;
      one.device = device;
      DeviceInfo& info = one.info;
      info.index = static_cast<int>(found.size());
      info.name = device.getInfo<CL_DEVICE_NAME>();
      info.platform = platform.getInfo<CL_PLATFORM_NAME>();
      info.driver = device.getInfo<CL_DRIVER_VERSION>();
      info.version = device.getInfo<CL_DEVICE_VERSION>();
      info.cpu = (device.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_CPU) != 0;
      info.compute_units = device.getInfo<CL_DEVICE_MAX_COMPUTE_UNITS>();
      info.memory_bytes = device.getInfo<CL_DEVICE_GLOBAL_MEM_SIZE>();
      info.threads = info.cpu ? default_threads(info) : 1;
      info.lanes = info.cpu ? 16 : 1;
      info.trace = info.cpu && embree_available() ? TraceKind::embree : TraceKind::opencl;
      info.tracer = tracer_description(info.trace);
      found.push_back(one);
    }
  }
  return found;
}

// FNV-1a, 64 bits: names a file of the cache, decides nothing else.
std::uint64_t fingerprint(std::uint64_t hash, std::string_view text) {
  for (unsigned char c : text) hash = (hash ^ c) * 0x100000001b3ull;
  return hash;
}

// Processes that compile beside this one, at most.
constexpr unsigned kMostCompilers = 4;

constexpr const char* kCompiledMark = ".compiled";  // every kernel of a program

std::filesystem::path cache_folder() {
  if (const char* folder = std::getenv("GLEANER_CACHE")) return folder;
  if (const char* folder = std::getenv("XDG_CACHE_HOME")) return std::filesystem::path(folder) / "gleaner";
  if (const char* home = std::getenv("HOME")) return std::filesystem::path(home) / ".cache" / "gleaner";
  return {};
}

// Whether the folder has no mark of a compiled program (Device::mark).
bool nothing_compiled() {
  const std::filesystem::path folder = cache_folder();
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(folder, ignored))
    if (entry.path().extension() == kCompiledMark) return false;
  return !folder.empty();
}

// The text of `file` with its #includes put in, each once.
void flatten(const std::string& file, std::set<std::string>& seen, std::string& out) {
  if (!seen.insert(file).second) return;
  for (const auto& source : kernel_sources()) {
    if (source.path != file) continue;
    std::istringstream lines{std::string(source.text)};
    std::string line;
    while (std::getline(lines, line)) {
      if (line.starts_with("#include \"")) {
        auto end = line.find('"', 10);
        flatten(line.substr(10, end - 10), seen, out);
      } else if (!line.starts_with("#include <")) {
        out += line + "\n";
      }
    }
    return;
  }
  throw Error::failed("no kernel source named " + file);
}

std::string program_text(const std::string& file) {
  std::string text;
  std::set<std::string> seen;
  flatten(file, seen, text);
  return text;
}

}  // namespace

// PoCL's "basic" driver runs a kernel in the thread that asks for it. A batch has host threads of its own, so
// that PoCL's other driver, with its pool, only adds a hand-over per kernel (measured: 60 us against 0.7 us) and a
// barrier between the threads. PoCL itself sets the other variable, to this.
void prepare_environment() {
  static std::once_flag once;
  std::call_once(once, [] {
    setenv("POCL_DEVICES", "basic", /*overwrite=*/0);
    setenv("HWLOC_PLUGINS_PATH", "/dev/null", /*overwrite=*/0);
  });
}

std::vector<DeviceInfo> list_devices() {
  std::vector<DeviceInfo> infos;
  for (auto& found : find_devices()) infos.push_back(found.info);
  return infos;
}

TraceKind parse_trace_kind(const std::string& word) {
  if (word == "auto") return TraceKind::automatic;
  if (word == "embree") return TraceKind::embree;
  if (word == "opencl") return TraceKind::opencl;
  throw Error::usage("--trace: expected auto, embree or opencl, found " + word);
}

const char* trace_kind_name(TraceKind kind) {
  switch (kind) {
    case TraceKind::embree:
      return "embree";
    case TraceKind::opencl:
      return "opencl";
    case TraceKind::automatic:
      break;
  }
  return "auto";
}

Device::Device(const DeviceChoice& choice) {
  auto found = find_devices();
  if (found.empty())
    throw Error::failed("no OpenCL device found: install a driver (on Debian: pocl-opencl-icd for the CPU)");
  int index = choice.device;
  if (index < 0) {
    index = 0;
    for (auto& one : found)
      if (!one.info.cpu) {
        index = one.info.index;
        break;
      }
  }
  if (index >= static_cast<int>(found.size()))
    throw Error::failed("no OpenCL device " + std::to_string(index) + ": there are " + std::to_string(found.size()) +
                        " (see gleaner devices)");
  device_ = found[index].device;
  info_ = found[index].info;
  if (choice.lanes != 0 && choice.lanes != 1 && choice.lanes != 16)
    throw Error::failed("a work-item has 1 or 16 lanes, not " + std::to_string(choice.lanes));
  if (choice.lanes) info_.lanes = choice.lanes;
  if (choice.threads > 0 && info_.cpu) info_.threads = static_cast<unsigned>(choice.threads);
  if (choice.trace == TraceKind::embree && !(info_.cpu && embree_available()))
    throw Error::failed("device " + info_.name + " cannot trace with Embree: " +
                        (info_.cpu ? "this program was built without it" : "it is no CPU"));
  if (choice.trace != TraceKind::automatic) info_.trace = choice.trace;
  info_.tracer = tracer_description(info_.trace);
  context_ = cl::Context(device_);
  // Beside this process: one a further core, of which more than a few find nothing to do.
  const unsigned others = std::min(info_.threads ? info_.threads - 1 : 0, kMostCompilers);
  if (info_.platform == kPoclPlatform && !choice.compiler.empty() && others > 0)
    compilers_ = std::make_unique<KernelCompilers>(choice.compiler, info_.index, others,
                                                   [this](const std::string& file, const std::string& options) {
                                                     remember_compiled(program_text(file), options);
                                                   });
  if (compilers_ && nothing_compiled()) ready_compiler();
}

// PoCL needs half a second of CPU time for the first program of a context, whatever that is: it reads its library.
void Device::ready_compiler() {
  readying_ = std::jthread([this] {
    try {
      cl::Program(context_, "kernel void nothing(void) {}").build(std::vector<cl::Device>{device_});
    } catch (const cl::Error&) {
      // The first program that is needed meets the same failure and reports it.
    }
  });
}

namespace {

std::vector<std::string> kernel_names(const KernelDeclarations& kernels) {
  std::vector<std::string> names;
  for (auto one = kernels.begin(); one != kernels.end(); one = kernels.upper_bound(one->first))
    names.push_back(one->first);
  return names;
}

}  // namespace

void Device::compile_ahead(const std::string& file, const std::string& options) const {
  if (!compilers_) return;
  const std::string text = program_text(file);
  if (!was_compiled(text, options)) compilers_->ask(file, options, kernel_names(parse_kernels(text, file)));
}

// Files of such names in our cache folder say what PoCL's holds. Where that has been emptied since, each process
// compiles for itself once more.
std::filesystem::path Device::mark(const std::string& text, const std::string& options, const std::string& of) const {
  const std::filesystem::path folder = cache_folder();
  if (folder.empty() || info_.platform != kPoclPlatform) return {};
  const char* pocl = std::getenv("POCL_CACHE_DIR");
  return folder / (build_name(text, options + (pocl ? pocl : "")) + of);
}

bool Device::was_compiled(const std::string& text, const std::string& options) const {
  std::error_code ignored;
  const auto compiled = mark(text, options, kCompiledMark);
  return !compiled.empty() && std::filesystem::exists(compiled, ignored);
}

void Device::remember_compiled(const std::string& text, const std::string& options) const {
  const auto compiled = mark(text, options, kCompiledMark);
  if (compiled.empty()) return;
  std::error_code ignored;
  std::filesystem::create_directories(compiled.parent_path(), ignored);
  std::ofstream touched(compiled);
}

cl::Buffer Device::make_buffer(std::size_t bytes, cl_mem_flags flags) const {
  if (info_.cpu) flags |= CL_MEM_ALLOC_HOST_PTR;
  return cl::Buffer(context_, flags, std::max<std::size_t>(bytes, 1));
}

Program Device::build(const std::string& file, const std::string& options) const {
  std::lock_guard lock(programs_mutex_);
  auto [program, fresh] = programs_.try_emplace(file + " " + options);
  if (fresh) {
    try {
      const std::string text = program_text(file);
      const auto kernels = std::make_shared<const KernelDeclarations>(parse_kernels(text, file));
      if (compilers_) compilers_->claim(file, options);
      CompileTurn turn(mark(text, options, ".program"));
      program->second = {file, options, compile(file, text, options), kernels, mark(text, options, "")};
      turn.done();
      if (compilers_ && !was_compiled(text, options)) compilers_->ask_kernels(file, options, kernel_names(*kernels));
    } catch (...) {
      programs_.erase(program);
      throw;
    }
  }
  return program->second;
}

// Names what this device's driver makes of a program.
std::string Device::build_name(const std::string& text, const std::string& options) const {
  std::uint64_t hash = 0xcbf29ce484222325ull;
  for (const std::string& part : {info_.platform, info_.name, info_.driver, info_.version, options, text})
    hash = fingerprint(fingerprint(hash, part), std::string_view("\0", 1));
  char name[40];
  std::snprintf(name, sizeof name, "%016llx", static_cast<unsigned long long>(hash));
  return name;
}

cl::Program Device::compile(const std::string& file, const std::string& text, const std::string& options) const {
  // PoCL tells the number of warnings on standard error, whoever listens there.
  const std::string all_options = "-cl-std=CL1.2 -w " + options;
  std::filesystem::path cached;
  // PoCL has a cache of its own. To be asked for a binary makes it compile every kernel once more, for a launch that
  // never comes: half of a first frame's wait.
  const bool keeps_its_own = info_.platform == kPoclPlatform;
  if (auto folder = cache_folder(); !folder.empty() && !keeps_its_own) {
    cached = folder / (build_name(text, all_options) + ".clbin");
    std::ifstream in(cached, std::ios::binary);
    if (in) {
      std::vector<unsigned char> binary((std::istreambuf_iterator<char>(in)), {});
      try {
        cl::Program program(context_, {device_}, cl::Program::Binaries{binary});
        program.build(std::vector<cl::Device>{device_}, all_options.c_str());
        return program;
      } catch (const cl::Error&) {
        // A binary of another driver's making: built anew below, and replaced.
      }
    }
  }
  cl::Program program(context_, text);
  try {
    program.build(std::vector<cl::Device>{device_}, all_options.c_str());
  } catch (const cl::Error& error) {
    throw Error::failed("building " + file + " for " + info_.name + " with " + all_options + ": " + describe(error) +
                        "\n" + program.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device_));
  }
  if (!cached.empty()) {
    // A cache that cannot be written costs the next run its compile time, nothing else.
    std::error_code ignored;
    std::filesystem::create_directories(cached.parent_path(), ignored);
    auto binaries = program.getInfo<CL_PROGRAM_BINARIES>();
    if (!binaries.empty() && !binaries[0].empty()) {
      auto temporary = cached;
      temporary += "." + std::to_string(::getpid());
      std::ofstream out(temporary, std::ios::binary);
      out.write(reinterpret_cast<const char*>(binaries[0].data()), static_cast<std::streamsize>(binaries[0].size()));
      out.close();
      if (out)
        std::filesystem::rename(temporary, cached, ignored);
      else
        std::filesystem::remove(temporary, ignored);
    }
  }
  return program;
}

std::string describe(const cl::Error& error) {
  static const std::map<cl_int, const char*> names = {
      {CL_DEVICE_NOT_AVAILABLE, "CL_DEVICE_NOT_AVAILABLE"},
      {CL_COMPILER_NOT_AVAILABLE, "CL_COMPILER_NOT_AVAILABLE"},
      {CL_MEM_OBJECT_ALLOCATION_FAILURE, "CL_MEM_OBJECT_ALLOCATION_FAILURE"},
      {CL_OUT_OF_RESOURCES, "CL_OUT_OF_RESOURCES"},
      {CL_OUT_OF_HOST_MEMORY, "CL_OUT_OF_HOST_MEMORY"},
      {CL_MAP_FAILURE, "CL_MAP_FAILURE"},
      {CL_BUILD_PROGRAM_FAILURE, "CL_BUILD_PROGRAM_FAILURE"},
      {CL_INVALID_VALUE, "CL_INVALID_VALUE"},
      {CL_INVALID_MEM_OBJECT, "CL_INVALID_MEM_OBJECT"},
      {CL_INVALID_KERNEL_ARGS, "CL_INVALID_KERNEL_ARGS"},
      {CL_INVALID_WORK_GROUP_SIZE, "CL_INVALID_WORK_GROUP_SIZE"},
      {CL_INVALID_BUFFER_SIZE, "CL_INVALID_BUFFER_SIZE"},
  };
  auto name = names.find(error.err());
  return std::string(error.what()) + " failed" + (name == names.end() ? "" : std::string(": ") + name->second) + " (" +
         std::to_string(error.err()) + ")";
}

}  // namespace gleaner::worker
