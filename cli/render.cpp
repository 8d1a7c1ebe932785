// `gleaner render`: one frame (or a few) with a farm of this process's own.

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <future>
#include <iostream>
#include <memory>
#include <optional>
#include <string>

#include "cli/commands.h"
#include "cli/embedded.h"
#include "cli/frame_options.h"
#include "cli/kernel_compiler.h"
#include "cli/progress.h"
#include "cli/signals.h"
#include "scene/bvh/build.h"
#include "scene/import/sequence.h"
#include "scene/model/error.h"
#include "scene/model/names.h"
#include "worker/denoise/denoiser.h"

namespace gleaner::cli {

namespace fs = std::filesystem;
using coordinator::FramePaths;
using coordinator::JobState;
using coordinator::JobStatus;

namespace {

constexpr coordinator::Seconds grace = 5;  // for a plan that computes when the frame is cancelled

struct RenderOptions {
  FrameOptions frame;
  std::string output, report, trace = "auto";
  unsigned workers = 1;
  int device = -1;
  std::uint64_t batch_items = 0;
};

// OUT.exr, or OUT_0007.exr where frames are numbered; OUT.####.exr says where the number goes.
fs::path numbered(const fs::path& path, bool number, std::uint32_t frame) {
  if (!number || path.empty()) return path;
  if (const std::string name = path.filename().string(); name.find('#') != std::string::npos)
    return path.parent_path() / scene::file_of_frame(name, frame);
  char text[16];
  std::snprintf(text, sizeof text, "_%04u", frame);
  return path.parent_path() / (path.stem().string() + text + path.extension().string());
}

void check_folder(const fs::path& file) {
  if (file.empty()) return;
  fs::path folder = file.parent_path().empty() ? fs::path(".") : file.parent_path();
  std::error_code code;
  if (!fs::is_directory(folder, code)) throw Error::failed(file.string() + ": there is no folder " + folder.string());
  if (::access(folder.c_str(), W_OK) != 0)
    throw Error::failed(file.string() + ": cannot write into " + folder.string());
  if (fs::is_directory(file, code)) throw Error::failed(file.string() + ": is a folder");
}

// A scene's blobs in the embedded farm's store, until they are needed no more.
class LentScene {
 public:
  LentScene(EmbeddedFarm& embedded, scene::Scene scene) {
    blobs_.summary = coordinator::summarize(scene);
    scene_ = std::make_shared<const scene::Bytes>(scene::serialize(scene));
    blobs_.scene_blob = embedded.blobs().lend(scene_);
    if (!embedded.needs_bvh()) return;
    bvh_ = std::make_shared<const scene::Bytes>(scene::serialize(scene::build_bvh(scene)));
    blobs_.bvh_blob = embedded.blobs().lend(bvh_);
  }
  const coordinator::FrameScene& blobs() const { return blobs_; }

 private:
  coordinator::FrameScene blobs_;
  coordinator::Blob scene_, bvh_;
};

std::string cancelled(std::uint64_t written) {
  return written == 0 ? "cancelled; nothing was written"
                      : "cancelled; " + std::to_string(written) + (written == 1 ? " frame was" : " frames were") +
                            " written before";
}

// Submits a job and waits for its end. Throws Error::failed where it was cancelled or has failed. `written_before`:
// frames, by other jobs.
void render_job(coordinator::Farm& farm, const coordinator::JobRequest& request, Signals& signals, bool quiet,
                std::uint64_t written_before = 0) {
  const std::string job = farm.submit(request);
  signals.watch([&] { farm.cancel(job); });

  ProgressDisplay progress(quiet);
  JobStatus status;
  do {
    // Often enough for a bar; the job's end is told at once.
    status = *farm.wait(job, ~std::uint64_t{0}, 0.1);
    progress.show(status);
  } while (!ended(status.state));
  progress.clear();
  signals.watch({});
  const std::uint64_t written = written_before + status.frames_done;
  if (status.state == JobState::cancelled && !farm.end(grace)) {
    std::cerr << "gleaner: error: " << cancelled(written) << "\n";
    std::_Exit(static_cast<int>(ErrorKind::failed));  // a plan still computes, with what main's end would destroy
  }
  if (status.state == JobState::cancelled) throw Error::failed(cancelled(written));
  if (!quiet)
    for (const fs::path& file : farm.files(job)) std::cerr << "gleaner: wrote " << file.string() << "\n";
  if (status.state == JobState::failed) throw Error::failed(status.message);
  if (!status.message.empty()) std::cerr << "gleaner: warning: " << status.message << "\n";
  if (!quiet) std::fprintf(stderr, "gleaner: %.2f s\n", status.seconds);
}

// One job: a base, and a state of it a frame.
void render_states(EmbeddedFarm& embedded, scene::Scene base, const std::vector<FrameLook>& looks,
                   coordinator::JobRequest& request, Signals& signals, bool quiet) {
  const LentScene lent(embedded, std::move(base));
  std::vector<coordinator::Blob> states;  // as long as they are lent
  for (const FrameLook& look : looks) {
    coordinator::FrameScene& shown = request.scenes.emplace_back(lent.blobs());
    request.cameras.push_back(look.camera);
    if (look.state->empty()) continue;
    states.push_back(std::make_shared<const scene::Bytes>(scene::serialize(*look.state)));
    shown.state_blob = embedded.blobs().lend(states.back());
  }
  render_job(embedded.farm(), request, signals, quiet);
}

// A job a frame: no more than one scene is in memory. A frame that fails does not end the others; when all have had
// their turn, throws an error of the first failure's kind.
void render_own_scenes(EmbeddedFarm& embedded, const LoadedFrame& frame, const std::vector<FrameLook>& looks,
                       coordinator::JobRequest& request, Signals& signals, bool quiet) {
  std::optional<Error> first;
  std::uint32_t failed = 0;
  for (std::uint32_t i = 0; i < frame.frames(); ++i) {
    request.first_frame = request.last_frame = frame.number(i);
    request.numbers.clear();
    request.settings.camera = looks[i].camera;
    try {
      const LentScene lent(embedded, frame.moving->scene_at(looks[i].seconds));
      request.scenes = {lent.blobs()};
      render_job(embedded.farm(), request, signals, quiet, i - failed);
    } catch (const Error& error) {
      if (signals.raised()) throw;
      const std::string words = "frame " + std::to_string(frame.number(i)) + ": " + error.what();
      if (++failed == 1) first.emplace(error.kind(), words);
      std::cerr << "gleaner: warning: " << printable_lines(words) << "\n";
    }
  }
  if (first)
    throw Error(first->kind(), std::to_string(failed) + " of " + std::to_string(frame.frames()) +
                                   " frames failed; first " + first->what());
}

int render(const RenderOptions& options) {
  if (fs::path(options.output).extension() != ".exr")
    throw Error::usage("-o: expected a name that ends in .exr, found \"" + options.output + "\"");
  if (fs::path(options.output).stem().empty()) throw Error::usage("-o: expected a name before .exr");
  check_folder(options.output);
  check_folder(options.report);
  EmbeddedSettings settings;
  settings.workers = options.workers;
  settings.device.device = options.device;
  settings.device.trace = worker::parse_trace_kind(options.trace);
  settings.device.compiler = kernel_compiler();
  settings.batch_items = options.batch_items;

  // Before the scene is rendered, not after.
  if (coordinator::parse_denoise(options.frame.denoise) != coordinator::Denoise::off) worker::denoiser_version();

  Signals signals;
  bool number = false;
  settings.paths = [&](const std::string&, std::uint32_t at) {
    FramePaths paths;
    paths.exr = numbered(options.output, number, at);
    paths.png = fs::path(paths.exr).replace_extension(".png");
    paths.report = numbered(options.report, number, at);
    return paths;
  };
  // Devices take their time to open, and so does a scene.
  auto opening = std::async(std::launch::async, [&] { return std::make_unique<EmbeddedFarm>(settings); });
  LoadedFrame frame = load_frame(options.frame);
  number = frame.numbered;
  coordinator::JobRequest request;
  request.scene_name = frame.scene_name;
  request.camera_name = frame.camera_name;
  request.settings = frame.settings;
  request.first_frame = frame.frame_numbers.first;
  request.last_frame = frame.frame_numbers.last;
  request.frame_step = frame.frame_numbers.step;
  request.numbers = frame.frame_numbers.list;
  request.cameras = frame.cameras;
  request.exposure_stops = options.frame.exposure_stops;
  request.time_limit = options.frame.time_limit;
  coordinator::check_settings(request.settings, coordinator::summarize(frame.scene));

  const std::unique_ptr<EmbeddedFarm> farm = opening.get();
  EmbeddedFarm& embedded = *farm;
  if (!frame.moving) {
    const LentScene lent(embedded, std::exchange(frame.scene, {}));
    request.scenes = {lent.blobs()};
    render_job(embedded.farm(), request, signals, options.frame.quiet);
    return 0;
  }
  frame.scene = {};
  std::vector<FrameLook> looks;
  for (std::uint32_t i = 0; i < frame.frames(); ++i) looks.push_back(look_of(options.frame, frame, frame.number(i)));
  if (std::ranges::all_of(looks, [](const FrameLook& look) { return look.state.has_value(); }))
    render_states(embedded, std::move(frame.moving->base()), looks, request, signals, options.frame.quiet);
  else
    render_own_scenes(embedded, frame, looks, request, signals, options.frame.quiet);
  return 0;
}

}  // namespace

void add_render(CLI::App& app, Run& run) {
  auto options = std::make_shared<RenderOptions>();
  CLI::App* command = app.add_subcommand("render", "Render a scene here and now");
  add_frame_options(*command, options->frame);
  command
      ->add_option("-o,--output", options->output, "OUT.exr, or OUT.####.exr with --frames; a PNG is written beside it")
      ->required();
  command->add_option("--workers", options->workers, "workers of the embedded farm")
      ->capture_default_str()
      ->check(CLI::Range(1u, 256u));
  command->add_option("--device", options->device,
                      "OpenCL device, as `gleaner devices` counts (default: the first GPU, else the first)");
  command->add_option("--trace", options->trace, "auto, embree or opencl")->capture_default_str();
  command->add_option("--report", options->report, "REPORT.json: what the frame cost");
  command->add_option("--batch-items", options->batch_items, "every batch of this size")->group("");
  command->callback([options, &run] { run = [options] { return render(*options); }; });
}

}  // namespace gleaner::cli
