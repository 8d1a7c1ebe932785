#include "cli/client.h"

#include <grpcpp/grpcpp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>

#include "cli/program.h"
#include "coordinator/gateway/convert.h"
#include "proto/credentials.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;
using coordinator::JobStatus;
using gateway::from_proto;

namespace {

constexpr std::chrono::seconds connect_patience{3};  // with nobody there
constexpr std::chrono::seconds busy_patience{15};    // with one that is there and has not spoken yet
constexpr std::chrono::seconds call_patience{60};    // calls that do not stream; a submission parses its scene

void set_deadline(grpc::ClientContext& context) {
  context.set_deadline(std::chrono::system_clock::now() + call_patience);
}

// A coordinator with thousands of connections before this one takes its time.
bool connects(grpc::Channel& channel) {
  const auto begun = std::chrono::system_clock::now();
  for (auto state = channel.GetState(true); state != GRPC_CHANNEL_READY; state = channel.GetState(true)) {
    const auto until = begun + (state == GRPC_CHANNEL_CONNECTING ? busy_patience : connect_patience);
    if (std::chrono::system_clock::now() >= until) return false;
    channel.WaitForStateChange(state, until);
  }
  return true;
}

}  // namespace

void add_coordinator_option(CLI::App& command, std::string& address) {
  command.add_option("--coordinator", address, "HOST:PORT (default: $GLEANER_COORDINATOR)")
      ->envname("GLEANER_COORDINATOR");
  add_keys_option(command);
}

Client::Client(const std::string& address) : address_(address) {
  if (address_.empty()) throw Error::usage("which coordinator? --coordinator HOST:PORT, or $GLEANER_COORDINATOR");
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(256 << 20);  // previews are whole
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 15000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10000);
  // Who calls again has waits of its own.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 500);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
  const std::shared_ptr<const Keys> keys = own_keys();
  const auto credentials = channel_credentials(keys.get(), Role::coordinate, arguments);
  auto channel = grpc::CreateCustomChannel(address_, credentials, arguments);
  if (!connects(*channel))
    throw Error::connection("no coordinator answers at " + address_ +
                            (keys ? ", or not one of this farm (keys of " + keys->folder.string() + ")"
                                  : std::string(", or none that takes connections without keys (--keys)")));
  stub_ = pb::Farm::NewStub(channel);
}

Client::Client(const std::shared_ptr<grpc::Channel>& channel)
    : address_("this process"), stub_(pb::Farm::NewStub(channel)) {}

void Client::check(const grpc::Status& status) const {
  switch (status.error_code()) {
    case grpc::StatusCode::OK:
      return;
    case grpc::StatusCode::UNAVAILABLE:
    case grpc::StatusCode::DEADLINE_EXCEEDED:
    case grpc::StatusCode::CANCELLED:  // by a coordinator that ends
      throw Error::connection("the coordinator at " + address_ + " does not answer: " + status.error_message());
    case grpc::StatusCode::INVALID_ARGUMENT:
    case grpc::StatusCode::NOT_FOUND:
      throw Error(ErrorKind::bad_input, status.error_message());
    default:
      throw Error::failed("the coordinator at " + address_ + ": " + status.error_message());
  }
}

template <typename Request, typename Reply>
Reply Client::call(grpc::Status (pb::Farm::Stub::*method)(grpc::ClientContext*, const Request&, Reply*),
                   const Request& request) {
  grpc::ClientContext context;
  set_deadline(context);
  Reply reply;
  check((*stub_.*method)(&context, request, &reply));
  return reply;
}

void Client::upload_missing(const std::vector<std::pair<std::string, const scene::Bytes*>>& blobs) {
  pb::MissingBlobsRequest request;
  for (const auto& [id, bytes] : blobs) request.add_ids(id);
  const pb::MissingBlobsReply missing = call(&pb::Farm::Stub::MissingBlobs, request);
  for (const auto& [id, bytes] : blobs) {
    if (std::find(missing.ids().begin(), missing.ids().end(), id) == missing.ids().end()) continue;
    grpc::ClientContext context;
    pb::UploadBlobReply reply;
    auto writer = stub_->UploadBlob(&context, &reply);
    pb::UploadBlobRequest part;
    part.mutable_header()->set_id(id);
    part.mutable_header()->set_bytes(bytes->size());
    bool open = writer->Write(part);
    for (std::size_t offset = 0; open && offset < bytes->size(); offset += piece_bytes) {
      part.set_data(bytes->data() + offset, std::min(piece_bytes, bytes->size() - offset));
      open = writer->Write(part);
    }
    writer->WritesDone();
    check(writer->Finish());
  }
}

std::string Client::submit(const pb::SubmitJobRequest& request) {
  return call(&pb::Farm::Stub::SubmitJob, request).job();
}

std::vector<JobStatus> Client::list() {
  const pb::ListJobsReply reply = call(&pb::Farm::Stub::ListJobs, pb::ListJobsRequest());
  std::vector<JobStatus> jobs;
  for (const pb::Job& job : reply.jobs()) jobs.push_back(from_proto(job));
  return jobs;
}

JobStatus Client::show(const std::string& job) {
  pb::GetJobRequest request;
  request.set_job(job);
  return from_proto(call(&pb::Farm::Stub::GetJob, request));
}

JobStatus Client::cancel(const std::string& job) {
  pb::CancelJobRequest request;
  request.set_job(job);
  return from_proto(call(&pb::Farm::Stub::CancelJob, request));
}

JobStatus Client::pause(const std::string& job, bool paused) {
  pb::PauseJobRequest request;
  request.set_job(job);
  request.set_resume(!paused);
  return from_proto(call(&pb::Farm::Stub::PauseJob, request));
}

JobStatus Client::retry(const std::string& job) {
  pb::RetryJobRequest request;
  request.set_job(job);
  return from_proto(call(&pb::Farm::Stub::RetryJob, request));
}

void Client::drain(const std::string& worker) {
  pb::DrainWorkerRequest request;
  request.set_worker(worker);
  call(&pb::Farm::Stub::DrainWorker, request);
}

JobStatus Client::watch(const std::string& job, const std::function<bool(const JobStatus&)>& on_change) {
  grpc::ClientContext context;
  pb::WatchJobRequest request;
  request.set_job(job);
  auto reader = stub_->WatchJob(&context, request);
  pb::Job change;
  JobStatus last;
  while (reader->Read(&change)) {
    last = from_proto(change);
    if (!on_change(last)) {
      context.TryCancel();
      reader->Finish();
      return last;
    }
  }
  check(reader->Finish());
  if (!ended(last.state)) throw Error::connection("the coordinator at " + address_ + " went away while the job ran");
  return last;
}

void Client::events(std::uint64_t after, const std::string& job,
                    const std::function<void(const coordinator::FarmEvent&)>& on_event) {
  grpc::ClientContext context;
  pb::WatchEventsRequest request;
  request.set_after(after);
  request.set_job(job);
  auto reader = stub_->WatchEvents(&context, request);
  pb::Event event;
  while (reader->Read(&event)) on_event(from_proto(event));
  check(reader->Finish());
}

std::string Client::preview(const std::string& job, bool denoise) {
  grpc::ClientContext context;
  set_deadline(context);
  pb::GetPreviewRequest request;
  request.set_job(job);
  if (!denoise) request.set_denoise("off");
  pb::GetPreviewReply reply;
  grpc::Status status = stub_->GetPreview(&context, request, &reply);
  if (status.error_code() == grpc::StatusCode::FAILED_PRECONDITION) return {};
  check(status);
  return std::move(*reply.mutable_png());
}

std::vector<std::string> Client::why(const std::string& job) {
  pb::WhyRequest request;
  request.set_job(job);
  const pb::WhyReply reply = call(&pb::Farm::Stub::Why, request);
  return {reply.reasons().begin(), reply.reasons().end()};
}

std::vector<pb::File> Client::files(const std::string& job) {
  pb::ListFilesRequest request;
  request.set_job(job);
  const pb::ListFilesReply reply = call(&pb::Farm::Stub::ListFiles, request);
  return {reply.files().begin(), reply.files().end()};
}

void Client::fetch_file(const std::string& job, const std::string& name,
                        const std::function<void(const std::string&)>& on_piece) {
  grpc::ClientContext context;
  pb::FetchFileRequest request;
  request.set_job(job);
  request.set_name(name);
  auto reader = stub_->FetchFile(&context, request);
  pb::FetchFileReply piece;
  std::uint64_t expected = 0, received = 0;
  while (reader->Read(&piece)) {
    expected = piece.total_bytes();
    received += piece.data().size();
    on_piece(piece.data());
  }
  check(reader->Finish());
  if (received != expected)
    throw Error::failed("file " + name + ": expected " + std::to_string(expected) + " bytes, found " +
                        std::to_string(received));
}

std::vector<coordinator::WorkerStatus> Client::workers() {
  const pb::ListWorkersReply reply = call(&pb::Farm::Stub::ListWorkers, pb::ListWorkersRequest());
  std::vector<coordinator::WorkerStatus> workers;
  for (const pb::Worker& worker : reply.workers()) workers.push_back(from_proto(worker));
  return workers;
}

}  // namespace gleaner::cli
