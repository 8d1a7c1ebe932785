#include "coordinator/gateway/farm_service.h"

#include <chrono>
#include <cmath>
#include <fstream>
#include <set>
#include <thread>

#include "coordinator/film/write.h"
#include "coordinator/gateway/convert.h"
#include "coordinator/gateway/session_call.h"
#include "scene/model/error.h"
#include "scene/model/frame_state.h"
#include "scene/model/names.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;
namespace fs = std::filesystem;
using grpc::Status;
using grpc::StatusCode;

namespace {

constexpr Seconds event_wait = 1;  // for something to happen, before the caller is looked at again
constexpr int most_ids = 1024;     // in one MissingBlobs call
constexpr std::uint64_t most_frames_bytes = std::uint64_t{64} << 20;
constexpr std::size_t most_awaited = 1000;  // jobs that one may wait for

Status no_job(const std::string& id) { return {StatusCode::NOT_FOUND, "no job " + id.substr(0, 80)}; }

Bytes read_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) throw Error::failed(path.string() + ": cannot open");
  Bytes bytes(static_cast<std::size_t>(file.tellg()));
  file.seekg(0);
  if (!file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size())))
    throw Error::failed(path.string() + ": cannot read");
  return bytes;
}

std::string text_of(const Bytes& bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

// Which job it is, and when it is its turn.
void take_order(const pb::SubmitJobRequest& request, JobRequest& job) {
  const auto check = [](const std::string& field, const std::string& word) {
    if (word.size() > most_name_bytes) throw Error::bad_input("request", field, "at most 256 bytes");
  };
  check("name", request.name());
  check("request_id", request.request_id());
  if (static_cast<std::size_t>(request.after_size()) > most_awaited)
    throw Error::bad_input("request", "after", "at most " + std::to_string(most_awaited) + " jobs");
  for (const std::string& other : request.after()) check("after", other);
  job.name = printable(request.name(), most_name_bytes);
  job.priority = request.priority();
  job.after.assign(request.after().begin(), request.after().end());
  job.request_id = request.request_id();
}

}  // namespace

Status FarmService::admitted(const grpc::ServerContext& context, const std::function<Status()>& answer) {
  if (Status refused = callers_.admit(context); !refused.ok()) return refused;
  return guarded(answer);
}

Status FarmService::MissingBlobs(grpc::ServerContext* context, const pb::MissingBlobsRequest* request,
                                 pb::MissingBlobsReply* reply) {
  return admitted(*context, [&]() -> Status {
    if (request->ids_size() > most_ids) return {StatusCode::INVALID_ARGUMENT, "more than 1024 ids"};
    for (const std::string& id : request->ids()) {
      if (!is_sha256_hex(id))
        return {StatusCode::INVALID_ARGUMENT,
                "blob id: expected 64 lower-case hexadecimal digits, found \"" + id.substr(0, 80) + "\""};
      if (!blobs_.has(id)) reply->add_ids(id);
    }
    return Status::OK;
  });
}

Status FarmService::UploadBlob(grpc::ServerContext* context, grpc::ServerReader<pb::UploadBlobRequest>* stream,
                               pb::UploadBlobReply* reply) {
  Callers::Call open(callers_, *context, Callers::Call::upload);
  if (!open.status().ok()) return open.status();
  const Seat seat(uploads_);
  if (seat.before >= settings_.most_uploads)
    return {StatusCode::RESOURCE_EXHAUSTED, "this coordinator takes " + std::to_string(settings_.most_uploads) +
                                                " uploads at the same time: try again"};
  SilenceWatch::Call call(silence_, *context, settings_.silent_seconds);
  pb::UploadBlobRequest part;
  if (!stream->Read(&part) || !part.has_header())
    return {StatusCode::INVALID_ARGUMENT, "an upload begins with its header"};
  const std::string id = part.header().id();
  const std::uint64_t bytes = part.header().bytes();
  if (!is_sha256_hex(id))
    return {StatusCode::INVALID_ARGUMENT,
            "blob id: expected 64 lower-case hexadecimal digits, found \"" + id.substr(0, 80) + "\""};
  if (bytes > settings_.upload_bytes)
    return {StatusCode::RESOURCE_EXHAUSTED, "blob " + id + ": " + std::to_string(bytes) +
                                                " bytes are over this coordinator's limit of " +
                                                std::to_string(settings_.upload_bytes)};
  if (blobs_.has(id)) {
    reply->set_held_before(true);
    return Status::OK;
  }
  try {
    auto upload = blobs_.begin_upload(id, bytes);
    if (!upload) {
      reply->set_held_before(true);
      return Status::OK;
    }
    while (stream->Read(&part)) {
      call.heard();
      open.heard();
      if (part.part_case() != pb::UploadBlobRequest::kData)
        return {StatusCode::INVALID_ARGUMENT, "blob " + id + ": a second header"};
      if (part.data().size() > piece_bytes)
        return {StatusCode::INVALID_ARGUMENT, "blob " + id + ": a piece is at most 1 MiB"};
      upload->append(std::as_bytes(std::span(part.data())));
    }
    upload->commit();
  } catch (const Error& error) {
    bool callers_fault = error.kind() == ErrorKind::bad_input;
    return {callers_fault ? StatusCode::INVALID_ARGUMENT : StatusCode::RESOURCE_EXHAUSTED, error.what()};
  } catch (const std::bad_alloc&) {
    return {StatusCode::RESOURCE_EXHAUSTED, "blob " + id + ": the coordinator is out of memory"};
  }
  return Status::OK;
}

SceneSummary FarmService::summary_of(const std::string& scene_blob, const std::string& scene_name) {
  {
    std::lock_guard lock(summaries_mutex_);
    if (auto found = summaries_.find(scene_blob); found != summaries_.end()) return found->second;
  }
  Blob blob = blobs_.get(scene_blob);
  if (!blob) throw Error::failed("blob " + scene_blob + " has gone");
  SceneSummary summary = summarize(scene::parse_scene(*blob, scene_name));
  std::lock_guard lock(summaries_mutex_);
  if (summaries_.size() >= 1024) summaries_.clear();
  return summaries_[scene_blob] = summary;
}

pb::JobFrames FarmService::frames_of(const pb::SubmitJobRequest& request) {
  pb::JobFrames frames;
  const std::string& id = request.frames_blob();
  if (id.empty()) {
    *frames.mutable_cameras() = request.frame_cameras();
    *frames.mutable_scenes() = request.frame_scenes();
    return frames;
  }
  if (!is_sha256_hex(id)) throw Error::bad_input("request", "frames_blob", "64 lower-case hexadecimal digits");
  const auto source = blobs_.source(id);
  if (!source) throw Error::bad_input("blob " + id, "", "to be uploaded first");
  if (source->bytes() > most_frames_bytes)
    throw Error::bad_input("blob " + id, "", "at most " + std::to_string(most_frames_bytes) + " bytes of frames",
                           std::to_string(source->bytes()));
  const Blob blob = blobs_.get(id);
  if (!blob || !frames.ParseFromArray(blob->data(), static_cast<int>(blob->size())))
    throw Error::bad_input("blob " + id, "", "the frames of a job");
  return frames;
}

void FarmService::check_state(const FrameScene& scene) {
  const Blob blob = blobs_.get(scene.state_blob);
  const std::string origin = "state blob " + scene.state_blob;
  if (!blob) throw Error::failed(origin + " has gone");
  const scene::FrameState state = scene::parse_frame_state(*blob, origin);
  scene::check_counts(state, scene.summary.matrices, scene.summary.morph_weights, origin);
}

Status FarmService::SubmitJob(grpc::ServerContext* context, const pb::SubmitJobRequest* request,
                              pb::SubmitJobReply* reply) {
  return admitted(*context, [&]() -> Status {
    const pb::JobFrames frames = frames_of(*request);
    const std::uint64_t most = most_frames;
    if (static_cast<std::uint64_t>(std::max(frames.scenes_size(), frames.cameras_size())) > most)
      return {StatusCode::INVALID_ARGUMENT, "frame_scenes, frame_cameras: expected at most " + std::to_string(most)};
    std::vector<FrameScene> scenes;
    const auto add = [&](const std::string& scene_blob, const std::string& bvh_blob, const std::string& state_blob) {
      FrameScene& scene = scenes.emplace_back();
      scene.scene_blob = scene_blob;
      scene.bvh_blob = bvh_blob;
      scene.state_blob = state_blob;
    };
    for (const pb::FrameScene& scene : frames.scenes()) add(scene.scene_blob(), scene.bvh_blob(), scene.state_blob());
    if (scenes.empty()) add(request->scene_blob(), request->bvh_blob(), {});
    for (const FrameScene& scene : scenes)
      for (const std::string* each : {&scene.scene_blob, &scene.bvh_blob, &scene.state_blob}) {
        const std::string& id = *each;
        if (each == &scene.state_blob && id.empty()) continue;
        if (!is_sha256_hex(id))
          return {StatusCode::INVALID_ARGUMENT,
                  "blob id: expected 64 lower-case hexadecimal digits, found \"" + id.substr(0, 80) + "\""};
        if (!blobs_.has(id)) return {StatusCode::FAILED_PRECONDITION, "blob " + id + " must be uploaded first"};
      }
    if (request->scene_name().empty() || request->scene_name().size() > most_name_bytes ||
        request->camera_name().size() > most_name_bytes)
      return {StatusCode::INVALID_ARGUMENT, "scene_name, camera_name: expected at most 256 bytes, and a scene name"};
    if (!std::isfinite(request->exposure_stops()) || std::abs(request->exposure_stops()) > 100)
      return {StatusCode::INVALID_ARGUMENT, "exposure_stops: expected -100 to 100"};
    JobRequest job;
    job.scene_name = printable(request->scene_name(), most_name_bytes);
    job.camera_name = printable(request->camera_name(), most_name_bytes);
    job.settings = from_proto(request->settings());
    job.exposure_stops = request->exposure_stops();
    job.time_limit = request->settings().time_limit_seconds();
    if (!(job.time_limit >= 0 && job.time_limit < 1e9))
      return {StatusCode::INVALID_ARGUMENT, "settings.time_limit_seconds: expected a number that is not negative"};
    if (request->first_frame() != 0 || request->last_frame() != 0) {
      job.first_frame = request->first_frame();
      job.last_frame = request->last_frame();
    }
    if (request->frame_step() != 0) job.frame_step = request->frame_step();
    job.numbers.assign(request->frame_numbers().begin(), request->frame_numbers().end());
    take_order(*request, job);
    job.owner = printable(callers_.name_of(*context), most_name_bytes);
    for (const pb::Camera& camera : frames.cameras()) job.cameras.push_back(from_proto(camera));
    std::set<std::string> checked;
    for (FrameScene& scene : scenes) {
      scene.summary = summary_of(scene.scene_blob, job.scene_name);
      if (!scene.state_blob.empty() && checked.insert(blobs_of(scene)).second) check_state(scene);
    }
    job.scenes = std::move(scenes);
    reply->set_job(farm_.submit(job));
    return Status::OK;
  });
}

Status FarmService::ListJobs(grpc::ServerContext* context, const pb::ListJobsRequest*, pb::ListJobsReply* reply) {
  return admitted(*context, [&]() -> Status {
    for (const JobStatus& status : farm_.list()) *reply->add_jobs() = to_proto(status);
    return Status::OK;
  });
}

Status FarmService::GetJob(grpc::ServerContext* context, const pb::GetJobRequest* request, pb::Job* reply) {
  return admitted(*context, [&]() -> Status {
    auto status = farm_.status(request->job());
    if (!status) return no_job(request->job());
    *reply = to_proto(*status);
    return Status::OK;
  });
}

Status FarmService::CancelJob(grpc::ServerContext* context, const pb::CancelJobRequest* request, pb::Job* reply) {
  return admitted(*context, [&]() -> Status {
    auto status = farm_.cancel(request->job());
    if (!status) return no_job(request->job());
    *reply = to_proto(*status);
    return Status::OK;
  });
}

Status FarmService::PauseJob(grpc::ServerContext* context, const pb::PauseJobRequest* request, pb::Job* reply) {
  return admitted(*context, [&]() -> Status {
    auto status = farm_.pause(request->job(), !request->resume());
    if (!status) return no_job(request->job());
    *reply = to_proto(*status);
    return Status::OK;
  });
}

Status FarmService::RetryJob(grpc::ServerContext* context, const pb::RetryJobRequest* request, pb::Job* reply) {
  return admitted(*context, [&]() -> Status {
    auto status = farm_.retry(request->job());
    if (!status) return no_job(request->job());
    *reply = to_proto(*status);
    return Status::OK;
  });
}

Status FarmService::WatchJob(grpc::ServerContext* context, const pb::WatchJobRequest* request,
                             grpc::ServerWriter<pb::Job>* stream) {
  Callers::Call open(callers_, *context, Callers::Call::download);
  if (!open.status().ok()) return open.status();
  using namespace std::chrono_literals;
  SilenceWatch::Call call(silence_, *context, settings_.silent_seconds);
  std::uint64_t seen = 0;
  while (!context->IsCancelled()) {
    // Silence of a second is broken, so that seconds and rates keep moving; a farm that goes away ends the wait.
    auto status = farm_.wait(request->job(), seen, 1.0);
    if (!status) return no_job(request->job());
    seen = status->version;
    if (!stream->Write(to_proto(*status))) return Status::OK;
    call.heard();
    open.heard();
    if (ended(status->state)) return Status::OK;
    std::this_thread::sleep_for(100ms);
  }
  return Status::OK;
}

Status FarmService::WatchEvents(grpc::ServerContext* context, const pb::WatchEventsRequest* request,
                                grpc::ServerWriter<pb::Event>* stream) {
  Callers::Call open(callers_, *context, Callers::Call::download);
  if (!open.status().ok()) return open.status();
  if (!request->job().empty() && !farm_.status(request->job())) return no_job(request->job());
  SilenceWatch::Call call(silence_, *context, settings_.silent_seconds);
  std::uint64_t seen = request->after() > 0 ? request->after() : farm_.last_event();
  stream->SendInitialMetadata();  // from here on nothing is missed
  while (!context->IsCancelled()) {
    const std::uint64_t last = farm_.last_event();
    const auto status = farm_.status(request->job());
    const bool over = status && ended(status->state);
    for (const FarmEvent& event : farm_.events(seen, request->job(), over ? 0 : event_wait)) {
      if (!stream->Write(to_proto(event))) return Status::OK;
      seen = std::max(seen, event.number);
      call.heard();
      open.heard();
    }
    if (over) return Status::OK;
    seen = std::max(seen, last);  // those of other jobs
    call.heard();                 // there is nothing to say: the peer is not the one that is silent
    open.heard();
  }
  return Status::OK;
}

Status FarmService::GetPreview(grpc::ServerContext* context, const pb::GetPreviewRequest* request,
                               pb::GetPreviewReply* reply) {
  return admitted(*context, [&]() -> Status {
    auto status = farm_.status(request->job());
    if (!status) return no_job(request->job());
    std::string png;
    if (status->state == JobState::done) {
      for (const fs::path& path : farm_.files(request->job()))
        if (path.extension() == ".png") png = text_of(read_file(path));
      reply->set_complete(true);
    } else if (status->state == JobState::running) {
      png = previews_.show(request->job(), status->exposure_stops, request->denoise() != "off");
    }
    if (png.empty()) return {StatusCode::FAILED_PRECONDITION, "job " + request->job() + ": nothing to show yet"};
    reply->set_png(std::move(png));
    return Status::OK;
  });
}

Status FarmService::Session(grpc::ServerContext* context,
                            grpc::ServerReaderWriter<pb::SessionPicture, pb::SessionRequest>* stream) {
  return admitted(*context, [&]() -> Status {
    const Callers::Call open(callers_, *context, Callers::Call::work);  // it has seats of its own
    const Seat seat(sessions_);
    if (seat.before >= settings_.most_sessions)
      return {StatusCode::RESOURCE_EXHAUSTED,
              "this coordinator has " + std::to_string(settings_.most_sessions) + " sessions, and takes no more"};
    pb::SessionRequest first;
    {
      SilenceWatch::Call call(silence_, *context, settings_.silent_seconds);
      if (!stream->Read(&first) || !first.has_open())
        return {StatusCode::INVALID_ARGUMENT, "a session begins with its scene"};
    }
    SessionCall(farm_, blobs_, first.open()).run(*context, *stream);
    return Status::OK;
  });
}

Status FarmService::Why(grpc::ServerContext* context, const pb::WhyRequest* request, pb::WhyReply* reply) {
  return admitted(*context, [&]() -> Status {
    auto reasons = farm_.why(request->job());
    if (!reasons) return no_job(request->job());
    for (const std::string& reason : *reasons) reply->add_reasons(printable(reason));
    return Status::OK;
  });
}

Status FarmService::ListFiles(grpc::ServerContext* context, const pb::ListFilesRequest* request,
                              pb::ListFilesReply* reply) {
  return admitted(*context, [&]() -> Status {
    if (!farm_.status(request->job())) return no_job(request->job());
    for (const fs::path& path : farm_.files(request->job())) {
      std::error_code code;
      std::uint64_t bytes = fs::file_size(path, code);
      if (code) continue;
      pb::File* file = reply->add_files();
      file->set_name(path.filename().string());
      file->set_bytes(bytes);
    }
    return Status::OK;
  });
}

Status FarmService::FetchFile(grpc::ServerContext* context, const pb::FetchFileRequest* request,
                              grpc::ServerWriter<pb::FetchFileReply>* stream) {
  Callers::Call open(callers_, *context, Callers::Call::download);
  if (!open.status().ok()) return open.status();
  if (!farm_.status(request->job())) return no_job(request->job());
  // Only names that the job itself gave: nothing else of the disk can be asked for.
  for (const fs::path& path : farm_.files(request->job())) {
    if (path.filename() != request->name()) continue;
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) return {StatusCode::INTERNAL, path.filename().string() + ": cannot open"};
    SilenceWatch::Call call(silence_, *context, settings_.silent_seconds);
    pb::FetchFileReply piece;
    piece.set_total_bytes(static_cast<std::uint64_t>(file.tellg()));
    std::uint64_t left = piece.total_bytes();
    file.seekg(0);
    do {
      piece.mutable_data()->resize(std::min<std::uint64_t>(left, piece_bytes));
      if (!file.read(piece.mutable_data()->data(), static_cast<std::streamsize>(piece.data().size())))
        return {StatusCode::INTERNAL, path.filename().string() + ": cannot read"};
      left -= piece.data().size();
      if (!stream->Write(piece)) return Status::OK;
      call.heard();
      open.heard();
    } while (left > 0);
    return Status::OK;
  }
  return {StatusCode::NOT_FOUND, "job " + request->job() + " has no file " + request->name().substr(0, 80)};
}

Status FarmService::ListWorkers(grpc::ServerContext* context, const pb::ListWorkersRequest*,
                                pb::ListWorkersReply* reply) {
  return admitted(*context, [&]() -> Status {
    for (const WorkerStatus& status : farm_.workers()) *reply->add_workers() = to_proto(status);
    return Status::OK;
  });
}

Status FarmService::DrainWorker(grpc::ServerContext* context, const pb::DrainWorkerRequest* request,
                                pb::DrainWorkerReply*) {
  return admitted(*context, [&]() -> Status {
    if (!farm_.drain(request->worker()))
      return {StatusCode::NOT_FOUND, "no worker " + printable(request->worker(), most_name_bytes) + " is connected"};
    return Status::OK;
  });
}

}  // namespace gleaner::gateway
