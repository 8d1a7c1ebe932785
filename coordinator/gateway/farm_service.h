#pragma once
// gleaner.v1.Farm: what people call.

#include <atomic>
#include <functional>
#include <map>
#include <mutex>
#include <string>

#include "coordinator/blobs/store.h"
#include "coordinator/gateway/callers.h"
#include "coordinator/gateway/previews.h"
#include "coordinator/gateway/server.h"
#include "coordinator/gateway/silence_watch.h"
#include "coordinator/jobs/farm.h"
#include "gleaner/v1/farm.grpc.pb.h"

namespace gleaner::gateway {

namespace pb = gleaner::v1;

class FarmService final : public pb::Farm::Service {
 public:
  FarmService(coordinator::Farm& farm, coordinator::BlobStore& blobs, SilenceWatch& silence, Callers& callers,
              const ServerSettings& settings)
      : farm_(farm), blobs_(blobs), silence_(silence), callers_(callers), settings_(settings) {}

  grpc::Status MissingBlobs(grpc::ServerContext*, const pb::MissingBlobsRequest*, pb::MissingBlobsReply*) override;
  grpc::Status UploadBlob(grpc::ServerContext*, grpc::ServerReader<pb::UploadBlobRequest>*,
                          pb::UploadBlobReply*) override;
  grpc::Status SubmitJob(grpc::ServerContext*, const pb::SubmitJobRequest*, pb::SubmitJobReply*) override;
  grpc::Status ListJobs(grpc::ServerContext*, const pb::ListJobsRequest*, pb::ListJobsReply*) override;
  grpc::Status GetJob(grpc::ServerContext*, const pb::GetJobRequest*, pb::Job*) override;
  grpc::Status CancelJob(grpc::ServerContext*, const pb::CancelJobRequest*, pb::Job*) override;
  grpc::Status PauseJob(grpc::ServerContext*, const pb::PauseJobRequest*, pb::Job*) override;
  grpc::Status RetryJob(grpc::ServerContext*, const pb::RetryJobRequest*, pb::Job*) override;
  grpc::Status DrainWorker(grpc::ServerContext*, const pb::DrainWorkerRequest*, pb::DrainWorkerReply*) override;
  grpc::Status WatchJob(grpc::ServerContext*, const pb::WatchJobRequest*, grpc::ServerWriter<pb::Job>*) override;
  grpc::Status WatchEvents(grpc::ServerContext*, const pb::WatchEventsRequest*,
                           grpc::ServerWriter<pb::Event>*) override;
  grpc::Status GetPreview(grpc::ServerContext*, const pb::GetPreviewRequest*, pb::GetPreviewReply*) override;
  grpc::Status Session(grpc::ServerContext*,
                       grpc::ServerReaderWriter<pb::SessionPicture, pb::SessionRequest>*) override;
  grpc::Status Why(grpc::ServerContext*, const pb::WhyRequest*, pb::WhyReply*) override;
  grpc::Status ListFiles(grpc::ServerContext*, const pb::ListFilesRequest*, pb::ListFilesReply*) override;
  grpc::Status FetchFile(grpc::ServerContext*, const pb::FetchFileRequest*,
                         grpc::ServerWriter<pb::FetchFileReply>*) override;
  grpc::Status ListWorkers(grpc::ServerContext*, const pb::ListWorkersRequest*, pb::ListWorkersReply*) override;

 private:
  // `answer`'s, of a caller that has a request left; else RESOURCE_EXHAUSTED. What it throws becomes a status. Watches,
  // uploads and downloads, which have shares of their own, open a Callers::Call instead.
  grpc::Status admitted(const grpc::ServerContext& context, const std::function<grpc::Status()>& answer);
  // Throws Error::bad_input where the frame's state is none, or not one of its base.
  // What the request says of each frame, in itself or in a blob.
  pb::JobFrames frames_of(const pb::SubmitJobRequest& request);
  void check_state(const coordinator::FrameScene& scene);
  coordinator::SceneSummary summary_of(const std::string& scene_blob, const std::string& scene_name);

  coordinator::Farm& farm_;
  coordinator::BlobStore& blobs_;
  SilenceWatch& silence_;
  Callers& callers_;
  const ServerSettings settings_;
  std::atomic<unsigned> uploads_{0}, sessions_{0};
  std::mutex summaries_mutex_;
  std::map<std::string, coordinator::SceneSummary> summaries_;  // by scene blob
  Previews previews_{farm_};
};

}  // namespace gleaner::gateway
