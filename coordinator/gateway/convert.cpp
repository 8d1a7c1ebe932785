#include "coordinator/gateway/convert.h"

#include <algorithm>
#include <cmath>
#include <new>

#include "coordinator/jobs/farm.h"
#include "proto/sha256.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;

namespace {

void set(pb::Vector3* to, const float (&from)[3]) {
  to->set_x(from[0]);
  to->set_y(from[1]);
  to->set_z(from[2]);
}

void get(const pb::Vector3& from, float (&to)[3]) {
  to[0] = from.x();
  to[1] = from.y();
  to[2] = from.z();
}

bool finite(const float (&v)[3]) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

bool unit(const float (&v)[3]) {
  double length2 = double{v[0]} * v[0] + double{v[1]} * v[1] + double{v[2]} * v[2];
  return length2 > 0.999 && length2 < 1.001;
}

void require(bool condition, const char* field, const char* expected) {
  if (!condition) throw Error::bad_input("request", field, expected);
}

pb::JobState to_proto(JobState state) {
  switch (state) {
    case JobState::queued:
      return pb::JOB_STATE_QUEUED;
    case JobState::running:
      return pb::JOB_STATE_RUNNING;
    case JobState::done:
      return pb::JOB_STATE_DONE;
    case JobState::failed:
      return pb::JOB_STATE_FAILED;
    case JobState::cancelled:
      return pb::JOB_STATE_CANCELLED;
  }
  return pb::JOB_STATE_UNSPECIFIED;
}

JobState from_proto(pb::JobState state) {
  switch (state) {
    case pb::JOB_STATE_RUNNING:
      return JobState::running;
    case pb::JOB_STATE_DONE:
      return JobState::done;
    case pb::JOB_STATE_FAILED:
      return JobState::failed;
    case pb::JOB_STATE_CANCELLED:
      return JobState::cancelled;
    default:
      return JobState::queued;
  }
}

}  // namespace

pb::Camera to_proto(const scene::Camera& camera) {
  pb::Camera out;
  out.set_type(camera.type == GLEANER_CAMERA_ORTHOGRAPHIC ? pb::CAMERA_TYPE_ORTHOGRAPHIC : pb::CAMERA_TYPE_PERSPECTIVE);
  set(out.mutable_origin(), camera.origin);
  set(out.mutable_right(), camera.right);
  set(out.mutable_up(), camera.up);
  set(out.mutable_forward(), camera.forward);
  out.set_half_width(camera.half_width);
  out.set_half_height(camera.half_height);
  return out;
}

scene::Camera from_proto(const pb::Camera& camera) {
  scene::Camera out{};
  require(camera.type() == pb::CAMERA_TYPE_PERSPECTIVE || camera.type() == pb::CAMERA_TYPE_ORTHOGRAPHIC, "camera.type",
          "perspective or orthographic");
  out.type = camera.type() == pb::CAMERA_TYPE_ORTHOGRAPHIC ? GLEANER_CAMERA_ORTHOGRAPHIC : GLEANER_CAMERA_PERSPECTIVE;
  get(camera.origin(), out.origin);
  get(camera.right(), out.right);
  get(camera.up(), out.up);
  get(camera.forward(), out.forward);
  out.half_width = camera.half_width();
  out.half_height = camera.half_height();
  require(finite(out.origin), "camera.origin", "finite coordinates");
  require(unit(out.right) && unit(out.up) && unit(out.forward), "camera", "unit axes");
  require(std::isfinite(camera.half_width()) && camera.half_width() > 0 && std::isfinite(camera.half_height()) &&
              camera.half_height() > 0,
          "camera.half_width, camera.half_height", "finite and positive");
  return out;
}

pb::FrameSettings to_proto(const FrameSettings& settings) {
  pb::FrameSettings out;
  out.set_method(settings.method);
  out.set_width(settings.width);
  out.set_height(settings.height);
  out.set_samples_per_pixel(settings.spp);
  out.set_depth(settings.depth);
  out.set_seed(settings.seed);
  out.set_target_error(settings.target_error);
  out.set_denoise(word_of(settings.denoise));
  for (const auto& [key, value] : settings.set) (*out.mutable_set())[key] = value;
  *out.mutable_camera() = to_proto(settings.camera);
  return out;
}

FrameSettings from_proto(const pb::FrameSettings& in) {
  FrameSettings out;
  require(in.method().size() <= 64, "settings.method", "at most 64 bytes");
  require(in.width() > 0 && in.height() > 0, "settings.width, settings.height", "at least one pixel");
  require(in.samples_per_pixel() > 0, "settings.samples_per_pixel", "at least 1");
  require(std::isfinite(in.target_error()) && in.target_error() >= 0, "settings.target_error",
          "a number that is not negative");
  require(in.set_size() <= 256, "settings.set", "at most 256 entries");
  out.method = in.method();
  out.width = in.width();
  out.height = in.height();
  out.spp = in.samples_per_pixel();
  out.depth = in.depth();
  out.seed = in.seed();
  out.target_error = in.target_error();
  if (!in.denoise().empty()) out.denoise = coordinator::parse_denoise(in.denoise());
  for (const auto& [key, value] : in.set()) {
    require(key.size() <= 256 && value.size() <= 4096, "settings.set",
            "keys of at most 256 bytes, values of at most 4096");
    out.set[key] = value;
  }
  out.camera = from_proto(in.camera());
  return out;
}

pb::Job to_proto(const JobStatus& status) {
  pb::Job out;
  out.set_id(status.id);
  out.set_name(printable(status.name));
  out.set_priority(status.priority);
  out.set_paused(status.paused);
  for (const std::string& other : status.after) out.add_after(other);
  out.set_worker_seconds(status.worker_seconds);
  out.set_owner(status.owner);
  out.set_rays(status.rays);
  out.set_state(to_proto(status.state));
  out.set_scene_name(printable(status.scene_name));
  out.set_method(status.method);
  out.set_width(status.width);
  out.set_height(status.height);
  out.set_frames(status.frames);
  out.set_frames_done(status.frames_done);
  out.set_frames_failed(status.frames_failed);
  out.set_frame_step(status.frame_step);
  for (const auto& [first, last] : status.written) {
    pb::FrameRange* range = out.add_written();
    range->set_first(first);
    range->set_last(last);
  }
  for (const std::uint32_t frame : status.running) out.add_running(frame);
  for (const StageStatus& stage : status.stages) {
    pb::StageProgress* to = out.add_stages();
    to->set_name(stage.name);
    to->set_kind(stage.kind);
    to->set_frame(stage.frame);
    to->set_items(stage.items);
    to->set_items_done(stage.items_done);
    to->set_items_per_second(stage.items_per_second);
    to->set_seconds_left(stage.seconds_left);
  }
  out.set_seconds(status.seconds);
  out.set_message(printable(status.message));
  out.set_preview_available(status.preview_available);
  out.set_submitted_unix_seconds(status.submitted_unix_seconds);
  out.set_frame_progress(status.frame_progress);
  out.set_progress(status.progress);
  out.set_frame_seconds_left(status.frame_seconds_left);
  out.set_seconds_left(status.seconds_left);
  return out;
}

JobStatus from_proto(const pb::Job& job) {
  JobStatus out;
  out.id = job.id();
  out.name = job.name();
  out.priority = job.priority();
  out.paused = job.paused();
  out.after.assign(job.after().begin(), job.after().end());
  out.worker_seconds = job.worker_seconds();
  out.owner = job.owner();
  out.rays = job.rays();
  out.state = from_proto(job.state());
  out.scene_name = job.scene_name();
  out.method = job.method();
  out.width = job.width();
  out.height = job.height();
  out.frames = job.frames();
  out.frames_done = job.frames_done();
  out.frames_failed = job.frames_failed();
  out.frame_step = std::max(1u, job.frame_step());
  for (const pb::FrameRange& range : job.written()) out.written.emplace_back(range.first(), range.last());
  out.running.assign(job.running().begin(), job.running().end());
  for (const pb::StageProgress& stage : job.stages())
    out.stages.push_back({stage.name(), stage.kind(), stage.frame(), stage.items(), stage.items_done(),
                          stage.items_per_second(), stage.seconds_left()});
  out.seconds = job.seconds();
  out.message = job.message();
  out.preview_available = job.preview_available();
  out.submitted_unix_seconds = job.submitted_unix_seconds();
  out.frame_progress = job.frame_progress();
  out.progress = job.progress();
  out.frame_seconds_left = job.frame_seconds_left();
  out.seconds_left = job.seconds_left();
  return out;
}

pb::Device to_proto(const DeviceDescription& device) {
  pb::Device out;
  out.set_name(device.name);
  out.set_platform(device.platform);
  out.set_driver(device.driver);
  out.set_version(device.version);
  out.set_tracer(device.tracer);
  out.set_cpu(device.cpu);
  out.set_compute_units(device.compute_units);
  out.set_threads(device.threads);
  out.set_memory_bytes(device.memory_bytes);
  out.set_denoiser(device.denoiser);
  return out;
}

DeviceDescription from_proto(const pb::Device& device) {
  auto text = [](const std::string& words) { return printable(words, most_name_bytes); };
  return {.name = text(device.name()),
          .platform = text(device.platform()),
          .driver = text(device.driver()),
          .version = text(device.version()),
          .tracer = text(device.tracer()),
          .denoiser = text(device.denoiser()),
          .cpu = device.cpu(),
          .compute_units = device.compute_units(),
          .threads = device.threads(),
          .memory_bytes = device.memory_bytes()};
}

pb::Worker to_proto(const WorkerStatus& status) {
  pb::Worker out;
  out.set_id(status.id);
  out.set_address(status.address);
  *out.mutable_device() = to_proto(status.device);
  out.set_leases(status.leases);
  out.set_draining(status.draining);
  out.set_aside(printable(status.aside));
  out.set_connected_seconds(status.connected_seconds);
  out.set_silent_seconds(status.silent_seconds);
  for (const auto& [kind, rate] : status.items_per_second) (*out.mutable_items_per_second())[kind] = rate;
  return out;
}

WorkerStatus from_proto(const pb::Worker& worker) {
  WorkerStatus out{.id = worker.id(),
                   .address = worker.address(),
                   .device = from_proto(worker.device()),
                   .leases = worker.leases(),
                   .draining = worker.draining(),
                   .aside = worker.aside(),
                   .connected_seconds = worker.connected_seconds(),
                   .silent_seconds = worker.silent_seconds(),
                   .items_per_second = {}};
  for (const auto& [kind, rate] : worker.items_per_second()) out.items_per_second[kind] = rate;
  return out;
}

WorkerHello from_proto(const pb::Hello& hello) {
  const std::string& name = hello.name();
  bool clean = !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' ||
           c == '-';
  });
  require(clean, "hello.name", "1 to 64 of [A-Za-z0-9._-]");
  require(hello.peer_address().size() <= 256, "hello.peer_address", "at most 256 bytes");
  return {.name = name,
          .address = {},
          .device = from_proto(hello.device()),
          .needs_bvh = hello.needs_bvh(),
          .peer_address = hello.peer_address(),
          .token = {}};
}

ShownFrame from_proto(const pb::ShownFrame& shown) {
  for (double seconds : {shown.load_seconds(), shown.pose_seconds(), shown.table_seconds(), shown.refit_seconds(),
                         shown.rebuild_seconds(), shown.top_level_seconds(), shown.most_growth()})
    require(seconds >= 0 && seconds < 1e9, "result.cost.shown", "seconds that are not negative");
  return {.load_seconds = shown.load_seconds(),
          .pose_seconds = shown.pose_seconds(),
          .table_seconds = shown.table_seconds(),
          .written_bytes = shown.written_bytes(),
          .refit_seconds = shown.refit_seconds(),
          .rebuild_seconds = shown.rebuild_seconds(),
          .top_level_seconds = shown.top_level_seconds(),
          .refitted = shown.refitted(),
          .rebuilt = shown.rebuilt(),
          .most_growth = shown.most_growth()};
}

BatchCost from_proto(const pb::BatchCost& cost) {
  for (double seconds : {cost.seconds(), cost.trace_seconds(), cost.kernel_seconds()})
    require(seconds >= 0 && seconds < 1e9, "result.cost", "seconds that are not negative");
  require(cost.nonfinite_items_size() <= 1024, "result.cost.nonfinite_items", "at most 1024");
  BatchCost out{.seconds = cost.seconds(),
                .trace_seconds = cost.trace_seconds(),
                .kernel_seconds = cost.kernel_seconds(),
                .camera_rays = cost.camera_rays(),
                .scatter_rays = cost.scatter_rays(),
                .shadow_rays = cost.shadow_rays(),
                .nonfinite = cost.nonfinite(),
                .nonfinite_items = {},
                .fetched_bytes = cost.fetched_bytes(),
                .peer_bytes = cost.peer_bytes()};
  if (cost.has_shown()) out.shown = from_proto(cost.shown());
  out.nonfinite_items.assign(cost.nonfinite_items().begin(), cost.nonfinite_items().end());
  return out;
}

BatchOutput::Retained from_proto(const pb::RetainedPart& part) {
  require(part.digest().size() == 32, "result.part.digest", "32 bytes");
  require(is_sha256_hex(part.artifact()), "result.part.artifact", "64 lower-case hexadecimal digits");
  return {.bytes = part.bytes(),
          .records = part.records(),
          .digest = part.digest(),
          .artifact = part.artifact(),
          .items = {part.first(), part.items()}};
}

pb::Event to_proto(const FarmEvent& event) {
  pb::Event out;
  out.set_number(event.number);
  out.set_unix_seconds(event.unix_seconds);
  out.set_kind(event.kind);
  out.set_what(event.what);
  out.set_job(event.job);
  out.set_frame(event.frame);
  out.set_worker(event.worker);
  out.set_message(printable(event.message));
  return out;
}

FarmEvent from_proto(const pb::Event& event) {
  return {.number = event.number(),
          .unix_seconds = event.unix_seconds(),
          .kind = event.kind(),
          .what = event.what(),
          .job = event.job(),
          .worker = event.worker(),
          .frame = event.frame(),
          .message = event.message()};
}

grpc::Status guarded(const std::function<grpc::Status()>& body) {
  try {
    return body();
  } catch (const LimitReached& error) {
    return {grpc::StatusCode::RESOURCE_EXHAUSTED, error.what()};
  } catch (const Error& error) {
    bool callers_fault = error.kind() == ErrorKind::usage || error.kind() == ErrorKind::bad_input;
    return {callers_fault ? grpc::StatusCode::INVALID_ARGUMENT : grpc::StatusCode::INTERNAL, error.what()};
  } catch (const std::bad_alloc&) {
    return {grpc::StatusCode::RESOURCE_EXHAUSTED, "the coordinator is out of memory"};
  } catch (const std::exception& error) {
    return {grpc::StatusCode::INTERNAL, error.what()};
  }
}

}  // namespace gleaner::gateway
