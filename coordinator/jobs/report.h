#pragma once
// What a frame's making cost, as tests and people outside the project read it.

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/jobs/job.h"
#include "coordinator/jobs/session.h"

namespace gleaner::coordinator {

struct StageReport {
  std::string name, kind;
  std::uint64_t items = 0, batches = 0;          // batches: those that were accepted
  double seconds = 0;                            // wall, from the first lease to the last accepted result
  double trace_seconds = 0, kernel_seconds = 0;  // summed over workers
  struct Share {
    std::uint64_t items = 0;
    double seconds = 0;  // as the worker measured
  };
  std::map<std::string, Share> workers;  // by worker id
};

struct FrameReport {
  std::string scene, camera, job;
  std::uint32_t frame = 1;
  FrameSettings settings;
  std::string plan_parameters;  // JSON object
  double seconds = 0;           // wall, from the accepted job to the written file
  double time_limit = 0;        // seconds; 0 = none
  bool time_limit_reached = false;
  double plan_seconds = 0, write_seconds = 0;  // of it: the plan's own work, and making and writing the files
  std::vector<StageReport> stages;
  std::uint64_t camera_rays = 0, scatter_rays = 0, shadow_rays = 0;
  std::uint64_t uploaded_bytes = 0, downloaded_bytes = 0;  // as seen from the coordinator: to and from workers
  std::uint64_t peer_bytes = 0;                            // from worker to worker
  std::vector<Skip> skips;
  std::vector<std::string> warnings;  // the plan's and the picture's, for people
  std::uint64_t nonfinite = 0;
  struct NonfiniteItem {
    std::string stage;
    std::uint64_t item = 0;
    std::string worker;
  };
  std::vector<NonfiniteItem> nonfinite_items;        // the first few
  std::map<std::string, DeviceDescription> devices;  // by worker id
  // By worker id, in order: a base shown in the frame's state. Where a worker went back and forth between frames, once
  // for each time.
  std::vector<std::pair<std::string, ShownFrame>> motion;
  std::string pixels_sha256;
};

std::string report_json(const FrameReport& report);
// The same figures as EXR attributes, and the whole JSON under "gleaner.report".
std::map<std::string, std::string> report_metadata(const FrameReport& report);

}  // namespace gleaner::coordinator
