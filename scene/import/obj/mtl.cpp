#include "scene/import/obj/mtl.h"

#include <algorithm>
#include <charconv>
#include <functional>
#include <set>

namespace gleaner::scene::obj {
namespace {

namespace fs = std::filesystem;

bool is_number(std::string_view word) {
  double value;
  const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
  return code == std::errc() && end == word.data() + word.size();
}

class MtlReader {
 public:
  MtlReader(Lines& lines, const fs::path& relative, MtlLibrary& library, Warnings& warnings)
      : lines_(lines), relative_(relative), library_(library), warnings_(warnings) {}

  void read() {
    MtlMaterial* material = nullptr;
    while (const auto line = lines_.next()) {
      std::string_view rest = *line;
      written_ = std::string(take_word(rest));
      const std::string keyword = lower_case(written_);
      if (keyword == "newmtl") {
        material = &(library_[name_in_utf8(trimmed(rest))] = {});
        continue;
      }
      if (!material) lines_.fail(keyword, "newmtl before it", "none");
      property(*material, keyword, rest);
    }
  }

 private:
  void property(MtlMaterial& m, const std::string& keyword, std::string_view rest) {
    if (color_property(m, keyword, rest) || number_property(m, keyword, rest) || map_property(m, keyword, rest)) return;
    static const std::set<std::string> meaningless = {"ka", "ns", "sharpness", "map_ka", "map_ns", "map_aat"};
    if (!meaningless.contains(keyword)) warnings_.add(relative_.string(), keyword.substr(0, 40) + " is not read");
  }

  bool color_property(MtlMaterial& m, const std::string& keyword, std::string_view rest) {
    if (keyword == "kd")
      m.kd = color(keyword, rest, 1);
    else if (keyword == "ks")
      m.ks = color(keyword, rest, 1);
    else if (keyword == "ke")
      m.ke = color(keyword, rest, 3e38);
    else if (keyword == "tf")
      m.tf = color(keyword, rest, 1);
    else
      return false;
    return true;
  }

  bool number_property(MtlMaterial& m, const std::string& keyword, std::string_view rest) {
    const auto number = [&](double upper) {
      return static_cast<float>(lines_.within(take_word(rest), keyword.c_str(), 0, upper));
    };
    if (keyword == "d") {
      std::string_view after = rest;
      if (take_word(after) == "-halo") rest = after;
      m.d = number(1);
    } else if (keyword == "tr") {
      m.tr = number(1);
    } else if (keyword == "ni") {
      m.ni = number(1e6);
    } else if (keyword == "pr") {
      m.roughness = number(1);
    } else if (keyword == "pm") {
      m.metallic = number(1);
    } else if (keyword == "illum") {
      m.illum = static_cast<long>(number(10));
    } else {
      return false;
    }
    return true;
  }

  bool map_property(MtlMaterial& m, const std::string& keyword, std::string_view rest) {
    static const std::map<std::string, std::optional<TextureMap> MtlMaterial::*> maps = {
        {"map_kd", &MtlMaterial::map_kd},       {"map_ke", &MtlMaterial::map_ke},
        {"map_d", &MtlMaterial::map_d},         {"map_pr", &MtlMaterial::map_roughness},
        {"map_pm", &MtlMaterial::map_metallic}, {"map_bump", &MtlMaterial::map_bump},
        {"bump", &MtlMaterial::map_bump},       {"norm", &MtlMaterial::map_normal},
        {"map_kn", &MtlMaterial::map_normal},   {"map_norm", &MtlMaterial::map_normal}};
    const auto known = maps.find(keyword);
    if (known == maps.end()) return false;
    if (trimmed(rest).empty())
      warnings_.add(lines_.file() + ": " + lines_.here() + ": " + written_,
                    "no file's name: the material does without it");
    else
      m.*known->second = texture_map(written_, rest);
    return true;
  }

  // One number stands for three. Above 1, where that is the limit: exporters' rounding and people's enthusiasm.
  Color color(const std::string& keyword, std::string_view rest, double upper) {
    const std::string_view first = take_word(rest), second = take_word(rest);
    const std::string_view words[] = {first, second, take_word(rest)};
    Color values;
    for (int c = 0; c < 3; ++c) {
      double value = lines_.within(second.empty() ? first : words[c], keyword.c_str(), 0, 3e38);
      if (value > upper) {
        warnings_.add(lines_.file() + ": " + lines_.here() + ": " + keyword, "above 1, 1 was taken");
        value = upper;
      }
      values[static_cast<std::size_t>(c)] = static_cast<float>(value);
    }
    return values;
  }

  // Reads one to three numbers of an option; those that are not there keep their values.
  static void read_numbers(std::string_view& rest, float (&to)[2]) {
    for (int i = 0; i < 3; ++i) {
      std::string_view after = rest;
      const std::string_view word = take_word(after);
      if (!is_number(word)) return;
      double value = 0;
      std::from_chars(word.data(), word.data() + word.size(), value);
      if (i < 2) to[i] = static_cast<float>(std::clamp(value, -1e6, 1e6));
      rest = after;
    }
  }

  // "wood.png -bm 0.5" becomes "-bm 0.5 wood.png".
  static std::string options_first(std::string_view rest) {
    std::size_t cut = std::string_view::npos;
    for (const char* option : {" -bm ", " -s ", " -o ", " -clamp ", " -imfchan ", " -blendu ", " -blendv ", " -mm "})
      cut = std::min(cut, rest.find(option, rest.find('.')));
    const std::string_view name = trimmed(rest.substr(0, cut));
    const bool has_extension = name.size() > 4 && name.substr(name.size() - 5).find('.') != std::string_view::npos;
    if (cut == std::string_view::npos || name.starts_with('-') || !has_extension) return std::string(rest);
    return std::string(trimmed(rest.substr(cut))) + " " + std::string(name);
  }

  TextureMap texture_map(const std::string& keyword, std::string_view rest) {
    // Options that are not read, with their numbers of values.
    static const std::map<std::string_view, int> values_of = {{"-blendu", 1}, {"-blendv", 1},  {"-boost", 1},
                                                              {"-cc", 1},     {"-imfchan", 1}, {"-mm", 2},
                                                              {"-texres", 1}, {"-type", 1}};
    TextureMap map;
    // Some write the options behind the name.
    const std::string reordered = options_first(rest);
    rest = reordered;
    for (;;) {
      std::string_view after = rest;
      const std::string_view option = take_word(after);
      if (option == "-o" || option == "-s") {
        rest = after;
        read_numbers(rest, option == "-o" ? map.offset : map.scale);
      } else if (option == "-t") {
        float unused[2];
        rest = after;
        read_numbers(rest, unused);
        warnings_.add(relative_.string(), keyword + " -t is not read");
      } else if (option == "-bm") {
        map.strength = static_cast<float>(lines_.within(take_word(after), keyword.c_str(), -1e6, 1e6));
        rest = after;
      } else if (option == "-clamp") {
        if (take_word(after) == "on") map.wrap = GLEANER_WRAP_CLAMP;
        rest = after;
      } else if (const auto known = values_of.find(option); known != values_of.end()) {
        for (int i = 0; i < known->second; ++i) take_word(after);
        rest = after;
        warnings_.add(relative_.string(), keyword + " " + std::string(option) + " is not read");
      } else {
        break;
      }
    }
    std::string_view name = trimmed(rest);
    if (name.size() > 1 && name.front() == '"' && name.back() == '"') name = name.substr(1, name.size() - 2);
    if (name.empty()) lines_.fail(keyword, "a file's name", "nothing");
    map.path = slashed(std::string(name));
    const bool has_drive = map.path.size() > 2 && map.path[1] == ':' && map.path[2] == '/';
    if (!fs::path(map.path).is_absolute() && !has_drive) map.path = (relative_.parent_path() / map.path).string();
    map.element = relative_.string() + ": " + lines_.here() + ": " + keyword;
    return map;
  }

  Lines& lines_;
  const fs::path& relative_;
  MtlLibrary& library_;
  Warnings& warnings_;
  std::string written_;  // the keyword as it stands in the line
};

}  // namespace

std::string slashed(std::string path) {
  std::replace(path.begin(), path.end(), '\\', '/');
  return path;
}

void read_mtl(const fs::path& path, const fs::path& relative, const std::string& shown, const std::string& element,
              MtlLibrary& library, Warnings& warnings) {
  Lines lines(path, shown, element);
  MtlReader(lines, relative, library, warnings).read();
}

}  // namespace gleaner::scene::obj
