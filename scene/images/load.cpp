// The programs' side: what needs images loads the module, once.

#include <dlfcn.h>

#include <filesystem>

#include "scene/images/module.h"
#include "scene/model/error.h"
#include "scene/model/program_folder.h"

namespace gleaner::scene {
namespace {

constexpr const char* kFile = "gleaner-images.so";

const ImageModule& load() {
  const std::filesystem::path folder = program_folder();
  if (folder.empty()) throw Error::failed("the module that reads images: where this program lies is not known");
  const std::filesystem::path file = folder / "lib" / kFile;
  void* library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!library) throw Error::failed("the module that reads images: " + std::string(dlerror()));
  const auto* module = static_cast<const ImageModule*>(dlsym(library, kImageModuleSymbol));
  if (!module) throw Error::failed(file.string() + ": " + dlerror());
  return *module;
}

const ImageModule& module() {
  static const ImageModule& loaded = load();
  return loaded;
}

}  // namespace

std::vector<DecodedImage> decode_images(const std::vector<ImageSource>& sources, const std::string& file,
                                        std::uint64_t most_texels, std::vector<std::uint32_t>& texels,
                                        Warnings& warnings) {
  // Without images there is nothing to load the module for.
  if (sources.empty()) return {};
  return module().decode(sources, file, most_texels, texels, warnings);
}

Environment import_environment(const std::string& path, const EnvironmentOptions& options,
                               std::vector<std::string>* warnings) {
  return module().environment(path, options, warnings);
}

std::vector<unsigned char> png_bytes(std::uint32_t width, std::uint32_t height, std::span<const std::uint32_t> texels) {
  return module().png(width, height, texels);
}

void write_exr(const std::string& path, std::uint32_t width, std::uint32_t height, std::span<const float> rgb) {
  module().exr(path, width, height, rgb);
}

}  // namespace gleaner::scene
