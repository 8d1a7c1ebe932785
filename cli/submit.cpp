// `gleaner submit`: hands a frame to a farm and prints the job's id.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <iostream>
#include <memory>
#include <optional>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/fetch.h"
#include "cli/frame_list.h"
#include "cli/frame_options.h"
#include "cli/status_words.h"
#include "cli/watch.h"
#include "coordinator/blobs/sha256.h"
#include "coordinator/gateway/convert.h"
#include "coordinator/jobs/frame_name.h"
#include "scene/bvh/build.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace {

struct SubmitOptions {
  FrameOptions frame;
  std::string coordinator;
  std::string name, request_id;
  int priority = 0;
  std::vector<std::string> after;
  bool wait = false;
  FetchOptions fetch;  // with `wait`
};

// Files that would be in the way are told before anything is rendered.
void check_targets(const FetchOptions& options, const scene::FrameNumbers& frames) {
  if (options.folder.empty()) return;
  std::vector<std::string> names;
  for (std::uint64_t i = 0; i < frames.count(); ++i)
    for (const char* ending : {".exr", ".png", ".json"})
      names.push_back(coordinator::frame_stem(frames.at(i)) + ending);
  refuse_to_overwrite(options, names);
}

// Until the job has ended; then what there is of it is fetched.
int wait_for(const std::string& job, const SubmitOptions& options) {
  WatchOptions watch;
  watch.coordinator = options.coordinator;
  watch.job = job;
  watch.quiet = options.frame.quiet;
  const coordinator::JobStatus last = follow_job(watch);
  if (options.fetch.folder.empty() || last.frames_done == 0) {
    require_done(last);
    return 0;
  }
  FetchOptions fetch = options.fetch;
  fetch.coordinator = options.coordinator;
  fetch.job = job;
  fetch.quiet = options.frame.quiet;
  return fetch_files(fetch);
}

// Which devices will work on it is not known here, so the BVH goes along; those that trace with Embree never fetch it.
gleaner::v1::FrameScene upload(Client& client, const scene::Scene& scene) {
  const scene::Bytes scene_blob = scene::serialize(scene), bvh_blob = scene::serialize(scene::build_bvh(scene));
  gleaner::v1::FrameScene blobs;
  blobs.set_scene_blob(coordinator::sha256_hex(scene_blob));
  blobs.set_bvh_blob(coordinator::sha256_hex(bvh_blob));
  client.upload_missing({{blobs.scene_blob(), &scene_blob}, {blobs.bvh_blob(), &bvh_blob}});
  return blobs;
}

constexpr std::size_t states_at_once = 256;          // that the coordinator is asked for
constexpr std::size_t most_message_bytes = 1 << 20;  // of a request; it takes 2 MiB

// What is too much for a message is sent as a blob.
void put_frames_apart(Client& client, gleaner::v1::SubmitJobRequest& request) {
  if (request.ByteSizeLong() <= most_message_bytes) return;
  gleaner::v1::JobFrames frames;
  frames.mutable_cameras()->Swap(request.mutable_frame_cameras());
  frames.mutable_scenes()->Swap(request.mutable_frame_scenes());
  scene::Bytes bytes(frames.ByteSizeLong());
  frames.SerializeToArray(bytes.data(), static_cast<int>(bytes.size()));
  request.set_frames_blob(coordinator::sha256_hex(bytes));
  client.upload_missing({{request.frames_blob(), &bytes}});
}

// The base once, then a state a frame; frames that no state of the base shows have scenes of their own.
void add_moving_frames(Client& client, const FrameOptions& options, const LoadedFrame& frame,
                       gleaner::v1::SubmitJobRequest& request) {
  std::optional<gleaner::v1::FrameScene> base;
  std::vector<std::pair<std::string, scene::Bytes>> states;
  const auto send_states = [&] {
    std::vector<std::pair<std::string, const scene::Bytes*>> blobs;
    for (const auto& [id, bytes] : states) blobs.emplace_back(id, &bytes);
    if (!blobs.empty()) client.upload_missing(blobs);
    states.clear();
  };
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
    scene::Bytes state = scene::serialize(*look.state);
    shown.set_state_blob(coordinator::sha256_hex(state));
    states.emplace_back(shown.state_blob(), std::move(state));
    if (states.size() == states_at_once) send_states();
  }
  send_states();
}

int submit(const SubmitOptions& options) {
  if (!options.frame.frames.empty())
    check_targets(options.fetch, parse_frame_list(options.frame.frames));
  else
    check_targets(options.fetch, {});
  Client client(options.coordinator);
  LoadedFrame frame = load_frame(options.frame);
  // What no plan takes is refused before anything is uploaded.
  coordinator::make_plan(frame.settings, coordinator::summarize(frame.scene));
  gleaner::v1::SubmitJobRequest request;
  request.set_scene_name(frame.scene_name);
  request.set_camera_name(printable(frame.camera_name, most_name_bytes));
  *request.mutable_settings() = gateway::to_proto(frame.settings);
  request.mutable_settings()->set_time_limit_seconds(options.frame.time_limit);
  request.set_name(printable(options.name, most_name_bytes));
  request.set_priority(options.priority);
  for (const std::string& job : options.after) request.add_after(job);
  request.set_request_id(printable(options.request_id));
  request.set_first_frame(frame.frame_numbers.first);
  request.set_last_frame(frame.frame_numbers.last);
  request.set_frame_step(frame.frame_numbers.step);
  for (const std::uint32_t number : frame.frame_numbers.list) request.add_frame_numbers(number);
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
  put_frames_apart(client, request);
  const std::string job = client.submit(request);
  std::cout << job << std::endl;
  return options.wait ? wait_for(job, options) : 0;
}

}  // namespace

void add_submit(CLI::App& app, Run& run) {
  auto options = std::make_shared<SubmitOptions>();
  CLI::App* command = app.add_subcommand("submit", "Hand a scene to a farm; prints the job's id");
  add_frame_options(*command, options->frame);
  command->add_option("--name", options->name, "of the job, for lists");
  command->add_option("--priority", options->priority, "higher ones first, -1000 to 1000")
      ->capture_default_str()
      ->check(CLI::Range(-1000, 1000));
  command->add_option("--after", options->after, "JOB that must be done before this one begins; may be given again")
      ->take_all()
      ->allow_extra_args(false);
  command->add_option("--request-id", options->request_id,
                      "ID of this request, as you choose it: submitted again with the same one it is the same job");
  CLI::Option* wait =
      command->add_flag("--wait", options->wait, "follow the job to its end, and fetch its files with -o");
  add_fetch_options(*command, options->fetch);
  for (const char* option : {"--output", "--pattern", "--force", "--new"}) command->get_option(option)->needs(wait);
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return submit(*options); }; });
}

}  // namespace gleaner::cli
