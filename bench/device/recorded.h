#pragma once
// Batches with the answers that one device gave, in files, for other devices to be checked against.

#include <filesystem>
#include <string>
#include <vector>

#include "worker/wavefront/stage_task.h"

namespace gleaner::bench {

struct RecordedBatch {
  std::string name;  // scene, method and stage
  worker::StageTask task;
  std::uint64_t first = 0, count = 0;
  scene::Bytes records;
};

// Throw Error::failed where a file cannot be written or read, Error::bad_input for bytes that are no recorded batch.
void write_batch(const RecordedBatch& batch, const std::filesystem::path& file);
RecordedBatch read_batch(const std::filesystem::path& file);

void write_file(const std::filesystem::path& file, const scene::Bytes& bytes);
scene::Bytes read_file(const std::filesystem::path& file);
// Files of the folder that end with `extension`, by name.
std::vector<std::filesystem::path> files_of(const std::filesystem::path& folder, const std::string& extension);

}  // namespace gleaner::bench
