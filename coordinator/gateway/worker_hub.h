#pragma once
// gleaner.v1.WorkerHub: a stream a worker.

#include <atomic>

#include "coordinator/artifacts/relay.h"
#include "coordinator/blobs/store.h"
#include "coordinator/gateway/callers.h"
#include "coordinator/gateway/server.h"
#include "coordinator/gateway/silence_watch.h"
#include "coordinator/jobs/farm.h"
#include "gleaner/v1/worker.grpc.pb.h"

namespace gleaner::gateway {

namespace pb = gleaner::v1;

class WorkerHub final : public pb::WorkerHub::Service {
 public:
  WorkerHub(coordinator::Farm& farm, coordinator::BlobStore& blobs, SilenceWatch& silence, Callers& callers,
            const ServerSettings& settings)
      : farm_(farm), blobs_(blobs), silence_(silence), callers_(callers), settings_(settings) {}

  grpc::Status Work(grpc::ServerContext*, grpc::ServerReaderWriter<pb::HubMessage, pb::WorkerMessage>*) override;
  grpc::Status FetchBlob(grpc::ServerContext*, const pb::FetchBlobRequest*,
                         grpc::ServerWriter<pb::BlobPiece>*) override;
  grpc::Status LocateArtifact(grpc::ServerContext*, const pb::LocateArtifactRequest*,
                              pb::LocateArtifactReply*) override;
  grpc::Status FetchPart(grpc::ServerContext*, const pb::FetchPartRequest*,
                         grpc::ServerWriter<pb::PartPiece>*) override;
  grpc::Status DeliverPart(grpc::ServerContext*, const pb::DeliverPartRequest*, pb::DeliverPartReply*) override;

 private:
  coordinator::Farm& farm_;
  coordinator::BlobStore& blobs_;
  coordinator::Relay relay_;
  SilenceWatch& silence_;
  Callers& callers_;
  const ServerSettings settings_;
  std::atomic<unsigned> workers_{0};
};

}  // namespace gleaner::gateway
