#pragma once
// Brings a job's files: `gleaner fetch`, and the end of `gleaner submit --wait`.

#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace gleaner::cli {

struct FetchOptions {
  std::string coordinator, job, folder;
  std::string pattern;    // of the names, without their endings: a run of # is the frame's number; empty: the farm's
  bool force = false;     // writes over files that are there
  bool only_new = false;  // leaves these, and does not bring them
  bool quiet = false;
};

void add_fetch_options(CLI::App& command, FetchOptions& options);

// Throws Error::usage for a pattern that is none, Error::failed for a file that is there, where neither `force` nor
// `only_new` says what to do. `names`: as the farm has them.
void refuse_to_overwrite(const FetchOptions& options, const std::vector<std::string>& names);

// Brings what there is; then throws Error::failed where the job failed or was cancelled.
int fetch_files(const FetchOptions& options);

}  // namespace gleaner::cli
