#pragma once
// The textures of a scene while it is imported: one record for each way in which an image is laid on, each image
// decoded once.

#include <array>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "scene/files/warnings.h"
#include "scene/images/images.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

// How an image is laid on.
struct TextureUse {
  std::size_t image = 0;
  gl_uint wrap_u = GLEANER_WRAP_REPEAT, wrap_v = GLEANER_WRAP_REPEAT, flags = 0, uv_set = 0;
  std::array<float, 6> transform{1, 0, 0, 0, 1, 0};  // Texture::transform
  auto operator<=>(const TextureUse&) const = default;
};

// Texels of one image, RGBA bytes, R lowest, row 0 at the top.
struct Bitmap {
  std::uint32_t width = 0, height = 0;
  std::vector<std::uint32_t> texels;
};

class TextureTable {
 public:
  // Returns the image's number; files are recognised by their paths.
  std::size_t add_image(ImageSource source);
  // An image that is made of others once they are decoded.
  std::size_t add_composed(std::vector<std::size_t> sources, std::function<Bitmap(const std::vector<Bitmap>&)> compose);
  // Returns the texture's number in Scene::textures.
  gl_uint add(const TextureUse& use);

  bool empty() const { return uses_.empty(); }
  // Whether the same images, by their numbers, are laid on in the same ways.
  bool operator==(const TextureTable& other) const { return uses_ == other.uses_; }

  // Fills in the scene's textures and texels. Throws Error::bad_input naming `file` and the image.
  void decode_into(Scene& scene, const std::string& file, std::uint64_t most_texels, Warnings& warnings) const;

 private:
  struct Composition {
    std::vector<std::size_t> sources;
    std::function<Bitmap(const std::vector<Bitmap>&)> compose;
  };

  std::vector<ImageSource> sources_;
  std::vector<std::size_t> source_of_image_;         // or sources_.size() ... : see compositions_
  std::map<std::size_t, Composition> compositions_;  // by image
  std::map<std::filesystem::path, std::size_t> image_by_path_;
  std::vector<TextureUse> uses_;
  std::map<TextureUse, gl_uint> number_of_use_;
};

}  // namespace gleaner::scene
