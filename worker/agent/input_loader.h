#pragma once
// What a lease reads, brought to where its stage program can read it.

#include <memory>
#include <string>
#include <vector>

#include "gleaner/v1/worker.pb.h"
#include "worker/agent/blob_client.h"
#include "worker/agent/part_client.h"
#include "worker/artifacts/artifact.h"
#include "worker/artifacts/byte_cache.h"

namespace gleaner::worker {

// Inputs of up to half the cache's bound are fetched before the batch runs, whole ones to be kept in the cache; larger
// ones are read in ranges while it runs.
class InputLoader {
 public:
  InputLoader(BlobClient& blobs, PartClient& parts, std::shared_ptr<ByteCache> cache)
      : blobs_(blobs), parts_(parts), cache_(std::move(cache)) {}

  // Throws Error::connection where it cannot be had at the moment, Error::failed where the coordinator refuses it or
  // says things that do not fit together. Reading the result may throw the same.
  TaskInput load(const gleaner::v1::StageInput& input, const gleaner::v1::Lease& lease);
  // A blob that is named by its bytes. It is not kept.
  std::shared_ptr<const scene::Bytes> blob(const std::string& id);

 private:
  TaskInput load_from_coordinator(const gleaner::v1::StageInput& input, const gleaner::v1::Lease& lease);
  TaskInput load_parts(const gleaner::v1::StageInput& input, const gleaner::v1::Lease& lease);
  // Reads the source into memory where it is small enough.
  void settle(TaskInput& input, const std::string& keep_as);

  BlobClient& blobs_;
  PartClient& parts_;
  std::shared_ptr<ByteCache> cache_;
};

}  // namespace gleaner::worker
