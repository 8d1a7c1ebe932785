#pragma once
// One function a command, each in a file of its own: it adds the command's words to the parser, and `run` is set to
// what the command does where it was the one called. The run function returns the exit status; errors are thrown
// (gleaner::Error).

#include <functional>

namespace CLI {
class App;
}

namespace gleaner::cli {

using Run = std::function<int()>;

void add_render(CLI::App& app, Run& run);
void add_submit(CLI::App& app, Run& run);
void add_session(CLI::App& app, Run& run);
void add_watch(CLI::App& app, Run& run);
void add_events(CLI::App& app, Run& run);
void add_fetch(CLI::App& app, Run& run);
void add_show(CLI::App& app, Run& run);
void add_list(CLI::App& app, Run& run);
void add_cancel(CLI::App& app, Run& run);
void add_pause(CLI::App& app, Run& run);
void add_resume(CLI::App& app, Run& run);
void add_retry(CLI::App& app, Run& run);
void add_drain(CLI::App& app, Run& run);
void add_workers(CLI::App& app, Run& run);
void add_why(CLI::App& app, Run& run);
void add_replay(CLI::App& app, Run& run);
void add_explain(CLI::App& app, Run& run);
void add_methods(CLI::App& app, Run& run);
void add_info(CLI::App& app, Run& run);
void add_compare(CLI::App& app, Run& run);
void add_scene(CLI::App& app, Run& run);
void add_devices(CLI::App& app, Run& run);
void add_keys(CLI::App& app, Run& run);

}  // namespace gleaner::cli
