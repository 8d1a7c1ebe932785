#pragma once
// The journal in one SQLite file.

#include <filesystem>
#include <memory>

#include "coordinator/journal/journal.h"

namespace gleaner::coordinator {

// Makes the file where there is none. Throws Error::failed, naming the file and what can be done, where it cannot be
// opened, is damaged, was written by a newer version, or is locked by another process for longer than `patience`
// seconds.
std::unique_ptr<Journal> open_sqlite_journal(const std::filesystem::path& file, double patience = 5);

}  // namespace gleaner::coordinator
