#pragma once
// What the programs' mains share: errors are shown once, and say how the program ends.

#include <functional>
#include <string>

namespace CLI {
class App;
}

namespace gleaner::cli {

// Parses, calls what `run` was set to, and returns the exit status: 0 done, 1 failed, 2 usage, 3 bad input, 4 no
// connection.
int run_program(CLI::App& app, int argc, char** argv, const std::function<int()>& run);

// --keys FOLDER, which becomes $GLEANER_KEYS.
void add_keys_option(CLI::App& command);

// gRPC prints its own account of every connection that fails; ours is the one that people should read. Before any
// thread starts.
void silence_grpc();

}  // namespace gleaner::cli
