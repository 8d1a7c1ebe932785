// STL, binary and ASCII. Triangles do not share vertices and have no normals but their own; lengths are taken as
// metres.

#include <charconv>
#include <cmath>

#include "scene/import/formats.h"
#include "scene/import/mesh/piece_reader.h"
#include "scene/import/placement.h"
#include "scene/import/text.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

constexpr std::size_t kHeaderBytes = 84, kTriangleBytes = 50;

class StlReader {
 public:
  StlReader(const std::string& path, Warnings& warnings) : path_(path), warnings_(warnings), in_(path) {}

  Scene read() {
    const std::uint64_t bytes = in_.left();
    if (bytes < 15) throw Error::bad_input(path_, "", "an STL file", std::to_string(bytes) + " bytes");
    if (is_binary(bytes))
      read_binary();
    else
      read_ascii();
    finish();
    return std::move(scene_);
  }

 private:
  // Binary files may begin with "solid" as well: their length decides.
  bool is_binary(std::uint64_t bytes) const {
    std::ifstream stream(path_, std::ios::binary);
    char head[kHeaderBytes] = {};
    stream.read(head, sizeof head);
    const auto count = static_cast<std::size_t>(stream.gcount());
    std::uint32_t triangles = 0;
    if (count == sizeof head) std::memcpy(&triangles, head + 80, sizeof triangles);
    if (count == sizeof head && bytes == kHeaderBytes + kTriangleBytes * std::uint64_t(triangles)) return true;
    return std::string_view(head, count).substr(0, 5) != "solid";
  }

  void read_binary() {
    in_.take(80, "header");
    const auto count = in_.take_value<std::uint32_t>("header");
    if (count > kMaxTriangles)
      throw Error::bad_input(path_, "header", "at most " + std::to_string(kMaxTriangles) + " triangles",
                             std::to_string(count));
    const std::uint64_t needed = kTriangleBytes * std::uint64_t(count);
    if (needed > in_.left())
      throw Error::bad_input(path_, "header",
                             std::to_string(needed) + " bytes of " + std::to_string(count) + " triangles",
                             std::to_string(in_.left()));
    if (needed < in_.left())
      warnings_.add("header", std::to_string(in_.left() - needed) + " bytes after its end are not read");
    positions_.reserve(9 * std::size_t(count));
    for (std::uint32_t t = 0; t < count; ++t) {
      float values[12];
      std::memcpy(values, in_.take(kTriangleBytes, "triangles"), sizeof values);
      for (int k = 3; k < 12; ++k) add(values[k], "triangles");
    }
    scene_.meshes.push_back({"mesh 0", 0, count});
  }

  double number(std::string_view word) {
    double value = 0;
    if (word.starts_with('+')) word.remove_prefix(1);
    const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (code != std::errc() || end != word.data() + word.size())
      throw Error::bad_input(path_, "vertex", "a finite number", in_quotes(word));
    return value;
  }

  void read_ascii() {
    std::string name;
    const auto close = [&] {
      const std::size_t triangles = positions_.size() / 9;
      const std::size_t first =
          scene_.meshes.empty() ? 0 : scene_.meshes.back().first_triangle + scene_.meshes.back().triangle_count;
      if (triangles > first)
        scene_.meshes.push_back({name.empty() ? "mesh " + std::to_string(scene_.meshes.size()) : name,
                                 std::uint32_t(first), std::uint32_t(triangles - first)});
    };
    std::size_t corners = 0;
    while (in_.left() > 0) {
      const std::string_view line = in_.take_line("text");
      std::size_t at = line.find_first_not_of(" \t");
      if (at == std::string_view::npos) continue;
      std::string_view rest = line.substr(at);
      const auto word = [&] {
        rest.remove_prefix(std::min(rest.find_first_not_of(" \t"), rest.size()));
        const std::size_t length = std::min(rest.find_first_of(" \t"), rest.size());
        const std::string_view taken = rest.substr(0, length);
        rest.remove_prefix(length);
        return taken;
      };
      const std::string_view keyword = word();
      if (keyword == "vertex") {
        for (int c = 0; c < 3; ++c) add(number(word()), "vertex");
        ++corners;
      } else if (keyword == "endfacet" || keyword == "endloop") {
        if (corners % 3 != 0)
          throw Error::bad_input(path_, "facet " + std::to_string(positions_.size() / 9), "3 vertices",
                                 std::to_string(corners % 3));
      } else if (keyword == "solid") {
        close();
        rest.remove_prefix(std::min(rest.find_first_not_of(" \t"), rest.size()));
        name = std::string(rest);
      } else if (keyword != "facet" && keyword != "outer" && keyword != "endsolid") {
        throw Error::bad_input(path_, "text", "the words of an STL file", in_quotes(keyword));
      }
    }
    if (positions_.size() % 9 != 0) throw Error::bad_input(path_, "end", "a whole facet", "a part of one");
    close();
  }

  void add(double value, const char* where) {
    if (!std::isfinite(value)) throw Error::bad_input(path_, where, "finite coordinates", std::to_string(value));
    if (positions_.size() >= 9 * kMaxTriangles)
      throw Error::bad_input(path_, where, "at most " + std::to_string(kMaxTriangles) + " triangles", "more");
    positions_.push_back(static_cast<float>(value));
  }

  void finish() {
    Box box;
    for (std::size_t i = 0; i < positions_.size(); i += 3)
      box.add({positions_[i], positions_[i + 1], positions_[i + 2]});
    scene_.origin = origin_for(box);
    warn_of_coarse_floats(box, "", "the file's coordinates", warnings_);
    scene_.positions = std::move(positions_);
    for (std::size_t i = 0; i < scene_.positions.size(); ++i)
      scene_.positions[i] = static_cast<float>(scene_.positions[i] - scene_.origin[i % 3]);
    scene_.normals.resize(scene_.positions.size());
    scene_.indices.resize(scene_.positions.size() / 3);
    for (std::size_t i = 0; i < scene_.indices.size(); ++i) scene_.indices[i] = static_cast<std::uint32_t>(i);
    scene_.triangle_material.resize(scene_.indices.size() / 3);
    scene_.materials.push_back(grey_material());
    scene_.material_names.push_back("default");
  }

  std::string path_;
  Warnings& warnings_;
  PieceReader in_;
  Scene scene_;
  std::vector<float> positions_;
};

}  // namespace

Scene read_stl(const std::string& path, Warnings& warnings) { return StlReader(path, warnings).read(); }

}  // namespace gleaner::scene
