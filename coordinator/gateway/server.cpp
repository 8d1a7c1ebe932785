#include "coordinator/gateway/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>

#include <chrono>

#include "coordinator/gateway/convert.h"
#include "coordinator/gateway/farm_service.h"
#include "coordinator/gateway/listener.h"
#include "coordinator/gateway/silence_watch.h"
#include "coordinator/gateway/worker_hub.h"
#include "scene/model/error.h"

namespace gleaner::gateway {

namespace {

void enable_plugins() {
  static const bool once = [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    return true;
  }();
  static_cast<void>(once);
}

// What no line names, such as a call that is yet to come, is for administrators.
Role role_for(std::string_view method) {
  constexpr std::string_view farm = "/gleaner.v1.Farm/", hub = "/gleaner.v1.WorkerHub/";
  if (method.starts_with(hub)) return Role::work;
  if (method.starts_with("/grpc.health.v1.") || method.starts_with("/grpc.reflection.")) return Role::observe;
  if (!method.starts_with(farm)) return Role::administer;
  method.remove_prefix(farm.size());
  for (const std::string_view name :
       {"ListJobs", "GetJob", "WatchJob", "WatchEvents", "GetPreview", "Why", "ListFiles", "FetchFile", "ListWorkers"})
    if (method == name) return Role::observe;
  for (const std::string_view name :
       {"MissingBlobs", "UploadBlob", "SubmitJob", "CancelJob", "PauseJob", "RetryJob", "Session"})
    if (method == name) return Role::submit;
  return Role::administer;
}

}  // namespace

struct Server::Impl {
  Impl(coordinator::Farm& farm, coordinator::BlobStore& blobs, const ServerSettings& settings)
      : callers(settings.caller, settings.keys),
        farm_service(farm, blobs, silence, callers, settings),
        hub(farm, blobs, silence, callers, settings) {}

  SilenceWatch silence;
  Callers callers;
  FarmService farm_service;
  WorkerHub hub;
  std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> acceptor;
  std::unique_ptr<grpc::Server> server;
  std::unique_ptr<Listener> listener;
  std::string address;
};

Server::Server(coordinator::Farm& farm, coordinator::BlobStore& blobs, const ServerSettings& settings)
    : impl_(std::make_unique<Impl>(farm, blobs, settings)) {
  enable_plugins();
  grpc::ServerBuilder builder;
  // Peers that connect and say nothing, or nothing any more, do not keep their descriptors.
  builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, 10000);
  builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, 300000);
  // Workers behind NAT ping to keep their connection; a peer that vanished without a word is found the same way.
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 20000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10000);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 5000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  builder.SetMaxReceiveMessageSize(static_cast<int>(2 * piece_bytes));
  grpc::ResourceQuota quota("gleaner");
  // A worker takes a thread while it is connected, a call while it runs.
  quota.SetMaxThreads(static_cast<int>(settings.most_workers + 1024));
  builder.SetResourceQuota(quota);
  builder.RegisterService(&impl_->farm_service);
  builder.RegisterService(&impl_->hub);
  if (!settings.listen.empty()) {
    impl_->acceptor = builder.experimental().AddExternalConnectionAcceptor(
        grpc::ServerBuilder::experimental_type::ExternalConnectionType::FROM_FD,
        server_credentials(settings.keys, role_for, Admits::tokens_too));
    impl_->listener = std::make_unique<Listener>(settings.listen, [acceptor = impl_->acceptor.get()](int descriptor) {
      grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters connection;
      connection.fd = descriptor;
      acceptor->HandleNewConnection(&connection);
    });
  }
  impl_->server = builder.BuildAndStart();
  if (!impl_->server) throw Error::failed("gRPC does not start");
  if (!impl_->listener) return;
  impl_->address = settings.listen.substr(0, settings.listen.rfind(':') + 1) + std::to_string(impl_->listener->port());
  impl_->listener->start();
}

Server::~Server() { shutdown(); }

const std::string& Server::address() const { return impl_->address; }

std::shared_ptr<grpc::Channel> Server::in_process_channel() {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(-1);
  return impl_->server->InProcessChannel(arguments);
}

void Server::shutdown() {
  if (!impl_->server) return;
  if (impl_->listener) impl_->listener->stop();
  impl_->server->Shutdown(std::chrono::system_clock::now() + std::chrono::milliseconds(500));
  impl_->server->Wait();
}

}  // namespace gleaner::gateway
