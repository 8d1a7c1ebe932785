#pragma once
// Between the wire's messages and the farm's structs, both ways; what comes from the wire is checked here.

#include <grpcpp/support/status.h>

#include <functional>

#include "coordinator/jobs/event_log.h"
#include "coordinator/jobs/job.h"
#include "gleaner/v1/farm.pb.h"
#include "gleaner/v1/worker.pb.h"
#include "proto/protocol.h"

namespace gleaner::gateway {

namespace pb = gleaner::v1;

gleaner::v1::Camera to_proto(const scene::Camera& camera);
scene::Camera from_proto(const gleaner::v1::Camera& camera);  // throws as below
pb::FrameSettings to_proto(const coordinator::FrameSettings& settings);
// Throws Error::bad_input naming the field.
coordinator::FrameSettings from_proto(const pb::FrameSettings& settings);

pb::Job to_proto(const coordinator::JobStatus& status);
coordinator::JobStatus from_proto(const pb::Job& job);

pb::Worker to_proto(const coordinator::WorkerStatus& status);
coordinator::WorkerStatus from_proto(const pb::Worker& worker);

pb::Device to_proto(const coordinator::DeviceDescription& device);
coordinator::DeviceDescription from_proto(const pb::Device& device);

// Throws Error::bad_input naming the field.
coordinator::WorkerHello from_proto(const pb::Hello& hello);
coordinator::BatchCost from_proto(const pb::BatchCost& cost);
coordinator::BatchOutput::Retained from_proto(const pb::RetainedPart& part);

pb::Event to_proto(const coordinator::FarmEvent& event);
coordinator::FarmEvent from_proto(const pb::Event& event);

// Runs a handler's body; what it throws becomes the call's status.
grpc::Status guarded(const std::function<grpc::Status()>& body);

}  // namespace gleaner::gateway
