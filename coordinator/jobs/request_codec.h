#pragma once
// A job's request as the journal keeps it. Fields that an older version did not write get their usual values.

#include <span>

#include "coordinator/jobs/job.h"

namespace gleaner::coordinator {

// All but scenes and cameras of the frames.
Bytes encode_request(const JobRequest& request);
// The scenes and the cameras.
Bytes encode_frames(const JobRequest& request);

// Throw Error::failed, saying what is wrong with the bytes.
JobRequest decode_request(std::span<const std::byte> bytes);
void decode_frames(std::span<const std::byte> bytes, JobRequest& request);

}  // namespace gleaner::coordinator
