#pragma once
// Intel Open Image Denoise 2 by its C interface. The library is loaded at run time: a build needs nothing of it.

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace gleaner::worker {

enum class DenoiseQuality { fast, high };

// `fastest`: a GPU where the library finds one that it can use, else the CPU.
enum class DenoiserDevice { cpu, fastest };

// RGB or XYZ, width * height * 3 floats, row by row.
struct DenoiserImage {
  std::uint32_t width = 0, height = 0;
  std::span<const float> values;
};

class Denoiser {
 public:
  // Where the library was looked for: the file that $GLEANER_OIDN names (or the file libOpenImageDenoise.so.2 in the
  // folder that it names), the folder ../oidn beside the program's own, the system.
  //
  // Throws Error::failed, with what to do, where there is no such library, where it is not of version 2, or where it
  // has no such device.
  explicit Denoiser(DenoiserDevice device);
  ~Denoiser();
  Denoiser(const Denoiser&) = delete;
  Denoiser& operator=(const Denoiser&) = delete;

  const std::string& version() const;  // "2.5.1"
  const std::string& device() const;   // "CPU", "CUDA", ...

  // The guide (linear albedo in [0, 1], or unit normals) without its noise: "albedo" or "normal" says which.
  std::vector<float> prefilter(std::string_view guide, const DenoiserImage& image);
  // The pictures (linear radiance) without their noise: at least one, all of one size, by the same guides of that size.
  // `high` takes the guides for prefiltered, which takes longer than `fast` does for all else.
  std::vector<std::vector<float>> denoise(std::span<const DenoiserImage> colors, const DenoiserImage& albedo,
                                          const DenoiserImage& normal, DenoiseQuality quality);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The version of the library that a Denoiser would use. Throws as its constructor does.
std::string denoiser_version();

}  // namespace gleaner::worker
