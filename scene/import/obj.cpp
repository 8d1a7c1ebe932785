// Wavefront OBJ with MTL. Illumination models 5 and 7 are the mirror and the glass; every other one is a Lambert
// surface.

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <unordered_map>

#include "scene/import/files.h"
#include "scene/import/formats.h"
#include "scene/import/images.h"
#include "scene/import/polygon.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

namespace fs = std::filesystem;

constexpr float kDefaultReflectance = 0.8f;  // of faces that name no material

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r'; }

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
  return text;
}

// Takes the next word off the front of `text`; empty at its end.
std::string_view take_word(std::string_view& text) {
  text = trimmed(text);
  std::size_t length = 0;
  while (length < text.size() && !is_space(text[length])) ++length;
  const std::string_view word = text.substr(0, length);
  text.remove_prefix(length);
  return word;
}

std::string in_quotes(std::string_view text) {
  return text.empty() ? "nothing" : "\"" + std::string(text.substr(0, 80)) + (text.size() > 80 ? "...\"" : "\"");
}

// A text file line by line, comments and line continuations resolved; makes errors that name the line.
class Lines {
 public:
  explicit Lines(const std::string& shown, std::vector<std::byte> bytes) : file_(shown), bytes_(std::move(bytes)) {
    rest_ = {reinterpret_cast<const char*>(bytes_.data()), bytes_.size()};
  }

  // The next line that is not empty; nothing at the end. The view lasts until the next call.
  std::optional<std::string_view> next() {
    while (!rest_.empty()) {
      std::string_view line = physical_line();
      if (line.ends_with('\\')) {
        joined_.clear();
        while (line.ends_with('\\')) {
          joined_.append(line.substr(0, line.size() - 1)).push_back(' ');
          line = rest_.empty() ? std::string_view() : physical_line();
        }
        joined_.append(line);
        line = joined_;
      }
      for (std::size_t i = 0; i < line.size(); ++i)
        if (line[i] == '#' && (i == 0 || is_space(line[i - 1]))) line = line.substr(0, i);
      line = trimmed(line);
      if (!line.empty()) return line;
    }
    return std::nullopt;
  }

  std::string here() const { return "line " + std::to_string(number_); }

  [[noreturn]] void fail(const std::string& what, const std::string& expected, const std::string& found) const {
    throw Error::bad_input(file_, here() + ": " + what, expected, found);
  }

  double number(std::string_view word, const std::string& what) const {
    double value = 0;
    std::string_view digits = word;
    if (digits.starts_with('+')) digits.remove_prefix(1);
    const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (code != std::errc() || end != digits.data() + digits.size() || !std::isfinite(value))
      fail(what, "a finite number", in_quotes(word));
    return value;
  }

  double within(std::string_view word, const std::string& what, double lower, double upper) const {
    const double value = number(word, what);
    if (!(value >= lower && value <= upper)) {
      char range[64];
      std::snprintf(range, sizeof range, upper < 1e30 ? "a number from %g to %g" : "a number of at least %g", lower,
                    upper);
      fail(what, range, in_quotes(word));
    }
    return value;
  }

 private:
  std::string_view physical_line() {
    ++number_;
    const std::size_t end = std::min(rest_.find('\n'), rest_.size());
    std::string_view line = rest_.substr(0, end);
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    if (line.ends_with('\r')) line.remove_suffix(1);
    return line;
  }

  std::string file_;
  std::vector<std::byte> bytes_;
  std::string_view rest_;
  std::string joined_;
  std::size_t number_ = 0;
};

struct TextureMap {
  std::string path;     // relative to the scene's folder
  std::string element;  // for errors
  gl_uint wrap = GLEANER_WRAP_REPEAT;
};

// What an MTL says of one material.
struct MtlMaterial {
  std::array<float, 3> kd{kDefaultReflectance, kDefaultReflectance, kDefaultReflectance}, ks{}, ke{};
  std::optional<std::array<float, 3>> tf;
  std::optional<float> d, tr, ni;
  long illum = 2;
  std::optional<TextureMap> map_kd;
};

class ObjReader {
 public:
  explicit ObjReader(const std::string& path) : path_(path) {}

  Scene read() {
    Lines lines(path_, read_file(path_, file_bytes(path_, path_, ""), path_, ""));
    while (const auto line = lines.next()) statement(lines, *line);
    close_mesh();
    add_materials();
    return std::move(scene_);
  }

 private:
  using Corner = std::array<std::int64_t, 3>;  // vertex, texture, normal: from 0, -1 = none

  struct CornerHash {
    std::size_t operator()(const Corner& c) const {
      std::uint64_t h = 0;
      for (const std::int64_t i : c) h = (h ^ static_cast<std::uint64_t>(i)) * 0x9e3779b97f4a7c15u, h ^= h >> 29;
      return h;
    }
  };

  void warn(const std::string& text) {
    if (warned_.insert(text).second) scene_.warnings.push_back(text);
  }

  void statement(const Lines& lines, std::string_view line) {
    const std::string_view keyword = take_word(line);
    if (keyword == "v") {
      for (int c = 0; c < 3; ++c)
        vertices_.push_back(static_cast<float>(lines.within(take_word(line), "v", -kMaxCoordinate, kMaxCoordinate)));
    } else if (keyword == "vt") {
      texture_vertices_.push_back(static_cast<float>(lines.within(take_word(line), "vt", -1e30, 1e30)));
      const std::string_view v = take_word(line);
      // OBJ counts v from the image's bottom row, textures here from the top.
      texture_vertices_.push_back(static_cast<float>(1 - (v.empty() ? 0 : lines.within(v, "vt", -1e30, 1e30))));
    } else if (keyword == "vn") {
      add_normal(lines, line);
    } else if (keyword == "f") {
      add_face(lines, line);
    } else if (keyword == "g" || keyword == "o") {
      close_mesh();
      mesh_name_ = std::string(trimmed(line));
    } else if (keyword == "usemtl") {
      use_material(lines, std::string(trimmed(line)));
    } else if (keyword == "mtllib") {
      add_library(lines, line);
    } else if (keyword == "l" || keyword == "p") {
      warn("points and lines are not drawn");
    } else if (keyword != "s") {
      warn("the statement \"" + std::string(keyword.substr(0, 40)) + "\" is not read");
    }
  }

  void add_normal(const Lines& lines, std::string_view line) {
    double n[3];
    for (double& c : n) c = lines.number(take_word(line), "vn");
    const double length = std::hypot(n[0], n[1], n[2]);
    // A normal of length 0 is none: the triangle's own is taken.
    for (const double c : n)
      normals_.push_back(length > 0 && std::isfinite(length) ? static_cast<float>(c / length) : 0.0f);
  }

  // One index of a face: from 1, or backwards from the last with -1.
  static std::int64_t resolve(const Lines& lines, std::string_view word, std::size_t count, const char* what) {
    std::int64_t index = 0;
    const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), index);
    if (code != std::errc() || end != word.data() + word.size())
      lines.fail("f", std::string("an index of ") + what, in_quotes(word));
    const auto limit = static_cast<std::int64_t>(count);
    if (index > 0 && index <= limit) return index - 1;
    if (index < 0 && index >= -limit) return limit + index;
    lines.fail("f", "an index among the " + std::to_string(count) + " " + what + " so far", in_quotes(word));
  }

  Corner corner(const Lines& lines, std::string_view word) const {
    Corner c{-1, -1, -1};
    const std::size_t counts[] = {vertices_.size() / 3, texture_vertices_.size() / 2, normals_.size() / 3};
    constexpr const char* names[] = {"vertices", "texture vertices", "normals"};
    for (int k = 0; k < 3; ++k) {
      const std::size_t slash = std::min(word.find('/'), word.size());
      const std::string_view part = word.substr(0, slash);
      if (k == 0 || !part.empty()) c[k] = resolve(lines, part, counts[k], names[k]);
      if (slash == word.size()) return c;
      word.remove_prefix(slash + 1);
    }
    lines.fail("f", "at most three indices a corner", in_quotes(word));
  }

  std::uint32_t vertex_of(const Corner& c) {
    const auto [place, is_new] = vertex_by_corner_.try_emplace(c, static_cast<std::uint32_t>(scene_.vertex_count()));
    if (!is_new) return place->second;
    scene_.positions.insert(scene_.positions.end(), &vertices_[3 * c[0]], &vertices_[3 * c[0]] + 3);
    constexpr float zero[3] = {};
    const float* normal = c[2] < 0 ? zero : &normals_[3 * c[2]];
    scene_.normals.insert(scene_.normals.end(), normal, normal + 3);
    const float* uv = c[1] < 0 ? zero : &texture_vertices_[2 * c[1]];
    scene_.uvs.insert(scene_.uvs.end(), uv, uv + 2);
    return place->second;
  }

  void add_face(const Lines& lines, std::string_view line) {
    polygon_.clear();
    for (std::string_view word = take_word(line); !word.empty(); word = take_word(line))
      polygon_.push_back(corner(lines, word));
    if (polygon_.size() < 3) lines.fail("f", "at least 3 corners", std::to_string(polygon_.size()));
    if (scene_.triangle_count() + polygon_.size() - 2 > kMaxTriangles)
      lines.fail("f", "at most " + std::to_string(kMaxTriangles) + " triangles", "more");
    points_.clear();
    for (const Corner& c : polygon_)
      points_.push_back({vertices_[3 * c[0]], vertices_[3 * c[0] + 1], vertices_[3 * c[0] + 2]});
    if (!material_) use_material(lines, "");
    for (const auto& triangle : triangulated(points_)) {
      for (const std::uint32_t k : triangle) scene_.indices.push_back(vertex_of(polygon_[k]));
      scene_.triangle_material.push_back(*material_);
    }
  }

  void close_mesh() {
    const std::size_t first =
        scene_.meshes.empty() ? 0 : scene_.meshes.back().first_triangle + scene_.meshes.back().triangle_count;
    if (scene_.triangle_count() == first) return;
    scene_.meshes.push_back({mesh_name_.empty() ? "mesh " + std::to_string(scene_.meshes.size()) : mesh_name_,
                             static_cast<std::uint32_t>(first),
                             static_cast<std::uint32_t>(scene_.triangle_count() - first)});
  }

  void use_material(const Lines& lines, const std::string& name) {
    const auto [place, is_new] =
        material_by_name_.try_emplace(name, static_cast<std::uint32_t>(scene_.material_names.size()));
    if (is_new) {
      scene_.material_names.push_back(name);
      first_use_.push_back(lines.here());
    }
    material_ = place->second;
  }

  // --- MTL -----------------------------------------------------------------------------------------------------------

  // One file, or several with spaces between them; a name with spaces in it is tried first.
  void add_library(const Lines& lines, std::string_view names) {
    const std::string whole(trimmed(names));
    if (whole.empty()) lines.fail("mtllib", "a file's name", "nothing");
    std::error_code code;
    if (fs::exists(fs::path(path_).parent_path() / slashed(whole), code)) {
      read_library(lines, whole);
      return;
    }
    for (std::string_view name = take_word(names); !name.empty(); name = take_word(names))
      read_library(lines, std::string(name));
  }

  // Files from other systems separate folders by backslashes.
  static std::string slashed(std::string name) {
    std::replace(name.begin(), name.end(), '\\', '/');
    return name;
  }

  void read_library(const Lines& lines, const std::string& name) {
    const std::string element = lines.here() + ": mtllib " + name;
    const fs::path relative = slashed(name);
    const fs::path path = resolve_inside(relative.string(), path_, element);
    has_library_ = true;
    if (!libraries_.insert(path).second) return;
    Lines mtl(path.string(), read_file(path, file_bytes(path, path_, element), path_, element));
    MtlMaterial* material = nullptr;
    while (const auto line = mtl.next()) {
      std::string_view rest = *line;
      std::string keyword(take_word(rest));
      std::transform(keyword.begin(), keyword.end(), keyword.begin(), [](unsigned char c) { return std::tolower(c); });
      if (keyword == "newmtl") {
        material = &(mtl_[std::string(trimmed(rest))] = {});
        continue;
      }
      if (!material) mtl.fail(keyword, "newmtl before it", "none");
      property(mtl, *material, keyword, rest, relative);
    }
  }

  void property(const Lines& mtl, MtlMaterial& m, const std::string& keyword, std::string_view rest,
                const fs::path& library) {
    static const std::set<std::string> meaningless = {"ka", "ns", "sharpness", "map_ka", "map_ns"};
    if (keyword == "kd") {
      m.kd = colour(mtl, keyword, rest, 1);
    } else if (keyword == "ks") {
      m.ks = colour(mtl, keyword, rest, 1);
    } else if (keyword == "ke") {
      m.ke = colour(mtl, keyword, rest, 3e38);
    } else if (keyword == "tf") {
      m.tf = colour(mtl, keyword, rest, 1);
    } else if (keyword == "d") {
      std::string_view word = take_word(rest);
      if (word == "-halo") word = take_word(rest);
      m.d = static_cast<float>(mtl.within(word, keyword, 0, 1));
    } else if (keyword == "tr") {
      m.tr = static_cast<float>(mtl.within(take_word(rest), keyword, 0, 1));
    } else if (keyword == "ni") {
      m.ni = static_cast<float>(mtl.within(take_word(rest), keyword, 0, 1e6));
    } else if (keyword == "illum") {
      m.illum = static_cast<long>(mtl.within(take_word(rest), keyword, 0, 10));
    } else if (keyword == "map_kd") {
      m.map_kd = texture_map(mtl, rest, library);
    } else if (!meaningless.contains(keyword)) {
      warn(library.string() + ": " + keyword.substr(0, 40) + " is not read");
    }
  }

  static std::array<float, 3> colour(const Lines& mtl, const std::string& keyword, std::string_view rest,
                                     double upper) {
    std::array<float, 3> values;
    const std::string_view first = take_word(rest), second = take_word(rest);
    values[0] = static_cast<float>(mtl.within(first, keyword, 0, upper));
    // One number stands for three.
    values[1] = second.empty() ? values[0] : static_cast<float>(mtl.within(second, keyword, 0, upper));
    values[2] = second.empty() ? values[0] : static_cast<float>(mtl.within(take_word(rest), keyword, 0, upper));
    return values;
  }

  TextureMap texture_map(const Lines& mtl, std::string_view rest, const fs::path& library) {
    // Options come first, each with so many values; -o, -s and -t take one to three numbers.
    static const std::map<std::string_view, int> values_of = {
        {"-blendu", 1},  {"-blendv", 1}, {"-boost", 1},  {"-cc", 1}, {"-clamp", 1},
        {"-imfchan", 1}, {"-mm", 2},     {"-texres", 1}, {"-bm", 1}, {"-type", 1}};
    TextureMap map;
    const auto is_number = [](std::string_view word) {
      double value;
      const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
      return code == std::errc() && end == word.data() + word.size();
    };
    for (;;) {
      std::string_view after = rest;
      const std::string_view option = take_word(after);
      if (option == "-o" || option == "-s" || option == "-t") {
        rest = after;
        for (int i = 0; i < 3; ++i) {
          if (!is_number(take_word(after))) break;
          rest = after;
        }
      } else if (const auto known = values_of.find(option); known != values_of.end()) {
        for (int i = 0; i < known->second; ++i)
          if (take_word(after) == "on" && option == "-clamp") map.wrap = GLEANER_WRAP_CLAMP;
        rest = after;
        if (option == "-clamp") continue;
      } else {
        break;
      }
      warn(library.string() + ": map_Kd " + std::string(option) + " is not read");
    }
    const std::string name(trimmed(rest));
    if (name.empty()) mtl.fail("map_Kd", "a file's name", "nothing");
    map.path = (library.parent_path() / slashed(name)).string();
    map.element = library.string() + ": " + mtl.here() + ": map_Kd";
    if (fs::path(slashed(name)).is_absolute()) mtl.fail("map_Kd", "a path inside the scene's folder", in_quotes(name));
    return map;
  }

  // --- from MTL to glTF's model --------------------------------------------------------------------------------------

  void add_materials() {
    std::vector<ImageSource> sources;
    std::map<fs::path, std::size_t> image_by_path;
    std::map<std::pair<std::size_t, gl_uint>, gl_uint> textures;
    std::vector<std::size_t> image_of_texture;
    for (std::size_t i = 0; i < scene_.material_names.size(); ++i) {
      std::string& name = scene_.material_names[i];
      const auto known = mtl_.find(name);
      if (known == mtl_.end() && !name.empty()) {
        if (has_library_)
          throw Error::bad_input(path_, first_use_[i] + ": usemtl", "a material of the libraries that mtllib names",
                                 in_quotes(name));
        warn("usemtl without mtllib: materials are grey Lambert surfaces");
      }
      const MtlMaterial mtl = known == mtl_.end() ? MtlMaterial{} : known->second;
      Material m = converted(mtl, name);
      if (mtl.map_kd && m.metallic == 0 && m.transmission == 0) {
        const fs::path path = resolve_inside(mtl.map_kd->path, path_, mtl.map_kd->element);
        const std::size_t image = image_by_path.try_emplace(path, sources.size()).first->second;
        if (image == sources.size()) sources.push_back({mtl.map_kd->element, path, {}});
        const auto [place, is_new] =
            textures.try_emplace({image, mtl.map_kd->wrap}, static_cast<gl_uint>(scene_.textures.size()));
        if (is_new) {
          Texture t{};
          t.wrap_u = t.wrap_v = mtl.map_kd->wrap;
          t.flags = GLEANER_TEXTURE_SRGB;
          scene_.textures.push_back(t);
          image_of_texture.push_back(image);
        }
        m.base_color_texture = place->second;
      }
      scene_.materials.push_back(m);
      if (name.empty()) name = "default";
    }
    const std::vector<DecodedImage> images = decode_images(sources, path_, scene_.texels, scene_.warnings);
    for (std::size_t i = 0; i < scene_.textures.size(); ++i) {
      scene_.textures[i].first_texel = images[image_of_texture[i]].first_texel;
      scene_.textures[i].width = images[image_of_texture[i]].width;
      scene_.textures[i].height = images[image_of_texture[i]].height;
    }
    if (scene_.textures.empty()) {
      scene_.uvs.clear();
      scene_.uvs.shrink_to_fit();
    }
  }

  Material converted(const MtlMaterial& mtl, const std::string& name) {
    Material m = lambert_material();
    std::copy(mtl.ke.begin(), mtl.ke.end(), m.emission);
    const auto has_colour = [](const std::array<float, 3>& c) { return c[0] > 0 || c[1] > 0 || c[2] > 0; };
    if (mtl.illum == 5) {
      std::copy(mtl.ks.begin(), mtl.ks.end(), m.base_color);
      m.metallic = 1;
      m.roughness = 0;
      return m;
    }
    if (mtl.illum == 7) {
      const std::array<float, 3> tint = mtl.tf ? *mtl.tf : has_colour(mtl.ks) ? mtl.ks : std::array<float, 3>{1, 1, 1};
      std::copy(tint.begin(), tint.end(), m.base_color);
      m.roughness = 0;
      m.specular = 1;
      m.transmission = 1;
      m.flags |= GLEANER_MATERIAL_SOLID;
      if (!mtl.ni)
        warn("material " + name + ": glass (illum 7) without Ni, 1.5 is taken");
      else if (*mtl.ni < 1)
        warn("material " + name + ": glass (illum 7) with Ni below 1, 1 is taken");
      m.ior = std::max(mtl.ni.value_or(1.5f), 1.0f);
      return m;
    }
    std::copy(mtl.kd.begin(), mtl.kd.end(), m.base_color);
    if (has_colour(mtl.ks))
      warn("material " + name +
           ": Ks is read for mirrors (illum 5) and glass (illum 7) alone; this is a Lambert surface");
    if (mtl.illum == 4 || mtl.illum == 6 || mtl.illum == 9)
      warn("material " + name + ": illum " + std::to_string(mtl.illum) +
           " is read as a Lambert surface; glass is illum 7");
    // d wins over Tr: some exporters write Tr with the meaning of d beside it.
    m.alpha = mtl.d ? *mtl.d : mtl.tr ? 1 - *mtl.tr : 1;
    if (m.alpha < 1) m.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
    return m;
  }

  std::string path_;
  Scene scene_;
  std::set<std::string> warned_;
  std::vector<float> vertices_, texture_vertices_, normals_;
  std::vector<Corner> polygon_;
  std::vector<std::array<double, 3>> points_;  // of polygon_
  std::unordered_map<Corner, std::uint32_t, CornerHash> vertex_by_corner_;
  std::string mesh_name_;
  std::optional<std::uint32_t> material_;
  std::map<std::string, std::uint32_t> material_by_name_;
  std::vector<std::string> first_use_;  // of each material: its line
  bool has_library_ = false;
  std::set<fs::path> libraries_;
  std::map<std::string, MtlMaterial> mtl_;
};

}  // namespace

Scene read_obj(const std::string& path) { return ObjReader(path).read(); }

}  // namespace gleaner::scene
