#pragma once
// Every method that renders frames, one row each: its name, its plan, its settings. make_plan's errors, the help of
// --method and --set, `gleaner explain`, `gleaner methods` and docs/reference/settings.md all come from this table.

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "coordinator/plan/plan.h"

namespace gleaner::coordinator {

enum class SettingType { whole, real, flag };

// What --set NAME=VALUE may say.
struct Setting {
  std::string_view name;
  SettingType type = SettingType::whole;
  double least = 0, most = 0;  // of the value; a flag is 0 or 1
  std::string_view usual;      // what is taken where it is not given, in words
  std::string_view help;
  std::string_view old_name{};  // understood for one release, with a warning
};

struct Method {
  std::string_view name, help;
  std::unique_ptr<Plan> (*make)(const FrameSettings& settings, const SceneSummary& scene) = nullptr;
  // Of memory that its plan takes a pixel, beside the film and what it is made of.
  std::uint64_t bytes_a_pixel = 0;
  // Throws Error::usage for settings that are each in their range and yet do not go together; may be null.
  void (*check)(const FrameSettings& settings) = nullptr;
  bool takes_instances = true;  // false: scenes are to hold copies in their place
  std::vector<Setting> settings{};
};

template <typename PlanOfMethod>
std::unique_ptr<Plan> make_plan_of(const FrameSettings& settings, const SceneSummary& scene) {
  return std::make_unique<PlanOfMethod>(settings, scene);
}

const std::vector<Method>& methods();
// Throws Error::usage for an unknown name. "auto" is `path` until it can choose.
const Method& method_of(std::string_view name);
// Settings that every method reads.
const std::vector<Setting>& common_settings();

// Replaces old names by those that took their place. Returns one warning for each. Throws Error::usage where both are
// given.
std::vector<std::string> rename_old_settings(std::map<std::string, std::string>& set);

// Throws Error::usage for a name that no method knows, and for a value that is not of its setting's type and range. A
// setting of another method than the frame's is no error, so that one command line serves all.
void check_set(const std::map<std::string, std::string>& set);

// The value of a setting of the table, which check_set() has seen; none where it was not given.
std::optional<std::uint32_t> whole_setting(const FrameSettings& settings, std::string_view name);
std::optional<double> real_setting(const FrameSettings& settings, std::string_view name);
std::optional<bool> flag_setting(const FrameSettings& settings, std::string_view name);

std::string method_names();                          // "path, vpl or ao"
std::string describe_range(const Setting& setting);  // "1 to 64"
std::string settings_help();                         // every setting on a line, for --help
std::string settings_page();                         // docs/reference/settings.md

}  // namespace gleaner::coordinator
