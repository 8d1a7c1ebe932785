#include "coordinator/gateway/http.h"

#include "coordinator/gateway/dashboard.h"
#include "coordinator/gateway/metrics_page.h"
#include "coordinator/web/web_server.h"

namespace gleaner::gateway {

struct HttpServer::Impl {
  Impl(coordinator::Farm& farm, const std::string& listen, const std::vector<std::string>& names)
      : dashboard(farm), server({.option = "--http", .listen = listen, .names = names}) {}

  Dashboard dashboard;
  web::WebServer server;  // ends before what it calls
};

HttpServer::HttpServer(coordinator::Farm& farm, const std::string& listen, const std::vector<std::string>& names)
    : impl_(std::make_unique<Impl>(farm, listen, names)) {
  web::WebServer& server = impl_->server;
  server.get("/healthz", [&farm](const web::Request&) {
    // Asks the farm itself: a coordinator whose engine hangs does not answer.
    farm.totals();
    return web::text_answer(200, "ok\n");
  });
  server.get("/metrics", [&farm](const web::Request&) {
    return web::Answer{.type = "text/plain; version=0.0.4; charset=utf-8", .body = metrics_page(farm)};
  });
  impl_->dashboard.add_to(server);
  server.start();
}

HttpServer::~HttpServer() = default;

const std::string& HttpServer::address() const { return impl_->server.address(); }

}  // namespace gleaner::gateway
