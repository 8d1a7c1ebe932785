// `gleaner fetch`: the files of a job's finished frames.

#include "cli/fetch.h"

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/status_words.h"
#include "coordinator/jobs/frame_name.h"
#include "scene/import/sequence.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace fs = std::filesystem;

namespace {

// Under another name until it is whole.
void fetch_file(Client& client, const std::string& job, const std::string& name, const fs::path& target) {
  fs::path partial = target.string() + ".part";
  struct Leftover {
    fs::path path;
    ~Leftover() {
      std::error_code code;
      fs::remove(path, code);
    }
  } leftover{partial};
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  if (!file) throw Error::failed(partial.string() + ": cannot write");
  client.fetch_file(job, name, [&](const std::string& piece) {
    file.write(piece.data(), static_cast<std::streamsize>(piece.size()));
  });
  file.close();
  if (!file) throw Error::failed(partial.string() + ": cannot write (is the disk full?)");
  std::error_code code;
  fs::rename(partial, target, code);
  if (code) throw Error::failed(target.string() + ": " + code.message());
}

// Where the farm's file "frame_0007.exr" goes.
fs::path target_of(const FetchOptions& options, const std::string& name) {
  const fs::path file(name);
  const auto frame = coordinator::frame_of_stem(file.stem().string());
  if (options.pattern.empty() || !frame) return fs::path(options.folder) / file;
  return fs::path(options.folder) / (scene::file_of_frame(options.pattern, *frame) + file.extension().string());
}

// A name is a name, whatever the coordinator says.
std::string checked_name(const std::string& name) {
  if (fs::path(name).filename() != name || name == ".." || name == ".")
    throw Error::failed("the coordinator names a file \"" + name + "\"");
  return name;
}

bool is_there(const fs::path& path) {
  std::error_code code;
  return fs::exists(fs::symlink_status(path, code));
}

}  // namespace

void add_fetch_options(CLI::App& command, FetchOptions& options) {
  command.add_option("-o,--output", options.folder, "folder of the files; made where it is not there");
  command.add_option("--pattern", options.pattern,
                     "names of the files, without their endings: the frame's number stands for a run of #, as in "
                     "shot_#### (default: frame_####)");
  CLI::Option* force = command.add_flag("--force", options.force, "write over files that are there");
  command.add_flag("--new", options.only_new, "leave files that are there, and bring the others")->excludes(force);
}

void refuse_to_overwrite(const FetchOptions& options, const std::vector<std::string>& names) {
  if (!options.pattern.empty() &&
      (options.pattern.find('/') != std::string::npos || options.pattern.find('#') == std::string::npos))
    throw Error::usage("--pattern: expected a name with a run of #, and no folder, found \"" + options.pattern + "\"");
  if (options.force || options.only_new) return;
  for (const std::string& name : names)
    if (const fs::path target = target_of(options, name); is_there(target))
      throw Error::failed(target.string() +
                          ": is there already; --force writes over it, --new brings only what is not there");
}

int fetch_files(const FetchOptions& options) {
  refuse_to_overwrite(options, {});
  Client client(options.coordinator);
  const coordinator::JobStatus status = client.show(options.job);
  if (status.frames_done == 0) {
    require_done(status);
    throw Error::failed("job " + status.id + " is " + job_state_name(status.state) +
                        ", and none of its frames is finished; `gleaner watch " + status.id + "` ends with it");
  }
  std::vector<std::string> names;
  for (const auto& file : client.files(options.job)) names.push_back(checked_name(file.name()));
  refuse_to_overwrite(options, names);
  std::error_code code;
  fs::create_directories(options.folder, code);
  if (code) throw Error::failed(options.folder + ": cannot make the folder: " + code.message());
  for (const std::string& name : names) {
    const fs::path target = target_of(options, name);
    if (options.only_new && is_there(target)) continue;
    fetch_file(client, options.job, name, target);
    if (!options.quiet) std::cerr << "gleaner: wrote " << target.string() << "\n";
  }
  require_done(status);  // what there is has been fetched
  if (!ended(status.state) && !options.quiet)
    std::cerr << "gleaner: job " << status.id << " is " << job_state_name(status.state) << ": frames "
              << written_frames(status) << " of " << status.frames << " are finished\n";
  return 0;
}

void add_fetch(CLI::App& app, Run& run) {
  auto options = std::make_shared<FetchOptions>();
  CLI::App* command = app.add_subcommand("fetch", "Bring EXR, PNG and report of the frames that are finished");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  add_fetch_options(*command, *options);
  command->get_option("--output")->required();
  command->add_flag("--quiet", options->quiet, "no remarks");
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return fetch_files(*options); }; });
}

}  // namespace gleaner::cli
