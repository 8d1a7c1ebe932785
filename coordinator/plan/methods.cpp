#include "coordinator/plan/methods.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

#include "coordinator/plan/ao_plan.h"
#include "coordinator/plan/links_plan.h"
#include "coordinator/plan/path_plan.h"
#include "coordinator/plan/photon_plan.h"
#include "coordinator/plan/splat_plan.h"
#include "coordinator/plan/vpl_plan.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

const std::vector<Method>& methods() {
  static const std::vector<Method> table = {path_method(),  vpl_method(),   photon_method(),
                                            links_method(), splat_method(), ao_method()};
  return table;
}

const Method& method_of(std::string_view name) {
  if (name == "auto") name = "path";
  const auto found = std::ranges::find(methods(), name, &Method::name);
  if (found == methods().end())
    throw Error::usage("--method: expected " + method_names() + ", found " + std::string(name));
  return *found;
}

const std::vector<Setting>& common_settings() {
  static const std::vector<Setting> settings = {
      {"depth", SettingType::whole, 0, 1u << 30, "0",
       "most scatterings on a light's way: 1 is direct light; 0: until Russian roulette ends it"},
  };
  return settings;
}

namespace {

// `use` gets every setting of the table; false ends.
template <typename Use>
bool each_setting(Use use) {
  if (!std::ranges::all_of(common_settings(), use)) return false;
  return std::ranges::all_of(methods(),
                             [&](const Method& method) { return std::ranges::all_of(method.settings, use); });
}

const Setting* find_setting(std::string_view name) {
  const Setting* found = nullptr;
  each_setting([&](const Setting& setting) {
    if (setting.name == name) found = &setting;
    return !found;
  });
  return found;
}

std::string number_text(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.10g", value);
  return text;
}

// The number that `text` is, all of it.
std::optional<double> parse(const Setting& setting, const std::string& text) {
  const char* const end = text.data() + text.size();
  double value = 0;
  if (setting.type == SettingType::real) {
    const auto [stop, error] = std::from_chars(text.data(), end, value);
    if (error != std::errc() || stop != end || !std::isfinite(value)) return std::nullopt;
  } else {
    std::uint32_t whole = 0;
    const auto [stop, error] = std::from_chars(text.data(), end, whole);
    if (error != std::errc() || stop != end) return std::nullopt;
    value = whole;
  }
  if (!(value >= setting.least && value <= setting.most)) return std::nullopt;
  return value;
}

std::optional<double> given(const FrameSettings& settings, std::string_view name) {
  const auto entry = settings.set.find(std::string(name));
  if (entry == settings.set.end()) return std::nullopt;
  const Setting* setting = find_setting(name);
  const auto value = setting ? parse(*setting, entry->second) : std::nullopt;
  if (!value) throw Error::failed("setting " + std::string(name) + " was not checked before it was read");
  return value;
}

const char* kind_of(const Setting& setting) {
  return setting.type == SettingType::real ? "a number" : "a whole number";
}

void add_rows(std::string& page, const std::vector<Setting>& settings) {
  page += "\n| setting | values | default | meaning |\n|---|---|---|---|\n";
  for (const Setting& s : settings) {
    page += "| `" + std::string(s.name) + "` | " + describe_range(s) + " | " + std::string(s.usual) + " | " +
            std::string(s.help) + (s.old_name.empty() ? "" : " (until now `" + std::string(s.old_name) + "`)") + " |\n";
  }
}

}  // namespace

std::vector<std::string> rename_old_settings(std::map<std::string, std::string>& set) {
  std::vector<std::string> warnings;
  each_setting([&](const Setting& setting) {
    const std::string old_name(setting.old_name), name(setting.name);
    if (old_name.empty() || !set.contains(old_name)) return true;
    if (set.contains(name))
      throw Error::usage("--set " + old_name + ": is " + name + " by its old name; expected one of them");
    set[name] = set[old_name];
    set.erase(old_name);
    warnings.push_back("--set " + old_name + " is now called " + name + "; the next release knows only that name");
    return true;
  });
  return warnings;
}

void check_set(const std::map<std::string, std::string>& set) {
  for (const auto& [name, text] : set) {
    const Setting* setting = find_setting(name);
    if (!setting) {
      std::string known;
      each_setting([&](const Setting& one) {
        known += (known.empty() ? "" : ", ") + std::string(one.name);
        return true;
      });
      throw Error::usage("--set " + name + ": no such setting; known: " + known);
    }
    if (!parse(*setting, text))
      throw Error::usage("--set " + name + ": expected " + kind_of(*setting) + " from " + describe_range(*setting) +
                         ", found \"" + text + "\"");
  }
}

std::optional<std::uint32_t> whole_setting(const FrameSettings& settings, std::string_view name) {
  const auto value = given(settings, name);
  return value ? std::optional(static_cast<std::uint32_t>(*value)) : std::nullopt;
}

std::optional<double> real_setting(const FrameSettings& settings, std::string_view name) {
  return given(settings, name);
}

std::optional<bool> flag_setting(const FrameSettings& settings, std::string_view name) {
  const auto value = given(settings, name);
  return value ? std::optional(*value != 0) : std::nullopt;
}

std::string method_names() {
  std::string names;
  for (std::size_t i = 0; i < methods().size(); ++i)
    names += (i == 0 ? "" : i + 1 == methods().size() ? " or " : ", ") + std::string(methods()[i].name);
  return names;
}

std::string describe_range(const Setting& setting) {
  return number_text(setting.least) + " to " + number_text(setting.most);
}

std::string settings_help() {
  std::string text = "Settings (--set NAME=VALUE):";
  each_setting([&](const Setting& s) {
    std::string name(s.name);
    name.resize(std::max<std::size_t>(name.size(), 27), ' ');
    text += "\n  " + name + std::string(s.help) + " (" + describe_range(s) + "; default: " + std::string(s.usual) + ")";
    return true;
  });
  return text;
}

std::string settings_page() {
  std::string page =
      "# Methods and their settings\n\n"
      "`--method M` chooses how a frame is rendered, `--set NAME=VALUE` sets one of a method's numbers. A setting of "
      "a\n"
      "method that the frame does not use is checked and otherwise ignored. `gleaner methods --markdown` prints this "
      "page.\n\n"
      "## All methods\n";
  add_rows(page, common_settings());
  for (const Method& method : methods()) {
    page += "\n## " + std::string(method.name) + "\n\n" + std::string(method.help) + "\n";
    if (!method.settings.empty()) add_rows(page, method.settings);
  }
  return page;
}

}  // namespace gleaner::coordinator
