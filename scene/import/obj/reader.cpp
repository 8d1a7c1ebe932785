// Wavefront OBJ with MTL. Illumination models 5 and 7 are the mirror and the glass; every other one is a Lambert
// surface, unless the material has a roughness or a metallic value.

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>
#include <string_view>

#include "scene/files/files.h"
#include "scene/import/formats.h"
#include "scene/import/obj/lines.h"
#include "scene/import/obj/materials.h"
#include "scene/import/obj/mtl.h"
#include "scene/import/placement.h"
#include "scene/import/polygon.h"
#include "scene/import/vertex_colors.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace obj {
namespace {

namespace fs = std::filesystem;

constexpr double kMostCoordinate = 1e15;  // of what a file says; the scene's own limit holds about its centre

// The power of ten that the last written digit of a number stands for.
int last_digit_of(std::string_view word) {
  int exponent = 0, decimals = 0;
  bool is_fraction = false;
  for (std::size_t i = 0; i < word.size(); ++i) {
    if (word[i] == '.') {
      is_fraction = true;
    } else if (word[i] == 'e' || word[i] == 'E') {
      std::string_view digits = word.substr(i + 1);
      if (digits.starts_with('+')) digits.remove_prefix(1);
      std::from_chars(digits.data(), digits.data() + digits.size(), exponent);
      break;
    } else {
      decimals += is_fraction;
    }
  }
  return std::clamp(exponent, -1000, 1000) - decimals;
}

class ObjReader {
 public:
  ObjReader(const std::string& path, const ImportOptions& options, Warnings& warnings)
      : path_(path), options_(options), warnings_(warnings) {}

  Scene read() {
    Lines lines(path_, path_, "");
    while (const auto line = lines.next()) statement(lines, *line);
    close_mesh();
    place_vertices();
    add_materials();
    return std::move(scene_);
  }

 private:
  // A vertex of the scene: the corner that it stands for, as numbers from 0 (-1: none), and the next one of its v.
  struct Corner {
    std::int32_t v = -1, vt = -1, vn = -1;
  };
  struct Use {
    Corner corner;
    std::uint32_t next;
  };

  void statement(const Lines& lines, std::string_view line) {
    const std::string_view keyword = take_word(line);
    if (keyword == "v") {
      add_vertex(lines, line);
    } else if (keyword == "f") {
      add_face(lines, line);
    } else if (keyword == "vn") {
      add_normal(lines, line);
    } else if (keyword == "vt") {
      texture_vertices_.push_back(static_cast<float>(texture_coordinate(lines, take_word(line))));
      const std::string_view v = take_word(line);
      // OBJ counts v from the image's bottom row, textures here from the top.
      texture_vertices_.push_back(static_cast<float>(1 - (v.empty() ? 0 : texture_coordinate(lines, v))));
    } else if (keyword == "g" || keyword == "o") {
      close_mesh();
      mesh_name_ = std::string(trimmed(line));
    } else if (keyword == "usemtl") {
      use_material(lines, name_in_utf8(trimmed(line)));
    } else if (keyword == "mtllib") {
      add_library(lines, line);
    } else if (keyword == "l" || keyword == "p") {
      warnings_.add("points and lines are not drawn");
    } else if (keyword != "s") {
      warnings_.add("the statement \"" + std::string(keyword.substr(0, 40)) + "\" is not read");
    }
  }

  // x y z, then a weight, which polygons do not have, or a colour.
  void add_vertex(const Lines& lines, std::string_view line) {
    for (int c = 0; c < 3; ++c) {
      const std::string_view word = take_word(line);
      const std::optional<double> value = finite_number(word);
      if (!value && is_not_finite(word)) {
        warnings_.add(lines.here() + ": v", "without a place: no face may use it");
        vertices_.push_back(NAN);
        has_lost_vertices_ = true;
        continue;
      }
      const bool is_near = value && std::abs(*value) <= kMostCoordinate;
      vertices_.push_back(is_near ? *value : lines.within(word, "v", -kMostCoordinate, kMostCoordinate));
      finest_digit_ = std::min(finest_digit_, last_digit_of(word));
    }
    if (vertices_.size() / 3 > kMaxVertices)
      lines.fail("v", "at most " + std::to_string(kMaxVertices) + " vertices", "more");
    std::string_view words[4];
    int count = 0;
    for (std::string_view word = take_word(line); !word.empty() && count < 4; word = take_word(line))
      words[count++] = word;
    if (count < 3) return;
    colors_.resize(vertices_.size() - 3, -1);
    for (int c = 0; c < 3; ++c) colors_.push_back(static_cast<float>(lines.within(words[c], "v", -1e30, 1e30)));
  }

  double texture_coordinate(const Lines& lines, std::string_view word) {
    const std::optional<double> value = finite_number(word);
    if (value && std::abs(*value) <= 1e30) return *value;
    if (!is_not_finite(word)) return lines.within(word, "vt", -1e30, 1e30);
    warnings_.add(lines.here() + ": vt", "not a finite number: 0 is taken");
    return 0;
  }

  void add_normal(const Lines& lines, std::string_view line) {
    double n[3];
    for (double& c : n) {
      const std::string_view word = take_word(line);
      const std::optional<double> value = finite_number(word);
      c = value.value_or(HUGE_VAL);
      if (value) continue;
      if (!is_not_finite(word)) lines.fail("vn", "a finite number", in_quotes(word));
      warnings_.add(lines.here() + ": vn", "not a finite number: triangles take their own normals");
    }
    const double length = std::hypot(n[0], n[1], n[2]);
    // A normal of length 0 is none: the triangle's own is taken.
    for (const double c : n)
      normals_.push_back(length > 0 && std::isfinite(length) ? static_cast<float>(c / length) : 0.0f);
  }

  // One index of a face: from 1, or backwards from the last with -1.
  static std::int32_t resolve(const Lines& lines, std::string_view word, std::size_t count, const char* what) {
    std::int64_t index = 0;
    const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), index);
    if (code != std::errc() || end != word.data() + word.size())
      lines.fail("f", std::string("an index of ") + what, in_quotes(word));
    const auto limit = static_cast<std::int64_t>(count);
    if (index > 0 && index <= limit) return static_cast<std::int32_t>(index - 1);
    if (index < 0 && index >= -limit) return static_cast<std::int32_t>(limit + index);
    lines.fail("f", "an index among the " + std::to_string(count) + " " + what + " so far", in_quotes(word));
  }

  void check_place(const Lines& lines, std::size_t vertex, std::string_view word) const {
    const double* p = &vertices_[3 * vertex];
    if (!std::isfinite(p[0] + p[1] + p[2]))
      lines.fail("f", "vertices of finite coordinates", in_quotes(word) + ", which has none");
  }

  // v, v/vt, v//vn or v/vt/vn.
  Corner corner(const Lines& lines, std::string_view word) const {
    Corner c;
    const std::size_t counts[] = {vertices_.size() / 3, texture_vertices_.size() / 2, normals_.size() / 3};
    constexpr const char* names[] = {"vertices", "texture vertices", "normals"};
    std::int32_t* const parts[] = {&c.v, &c.vt, &c.vn};
    for (int k = 0; k < 3; ++k) {
      std::size_t slash = 0;
      while (slash < word.size() && word[slash] != '/') ++slash;
      const std::string_view part = word.substr(0, slash);
      if (k > 0 && counts[k] == 0 && !part.empty())
        warnings_.add(lines.here() + ": f", std::string("names ") + names[k] + ", of which the file has none");
      else if (k == 0 || !part.empty())
        *parts[k] = resolve(lines, part, counts[k], names[k]);
      if (k == 0 && has_lost_vertices_) check_place(lines, static_cast<std::size_t>(c.v), part);
      if (slash == word.size()) return c;
      word.remove_prefix(slash + 1);
    }
    lines.fail("f", "at most three indices a corner", in_quotes(word));
  }

  std::uint32_t vertex_of(const Corner& c) {
    const auto v = static_cast<std::size_t>(c.v);
    if (v >= first_use_of_.size()) first_use_of_.resize(std::max(vertices_.size() / 3, v + 1), kNone);
    const auto number = static_cast<std::uint32_t>(uses_.size());
    std::uint32_t* link = &first_use_of_[v];
    int steps = 0;
    for (; *link != kNone && steps < kMostSteps; link = &uses_[*link].next, ++steps) {
      const Corner& known = uses_[*link].corner;
      if (known.vt == c.vt && known.vn == c.vn) return *link;
    }
    if (steps == kMostSteps) {  // the pole of a sphere, or worse
      const auto [place, is_new] = further_uses_.try_emplace({c.v, c.vt, c.vn}, number);
      if (!is_new) return place->second;
    } else {
      *link = number;  // before the vector moves
    }
    uses_.push_back({c, kNone});
    return number;
  }

  void add_face(const Lines& lines, std::string_view line) {
    polygon_.clear();
    for (std::string_view word = take_word(line); !word.empty(); word = take_word(line))
      polygon_.push_back(corner(lines, word));
    if (polygon_.size() < 3) {
      warnings_.add(lines.here() + ": f", "faces of fewer than 3 corners are not drawn");
      return;
    }
    if (scene_.triangle_count() + polygon_.size() - 2 > kMaxTriangles)
      lines.fail("f", "at most " + std::to_string(kMaxTriangles) + " triangles", "more");
    if (!material_) use_material(lines, "");
    if (polygon_.size() == 3) {
      for (const Corner& c : polygon_) scene_.indices.push_back(vertex_of(c));
    } else {
      points_.clear();
      for (const Corner& c : polygon_) {
        const double* p = &vertices_[3 * static_cast<std::size_t>(c.v)];
        points_.push_back({p[0], p[1], p[2]});
      }
      bool is_simple = true;
      for (const auto& triangle : triangulated(points_, is_simple))
        for (const std::uint32_t k : triangle) scene_.indices.push_back(vertex_of(polygon_[k]));
      if (!is_simple) warnings_.add(lines.here() + ": f", "a polygon crosses itself: it is filled approximately");
    }
    scene_.triangle_material.resize(scene_.triangle_count(), *material_);
  }

  void close_mesh() {
    const std::size_t first =
        scene_.meshes.empty() ? 0 : scene_.meshes.back().first_triangle + scene_.meshes.back().triangle_count;
    if (scene_.triangle_count() == first) return;
    scene_.meshes.push_back({mesh_name_.empty() ? "mesh " + std::to_string(scene_.meshes.size()) : mesh_name_,
                             static_cast<std::uint32_t>(first),
                             static_cast<std::uint32_t>(scene_.triangle_count() - first)});
  }

  // Vertices that faces use, relative to the scene's centre.
  void place_vertices() {
    Box box;
    for (const Use& use : uses_) {
      const double* p = &vertices_[3 * static_cast<std::size_t>(use.corner.v)];
      box.add({p[0], p[1], p[2]});
    }
    scene_.origin = options_.origin.value_or(origin_for(box));
    const double finest_step = std::pow(10.0, std::clamp(finest_digit_, -15, 15));
    if (box.magnitude() > kFarAway * box.extent() && finest_step * kFewSteps > box.extent() && box.extent() > 0) {
      char text[160];
      std::snprintf(text, sizeof text, "coordinates far from the origin are written to %.2g m, %.2g %% of the size",
                    finest_step, 100 * finest_step / box.extent());
      warnings_.add(text);
    }
    scene_.positions.reserve(3 * uses_.size());
    for (const Use& use : uses_) {
      const double* p = &vertices_[3 * static_cast<std::size_t>(use.corner.v)];
      for (int c = 0; c < 3; ++c) {
        const double relative = p[c] - scene_.origin[static_cast<std::size_t>(c)];
        if (!(std::abs(relative) <= kMaxCoordinate))
          throw Error::bad_input(path_, "v " + std::to_string(use.corner.v + 1),
                                 "coordinates within 1e9 m of the scene's centre", std::to_string(relative));
        scene_.positions.push_back(static_cast<float>(relative));
      }
    }
    std::vector<double>().swap(vertices_);  // assigning {} would keep its memory
    scene_.normals.reserve(3 * uses_.size());
    constexpr float zero[3] = {};
    for (const Use& use : uses_) {
      const float* normal = use.corner.vn < 0 ? zero : &normals_[3 * static_cast<std::size_t>(use.corner.vn)];
      scene_.normals.insert(scene_.normals.end(), normal, normal + 3);
    }
    std::vector<float>().swap(normals_);
    if (!colors_.empty()) add_colors();
  }

  void add_colors() {
    std::vector<float> colors;
    colors.reserve(3 * uses_.size());
    for (const Use& use : uses_)
      for (std::size_t c = 0; c < 3; ++c) {
        const std::size_t at = 3 * static_cast<std::size_t>(use.corner.v) + c;
        colors.push_back(at < colors_.size() ? colors_[at] : -1);
      }
    scene_.colors = linear_colors(colors);
  }

  void add_uvs() {
    scene_.uvs.reserve(2 * uses_.size());
    constexpr float zero[2] = {};
    for (const Use& use : uses_) {
      const float* uv = use.corner.vt < 0 ? zero : &texture_vertices_[2 * static_cast<std::size_t>(use.corner.vt)];
      scene_.uvs.insert(scene_.uvs.end(), uv, uv + 2);
    }
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

  // One file, or several with spaces between them; a name with spaces in it is tried first.
  void add_library(const Lines& lines, std::string_view names) {
    const std::string whole(trimmed(names));
    if (whole.empty()) lines.fail("mtllib", "a file's name", "nothing");
    std::error_code code;
    const auto is_there = [&](const std::string& name) {
      return fs::exists(fs::path(path_).parent_path() / slashed(name), code);
    };
    const bool is_quoted = whole.size() > 2 && whole.front() == '"' && whole.back() == '"';
    const std::string bare = is_quoted ? whole.substr(1, whole.size() - 2) : whole;
    if (is_there(bare) || is_quoted || is_of_another_machine(bare)) {
      read_library(lines, bare);
      return;
    }
    // Of several names each may have spaces: the longest that is there is taken.
    std::vector<std::string> words;
    for (std::string_view name = take_word(names); !name.empty(); name = take_word(names)) words.emplace_back(name);
    for (std::size_t first = 0, count = 1; first < words.size(); first += count) {
      std::string name;
      for (count = words.size() - first; count > 0; --count) {
        name = words[first];
        for (std::size_t i = 1; i < count; ++i) name += " " + words[first + i];
        if (count == 1 || is_there(name)) break;
      }
      read_library(lines, name);
    }
  }

  static bool is_of_another_machine(const std::string& name) {
    return name.size() > 2 && name[1] == ':' && (name[2] == '\\' || name[2] == '/');
  }

  // An absolute path is another machine's; a library of that name may have come along beside the scene.
  std::string near_scene(const Lines& lines, const std::string& name) {
    const std::string relative = slashed(name);
    if (!is_of_another_machine(name) && !fs::path(relative).is_absolute()) return relative;
    const std::string file = fs::path(relative).filename().string();
    std::error_code code;
    if (file.empty() || !fs::exists(fs::path(path_).parent_path() / file, code)) return relative;
    warnings_.add(lines.here() + ": mtllib", "an absolute path: the file of that name in the scene's folder is taken");
    return file;
  }

  void read_library(const Lines& lines, const std::string& name) {
    const std::string element = lines.here() + ": mtllib " + name;
    const std::string relative = near_scene(lines, name);
    const fs::path path = resolve_reference(relative, path_, element, &warnings_);
    if (!libraries_.insert(path).second) return;
    std::error_code code;
    if (!fs::exists(path, code)) {
      warnings_.add(element, "there is no such file: its materials are grey");
      return;
    }
    has_library_ = true;
    if (fs::is_directory(path, code)) {
      warnings_.add(element, "a folder: its materials are grey");
      return;
    }
    if (fs::is_regular_file(path, code) && fs::file_size(path, code) == 0) {
      warnings_.add(element, "an empty file");
      return;
    }
    read_mtl(path, relative, path_, element, library_, warnings_);
  }

  // The library's material of a name; comments behind a name, which some write, are tried without.
  MtlMaterial material_named(const std::string& name, const std::string& where) {
    auto known = library_.find(name);
    if (known == library_.end()) {
      const std::size_t comment = name.find(" #");
      if (comment != std::string::npos) known = library_.find(std::string(trimmed(name.substr(0, comment))));
    }
    // Or the comment stands in the library alone. Names are sorted: "name #..." is not before "name #".
    if (known == library_.end() && !name.empty()) {
      known = library_.lower_bound(name + " #");
      if (known != library_.end() && !known->first.starts_with(name + " #")) known = library_.end();
    }
    if (known != library_.end()) return known->second;
    if (!name.empty() && has_library_)
      warnings_.add(where + ": usemtl", "no library has the material " + in_quotes(name) + ": it is grey");
    else if (!name.empty())
      warnings_.add("usemtl without mtllib: materials are grey Lambert surfaces");
    return {};
  }

  void add_materials() {
    TextureTable textures;
    for (std::size_t i = 0; i < scene_.material_names.size(); ++i) {
      std::string& name = scene_.material_names[i];
      MtlMaterial mtl = material_named(name, first_use_[i]);
      if (!scene_.colors.empty() && !mtl.kd) mtl.kd = Color{1, 1, 1};  // the vertices' colours are the surface's
      scene_.materials.push_back(converted(mtl, path_, name, textures, warnings_));
      if (name.empty()) name = "default";
    }
    textures.decode_into(scene_, path_, options_.most_texels, warnings_);
    if (!textures.empty()) add_uvs();
  }

  static constexpr std::uint32_t kNone = ~0u;
  static constexpr int kMostSteps = 32;  // along the uses of one v

  std::string path_;
  const ImportOptions& options_;
  Warnings& warnings_;
  Scene scene_;
  std::vector<double> vertices_;
  bool has_lost_vertices_ = false;                          // some are NaN
  std::vector<float> texture_vertices_, normals_, colors_;  // colours: 3 a vertex, -1 where it has none; may end early
  std::vector<Corner> polygon_;
  std::vector<std::array<double, 3>> points_;                          // of polygon_
  std::vector<std::uint32_t> first_use_of_;                            // of each v: its first use, or kNone
  std::vector<Use> uses_;                                              // the scene's vertices
  std::map<std::array<std::int32_t, 3>, std::uint32_t> further_uses_;  // of v with many
  int finest_digit_ = 1000;  // the power of ten that a coordinate's last digit stands for, the least over the file
  std::string mesh_name_;
  std::optional<std::uint32_t> material_;
  std::map<std::string, std::uint32_t> material_by_name_;
  std::vector<std::string> first_use_;  // of each material: its line
  bool has_library_ = false;
  std::set<fs::path> libraries_;
  MtlLibrary library_;
};

}  // namespace
}  // namespace obj

Scene read_obj(const std::string& path, const ImportOptions& options, Warnings& warnings) {
  return obj::ObjReader(path, options, warnings).read();
}

}  // namespace gleaner::scene
