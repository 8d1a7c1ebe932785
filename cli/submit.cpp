// `gleaner submit`: hands a frame to a farm and prints the job's id.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>
#include <optional>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/frame_options.h"
#include "coordinator/blobs/sha256.h"
#include "coordinator/gateway/convert.h"
#include "scene/bvh/build.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace {

struct SubmitOptions {
  FrameOptions frame;
  std::string coordinator;
};

// Which devices will work on it is not known here, so the BVH goes along; those that trace with Embree never fetch it.
gleaner::v1::FrameScene upload(Client& client, const scene::Scene& scene) {
  const scene::Bytes scene_blob = scene::serialize(scene), bvh_blob = scene::serialize(scene::build_bvh(scene));
  gleaner::v1::FrameScene blobs;
  blobs.set_scene_blob(coordinator::sha256_hex(scene_blob));
  blobs.set_bvh_blob(coordinator::sha256_hex(bvh_blob));
  client.upload_missing({{blobs.scene_blob(), &scene_blob}, {blobs.bvh_blob(), &bvh_blob}});
  return blobs;
}

// The base once, then a state a frame; frames that no state of the base shows have scenes of their own.
void add_moving_frames(Client& client, const FrameOptions& options, const LoadedFrame& frame,
                       gleaner::v1::SubmitJobRequest& request) {
  std::optional<gleaner::v1::FrameScene> base;
  for (std::uint32_t i = 0; i < frame.frames(); ++i) {
    const FrameLook look = look_of(options, frame, frame.number(i));
    *request.add_frame_cameras() = gateway::to_proto(look.camera);
    if (!look.state) {
      *request.add_frame_scenes() = upload(client, frame.moving->scene_at(look.seconds));
      continue;
    }
    if (!base) base = upload(client, frame.moving->base());
    gleaner::v1::FrameScene& shown = *request.add_frame_scenes();
    shown = *base;
    if (look.state->empty()) continue;
    const scene::Bytes state = scene::serialize(*look.state);
    shown.set_state_blob(coordinator::sha256_hex(state));
    client.upload_missing({{shown.state_blob(), &state}});
  }
}

int submit(const SubmitOptions& options) {
  Client client(options.coordinator);
  LoadedFrame frame = load_frame(options.frame);
  // What no plan takes is refused before anything is uploaded.
  coordinator::make_plan(frame.settings, coordinator::summarize(frame.scene));
  gleaner::v1::SubmitJobRequest request;
  request.set_scene_name(frame.scene_name);
  request.set_camera_name(printable(frame.camera_name, most_name_bytes));
  *request.mutable_settings() = gateway::to_proto(frame.settings);
  request.mutable_settings()->set_time_limit_seconds(options.frame.time_limit);
  request.set_first_frame(frame.first_frame);
  request.set_last_frame(frame.last_frame);
  request.set_frame_step(frame.frame_step);
  for (const scene::Camera& camera : frame.cameras) *request.add_frame_cameras() = gateway::to_proto(camera);
  request.set_exposure_stops(options.frame.exposure_stops);
  if (frame.moving) {
    frame.scene = {};
    add_moving_frames(client, options.frame, frame, request);
  } else {
    const gleaner::v1::FrameScene blobs = upload(client, frame.scene);
    request.set_scene_blob(blobs.scene_blob());
    request.set_bvh_blob(blobs.bvh_blob());
  }
  std::cout << client.submit(request) << std::endl;
  return 0;
}

}  // namespace

void add_submit(CLI::App& app, Run& run) {
  auto options = std::make_shared<SubmitOptions>();
  CLI::App* command = app.add_subcommand("submit", "Hand a scene to a farm; prints the job's id");
  add_frame_options(*command, options->frame);
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return submit(*options); }; });
}

}  // namespace gleaner::cli
