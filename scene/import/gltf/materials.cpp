#include "scene/import/gltf/materials.h"

#include <algorithm>
#include <cmath>

#include "scene/files/files.h"
#include "scene/import/formats.h"

namespace gleaner::scene::gltf {
namespace {

constexpr double kMostUv = 1e6;  // of a texture transform's numbers

Material gltf_default() {
  Material m = blank_material();
  m.metallic = 1;
  m.specular = 1;
  return m;
}

gl_uint wrap(const Element& sampler, const char* key) {
  const auto mode = sampler.find(key);
  if (!mode) return GLEANER_WRAP_REPEAT;
  switch (mode->count(0, 65535)) {
    case 10497:
      return GLEANER_WRAP_REPEAT;
    case 33071:
      return GLEANER_WRAP_CLAMP;
    case 33648:
      return GLEANER_WRAP_MIRROR;
    default:
      mode->fail("10497, 33071 or 33648");
  }
}

void read_pair(const Element& element, const char* key, double (&to)[2]) {
  if (const auto value = element.find(key)) {
    const std::vector<double> numbers = value->numbers(2, -kMostUv, kMostUv);
    std::copy(numbers.begin(), numbers.end(), to);
  }
}

}  // namespace

std::array<double, 6> UvSource::matrix() const {
  const double cosine = std::cos(rotation), sine = std::sin(rotation);
  return {cosine * scale[0], sine * scale[1], offset[0], -sine * scale[0], cosine * scale[1], offset[1]};
}

void Materials::read(std::uint64_t most_texels) {
  read_without_images();
  textures_.decode_into(scene_, document_.file(), most_texels, warnings_);
}

void Materials::read_without_images() {
  for (std::size_t i = 0; i < document_.size("materials"); ++i) add(document_.item("materials", i));
  in_file_ = uvs_.size();
}

bool Materials::lays_on_textures_as(const Materials& other) const {
  return in_file_ == other.in_file_ &&
         std::equal(uvs_.begin(), uvs_.begin() + std::ptrdiff_t(in_file_), other.uvs_.begin()) &&
         slots_ == other.slots_ && textures_ == other.textures_;
}

std::uint32_t Materials::material_of(const Element& primitive, std::optional<std::size_t> variant) {
  const std::size_t in_file = document_.size("materials");
  if (const auto variants = primitive.extension("KHR_materials_variants"); variants && variant) {
    const Element mappings = variants->at("mappings");
    for (std::size_t i = 0; i < mappings.size(); ++i) {
      const Element chosen = mappings[i].at("variants");
      for (std::size_t k = 0; k < chosen.size(); ++k)
        if (chosen[k].count(0, 0xffffffffu) == *variant)
          return static_cast<std::uint32_t>(mappings[i].at("material").index(in_file));
    }
  }
  if (const auto reference = primitive.find("material")) return static_cast<std::uint32_t>(reference->index(in_file));
  if (!default_material_) {
    default_material_ = static_cast<std::uint32_t>(scene_.materials.size());
    scene_.materials.push_back(gltf_default());
    scene_.material_names.push_back("glTF default");
    uvs_.emplace_back();
  }
  return *default_material_;
}

bool Materials::needs_channel(std::size_t channel) const {
  return std::any_of(uvs_.begin(), uvs_.end(), [&](const MaterialUvs& m) { return m.channels[channel].has_value(); });
}

void Materials::add(const Element& element) {
  Material m = gltf_default();
  pending_.clear();
  if (const auto pbr = element.find("pbrMetallicRoughness")) {
    gl_float base[4] = {1, 1, 1, 1};
    pbr->colour("baseColorFactor", base);
    std::copy(base, base + 3, m.base_color);
    m.alpha = base[3];
    m.metallic = static_cast<float>(pbr->factor("metallicFactor", 1));
    m.roughness = static_cast<float>(pbr->factor("roughnessFactor", 1));
    texture(*pbr, "baseColorTexture", true, &Material::base_color_texture);
    texture(*pbr, "metallicRoughnessTexture", false, &Material::metallic_roughness_texture);
  }
  texture(element, "normalTexture", false, &Material::normal_texture);
  if (const auto normal = element.find("normalTexture"))
    if (const auto scale = normal->find("scale"))
      m.normal_scale = static_cast<float>(scale->number(-kAnyNumber, kAnyNumber));
  add_emission(element, m);
  add_alpha(element, m);
  add_specular(element, m);
  add_transmission(element, m);
  if (const auto volume = element.extension("KHR_materials_volume")) add_volume(*volume, m);
  add_diffuse_transmission(element, m);
  add_layers(element, m);
  const bool is_unlit = element.extension("KHR_materials_unlit").has_value();
  if (is_unlit) {
    // It emits its base colour whatever else the file says.
    m.flags |= GLEANER_MATERIAL_UNLIT;
    m.metallic = m.specular = m.transmission = m.diffuse_transmission = m.clearcoat = m.anisotropy = m.iridescence = 0;
    std::fill(m.sheen_color, m.sheen_color + 3, 0.0f);
    m.flags &= ~GLEANER_MATERIAL_DOUBLE_SIDED;
    std::fill(m.emission, m.emission + 3, 0.0f);
    std::erase_if(pending_, [](const PendingTexture& t) { return t.slot != &Material::base_color_texture; });
  }
  lay_on(m);
  scene_.materials.push_back(m);
  scene_.material_names.push_back(name_of(element, element, element.name()));
}

void Materials::add_emission(const Element& element, Material& m) {
  texture(element, "emissiveTexture", true, &Material::emission_texture);
  element.colour("emissiveFactor", m.emission, kAnyNumber);
  if (std::any_of(m.emission, m.emission + 3, [](float e) { return e > 1; }))
    warnings_.add(element.name() + ".emissiveFactor",
                  "above 1, taken as it stands (glTF has KHR_materials_emissive_strength for it)");
  // Other surfaces scatter on both sides whatever the file says.
  const auto sides = element.find("doubleSided");
  if (sides && sides->boolean() && std::any_of(m.emission, m.emission + 3, [](float e) { return e > 0; }))
    m.flags |= GLEANER_MATERIAL_DOUBLE_SIDED;
  const auto strength = element.extension("KHR_materials_emissive_strength");
  if (!strength) return;
  for (float& e : m.emission) {
    const double product = e * strength->factor("emissiveStrength", 1, kAnyNumber);
    if (!(product <= kAnyNumber)) strength->fail("a product with emissiveFactor that a float can hold");
    e = static_cast<float>(product);
  }
}

void Materials::add_alpha(const Element& element, Material& m) {
  const std::string mode = element.find("alphaMode") ? element.at("alphaMode").text() : "OPAQUE";
  if (mode == "MASK")
    m.flags |= GLEANER_MATERIAL_ALPHA_MASK;
  else if (mode == "BLEND")
    m.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
  else if (mode != "OPAQUE")
    element.at("alphaMode").fail("OPAQUE, MASK or BLEND");
  m.alpha_cutoff = static_cast<float>(element.factor("alphaCutoff", 0.5, kAnyNumber));
}

void Materials::add_specular(const Element& element, Material& m) {
  if (const auto specular = element.extension("KHR_materials_specular")) {
    m.specular = static_cast<float>(specular->factor("specularFactor", 1));
    specular->colour("specularColorFactor", m.specular_color, kAnyNumber);
    texture(*specular, "specularTexture", false, &Material::specular_texture);
    texture(*specular, "specularColorTexture", true, &Material::specular_color_texture);
  }
  if (const auto ior = element.extension("KHR_materials_ior")) {
    m.ior = static_cast<float>(ior->factor("ior", 1.5, kAnyNumber));
    if (m.ior != 0 && m.ior < 1) ior->at("ior").fail("0 or at least 1");
  }
}

void Materials::add_transmission(const Element& element, Material& m) {
  const auto transmission = element.extension("KHR_materials_transmission");
  if (!transmission) return;
  m.transmission = static_cast<float>(transmission->factor("transmissionFactor", 0));
  if (m.transmission == 0) return;
  texture(*transmission, "transmissionTexture", false, &Material::transmission_texture);
  if (m.ior < 1) element.fail("an ior of at least 1 where light is transmitted", "0");
}

// The extension makes glass a solid. An explicit thickness of 0 is how glTF itself says thin-walled.
void Materials::add_volume(const Element& volume, Material& m) {
  const auto thickness = volume.find("thicknessFactor");
  if (m.transmission == 0 || (thickness && thickness->number(0) == 0)) return;
  m.flags |= GLEANER_MATERIAL_SOLID;
  if (volume.find("thicknessTexture"))
    warnings_.add(volume.name() + ".thicknessTexture", "not read, the geometry says how thick it is");
  const auto distance = volume.find("attenuationDistance");
  if (!distance) return;
  const double metres = distance->number(0);
  if (!(metres > 0)) distance->fail("more than 0");
  gl_float left[3] = {1, 1, 1};
  volume.colour("attenuationColor", left);
  // Nothing comes through a colour of 0 at any distance; 1e12 per metre is as good as infinity, and finite.
  for (int c = 0; c < 3; ++c)
    m.attenuation[c] = left[c] >= 1 ? 0.0f : static_cast<float>(std::min(-std::log(double(left[c])) / metres, 1e12));
}

// After transmission and volume.
void Materials::add_diffuse_transmission(const Element& element, Material& m) {
  const auto shining = element.extension("KHR_materials_diffuse_transmission");
  if (!shining) return;
  m.diffuse_transmission = static_cast<float>(shining->factor("diffuseTransmissionFactor", 0));
  shining->colour("diffuseTransmissionColorFactor", m.diffuse_transmission_color);
  if (m.diffuse_transmission == 0) return;
  texture(*shining, "diffuseTransmissionTexture", false, &Material::diffuse_transmission_texture);
  texture(*shining, "diffuseTransmissionColorTexture", true, &Material::diffuse_transmission_color_texture);
  const auto volume = element.extension("KHR_materials_volume");
  const auto thickness = volume ? volume->find("thicknessFactor") : std::nullopt;
  if (m.transmission == 0 && thickness && thickness->number(0) > 0)
    warnings_.add(volume->name(), "light that shines through is not scattered within: the surface is a thin sheet");
}

// Textures of what is switched off are not read.
void Materials::add_layers(const Element& element, Material& m) {
  if (const auto coat = element.extension("KHR_materials_clearcoat")) {
    m.clearcoat = static_cast<float>(coat->factor("clearcoatFactor", 0));
    m.clearcoat_roughness = static_cast<float>(coat->factor("clearcoatRoughnessFactor", 0));
    if (m.clearcoat > 0) {
      texture(*coat, "clearcoatTexture", false, &Material::clearcoat_texture);
      texture(*coat, "clearcoatRoughnessTexture", false, &Material::clearcoat_roughness_texture);
      texture(*coat, "clearcoatNormalTexture", false, &Material::clearcoat_normal_texture);
      if (const auto normal = coat->find("clearcoatNormalTexture"))
        if (const auto scale = normal->find("scale"))
          m.clearcoat_normal_scale = static_cast<float>(scale->number(-kAnyNumber, kAnyNumber));
    }
  }
  if (const auto sheen = element.extension("KHR_materials_sheen")) {
    sheen->colour("sheenColorFactor", m.sheen_color);
    m.sheen_roughness = static_cast<float>(sheen->factor("sheenRoughnessFactor", 0));
    if (std::any_of(m.sheen_color, m.sheen_color + 3, [](float c) { return c > 0; })) {
      texture(*sheen, "sheenColorTexture", true, &Material::sheen_color_texture);
      texture(*sheen, "sheenRoughnessTexture", false, &Material::sheen_roughness_texture);
    }
  }
  if (const auto grain = element.extension("KHR_materials_anisotropy")) {
    m.anisotropy = static_cast<float>(grain->factor("anisotropyStrength", 0));
    if (const auto rotation = grain->find("anisotropyRotation"))
      m.anisotropy_rotation = static_cast<float>(std::remainder(rotation->number(-kMostUv, kMostUv), 2 * M_PI));
    if (m.anisotropy > 0) texture(*grain, "anisotropyTexture", false, &Material::anisotropy_texture);
  }
  if (const auto film = element.extension("KHR_materials_iridescence")) add_film(*film, m);
  const bool has_layer = m.clearcoat > 0 || *std::max_element(m.sheen_color, m.sheen_color + 3) > 0;
  if (m.transmission > 0 && has_layer)
    warnings_.add(element.name(), "coat and sheen lie on what does not transmit light");
}

void Materials::add_film(const Element& film, Material& m) {
  constexpr double kThickest = 1e5;  // nm: of thicker films nobody sees colours
  m.iridescence = static_cast<float>(film.factor("iridescenceFactor", 0));
  m.iridescence_ior = static_cast<float>(film.factor("iridescenceIor", 1.3, kAnyNumber));
  if (!(m.iridescence_ior >= 1)) film.at("iridescenceIor").fail("at least 1");
  m.iridescence_minimum = static_cast<float>(film.factor("iridescenceThicknessMinimum", 100, kThickest));
  m.iridescence_maximum = static_cast<float>(film.factor("iridescenceThicknessMaximum", 400, kThickest));
  if (m.iridescence == 0) return;
  texture(film, "iridescenceTexture", false, &Material::iridescence_texture);
  texture(film, "iridescenceThicknessTexture", false, &Material::iridescence_thickness_texture);
}

UvSource Materials::uv_source(const Element& info) const {
  UvSource uv;
  if (const auto set = info.find("texCoord")) uv.set = set->count(0, 255);
  if (const auto transform = info.extension("KHR_texture_transform")) {
    read_pair(*transform, "offset", uv.offset);
    read_pair(*transform, "scale", uv.scale);
    if (const auto rotation = transform->find("rotation")) uv.rotation = rotation->number(-kMostUv, kMostUv);
    if (const auto set = transform->find("texCoord")) uv.set = set->count(0, 255);
  }
  return uv;
}

// The image that a texture shows; an extension's goes before the plain one, which is there for older readers.
std::optional<Element> Materials::image_of(const Element& texture) {
  if (const auto webp = texture.extension("EXT_texture_webp"))
    if (const auto source = webp->find("source")) return document_.item("images", *source);
  if (const auto source = texture.find("source")) return document_.item("images", *source);
  warnings_.add(texture.name(), "no image that can be read: the material does without it");
  return std::nullopt;
}

void Materials::texture(const Element& owner, const char* key, bool is_srgb, gl_uint Material::*slot) {
  const auto info = owner.find(key);
  if (!info) return;
  const Element element = document_.item("textures", info->at("index"));
  const auto picture = image_of(element);
  if (!picture) return;
  PendingTexture pending{slot, uv_source(*info), {}, info->name()};
  pending.use.flags = is_srgb ? GLEANER_TEXTURE_SRGB : 0;
  if (const auto reference = element.find("sampler")) {
    const Element sampler = document_.item("samplers", *reference);
    pending.use.wrap_u = wrap(sampler, "wrapS");
    pending.use.wrap_v = wrap(sampler, "wrapT");
    if (const auto filter = sampler.find("magFilter"); filter && filter->count(0, 65535) == 9728)
      warnings_.add(filter->name(), "NEAREST is read as LINEAR");
  }
  pending.use.image = image(*picture);
  pending_.push_back(std::move(pending));
}

// Gives each set of coordinates that the material's textures read a channel of the vertices. Where all that read a
// channel agree on a transform, the vertices carry it already; else each texture has its own.
void Materials::lay_on(Material& m) {
  MaterialUvs uvs;
  std::array<bool, 2> agree = {true, true};
  for (PendingTexture& t : pending_) {
    std::size_t channel = 0;
    while (channel < 2 && uvs.channels[channel] && uvs.channels[channel]->set != t.uv.set) ++channel;
    if (channel == 2) {
      warnings_.add(t.name, "a third set of texture coordinates in one material: the first is taken");
      channel = 0;
    }
    t.use.uv_set = static_cast<gl_uint>(channel);
    if (!uvs.channels[channel]) uvs.channels[channel] = t.uv;
    UvSource mine = t.uv;
    mine.set = uvs.channels[channel]->set;
    agree[channel] = agree[channel] && mine.key() == uvs.channels[channel]->key();
  }
  // The direction of a grain is that of the first coordinates where no texture says otherwise.
  if (m.anisotropy > 0 && !uvs.channels[0]) uvs.channels[0] = UvSource{};
  for (std::size_t channel = 0; channel < 2; ++channel)
    if (!agree[channel]) {
      UvSource plain;
      plain.set = uvs.channels[channel]->set;
      uvs.channels[channel] = plain;
    }
  for (PendingTexture& t : pending_) {
    if (!agree[t.use.uv_set]) {
      const std::array<double, 6> matrix = t.uv.matrix();
      for (std::size_t k = 0; k < 6; ++k) t.use.transform[k] = static_cast<float>(matrix[k]);
    }
    m.*t.slot = textures_.add(t.use);
    slots_.emplace_back(t.slot, m.*t.slot);
  }
  uvs_.push_back(uvs);
  slots_.emplace_back(nullptr, GLEANER_NONE);  // the material's end
}

std::size_t Materials::image(const Element& element) {
  if (const auto known = image_by_element_.find(element.name()); known != image_by_element_.end()) return known->second;
  ImageSource source;
  source.element = element.name();
  if (const auto uri = element.find("uri")) {
    source.element = uri->name();
    if (is_data_uri(uri->text())) {
      embedded_.push_back(data_uri_bytes(uri->text(), document_.file(), uri->name()));
      source.bytes = embedded_.back();
    } else {
      source.path = resolve_reference(percent_decoded(uri->text(), document_.file(), uri->name()), document_.file(),
                                      uri->name(), &warnings_);
      file_bytes(source.path, document_.file(), uri->name());
    }
  } else {
    source.bytes = document_.buffer_view(element.at("bufferView"));
  }
  return image_by_element_[element.name()] = textures_.add_image(std::move(source));
}

}  // namespace gleaner::scene::gltf
