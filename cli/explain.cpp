#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/commands.h"
#include "cli/frame_options.h"
#include "coordinator/plan/methods.h"
#include "coordinator/plan/plan.h"

namespace gleaner::cli {
namespace {

using nlohmann::ordered_json;

struct ExplainWords {
  FrameOptions frame;
  bool json = false;
};

// The method's settings, each with what it was given or else what it takes.
std::vector<std::pair<const coordinator::Setting*, std::string>> settings_of(const coordinator::FrameSettings& frame) {
  std::vector<std::pair<const coordinator::Setting*, std::string>> settings;
  for (const coordinator::Setting& setting : coordinator::method_of(frame.method).settings) {
    const auto given = frame.set.find(std::string(setting.name));
    settings.emplace_back(&setting,
                          given == frame.set.end() ? "default: " + std::string(setting.usual) : given->second);
  }
  return settings;
}

void print_json(const LoadedFrame& frame, const coordinator::Plan& plan) {
  ordered_json needs = ordered_json::array(), skips = ordered_json::array();
  ordered_json settings = ordered_json::object();
  for (const auto& [setting, value] : settings_of(frame.settings)) settings[std::string(setting->name)] = value;
  const std::uint32_t bits = needs_of(frame.scene).bits();
  for (std::size_t i = 0; i < scene::need_names().size(); ++i)
    if (bits >> i & 1) needs.push_back(scene::need_names()[i]);
  for (const coordinator::Skip& skip : plan.skips())
    skips.push_back({{"what", skip.what}, {"why", skip.why}, {"count", skip.count}});
  const ordered_json result = {{"scene", frame.scene_name},
                               {"method", frame.settings.method},
                               {"size", {frame.settings.width, frame.settings.height}},
                               {"camera", frame.camera_name},
                               {"needs", needs},
                               {"stages", plan.outline()},
                               {"settings", settings},
                               {"skips", skips},
                               {"parameters", ordered_json::parse(plan.parameters_json())}};
  // Names come from the file as they are; JSON must be UTF-8 all the same.
  std::cout << result.dump(2, ' ', false, ordered_json::error_handler_t::replace) << '\n';
}

void print(const LoadedFrame& frame, const coordinator::Plan& plan) {
  fmt::print("{}, {}x{} pixels, camera \"{}\", method {}\n", frame.scene_name, frame.settings.width,
             frame.settings.height, frame.camera_name, frame.settings.method);
  fmt::print("stages\n");
  for (const std::string& line : plan.outline()) fmt::print("  {}\n", line);
  const std::vector<coordinator::Skip> skips = plan.skips();
  fmt::print("left out{}\n", skips.empty() ? ": nothing" : "");
  for (const coordinator::Skip& skip : skips) fmt::print("  {}: {}\n", skip.what, skip.why);
  if (const auto settings = settings_of(frame.settings); !settings.empty()) {
    fmt::print("settings\n");
    for (const auto& [setting, value] : settings) fmt::print("  {} = {}: {}\n", setting->name, value, setting->help);
  }
  const ordered_json parameters = ordered_json::parse(plan.parameters_json());
  if (!parameters.empty()) fmt::print("parameters\n");
  for (const auto& [name, value] : parameters.items()) fmt::print("  {} = {}\n", name, value.dump());
}

int explain(const ExplainWords& words) {
  const LoadedFrame frame = load_frame(words.frame);
  const auto plan = coordinator::make_plan(frame.settings, coordinator::summarize(frame.scene));
  if (words.json)
    print_json(frame, *plan);
  else
    print(frame, *plan);
  return 0;
}

}  // namespace

void add_explain(CLI::App& app, Run& run) {
  auto* command = app.add_subcommand("explain", "the plan of a frame, what it leaves out and why; renders nothing");
  auto words = std::make_shared<ExplainWords>();
  add_frame_options(*command, words->frame);
  command->add_flag("--json", words->json, "one JSON object on standard output");
  command->callback([words, &run] { run = [words] { return explain(*words); }; });
}

}  // namespace gleaner::cli
