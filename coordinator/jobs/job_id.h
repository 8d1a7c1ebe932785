#pragma once
// Names of jobs.

#include <string>

namespace gleaner::coordinator {

// Sorts by the time of submission, cannot be guessed from another one, and is short enough to type.
std::string new_job_id();

}  // namespace gleaner::coordinator
