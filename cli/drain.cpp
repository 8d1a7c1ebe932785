// `gleaner drain`: a worker ends when it has finished what it holds.

#include <CLI/CLI.hpp>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"

namespace gleaner::cli {

void add_drain(CLI::App& app, Run& run) {
  struct Words {
    std::string coordinator, worker;
  };
  auto words = std::make_shared<Words>();
  CLI::App* command = app.add_subcommand("drain", "Let a worker finish what it holds, and end: it gets nothing more");
  command->add_option("WORKER", words->worker, "as `gleaner workers` names it")->required();
  add_coordinator_option(*command, words->coordinator);
  command->callback([words, &run] {
    run = [words] {
      Client(words->coordinator).drain(words->worker);
      return 0;
    };
  });
}

}  // namespace gleaner::cli
