#include "cli/session_stream.h"

#include <grpcpp/grpcpp.h>

#include <utility>

#include "cli/kernel_compiler.h"
#include "coordinator/blobs/sha256.h"
#include "coordinator/gateway/convert.h"
#include "scene/bvh/build.h"
#include "scene/model/edited_scene.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;

namespace {

std::unique_ptr<EmbeddedFarm> open_farm(const SessionOptions& options) {
  if (!options.coordinator.empty()) return nullptr;
  EmbeddedSettings settings;
  settings.workers = options.workers;
  settings.device.device = options.device;
  settings.device.trace = worker::parse_trace_kind(options.trace);
  settings.device.compiler = kernel_compiler();
  settings.paths = [](const std::string&, std::uint32_t) { return coordinator::FramePaths{}; };
  return std::make_unique<EmbeddedFarm>(settings);
}

}  // namespace

SessionScene load_session_scene(const SessionOptions& options) {
  FrameOptions asked = options.frame;
  if (asked.denoise.empty()) asked.denoise = "off";
  SessionScene scene{load_frame(asked), {}};
  scene.frame.scene.rig = {};
  for (const std::string& name : options.movable) scene.objects[name] = scene::make_movable(scene.frame.scene, name);
  return scene;
}

SessionStream::SessionStream(const SessionOptions& options, LoadedFrame frame, pb::PictureFormat format)
    : embedded_(open_farm(options)), client_(embedded_ ? Client(embedded_->channel()) : Client(options.coordinator)) {
  pb::SessionRequest request;
  pb::SessionOpen& open = *request.mutable_open();
  {
    const scene::Bytes scene_blob = scene::serialize(frame.scene);
    open.set_scene_blob(coordinator::sha256_hex(scene_blob));
    client_.upload_missing({{open.scene_blob(), &scene_blob}});
  }
  if (!embedded_ || embedded_->needs_bvh()) {
    const scene::Bytes bvh_blob = scene::serialize(scene::build_bvh(frame.scene));
    open.set_bvh_blob(coordinator::sha256_hex(bvh_blob));
    client_.upload_missing({{open.bvh_blob(), &bvh_blob}});
  }
  open.set_scene_name(frame.scene_name);
  *open.mutable_settings() = gateway::to_proto(frame.settings);
  // Nothing is said: refined pictures are denoised, first ones are not.
  if (options.frame.denoise.empty()) open.mutable_settings()->clear_denoise();
  open.set_exposure_stops(options.frame.exposure_stops);
  open.set_format(format);
  open.set_refine_to(options.refine_to);
  stream_ = client_.session(context_);
  stream_->Write(request);  // a stream that is over says so to who reads it
}

}  // namespace gleaner::cli
