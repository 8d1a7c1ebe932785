#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/commands.h"
#include "scene/library/library.h"
#include "scene/model/error.h"

namespace gleaner::cli {
namespace {

struct SceneWords {
  std::string name, output;
  std::vector<std::string> settings;
  bool list = false, json = false;
};

void print_list(bool json) {
  if (json) {
    nlohmann::ordered_json entries = nlohmann::ordered_json::array();
    for (const scene::LibraryEntry& entry : scene::library()) {
      nlohmann::ordered_json parameters = nlohmann::ordered_json::object();
      for (const auto& [name, value] : entry.parameters)
        parameters[name] = {{"default", std::stod(value)}, {"range", entry.ranges.at(name)}};
      entries.push_back({{"name", entry.name}, {"description", entry.description}, {"parameters", parameters}});
    }
    std::cout << entries.dump(2) << '\n';
    return;
  }
  for (const scene::LibraryEntry& entry : scene::library()) {
    std::cout << fmt::format("{:<22} {}\n", entry.name, entry.description);
    for (const auto& [name, value] : entry.parameters)
      std::cout << fmt::format("{:<22}   --set {}={}   ({})\n", "", name, value, entry.ranges.at(name));
  }
}

std::map<std::string, std::string> parse_settings(const std::vector<std::string>& settings) {
  std::map<std::string, std::string> parameters;
  for (const std::string& setting : settings) {
    const std::size_t equals = setting.find('=');
    if (equals == std::string::npos || equals == 0)
      throw Error::usage(fmt::format("--set expects KEY=VALUE, found '{}'", setting));
    parameters[setting.substr(0, equals)] = setting.substr(equals + 1);
  }
  return parameters;
}

int write_scene(const SceneWords& words) {
  if (words.list) {
    print_list(words.json);
    return 0;
  }
  if (words.name.empty()) throw Error::usage("gleaner scene expects a NAME, or --list");
  if (words.output.empty()) throw Error::usage("gleaner scene expects -o FILE.glb");
  if (std::filesystem::path(words.output).extension() != ".glb")
    throw Error::usage(fmt::format("-o expects a name that ends in .glb, found '{}'", words.output));
  const scene::AnimatedScene animated = scene::make_animated_scene(words.name, parse_settings(words.settings));
  const scene::Scene& made = animated.scene;
  scene::write_glb(animated, words.output);
  std::cerr << fmt::format("{}: {} triangles, {} camera{}\n", words.output, made.triangle_count(), made.cameras.size(),
                           made.cameras.size() == 1 ? "" : "s");
  if (!made.environment.empty())
    std::cerr << fmt::format("{0}: the scene's light, which glTF cannot hold; render with --environment {0}\n",
                             scene::environment_path(words.output));
  return 0;
}

}  // namespace

void add_scene(CLI::App& app, Run& run) {
  CLI::App* command = app.add_subcommand("scene", "write a scene of the procedural library as binary glTF");
  const auto words = std::make_shared<SceneWords>();
  command->add_option("NAME", words->name, "the scene (see --list)");
  command->add_option("-o,--output", words->output, "the file to write, *.glb");
  command->add_option("--set", words->settings, "KEY=VALUE: a parameter of the scene")
      ->take_all()
      ->allow_extra_args(false);
  command->add_flag("--list", words->list, "print the scenes and their parameters");
  command->add_flag("--json", words->json, "with --list: one JSON array on standard output");
  command->callback([words, &run] { run = [words] { return write_scene(*words); }; });
}

}  // namespace gleaner::cli
