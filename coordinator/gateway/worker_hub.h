#pragma once
// gleaner.v1.WorkerHub: a stream a worker.

#include <atomic>

#include "coordinator/blobs/store.h"
#include "coordinator/jobs/farm.h"
#include "gleaner/v1/worker.grpc.pb.h"

namespace gleaner::gateway {

namespace pb = gleaner::v1;

class WorkerHub final : public pb::WorkerHub::Service {
 public:
  WorkerHub(coordinator::Farm& farm, coordinator::BlobStore& blobs, unsigned most_workers, double heartbeat_seconds)
      : farm_(farm), blobs_(blobs), most_workers_(most_workers), heartbeat_seconds_(heartbeat_seconds) {}

  grpc::Status Work(grpc::ServerContext*, grpc::ServerReaderWriter<pb::HubMessage, pb::WorkerMessage>*) override;
  grpc::Status FetchBlob(grpc::ServerContext*, const pb::FetchBlobRequest*,
                         grpc::ServerWriter<pb::BlobPiece>*) override;

 private:
  coordinator::Farm& farm_;
  coordinator::BlobStore& blobs_;
  unsigned most_workers_;
  double heartbeat_seconds_;
  std::atomic<unsigned> workers_{0};
};

}  // namespace gleaner::gateway
