// `gleaner fetch`: the files of a job's finished frames.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/status_words.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace fs = std::filesystem;

namespace {

struct FetchOptions {
  std::string coordinator, job, folder;
  bool quiet = false;
};

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

int fetch(const FetchOptions& options) {
  Client client(options.coordinator);
  const coordinator::JobStatus status = client.show(options.job);
  if (status.frames_done == 0) {
    require_done(status);
    throw Error::failed("job " + status.id + " is " + job_state_name(status.state) +
                        ", and none of its frames is finished; `gleaner watch " + status.id + "` ends with it");
  }
  std::error_code code;
  fs::create_directories(options.folder, code);
  if (code) throw Error::failed(options.folder + ": cannot make the folder: " + code.message());
  for (const auto& file : client.files(options.job)) {
    // A name is a name, whatever the coordinator says.
    if (fs::path(file.name()).filename() != file.name() || file.name() == ".." || file.name() == ".")
      throw Error::failed("the coordinator names a file \"" + file.name() + "\"");
    fs::path target = fs::path(options.folder) / file.name();
    fetch_file(client, options.job, file.name(), target);
    if (!options.quiet) std::cerr << "gleaner: wrote " << target.string() << "\n";
  }
  require_done(status);  // what there is has been fetched
  if (!ended(status.state) && !options.quiet)
    std::cerr << "gleaner: job " << status.id << " is running: frames " << written_frames(status) << " of "
              << status.frames << " are finished\n";
  return 0;
}

}  // namespace

void add_fetch(CLI::App& app, Run& run) {
  auto options = std::make_shared<FetchOptions>();
  CLI::App* command = app.add_subcommand("fetch", "Bring EXR, PNG and report of the frames that are finished");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  command->add_option("-o,--output", options->folder, "folder; made where it is not there")->required();
  command->add_flag("--quiet", options->quiet, "no remarks");
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return fetch(*options); }; });
}

}  // namespace gleaner::cli
