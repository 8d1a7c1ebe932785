#pragma once
// HTTP beside gRPC, for what watches the farm: /healthz for probes, /metrics for Prometheus.

#include <memory>
#include <string>

#include "coordinator/jobs/farm.h"

namespace gleaner::gateway {

class HttpServer {
 public:
  // `listen` is HOST:PORT, port 0 = any free one. Throws Error::usage where it is not, Error::failed where it cannot be
  // listened on.
  HttpServer(const coordinator::Farm& farm, const std::string& listen);
  ~HttpServer();  // ends all calls
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  const std::string& address() const;  // HOST:PORT as bound

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::gateway
