// PLY, ASCII and binary: vertices with normals, colours and texture coordinates; faces and triangle strips.

#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <optional>

#include "scene/files/text.h"
#include "scene/import/formats.h"
#include "scene/import/mesh/piece_reader.h"
#include "scene/import/placement.h"
#include "scene/import/polygon.h"
#include "scene/import/texture_table.h"
#include "scene/import/vertex_colors.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::size_t kMaxListLength = std::size_t(1) << 24;

enum class Type { none, int8, uint8, int16, uint16, int32, uint32, float32, float64 };

Type type_named(std::string_view word) {
  if (word == "char" || word == "int8") return Type::int8;
  if (word == "uchar" || word == "uint8") return Type::uint8;
  if (word == "short" || word == "int16") return Type::int16;
  if (word == "ushort" || word == "uint16") return Type::uint16;
  if (word == "int" || word == "int32") return Type::int32;
  if (word == "uint" || word == "uint32") return Type::uint32;
  if (word == "float" || word == "float32") return Type::float32;
  if (word == "double" || word == "float64") return Type::float64;
  return Type::none;
}

std::size_t bytes_of(Type type) {
  switch (type) {
    case Type::int8:
    case Type::uint8:
      return 1;
    case Type::int16:
    case Type::uint16:
      return 2;
    case Type::float64:
      return 8;
    default:
      return 4;
  }
}

// What an integer of a colour stands for is a share of its type's largest value.
double largest_of(Type type) {
  if (type == Type::uint8 || type == Type::int8) return 255;
  if (type == Type::uint16 || type == Type::int16) return 65535;
  if (type == Type::uint32 || type == Type::int32) return 255;
  return 1;
}

template <typename T>
double value_at(const char* bytes, bool swapped) {
  char turned[sizeof(T)];
  for (std::size_t i = 0; i < sizeof(T); ++i) turned[i] = bytes[swapped ? sizeof(T) - 1 - i : i];
  T value;
  std::memcpy(&value, turned, sizeof value);
  return static_cast<double>(value);
}

double decoded(const char* bytes, Type type, bool swapped) {
  switch (type) {
    case Type::int8:
      return value_at<std::int8_t>(bytes, swapped);
    case Type::uint8:
      return value_at<std::uint8_t>(bytes, swapped);
    case Type::int16:
      return value_at<std::int16_t>(bytes, swapped);
    case Type::uint16:
      return value_at<std::uint16_t>(bytes, swapped);
    case Type::int32:
      return value_at<std::int32_t>(bytes, swapped);
    case Type::uint32:
      return value_at<std::uint32_t>(bytes, swapped);
    case Type::float32:
      return value_at<float>(bytes, swapped);
    default:
      return value_at<double>(bytes, swapped);
  }
}

struct Property {
  std::string name;
  Type type = Type::none, count_type = Type::none;  // of a list
  bool is_list() const { return count_type != Type::none; }
};

struct ElementKind {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;

  // Bytes that one takes at least, in a binary file or as text.
  std::uint64_t least_bytes(bool is_text) const {
    std::uint64_t bytes = 0;
    for (const Property& p : properties) bytes += is_text ? 2 : p.is_list() ? bytes_of(p.count_type) : bytes_of(p.type);
    return std::max<std::uint64_t>(bytes, 1);
  }
};

class PlyReader {
 public:
  PlyReader(const std::string& path, Warnings& warnings) : path_(path), warnings_(warnings), in_(path) {}

  Scene read() {
    read_header();
    for (const ElementKind& kind : kinds_) {
      const std::uint64_t room = in_.left() + 1;
      if (kind.count > room / kind.least_bytes(is_text_) + 1)
        fail("element " + kind.name, "as many as " + std::to_string(in_.left()) + " bytes can hold",
             std::to_string(kind.count));
      if (kind.name == "vertex")
        read_vertices(kind);
      else if (kind.name == "face")
        read_faces(kind);
      else if (kind.name == "tristrips")
        read_strips(kind);
      else
        skip(kind);
    }
    finish();
    return std::move(scene_);
  }

 private:
  enum Target { kX, kY, kZ, kNormalX, kNormalY, kNormalZ, kRed, kGreen, kBlue, kU, kV, kTargets };

  [[noreturn]] void fail(const std::string& where, const std::string& expected, const std::string& found) const {
    throw Error::bad_input(path_, where, expected, found);
  }

  static std::vector<std::string> words_of(std::string_view line) {
    std::vector<std::string> words;
    for (std::size_t at = 0; (at = line.find_first_not_of(" \t", at)) != std::string_view::npos;) {
      const std::size_t end = std::min(line.find_first_of(" \t", at), line.size());
      words.emplace_back(line.substr(at, end - at));
      at = end;
    }
    return words;
  }

  void read_header() {
    in_.skip_mark();
    if (in_.take_line("header") != "ply") fail("header", "the word ply", "other bytes");
    for (;;) {
      if (in_.left() == 0) fail("header", "end_header", "the file's end");
      const std::string line(in_.take_line("header"));
      const std::vector<std::string> words = words_of(line);
      if (words.empty()) continue;
      if (words[0] == "end_header") break;
      if (words[0] == "format" && words.size() >= 2)
        read_format(words[1]);
      else if (words[0] == "element" && words.size() >= 3)
        read_element(words);
      else if (words[0] == "property")
        read_property(words, line);
      else if (words[0] == "comment" && words.size() >= 3 && words[1] == "TextureFile")
        texture_ = line.substr(line.find(words[2], line.find(words[1]) + words[1].size()));
      else if (words[0] != "comment" && words[0] != "obj_info")  // some write comments without the word
        warnings_.add("header: " + in_quotes(line), "no statement of PLY: passed over");
      if (kinds_.size() > 1000) fail("header", "at most 1000 elements", "more");
    }
    if (!has_format_) fail("header", "a format", "none");
  }

  void read_format(const std::string& word) {
    has_format_ = true;
    is_text_ = word == "ascii";
    swapped_ = word == "binary_big_endian";
    if (!is_text_ && !swapped_ && word != "binary_little_endian")
      fail("format", "ascii, binary_little_endian or binary_big_endian", in_quotes(word));
  }

  void read_element(const std::vector<std::string>& words) {
    ElementKind kind{words[1], 0, {}};
    const char *begin = words[2].data(), *end = begin + words[2].size();
    const auto [stop, code] = std::from_chars(begin, end, kind.count);
    if (code != std::errc() || stop != end) fail("element " + words[1], "a number of elements", in_quotes(words[2]));
    kinds_.push_back(std::move(kind));
  }

  void read_property(const std::vector<std::string>& words, const std::string& line) {
    if (kinds_.empty()) fail("header", "an element before its properties", in_quotes(line));
    Property property;
    if (words.size() >= 5 && words[1] == "list") {
      property = {words[4], type_named(words[3]), type_named(words[2])};
      if (property.count_type == Type::none || property.count_type == Type::float32 ||
          property.count_type == Type::float64)
        fail("property " + words[4], "an integer type of its count", in_quotes(words[2]));
    } else if (words.size() >= 3) {
      property = {words[2], type_named(words[1]), Type::none};
    }
    if (property.type == Type::none) fail("header", "a property's type and name", in_quotes(line));
    if (kinds_.back().properties.size() >= 1000) fail("header", "at most 1000 properties", "more");
    kinds_.back().properties.push_back(std::move(property));
  }

  double take(Type type) {
    if (!is_text_) return decoded(in_.take(bytes_of(type), "data"), type, swapped_);
    std::string_view word = in_.take_word("data");
    if (word.starts_with('+')) word.remove_prefix(1);
    double value = 0;
    const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (code == std::errc::result_out_of_range) return 0;
    if (code != std::errc() || end != word.data() + word.size()) fail("data", "a number", in_quotes(word));
    return value;
  }

  std::size_t take_length(const Property& list, const std::string& where) {
    const double length = take(list.count_type);
    if (!(length >= 0 && length <= double(kMaxListLength)))
      fail(where, "a list of at most " + std::to_string(kMaxListLength), std::to_string(length));
    const auto count = static_cast<std::size_t>(length);
    if (count * (is_text_ ? 1 : bytes_of(list.type)) > in_.left() + 1)
      fail(where, "a list within the file", std::to_string(count) + " values");
    return count;
  }

  void skip(const Property& property, const std::string& where) {
    const std::size_t count = property.is_list() ? take_length(property, where) : 1;
    for (std::size_t i = 0; i < count; ++i) take(property.type);
  }

  void skip(const ElementKind& kind) {
    if (kind.properties.empty()) return;
    for (std::uint64_t i = 0; i < kind.count; ++i)
      for (const Property& property : kind.properties) skip(property, kind.name);
    warnings_.add("element " + kind.name, "not read");
  }

  static std::optional<Target> target_named(const std::string& name) {
    static const std::map<std::string, Target> targets = {{"x", kX},
                                                          {"y", kY},
                                                          {"z", kZ},
                                                          {"nx", kNormalX},
                                                          {"ny", kNormalY},
                                                          {"nz", kNormalZ},
                                                          {"red", kRed},
                                                          {"green", kGreen},
                                                          {"blue", kBlue},
                                                          {"r", kRed},
                                                          {"g", kGreen},
                                                          {"b", kBlue},
                                                          {"s", kU},
                                                          {"t", kV},
                                                          {"u", kU},
                                                          {"v", kV},
                                                          {"texture_u", kU},
                                                          {"texture_v", kV},
                                                          {"diffuse_red", kRed},
                                                          {"diffuse_green", kGreen},
                                                          {"diffuse_blue", kBlue}};
    const auto known = targets.find(name);
    return known == targets.end() ? std::nullopt : std::optional(known->second);
  }

  void read_vertices(const ElementKind& kind) {
    if (kind.count > kMaxVertices)
      fail("element vertex", "at most " + std::to_string(kMaxVertices), std::to_string(kind.count));
    std::vector<std::optional<Target>> targets;
    std::array<bool, kTargets> has{};
    for (const Property& property : kind.properties) {
      targets.push_back(property.is_list() ? std::nullopt : target_named(property.name));
      if (targets.back()) has[*targets.back()] = true;
    }
    if (!has[kX] || !has[kY] || !has[kZ]) fail("element vertex", "x, y and z", "less");
    const bool has_normals = has[kNormalX] && has[kNormalY] && has[kNormalZ];
    const bool has_colors = has[kRed] && has[kGreen] && has[kBlue];
    const bool has_uvs = has[kU] && has[kV] && !texture_.empty();
    points_.reserve(3 * kind.count);
    for (std::uint64_t i = 0; i < kind.count; ++i) {
      std::array<double, kTargets> values{};
      for (std::size_t p = 0; p < targets.size(); ++p) {
        const Property& property = kind.properties[p];
        if (!targets[p]) {
          skip(property, "vertex " + std::to_string(i));
          continue;
        }
        const Target target = *targets[p];
        values[target] = take(property.type);
        if (target >= kRed && target <= kBlue) values[target] /= largest_of(property.type);
      }
      for (const Target t : {kX, kY, kZ}) {
        if (!std::isfinite(values[t]))
          warnings_.add("vertex " + std::to_string(i), "without a place: no face may use it");
        points_.push_back(values[t]);
      }
      if (has_normals) add_normal(values[kNormalX], values[kNormalY], values[kNormalZ]);
      if (has_colors)
        for (const Target t : {kRed, kGreen, kBlue})
          colors_.push_back(static_cast<float>(std::isfinite(values[t]) ? std::clamp(values[t], 0.0, 255.0) : 1));
      // As in OBJ, v counts from the image's bottom row.
      if (has_uvs)
        for (const double c : {values[kU], 1 - values[kV]})
          scene_.uvs.push_back(std::abs(c) <= 1e30 ? static_cast<float>(c) : 0.0f);
    }
  }

  void add_normal(double x, double y, double z) {
    const double length = std::hypot(x, y, z);
    const bool usable = length > 0 && std::isfinite(length);
    for (const double c : {x, y, z}) scene_.normals.push_back(usable ? static_cast<float>(c / length) : 0.0f);
  }

  std::uint32_t take_vertex(Type type, const std::string& where) {
    const double index = take(type);
    const double count = static_cast<double>(points_.size() / 3);
    if (!(index >= 0 && index < count && index == std::floor(index)))
      fail(where, "a vertex below " + std::to_string(points_.size() / 3), std::to_string(index));
    const auto vertex = static_cast<std::uint32_t>(index);
    check_place(vertex);
    return vertex;
  }

  // Range scanners write points that they did not see as NaN; no face has a corner there.
  void check_place(std::uint32_t vertex) const {
    for (std::size_t c = 3 * std::size_t(vertex); c < 3 * std::size_t(vertex) + 3; ++c)
      if (!std::isfinite(points_[c]))
        fail("vertex " + std::to_string(vertex), "finite coordinates", std::to_string(points_[c]));
  }

  void add_triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (scene_.triangle_count() >= kMaxTriangles)
      fail("element face", "at most " + std::to_string(kMaxTriangles) + " triangles", "more");
    for (const std::uint32_t v : {a, b, c}) scene_.indices.push_back(v);
  }

  void read_faces(const ElementKind& kind) {
    const auto corners_at = std::find_if(kind.properties.begin(), kind.properties.end(), [](const Property& p) {
      return p.is_list() && (p.name == "vertex_indices" || p.name == "vertex_index");
    });
    if (corners_at == kind.properties.end()) {
      skip(kind);
      return;
    }
    if (points_.empty() && kind.count > 0) fail("element face", "element vertex before it", "none");
    if (kind.properties.size() > 1) warnings_.add("element face", "properties beside its corners are not read");
    scene_.indices.reserve(3 * std::min<std::uint64_t>(kind.count, kMaxTriangles));
    std::vector<std::uint32_t> corners;
    std::vector<std::array<double, 3>> outline;
    for (std::uint64_t i = 0; i < kind.count; ++i)
      for (const Property& property : kind.properties) {
        if (&property != &*corners_at) {
          skip(property, "face " + std::to_string(i));
          continue;
        }
        const std::size_t count = take_length(property, "face");
        corners.clear();
        for (std::size_t k = 0; k < count; ++k) corners.push_back(take_vertex(property.type, "face"));
        add_polygon(corners, outline, i);
      }
  }

  void add_polygon(const std::vector<std::uint32_t>& corners, std::vector<std::array<double, 3>>& outline,
                   std::uint64_t face) {
    if (corners.size() < 3) {
      warnings_.add("face " + std::to_string(face), "faces of fewer than 3 corners are not drawn");
    } else if (corners.size() == 3) {
      add_triangle(corners[0], corners[1], corners[2]);
    } else {
      outline.clear();
      for (const std::uint32_t v : corners)
        outline.push_back(
            {points_[3 * std::size_t(v)], points_[3 * std::size_t(v) + 1], points_[3 * std::size_t(v) + 2]});
      bool is_simple = true;
      for (const auto& t : triangulated(outline, is_simple)) add_triangle(corners[t[0]], corners[t[1]], corners[t[2]]);
      if (!is_simple)
        warnings_.add("face " + std::to_string(face), "a polygon crosses itself: it is filled approximately");
    }
  }

  // Lists of vertices; -1 begins a new strip.
  void read_strips(const ElementKind& kind) {
    for (std::uint64_t i = 0; i < kind.count; ++i)
      for (const Property& property : kind.properties) {
        if (!property.is_list() || (property.name != "vertex_indices" && property.name != "vertex_index")) {
          skip(property, "tristrips");
          continue;
        }
        std::vector<std::uint32_t> strip;
        for (std::size_t left = take_length(property, "tristrips"); left > 0; --left) {
          const double value = take(property.type);
          if (value < 0) {
            strip.clear();
            continue;
          }
          if (!(value < static_cast<double>(points_.size() / 3)))
            fail("tristrips", "a vertex below " + std::to_string(points_.size() / 3), std::to_string(value));
          strip.push_back(static_cast<std::uint32_t>(value));
          check_place(strip.back());
          const std::size_t n = strip.size();
          if (n < 3) continue;
          const bool odd = n % 2 == 0;
          add_triangle(strip[n - 3], strip[odd ? n - 1 : n - 2], strip[odd ? n - 2 : n - 1]);
        }
      }
  }

  bool has_place(std::size_t first) const {
    return std::isfinite(points_[first]) && std::isfinite(points_[first + 1]) && std::isfinite(points_[first + 2]);
  }

  void finish() {
    if (scene_.indices.empty() && !points_.empty()) warnings_.add("points without faces are not drawn");
    Box box;
    for (std::size_t i = 0; i + 2 < points_.size(); i += 3)
      if (has_place(i)) box.add({points_[i], points_[i + 1], points_[i + 2]});
    for (std::size_t i = 0; i + 2 < points_.size(); i += 3)
      if (!has_place(i)) std::copy_n(box.lower.begin(), 3, &points_[i]);
    scene_.origin = origin_for(box);
    const auto vertex = std::find_if(kinds_.begin(), kinds_.end(), [](const auto& k) { return k.name == "vertex"; });
    if (vertex != kinds_.end() && std::any_of(vertex->properties.begin(), vertex->properties.end(),
                                              [](const auto& p) { return p.name == "x" && p.type == Type::float32; }))
      warn_of_coarse_floats(box, "", "the file's coordinates", warnings_);
    scene_.positions.reserve(points_.size());
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const double relative = points_[i] - scene_.origin[i % 3];
      if (!(std::abs(relative) <= kMaxCoordinate))
        fail("vertex " + std::to_string(i / 3), "coordinates within 1e9 m of the scene's centre",
             std::to_string(relative));
      scene_.positions.push_back(static_cast<float>(relative));
    }
    std::vector<double>().swap(points_);  // assigning {} would keep its memory
    scene_.normals.resize(scene_.positions.size());
    if (!colors_.empty()) scene_.colors = linear_colors(colors_);
    Material m = grey_material();
    if (!scene_.colors.empty() || !texture_.empty()) std::fill(m.base_color, m.base_color + 3, 1.0f);
    if (!texture_.empty() && !scene_.uvs.empty()) add_texture(m);
    scene_.materials.push_back(m);
    scene_.material_names.push_back("default");
    scene_.triangle_material.resize(scene_.triangle_count());
    if (scene_.triangle_count() > 0)
      scene_.meshes.push_back({"mesh 0", 0, static_cast<std::uint32_t>(scene_.triangle_count())});
  }

  void add_texture(Material& m) {
    const std::string element = "comment TextureFile";
    const auto image = resolve_reference(texture_, path_, element, &warnings_);
    std::error_code code;
    if (!std::filesystem::exists(image, code)) {
      warnings_.add(element, "there is no such file: the mesh does without it");
      std::vector<float>().swap(scene_.uvs);
      return;
    }
    TextureTable textures;
    TextureUse use;
    use.image = textures.add_image({element, image, {}});
    use.flags = GLEANER_TEXTURE_SRGB;
    m.base_color_texture = textures.add(use);
    textures.decode_into(scene_, path_, ImportOptions().most_texels, warnings_);
  }

  std::string path_;
  Warnings& warnings_;
  PieceReader in_;
  bool has_format_ = false, is_text_ = false, swapped_ = false;
  std::vector<ElementKind> kinds_;
  std::string texture_;
  Scene scene_;
  std::vector<double> points_;
  std::vector<float> colors_;
};

}  // namespace

Scene read_ply(const std::string& path, Warnings& warnings) { return PlyReader(path, warnings).read(); }

}  // namespace gleaner::scene
