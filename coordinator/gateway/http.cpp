#include "coordinator/gateway/http.h"

#include <httplib.h>
#include <sys/socket.h>

#include <thread>

#include "coordinator/gateway/address.h"
#include "coordinator/gateway/metrics_page.h"
#include "scene/model/error.h"

namespace gleaner::gateway {

namespace {

constexpr std::size_t threads = 8;
constexpr int patience_seconds = 5;            // with a peer that neither asks nor reads
constexpr std::size_t largest_body = 1 << 10;  // nobody has anything to send

}  // namespace

struct HttpServer::Impl {
  httplib::Server server;
  std::string address;
  std::thread thread;
};

HttpServer::HttpServer(const coordinator::Farm& farm, const std::string& listen) : impl_(std::make_unique<Impl>()) {
  const ListenAddress wanted = parse_listen_address("--http", listen);
  httplib::Server& server = impl_->server;
  server.new_task_queue = [] { return new httplib::ThreadPool(threads); };
  // Not SO_REUSEPORT, the library's default: a second coordinator would take half of the first one's calls.
  server.set_socket_options([](socket_t socket) {
    const int yes = 1;
    ::setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  });
  server.set_read_timeout(patience_seconds);
  server.set_write_timeout(patience_seconds);
  server.set_payload_max_length(largest_body);
  server.Get("/healthz", [&farm](const httplib::Request&, httplib::Response& response) {
    // Asks the farm itself: a coordinator whose engine hangs does not answer.
    farm.workers();
    response.set_content("ok\n", "text/plain");
  });
  server.Get("/metrics", [&farm](const httplib::Request&, httplib::Response& response) {
    response.set_content(metrics_page(farm), "text/plain; version=0.0.4; charset=utf-8");
  });

  const std::string host = wanted.host.empty() ? "0.0.0.0" : wanted.host;
  int port = wanted.port;
  if (port == 0)
    port = server.bind_to_any_port(host);
  else if (!server.bind_to_port(host, port))
    port = -1;
  if (port < 0)
    throw Error::failed("cannot listen on " + listen + ": is the port taken, or the address not this machine's?");
  impl_->address = listen.substr(0, listen.rfind(':') + 1) + std::to_string(port);
  impl_->thread = std::thread([&server] { server.listen_after_bind(); });
  // stop() does nothing to a server that does not run yet.
  while (!server.is_running()) std::this_thread::yield();
}

HttpServer::~HttpServer() {
  impl_->server.stop();
  impl_->thread.join();
}

const std::string& HttpServer::address() const { return impl_->address; }

}  // namespace gleaner::gateway
