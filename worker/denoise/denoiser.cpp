#include "worker/denoise/denoiser.h"

#include <dlfcn.h>

#include <cstdlib>
#include <filesystem>
#include <initializer_list>
#include <iterator>
#include <utility>

#include "scene/model/error.h"
#include "scene/model/program_folder.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

constexpr const char* kFile = "libOpenImageDenoise.so.2";
constexpr const char* kAdvice = "run ./farm denoiser, or set GLEANER_OIDN to the folder that holds it";

// What the interface's header calls these (oidn.h of version 2).
constexpr int kDeviceTypeDefault = 0, kDeviceTypeCpu = 1, kFormatFloat3 = 3, kQualityFast = 4, kQualityHigh = 6;
constexpr const char* kDeviceTypes[] = {"default", "CPU", "SYCL", "CUDA", "HIP", "Metal"};
// Above this the library works in tiles.
constexpr int kMostMemoryMb = 1024;

using Device = struct OIDNDeviceImpl*;
using Buffer = struct OIDNBufferImpl*;
using Filter = struct OIDNFilterImpl*;

struct Interface {
  Device (*new_device)(int type);
  void (*commit_device)(Device);
  void (*release_device)(Device);
  void (*set_device_bool)(Device, const char* name, bool value);
  int (*get_device_int)(Device, const char* name);
  int (*get_device_error)(Device, const char** message);
  Buffer (*new_buffer)(Device, std::size_t bytes);
  void (*release_buffer)(Buffer);
  void (*write_buffer)(Buffer, std::size_t offset, std::size_t bytes, const void* from);
  void (*read_buffer)(Buffer, std::size_t offset, std::size_t bytes, void* to);
  Filter (*new_filter)(Device, const char* type);
  void (*set_filter_image)(Filter, const char* name, Buffer, int format, std::size_t width, std::size_t height,
                           std::size_t offset, std::size_t pixel_stride, std::size_t row_stride);
  void (*set_filter_bool)(Filter, const char* name, bool value);
  void (*set_filter_int)(Filter, const char* name, int value);
  void (*set_filter_monitor)(Filter, bool (*goes_on)(void* user, double done), void* user);
  void (*commit_filter)(Filter);
  void (*execute_filter)(Filter);
  void (*release_filter)(Filter);
};

std::filesystem::path own_folder() {
  const std::filesystem::path folder = program_folder();
  return folder.empty() ? folder : folder / "oidn";
}

void* open_library(const std::filesystem::path& path) { return dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL); }

// The library's own parts look for each other in ../lib from where they lie (their RPATH).
std::vector<std::filesystem::path> files_of(const std::filesystem::path& folder) {
  return {folder / "lib" / kFile, folder / kFile};
}

// A library that was named must be there, and one that is there must load.
void* load_library() {
  const char* named = std::getenv("GLEANER_OIDN");
  const bool is_named = named && *named;
  const std::filesystem::path folder = is_named ? std::filesystem::path(named) : own_folder();
  std::vector<std::filesystem::path> files = files_of(folder);
  files.push_back(folder);
  std::error_code code;
  for (const std::filesystem::path& file : files) {
    if (!std::filesystem::is_regular_file(file, code)) continue;
    if (void* library = open_library(file)) return library;
    throw Error::failed("the denoiser's library " + file.string() + ": " + dlerror());
  }
  if (is_named)
    throw Error::failed("GLEANER_OIDN: expected the file " + std::string(kFile) + " or a folder that holds it, found " +
                        folder.string());
  if (void* library = open_library(kFile)) return library;
  throw Error::failed(std::string("the denoiser's library ") + kFile +
                      " (Open Image Denoise 2) is not there: " + kAdvice);
}

template <typename Function>
void find(void* library, const char* symbol, Function& function) {
  function = reinterpret_cast<Function>(dlsym(library, symbol));
  if (!function)
    throw Error::failed(std::string("the denoiser's library has no ") + symbol + ": expected Open Image Denoise 2; " +
                        kAdvice);
}

Interface interface_of(void* library) {
  Interface f{};
  find(library, "oidnNewDevice", f.new_device);
  find(library, "oidnCommitDevice", f.commit_device);
  find(library, "oidnReleaseDevice", f.release_device);
  find(library, "oidnSetDeviceBool", f.set_device_bool);
  find(library, "oidnGetDeviceInt", f.get_device_int);
  find(library, "oidnGetDeviceError", f.get_device_error);
  find(library, "oidnNewBuffer", f.new_buffer);
  find(library, "oidnReleaseBuffer", f.release_buffer);
  find(library, "oidnWriteBuffer", f.write_buffer);
  find(library, "oidnReadBuffer", f.read_buffer);
  find(library, "oidnNewFilter", f.new_filter);
  find(library, "oidnSetFilterImage", f.set_filter_image);
  find(library, "oidnSetFilterBool", f.set_filter_bool);
  find(library, "oidnSetFilterInt", f.set_filter_int);
  find(library, "oidnSetFilterProgressMonitorFunction", f.set_filter_monitor);
  find(library, "oidnCommitFilter", f.commit_filter);
  find(library, "oidnExecuteFilter", f.execute_filter);
  find(library, "oidnReleaseFilter", f.release_filter);
  return f;
}

// The library asks, in a thread of its own, whether to go on; user: given_up_flag().
bool goes_on(void* user, double) {
  const auto* given_up = static_cast<const std::atomic<bool>*>(user);
  return !given_up || !given_up->load(std::memory_order_relaxed);
}

struct NamedImage {
  const char* name;  // as the filter calls it
  const DenoiserImage* image;
};

}  // namespace

struct Denoiser::Impl {
  // Never unloaded: its threads outlive the device.
  Interface f = interface_of(load_library());
  Device device = nullptr;
  std::string version, device_name;

  explicit Impl(DenoiserDevice wanted) {
    device = f.new_device(wanted == DenoiserDevice::cpu ? kDeviceTypeCpu : kDeviceTypeDefault);
    if (!device) {
      const char* message = nullptr;
      f.get_device_error(nullptr, &message);
      throw Error::failed(std::string("the denoiser has no device that it can use: ") + (message ? message : ""));
    }
    try {
      const int type = f.get_device_int(device, "type");
      device_name = kDeviceTypes[type > 0 && type < static_cast<int>(std::size(kDeviceTypes)) ? type : 0];
      // Workers share a machine: none may claim its cores.
      if (type == kDeviceTypeCpu) f.set_device_bool(device, "setAffinity", false);
      f.commit_device(device);
      check("opening its device");
      const int number = f.get_device_int(device, "version");
      version = std::to_string(number / 10000) + "." + std::to_string(number / 100 % 100) + "." +
                std::to_string(number % 100);
      if (number / 10000 != 2)
        throw Error::failed("the denoiser's library is of version " + version + ": expected 2; " + kAdvice);
    } catch (...) {
      f.release_device(device);
      throw;
    }
  }
  ~Impl() { f.release_device(device); }

  void check(const char* what) const {
    const char* message = nullptr;
    if (f.get_device_error(device, &message) != 0)
      throw Error::failed(std::string("denoiser, ") + what + ": " + (message ? message : "an error without a word"));
  }

  struct BufferHolder {
    const Interface& f;
    Buffer buffer;
    ~BufferHolder() {
      if (buffer) f.release_buffer(buffer);
    }
  };
  struct FilterHolder {
    const Interface& f;
    Filter filter;
    ~FilterHolder() {
      if (filter) f.release_filter(filter);
    }
  };

  // Denoises each of `pictures` by the same guides, one after the other: one filter makes them all.
  std::vector<std::vector<float>> run(const char* name, std::span<const DenoiserImage> pictures,
                                      std::initializer_list<NamedImage> guides,
                                      std::initializer_list<const char*> flags, DenoiseQuality quality) const {
    const DenoiserImage& size = pictures.front();
    const std::size_t floats = std::size_t{3} * size.width * size.height, bytes = floats * sizeof(float);
    const auto check_size = [&](const char* of, const DenoiserImage& image) {
      if (image.values.size() != floats || image.width != size.width)
        throw Error::failed(std::string("denoiser: image ") + of + " has another size than the first one");
    };
    for (const DenoiserImage& picture : pictures) check_size(name, picture);
    for (const NamedImage& guide : guides) check_size(guide.name, *guide.image);

    std::vector<std::unique_ptr<BufferHolder>> buffers;
    const FilterHolder filter{f, f.new_filter(device, "RT")};
    check("making its filter");
    const auto new_image = [&](const char* of) {
      buffers.push_back(std::make_unique<BufferHolder>(f, f.new_buffer(device, bytes)));
      check("taking memory");
      Buffer buffer = buffers.back()->buffer;
      f.set_filter_image(filter.filter, of, buffer, kFormatFloat3, size.width, size.height, 0, 0, 0);
      return buffer;
    };
    Buffer input = new_image(name);
    for (const NamedImage& guide : guides) f.write_buffer(new_image(guide.name), 0, bytes, guide.image->values.data());
    Buffer output = new_image("output");
    for (const char* flag : flags) f.set_filter_bool(filter.filter, flag, true);
    f.set_filter_int(filter.filter, "quality", quality == DenoiseQuality::fast ? kQualityFast : kQualityHigh);
    f.set_filter_int(filter.filter, "maxMemoryMB", kMostMemoryMb);
    f.set_filter_monitor(filter.filter, goes_on, const_cast<std::atomic<bool>*>(given_up_flag()));
    f.commit_filter(filter.filter);
    check("preparing its filter");
    std::vector<std::vector<float>> made;
    for (const DenoiserImage& picture : pictures) {
      f.write_buffer(input, 0, bytes, picture.values.data());
      f.execute_filter(filter.filter);
      check_wanted();
      check("running its filter");
      f.read_buffer(output, 0, bytes, made.emplace_back(floats).data());
      check("reading what it made");
    }
    return made;
  }
};

std::string denoiser_version() {
  static const std::string version = Denoiser(DenoiserDevice::cpu).version();
  return version;
}

Denoiser::Denoiser(DenoiserDevice device) : impl_(std::make_unique<Impl>(device)) {}
Denoiser::~Denoiser() = default;

const std::string& Denoiser::version() const { return impl_->version; }
const std::string& Denoiser::device() const { return impl_->device_name; }

std::vector<float> Denoiser::prefilter(std::string_view guide, const DenoiserImage& image) {
  return std::move(impl_->run(std::string(guide).c_str(), {&image, 1}, {}, {}, DenoiseQuality::fast).front());
}

std::vector<std::vector<float>> Denoiser::denoise(std::span<const DenoiserImage> colors, const DenoiserImage& albedo,
                                                  const DenoiserImage& normal, DenoiseQuality quality) {
  const std::initializer_list<NamedImage> guides = {{"albedo", &albedo}, {"normal", &normal}};
  return quality == DenoiseQuality::high ? impl_->run("color", colors, guides, {"hdr", "cleanAux"}, quality)
                                         : impl_->run("color", colors, guides, {"hdr"}, quality);
}

}  // namespace gleaner::worker
