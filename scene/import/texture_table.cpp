#include "scene/import/texture_table.h"

#include <algorithm>

#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

constexpr std::size_t kComposed = ~std::size_t{0};

}  // namespace

std::size_t TextureTable::add_image(ImageSource source) {
  const std::size_t image = source_of_image_.size();
  if (!source.path.empty()) {
    const auto [place, is_new] = image_by_path_.try_emplace(source.path, image);
    if (!is_new) return place->second;
  }
  source_of_image_.push_back(sources_.size());
  sources_.push_back(std::move(source));
  return image;
}

std::size_t TextureTable::add_composed(std::vector<std::size_t> sources,
                                       std::function<Bitmap(const std::vector<Bitmap>&)> compose) {
  compositions_[source_of_image_.size()] = {std::move(sources), std::move(compose)};
  source_of_image_.push_back(kComposed);
  return source_of_image_.size() - 1;
}

gl_uint TextureTable::add(const TextureUse& use) {
  const auto [place, is_new] = number_of_use_.try_emplace(use, static_cast<gl_uint>(uses_.size()));
  if (is_new) uses_.push_back(use);
  return place->second;
}

void TextureTable::decode_into(Scene& scene, const std::string& file, std::uint64_t most_texels,
                               Warnings& warnings) const {
  const std::vector<DecodedImage> decoded = decode_images(sources_, file, most_texels, scene.texels, warnings);
  std::vector<DecodedImage> images(source_of_image_.size());
  for (std::size_t i = 0; i < images.size(); ++i)
    if (source_of_image_[i] != kComposed) images[i] = decoded[source_of_image_[i]];
  for (const auto& [image, composition] : compositions_) {
    std::vector<Bitmap> parts;
    for (const std::size_t source : composition.sources) {
      const DecodedImage& part = images[source];
      const auto first = scene.texels.begin() + part.first_texel;
      parts.push_back({part.width, part.height, {first, first + std::size_t(part.width) * part.height}});
    }
    const Bitmap made = composition.compose(parts);
    images[image] = {static_cast<std::uint32_t>(scene.texels.size()), made.width, made.height};
    if (scene.texels.size() + made.texels.size() > most_texels)
      throw Error::bad_input(file, "textures", "at most " + std::to_string(most_texels) + " texels in all images",
                             std::to_string(scene.texels.size() + made.texels.size()));
    scene.texels.insert(scene.texels.end(), made.texels.begin(), made.texels.end());
  }
  for (const TextureUse& use : uses_) {
    Texture t = plain_texture();
    t.first_texel = images[use.image].first_texel;
    t.width = images[use.image].width;
    t.height = images[use.image].height;
    t.wrap_u = use.wrap_u;
    t.wrap_v = use.wrap_v;
    t.flags = use.flags;
    t.uv_set = use.uv_set;
    std::copy(use.transform.begin(), use.transform.end(), t.transform);
    scene.textures.push_back(t);
  }
}

}  // namespace gleaner::scene
