// STL, binary and ASCII. Triangles do not share vertices and have no normals but their own; lengths are taken as
// metres.

#include <charconv>
#include <cmath>

#include "scene/files/text.h"
#include "scene/import/formats.h"
#include "scene/import/mesh/piece_reader.h"
#include "scene/import/placement.h"
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
  // Binary files may begin with "solid" as well: their length decides, or a zero byte, of which the number of triangles
  // always has one and text none.
  bool is_binary(std::uint64_t bytes) const {
    std::ifstream stream(path_, std::ios::binary);
    char head[512] = {};
    stream.read(head, sizeof head);
    std::string_view text(head, static_cast<std::size_t>(stream.gcount()));
    if (text.size() >= kHeaderBytes) {
      std::uint32_t triangles = 0;
      std::memcpy(&triangles, head + 80, sizeof triangles);
      if (bytes == kHeaderBytes + kTriangleBytes * std::uint64_t(triangles)) return true;
    }
    if (text.find('\0') != text.npos) return true;
    if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
    text.remove_prefix(std::min(text.find_first_not_of(" \t\r\n"), text.size()));
    return lower_case(text.substr(0, 5)) != "solid";
  }

  void read_binary() {
    in_.take(80, "header");
    auto count = in_.take_value<std::uint32_t>("header");
    // Programs that write as they go may never come back to fill in the number.
    if (count == 0 && in_.left() > 0 && in_.left() % kTriangleBytes == 0) {
      count = static_cast<std::uint32_t>(std::min<std::uint64_t>(in_.left() / kTriangleBytes, 0xffffffffu));
      warnings_.add("header", "0 triangles: the file's size says " + std::to_string(count));
    }
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
    bool has_attributes = false;
    for (std::uint32_t t = 0; t < count; ++t) {
      float values[12];
      const char* triangle = in_.take(kTriangleBytes, "triangles");
      std::memcpy(values, triangle, sizeof values);
      has_attributes |= triangle[kTriangleBytes - 2] != 0 || triangle[kTriangleBytes - 1] != 0;
      for (int k = 3; k < 12; ++k) add(values[k], "triangles");
    }
    if (has_attributes) warnings_.add("triangles", "attributes (colours, in some programs) are not read");
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

  // Word by word: line ends are of many kinds, or missing.
  void read_ascii() {
    in_.skip_mark();
    std::string name, keyword;
    const auto next = [&] { return keyword = lower_case(in_.take_word("text")); };
    bool is_open = false;
    std::size_t corners = 0;
    for (next(); !keyword.empty();) {
      if (keyword == "solid" || keyword == "endsolid") {
        close_solid(name);
        is_open = keyword == "solid";
        name = take_name(keyword);
        continue;  // with the word after it
      }
      if (keyword == "vertex") {
        for (int c = 0; c < 3; ++c) add(number(in_.take_word("vertex")), "vertex");
        ++corners;
      } else if (keyword == "facet") {
        for (int word = 0; word < 4; ++word) next();  // normal x y z
      } else if (keyword == "endfacet" || keyword == "endloop") {
        if (corners % 3 != 0)
          throw Error::bad_input(path_, "facet " + std::to_string(positions_.size() / 9), "3 vertices",
                                 std::to_string(corners % 3));
      } else if (keyword == "end") {  // "end loop", "end facet", "end solid"
        keyword = "end" + next();
        if (keyword != "end") continue;
        throw Error::bad_input(path_, "text", "the words of an STL file", in_quotes(keyword));
      } else if (keyword != "outer" && keyword != "loop") {
        throw Error::bad_input(path_, "text", "the words of an STL file", in_quotes(keyword));
      }
      next();
    }
    if (positions_.size() % 9 != 0) throw Error::bad_input(path_, "end", "a whole facet", "a part of one");
    close_solid(name);
    if (is_open) warnings_.add("end", "no endsolid: the file may have been cut");
  }

  // The rest of the line, or the words up to the next facet or solid; `keyword` becomes the word after it.
  std::string take_name(std::string& keyword) {
    std::string name;
    while (!in_.ends_line("name")) {
      const std::string word(in_.take_word("name"));
      keyword = lower_case(word);
      if (keyword == "facet" || keyword == "solid" || keyword == "endsolid") return name;
      name += (name.empty() ? "" : " ") + word;
    }
    keyword = lower_case(in_.take_word("text"));
    return name;
  }

  void close_solid(const std::string& name) {
    const std::size_t triangles = positions_.size() / 9;
    const std::size_t first =
        scene_.meshes.empty() ? 0 : scene_.meshes.back().first_triangle + scene_.meshes.back().triangle_count;
    if (triangles > first)
      scene_.meshes.push_back({name.empty() ? "mesh " + std::to_string(scene_.meshes.size()) : name,
                               std::uint32_t(first), std::uint32_t(triangles - first)});
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
