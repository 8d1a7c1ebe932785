// Writes what bench_device checks a device against: scenes, and the answers of an OpenCL device of this machine (PoCL)
// that traces in OpenCL.
//
//   bench_device_record FOLDER

#include <cstdio>
#include <cstring>

#include "bench/device/rays.h"
#include "bench/device/recorded.h"
#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/blob.h"

namespace gleaner::bench {
namespace {

constexpr std::uint32_t kRays = 1u << 16;

struct RecordedScene {
  const char* name;
  std::map<std::string, std::string> parameters;
  std::uint32_t side;  // of the pictures, pixels
  std::vector<const char*> methods = {"path", "vpl"};
};

const RecordedScene kScenes[] = {
    {"cornell-box", {}, 64, {"path", "vpl", "ao", "links", "splat"}},
    {"cornell-glass", {}, 64, {"path", "vpl", "photon"}},
    {"cornell-glossy", {}, 64},
    {"cornell-textured", {}, 64},
    {"punctual-lights", {}, 64},
    {"hall", {{"triangles", "50000"}}, 64},
};

void record_rays(const worker::Device& device, const scene::Scene& scene, const scene::Bvh& bvh,
                 const std::filesystem::path& file, RayKind kind) {
  const std::vector<RayAnswer> answers = trace_rays(device, scene, bvh, kind, kRays);
  scene::Bytes bytes(answers.size() * sizeof(RayAnswer));
  std::memcpy(bytes.data(), answers.data(), bytes.size());
  write_file(file, bytes);
}

// One batch of each kind of stage that the frame has: of a split stage its first tiles.
void record_frame(worker::Executor& executor, const std::string& name, const scene::Scene& scene,
                  const std::string& method, std::uint32_t side, const std::filesystem::path& folder) {
  coordinator::FrameSettings settings;
  settings.method = method;
  settings.width = settings.height = side;
  settings.spp = 16;
  settings.camera = scene.cameras.front().camera;
  settings.camera.half_width = settings.camera.half_height;
  // Small counts: the answers of all stages must fit into a folder.
  settings.set = {{"vpl.count", "1000"},     {"vpl.clusters", "256"},     {"vpl.point_clusters", "256"},
                  {"photon.count", "4096"},  {"photon.caustics", "4096"}, {"photon.passes", "1"},
                  {"links.vertices", "500"}, {"links.directions", "64"},  {"splat.gather_rays", "128"}};
  auto plan = coordinator::make_plan(settings, coordinator::summarize(scene));
  std::map<std::string, RecordedBatch> batches;
  cli::run_frame(
      *plan, executor, name,
      [&](const coordinator::StageSpec& stage, const worker::StageTask& task) {
        // A stage of direct light within `vpl` is of kind path; the first of each kind is enough.
        batches.try_emplace(stage.kind,
                            RecordedBatch{name + "." + method + "." + stage.name, task, 0, stage.items, {}});
        return true;
      },
      [&](const coordinator::StageSpec& stage, const worker::BatchResult& result) {
        RecordedBatch& batch = batches.at(stage.kind);
        if (batch.records.empty() && batch.name.ends_with("." + stage.name)) batch.records = result.records;
      });
  for (const auto& [kind, batch] : batches) write_batch(batch, folder / (name + "." + method + "." + kind + ".batch"));
}

void record(const std::filesystem::path& folder) {
  for (const char* part : {"scenes", "rays", "batches"}) std::filesystem::create_directories(folder / part);
  const worker::DeviceChoice choice{.device = -1, .threads = 0, .trace = worker::TraceKind::opencl};
  const worker::Device device(choice);
  worker::Executor executor(choice);
  for (const RecordedScene& one : kScenes) {
    const std::string name = one.name;
    const auto scene = std::make_shared<scene::Scene>(scene::make_scene(name, one.parameters));
    const auto bvh = std::make_shared<scene::Bvh>(scene::build_bvh(*scene));
    write_file(folder / "scenes" / (name + ".scene"), scene::serialize(*scene));
    write_file(folder / "scenes" / (name + ".bvh"), scene::serialize(*bvh));
    record_rays(device, *scene, *bvh, folder / "rays" / (name + ".camera"), RayKind::camera);
    record_rays(device, *scene, *bvh, folder / "rays" / (name + ".scattered"), RayKind::scattered);
    executor.load_scene(name, scene, bvh);
    for (const char* method : one.methods) record_frame(executor, name, *scene, method, one.side, folder / "batches");
    std::printf("%s: recorded on %s, %s\n", one.name, device.info().name.c_str(), device.info().driver.c_str());
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace gleaner::bench

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: bench_device_record FOLDER\n");
    return 2;
  }
  try {
    gleaner::bench::record(argv[1]);
    return 0;
  } catch (const gleaner::Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return static_cast<int>(error.kind());
  } catch (const cl::Error& error) {
    std::fprintf(stderr, "%s\n", gleaner::worker::describe(error).c_str());
    return 1;
  }
}
