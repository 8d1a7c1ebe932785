#pragma once
// A worker as the farm sees it: what it said of itself, what it is told, what its batches cost.

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "coordinator/artifacts/artifact_data.h"
#include "coordinator/artifacts/relay.h"
#include "coordinator/plan/plan.h"
#include "coordinator/schedule/scheduler.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

struct DeviceDescription {
  std::string name, platform, driver, version, tracer;
  std::string denoiser{};  // version of Open Image Denoise; empty: it cannot denoise
  bool cpu = false;
  std::uint32_t compute_units = 0, threads = 0;
  std::uint64_t memory_bytes = 0;
};

struct WorkerHello {
  std::string name;     // wish; numbered where it is taken
  std::string address;  // as the gateway sees it
  DeviceDescription device;
  bool needs_bvh = false;
  std::string peer_address{};  // HOST:PORT at which other workers fetch the parts that it holds; empty: they cannot
  std::string token{};         // secret of this connection (worker.proto); empty: it can neither hold nor fetch parts
};

// What it took a worker to show a scene's base in a frame's state (worker.proto).
struct ShownFrame {
  double load_seconds = 0, pose_seconds = 0, table_seconds = 0;
  std::uint64_t written_bytes = 0;
  double refit_seconds = 0, rebuild_seconds = 0, top_level_seconds = 0;
  std::uint32_t refitted = 0, rebuilt = 0;
  double most_growth = 0;
};

// What a batch cost, as its worker says. Seconds are wall time there.
struct BatchCost {
  double seconds = 0, trace_seconds = 0, kernel_seconds = 0;
  std::uint64_t camera_rays = 0, scatter_rays = 0, shadow_rays = 0;
  std::uint64_t nonfinite = 0;
  std::vector<std::uint64_t> nonfinite_items;  // the first few
  std::uint64_t fetched_bytes = 0;             // blobs that the worker fetched for this batch
  std::uint64_t peer_bytes = 0;                // parts that it fetched from other workers, not through the coordinator
  std::optional<ShownFrame> shown{};           // where the worker showed another frame before
};

// What a worker answers to a lease.
struct BatchOutput {
  // Collected: of a counted output the counts (4 bytes an item), then the records. Retained: empty.
  scene::Bytes image;
  struct Retained {
    std::uint64_t bytes = 0, records = 0;  // of the image that the worker keeps
    std::string digest;                    // 32 bytes
    // As the worker says: what of its part is to be dropped where the lease is over.
    ArtifactId artifact{};
    ItemRange items{};
  };
  std::optional<Retained> part{};
  scene::Bytes facts{};          // solo stages
  std::uint64_t sent_bytes = 0;  // of the image, as they travelled; 0: it was not packed
};

// All that a worker must know of a stage: the same for each of its leases.
struct StageWork {
  struct Input {
    std::string name;
    std::string blob;  // id of the artifact
    bool own_items = false;
    std::shared_ptr<const ArtifactData> data{};  // null: retained, its parts lie with workers
    bool counted = false;
    std::uint32_t record_bytes = 0;  // 0: bytes of the plan's own that are read whole
    std::uint64_t items = 0;         // as above
  };
  std::string job, stage, kind;
  scene::Bytes parameters;
  std::vector<Input> inputs;
  std::string artifact;  // id of what the stage makes
  StageOutput output;
  std::string scene_blob, bvh_blob, state_blob;  // ids; see FrameScene
  bool at_rest = false;                          // the scene is the base of a frame's state, and is shown without it
};

// The farm's way to one worker. Calls come with the farm locked: they queue what is to be said and return.
class WorkerSession {
 public:
  virtual ~WorkerSession() = default;
  virtual void welcome(const std::string& name) = 0;  // first of all
  virtual void lease(const Lease& lease, std::shared_ptr<const StageWork> work) = 0;
  virtual void revoke(const Lease& lease) = 0;
  virtual void drain() = 0;
  // Parts of these artifacts that the worker holds are no longer needed.
  virtual void release(const std::vector<ArtifactId>& artifacts) = 0;
  // This version of this part is not.
  virtual void drop_part(const ArtifactId& artifact, std::uint64_t first, const std::string& digest) = 0;
  // Somebody waits for these bytes of a part that the worker holds: it is to answer under this number.
  virtual void send_part(std::uint64_t request, const PartRange& range) = 0;
  // The farm has given the worker up: nothing more is said, nothing more is heard.
  virtual void close(const std::string& reason) = 0;
};

}  // namespace gleaner::coordinator
