#pragma once
// HTTP beside gRPC, for what watches the farm: / for people (dashboard.h), /healthz for probes, /metrics for
// Prometheus. Nothing of the farm can be changed by it.

#include <memory>
#include <string>
#include <vector>

#include "coordinator/jobs/farm.h"

namespace gleaner::gateway {

class HttpServer {
 public:
  // `listen` is HOST:PORT, port 0 = any free one; `names`: as web::WebSettings has them. Throws Error::usage where it
  // is not, Error::failed where it cannot be listened on.
  HttpServer(coordinator::Farm& farm, const std::string& listen, const std::vector<std::string>& names = {});
  ~HttpServer();  // ends all calls
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  const std::string& address() const;  // HOST:PORT as bound

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::gateway
