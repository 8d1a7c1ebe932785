// `gleaner`: the command that people type.

#include <CLI/CLI.hpp>
#include <string_view>
#include <vector>

#include "cli/commands.h"
#include "cli/kernel_compiler.h"
#include "cli/present_commands.h"
#include "cli/program.h"
#include "gleaner/version.h"
#include "worker/device/device.h"

namespace {

bool is_host_and_port(std::string_view word) {
  const std::size_t colon = word.rfind(':');
  return colon != std::string_view::npos && colon + 1 < word.size() &&
         word.find_first_not_of("0123456789", colon + 1) == std::string_view::npos;
}

// "--denoise fast" as "--denoise=fast", and "--web HOST:PORT" likewise: the word may be missing, and then what follows
// may be the scene's name.
std::vector<std::string> with_joined_words(int argc, char** argv) {
  std::vector<std::string> words;
  for (int i = 0; i < argc; ++i) {
    const std::string_view word(argv[i]);
    const std::string_view before = words.empty() ? std::string_view() : words.back();
    const bool joins = (before == "--denoise" && (word == "off" || word == "fast" || word == "high")) ||
                       (before == "--web" && is_host_and_port(word));
    if (joins)
      words.back() += "=" + std::string(word);
    else
      words.emplace_back(word);
  }
  return words;
}

}  // namespace

int main(int argc, char** argv) {
  if (gleaner::cli::served_as_kernel_compiler(argc, argv)) return 0;
  gleaner::cli::silence_grpc();
  gleaner::worker::prepare_environment();
  CLI::App app{"Gleaner: a render farm that splits one frame", "gleaner"};
  app.require_subcommand(1);
  app.set_version_flag("--version", std::string("gleaner ") + gleaner::version);
  gleaner::cli::Run run;
#define GLEANER_ADD(command) gleaner::cli::add_##command(app, run);
  GLEANER_COMMANDS(GLEANER_ADD)
#undef GLEANER_ADD
  std::vector<std::string> words = with_joined_words(argc, argv);
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  return gleaner::cli::run_program(app, static_cast<int>(arguments.size()), arguments.data(), [&] { return run(); });
}
