#include "scene/import/obj/materials.h"

#include <algorithm>
#include <cmath>

#include "scene/files/files.h"
#include "scene/import/formats.h"

namespace gleaner::scene::obj {
namespace {

bool has_color(const Color& c) { return c[0] > 0 || c[1] > 0 || c[2] > 0; }

std::uint32_t channel(std::uint32_t texel, int c) { return texel >> (8 * c) & 255; }

std::uint32_t packed(std::uint32_t r, std::uint32_t g, std::uint32_t b, std::uint32_t a) {
  return r | g << 8 | b << 16 | a << 24;
}

// The texel of `bitmap` where (x, y) lies in an image of `width` x `height`.
std::uint32_t nearest(const Bitmap& bitmap, std::uint32_t x, std::uint32_t y, std::uint32_t width,
                      std::uint32_t height) {
  const std::size_t u = std::size_t(x) * bitmap.width / width, v = std::size_t(y) * bitmap.height / height;
  return bitmap.texels[v * bitmap.width + u];
}

template <typename Texel>
Bitmap made(std::uint32_t width, std::uint32_t height, const Texel& texel) {
  Bitmap bitmap{width, height, {}};
  bitmap.texels.reserve(std::size_t(width) * height);
  for (std::uint32_t y = 0; y < height; ++y)
    for (std::uint32_t x = 0; x < width; ++x) bitmap.texels.push_back(texel(x, y));
  return bitmap;
}

// Colours of the first image, opacity from the second: its alpha where it has one, else its red.
Bitmap with_opacity(const Bitmap& color, const Bitmap& opacity) {
  const bool has_alpha =
      std::any_of(opacity.texels.begin(), opacity.texels.end(), [](std::uint32_t t) { return channel(t, 3) != 255; });
  return made(std::max(color.width, opacity.width), std::max(color.height, opacity.height), [&](auto x, auto y) {
    const std::uint32_t width = std::max(color.width, opacity.width), height = std::max(color.height, opacity.height);
    const std::uint32_t c = nearest(color, x, y, width, height), o = nearest(opacity, x, y, width, height);
    return (c & 0xffffff) | channel(o, has_alpha ? 3 : 0) << 24;
  });
}

// glTF's packing: roughness in green, metallic in blue.
Bitmap roughness_and_metallic(const Bitmap* roughness, const Bitmap* metallic) {
  const std::uint32_t width = std::max(roughness ? roughness->width : 1, metallic ? metallic->width : 1);
  const std::uint32_t height = std::max(roughness ? roughness->height : 1, metallic ? metallic->height : 1);
  return made(width, height, [&](auto x, auto y) {
    const std::uint32_t r = roughness ? channel(nearest(*roughness, x, y, width, height), 0) : 255;
    const std::uint32_t m = metallic ? channel(nearest(*metallic, x, y, width, height), 0) : 255;
    return packed(255, r, m, 255);
  });
}

// Bump maps are heights by the book, but often normals: those are blue on average and never grey.
bool holds_normals(const Bitmap& bitmap) {
  double sum[3] = {};
  for (const std::uint32_t t : bitmap.texels)
    for (int c = 0; c < 3; ++c) sum[c] += channel(t, c);
  const double count = 255.0 * static_cast<double>(bitmap.texels.size());
  return sum[2] / count > 0.7 && std::abs(sum[0] / count - 0.5) < 0.15 && std::abs(sum[1] / count - 0.5) < 0.15;
}

std::uint32_t packed_normal(double x, double y, double z) {
  const double length = std::sqrt(x * x + y * y + z * z);
  const auto byte = [&](double c) { return static_cast<std::uint32_t>(std::lround((c / length * 0.5 + 0.5) * 255)); };
  return packed(byte(x), byte(y), byte(z), 255);
}

// A height of 1 stands for a hundredth of the image's width, times `strength` (-bm).
Bitmap normals_from(const Bitmap& bitmap, float strength) {
  constexpr double relief = 0.01;
  const std::uint32_t w = bitmap.width, h = bitmap.height;
  if (holds_normals(bitmap)) {
    return made(w, h, [&](auto x, auto y) {
      const std::uint32_t t = bitmap.texels[std::size_t(y) * w + x];
      const auto signed_value = [&](int c) { return channel(t, c) / 127.5 - 1; };
      return packed_normal(strength * signed_value(0), strength * signed_value(1), std::max(signed_value(2), 1e-3));
    });
  }
  const auto height = [&](std::uint32_t x, std::uint32_t y) {
    return channel(bitmap.texels[std::size_t(y % h) * w + x % w], 0) / 255.0;
  };
  const double slope = relief * strength * w / 2;
  return made(w, h, [&](auto x, auto y) {
    // v runs down and the bitangent up.
    return packed_normal(-slope * (height(x + 1, y) - height(x + w - 1, y)),
                         slope * (height(x, y + 1) - height(x, y + h - 1)), 1);
  });
}

class Textures {
 public:
  Textures(const std::string& file, TextureTable& table, Warnings& warnings)
      : file_(file), table_(table), warnings_(warnings) {}

  // A map whose file is missing is left out, as a missing MTL file is. One outside the scene's folder stays an error.
  void leave_out_missing(std::optional<TextureMap>& map) {
    if (!map) return;
    const std::string reference = near_scene(*map);
    std::error_code code;
    const bool is_elsewhere = is_absolute(reference) && !std::filesystem::exists(reference, code);
    if (!is_elsewhere && std::filesystem::exists(resolve_reference(reference, file_, map->element, &warnings_), code))
      return;
    warnings_.add(map->element, "there is no such file: the material does without it");
    map.reset();
  }

  std::size_t image(const TextureMap& map) {
    const auto path = resolve_reference(near_scene(map), file_, map.element, &warnings_);
    file_bytes(path, file_, map.element);
    return table_.add_image({map.element, path, {}});
  }

  gl_uint add(const TextureMap& map, std::size_t image, bool is_srgb) {
    TextureUse use;
    use.image = image;
    use.wrap_u = use.wrap_v = map.wrap;
    use.flags = is_srgb ? GLEANER_TEXTURE_SRGB : 0;
    // OBJ counts v from the image's bottom row, textures here from the top.
    use.transform = {map.scale[0], 0, map.offset[0], 0, map.scale[1], 1 - map.scale[1] - map.offset[1]};
    return table_.add(use);
  }

  gl_uint add(const TextureMap& map, bool is_srgb) { return add(map, image(map), is_srgb); }

  TextureTable& table() { return table_; }

 private:
  static bool is_absolute(const std::string& path) {
    return path.starts_with('/') || (path.size() > 2 && path[1] == ':' && path[2] == '/');
  }

  // Absolute paths are another machine's; a file of that name may have come along beside the scene.
  std::string near_scene(const TextureMap& map) {
    if (!is_absolute(map.path)) return map.path;
    const std::filesystem::path name = std::filesystem::path(map.path).filename();
    std::error_code code;
    if (name.empty() || !std::filesystem::exists(std::filesystem::path(file_).parent_path() / name, code))
      return map.path;
    warnings_.add(map.element, "an absolute path: the file of that name in the scene's folder is taken");
    return name.string();
  }

  const std::string& file_;
  TextureTable& table_;
  Warnings& warnings_;
};

void add_base_texture(const MtlMaterial& mtl, Material& m, Textures& textures) {
  if (mtl.map_d && (!mtl.map_kd || mtl.map_d->path != mtl.map_kd->path)) {
    const std::size_t opacity = textures.image(*mtl.map_d);
    std::vector<std::size_t> sources = {opacity};
    if (mtl.map_kd) sources.push_back(textures.image(*mtl.map_kd));
    const std::size_t image = textures.table().add_composed(sources, [](const std::vector<Bitmap>& parts) {
      const Bitmap white{1, 1, {0xffffffffu}};
      return with_opacity(parts.size() > 1 ? parts[1] : white, parts[0]);
    });
    m.base_color_texture = textures.add(mtl.map_kd ? *mtl.map_kd : *mtl.map_d, image, true);
  } else if (mtl.map_kd) {
    m.base_color_texture = textures.add(*mtl.map_kd, true);
  }
  if (mtl.map_d) m.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
}

void add_lobe_texture(const MtlMaterial& mtl, Material& m, Textures& textures) {
  if (!mtl.map_roughness && !mtl.map_metallic) return;
  std::vector<std::size_t> sources;
  if (mtl.map_roughness) sources.push_back(textures.image(*mtl.map_roughness));
  if (mtl.map_metallic) sources.push_back(textures.image(*mtl.map_metallic));
  const bool has_roughness = mtl.map_roughness.has_value();
  const std::size_t image = textures.table().add_composed(sources, [has_roughness](const std::vector<Bitmap>& parts) {
    return roughness_and_metallic(has_roughness ? &parts[0] : nullptr,
                                  parts.size() > 1 || !has_roughness ? &parts.back() : nullptr);
  });
  m.metallic_roughness_texture = textures.add(has_roughness ? *mtl.map_roughness : *mtl.map_metallic, image, false);
}

void add_normal_texture(const MtlMaterial& mtl, Material& m, Textures& textures) {
  if (mtl.map_normal) {
    m.normal_texture = textures.add(*mtl.map_normal, false);
    m.normal_scale = mtl.map_normal->strength;
  } else if (mtl.map_bump) {
    const float strength = mtl.map_bump->strength;
    const std::size_t image = textures.table().add_composed(
        {textures.image(*mtl.map_bump)},
        [strength](const std::vector<Bitmap>& parts) { return normals_from(parts[0], strength); });
    m.normal_texture = textures.add(*mtl.map_bump, image, false);
  }
}

Material mirror(const MtlMaterial& mtl, Material m) {
  std::copy(mtl.ks.begin(), mtl.ks.end(), m.base_color);
  m.metallic = 1;
  m.roughness = 0;
  return m;
}

Material glass(const MtlMaterial& mtl, Material m, const std::string& where, Warnings& warnings) {
  const Color tint = mtl.tf ? *mtl.tf : has_color(mtl.ks) ? mtl.ks : Color{1, 1, 1};
  std::copy(tint.begin(), tint.end(), m.base_color);
  m.roughness = 0;
  m.specular = 1;
  m.transmission = 1;
  m.flags |= GLEANER_MATERIAL_SOLID;
  if (!mtl.ni)
    warnings.add(where, "glass (illum 7) without Ni, 1.5 is taken");
  else if (*mtl.ni < 1)
    warnings.add(where, "glass (illum 7) with Ni below 1, 1 is taken");
  m.ior = std::max(mtl.ni.value_or(1.5f), 1.0f);
  return m;
}

// d wins over Tr: some exporters write Tr with the meaning of d beside it.
void add_opacity(const MtlMaterial& mtl, Material& m, const std::string& where, Warnings& warnings) {
  m.alpha = mtl.d ? *mtl.d : mtl.tr ? 1 - *mtl.tr : 1;
  if (mtl.d && mtl.tr && std::abs(*mtl.d + *mtl.tr - 1) > 1e-3f) warnings.add(where, "d and Tr disagree: d is taken");
  if (m.alpha < 1) m.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
  if (m.alpha == 0)
    warnings.add(where, mtl.d ? "wholly transparent (d 0): nothing of it will be seen"
                              : "wholly transparent (Tr 1 without d): nothing of it will be seen; some exporters mean "
                                "opaque by it, d 1 says so");
}

}  // namespace

Material converted(const MtlMaterial& as_read, const std::string& file, const std::string& name, TextureTable& table,
                   Warnings& warnings) {
  Material m = blank_material();
  Textures textures(file, table, warnings);
  MtlMaterial mtl = as_read;
  for (std::optional<TextureMap>* map :
       {&mtl.map_kd, &mtl.map_ke, &mtl.map_d, &mtl.map_roughness, &mtl.map_metallic, &mtl.map_bump, &mtl.map_normal})
    textures.leave_out_missing(*map);
  // A Kd of 0 with a map means the map's colours, and without its file the grey of what has none.
  if (as_read.map_kd && !mtl.map_kd && mtl.kd && !has_color(*mtl.kd)) mtl.kd.reset();
  const std::string where = "material " + name;
  std::copy(mtl.ke.begin(), mtl.ke.end(), m.emission);
  if (mtl.map_ke) {
    m.emission_texture = textures.add(*mtl.map_ke, true);
    if (!has_color(mtl.ke)) std::fill(m.emission, m.emission + 3, 1.0f);
  }
  if (mtl.illum == 5) return mirror(mtl, m);
  if (mtl.illum == 7) return glass(mtl, m, where, warnings);
  Color kd = mtl.kd.value_or(Color{kDefaultReflectance, kDefaultReflectance, kDefaultReflectance});
  if (mtl.map_kd && !has_color(kd)) {
    warnings.add(where, "Kd 0 would blacken its map_Kd: 1 is taken");
    kd = {1, 1, 1};
  }
  std::copy(kd.begin(), kd.end(), m.base_color);
  add_base_texture(mtl, m, textures);
  add_normal_texture(mtl, m, textures);
  const bool is_physical = mtl.roughness || mtl.metallic || mtl.map_roughness || mtl.map_metallic;
  if (is_physical) {
    m.roughness = mtl.roughness.value_or(mtl.map_roughness ? 1.0f : 0.5f);
    m.metallic = mtl.metallic.value_or(mtl.map_metallic ? 1.0f : 0.0f);
    m.specular = 1;
    m.ior = std::max(mtl.ni.value_or(1.5f), 1.0f);
    add_lobe_texture(mtl, m, textures);
  } else if (has_color(mtl.ks)) {
    warnings.add(where, "Ks is read for mirrors (illum 5) and glass (illum 7) alone; this is a Lambert surface");
  }
  if (mtl.illum == 4 || mtl.illum == 6 || mtl.illum == 9)
    warnings.add(where, "illum " + std::to_string(mtl.illum) + " is read as a Lambert surface; glass is illum 7");
  add_opacity(mtl, m, where, warnings);
  return m;
}

}  // namespace gleaner::scene::obj
