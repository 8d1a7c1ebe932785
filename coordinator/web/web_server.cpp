#include "coordinator/web/web_server.h"

#include <arpa/inet.h>
#include <httplib.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <ctime>
#include <optional>
#include <span>
#include <thread>
#include <utility>

#include "coordinator/gateway/address.h"
#include "proto/sha256.h"
#include "scene/model/error.h"

namespace gleaner::web {

namespace {

constexpr int patience_seconds = 5;  // with a peer that neither asks nor reads
// Browsers open connections before they know what for, and keep those that were answered. Each would hold a thread, and
// health checks would wait: a connection is for one request, which begins soon.
constexpr std::size_t requests_a_connection = 1;
constexpr int first_byte_seconds = 2;

// What of a page may come from where. Nothing but this server's own files, no script or style within them.
constexpr const char* content_policy =
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

std::string type_of(std::string_view path) {
  constexpr std::array<std::pair<std::string_view, const char*>, 4> types = {{{".html", "text/html; charset=utf-8"},
                                                                              {".css", "text/css; charset=utf-8"},
                                                                              {".js", "text/javascript; charset=utf-8"},
                                                                              {".svg", "image/svg+xml"}}};
  for (const auto& [ending, type] : types)
    if (path.ends_with(ending)) return type;
  throw Error::failed(std::string(path) + ": a page's file of no known type");
}

std::string http_date() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  char text[64];
  if (!::gmtime_r(&now, &parts) || std::strftime(text, sizeof text, "%a, %d %b %Y %H:%M:%S GMT", &parts) == 0)
    return {};
  return text;
}

// The library prefers Brotli, at its slowest: 30 ms for 16 kB, which gzip packs in a fraction of one. `request` is the
// library's own, which it reads again when it packs the answer.
void forgo_brotli(const httplib::Request& request) {
  const auto [first, last] = request.headers.equal_range("Accept-Encoding");
  for (auto header = first; header != last; ++header)
    if (header->second.find("br") != std::string::npos)
      const_cast<std::string&>(header->second) = header->second.find("gzip") == std::string::npos ? "identity" : "gzip";
}

// Among the tags of an If-None-Match header.
bool has_tag(const std::string& header, const std::string& tag) {
  return !tag.empty() && (header == "*" || header.find("\"" + tag + "\"") != std::string::npos);
}

}  // namespace

std::string tag_of(std::string_view bytes) {
  return sha256_hex(std::as_bytes(std::span(bytes.data(), bytes.size()))).substr(0, 32);
}

bool is_own_host(const std::string& header) {
  std::string host =
      header.substr(0, header.find(']') == std::string::npos ? header.rfind(':') : header.rfind(']') + 1);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    in6_addr ignored{};
    return ::inet_pton(AF_INET6, host.substr(1, host.size() - 2).c_str(), &ignored) == 1;
  }
  in_addr ignored{};
  return ::strcasecmp(host.c_str(), "localhost") == 0 || ::inet_pton(AF_INET, host.c_str(), &ignored) == 1;
}

struct WebServer::Impl {
  struct Path {
    Handler get, post;
  };

  // The answer where it needs no body of the request; none: a POST, whose body is to be read.
  std::optional<Answer> answer(const httplib::Request& request) const {
    if (known_hosts_alone && request.has_header("Host") && !is_known(request.get_header_value("Host")))
      return text_answer(403, "this is no name of this listener: ask for localhost, 127.0.0.1 or an address\n");
    const auto path = paths.find(path_of(request));
    if (path == paths.end()) return text_answer(404, "there is nothing here\n");
    const auto& [get, post] = path->second;
    if (get && (request.method == "GET" || request.method == "HEAD")) return get(request_of(request));
    if (!post || request.method != "POST") {
      Answer refusal = text_answer(405, "not with this method\n");
      refusal.headers["Allow"] = get ? "GET, HEAD" : "POST";
      return refusal;
    }
    // Other sites' pages can post without asking, but neither JSON nor without their names.
    const std::string origin = request.get_header_value("Origin");
    if (!origin.empty() && origin != "http://" + request.get_header_value("Host"))
      return text_answer(403, "this is for pages of this listener's own\n");
    if (!request.get_header_value("Content-Type").starts_with("application/json"))
      return text_answer(415, "application/json alone\n");
    return std::nullopt;
  }

  // Below the secret folder; empty: the request does not know it. How long it takes says nothing of how much was right.
  std::string path_of(const httplib::Request& request) const {
    if (secret.empty()) return request.path;
    const std::string folder = "/" + secret + "/";
    if (request.path.size() < folder.size()) return {};
    unsigned differ = 0;
    for (std::size_t k = 0; k < folder.size(); ++k)
      differ |= static_cast<unsigned char>(request.path[k]) ^ static_cast<unsigned char>(folder[k]);
    return differ == 0 ? request.path.substr(folder.size() - 1) : std::string();
  }

  bool is_known(const std::string& host) const {
    const std::string name = host.substr(0, host.rfind(':'));
    return is_own_host(host) || std::ranges::find_if(names, [&](const std::string& known) {
                                  return ::strcasecmp(known.c_str(), name.c_str()) == 0;
                                }) != names.end();
  }

  static Request request_of(const httplib::Request& request) {
    return {.parameters = {request.params.begin(), request.params.end()},
            .body = request.body,
            .host = request.get_header_value("Host"),
            .origin = request.get_header_value("Origin")};
  }

  static void give(const httplib::Request& request, Answer answer, httplib::Response& response) {
    response.status = answer.status;
    for (const auto& [name, value] : answer.headers) response.set_header(name, value);
    response.set_header("Date", http_date());
    response.set_header("Cache-Control", answer.tag.empty() ? "no-store" : "no-cache");
    if (!answer.tag.empty()) response.set_header("ETag", "W/\"" + answer.tag + "\"");
    if (has_tag(request.get_header_value("If-None-Match"), answer.tag))
      response.status = 304;
    else if (answer.status != 204)
      response.set_content(std::move(answer.body), answer.type);
  }

  httplib::Server server;
  std::string address;
  std::string secret;
  std::vector<std::string> names;
  bool known_hosts_alone = false;
  std::map<std::string, Path> paths;
  std::thread thread;
};

WebServer::WebServer(const WebSettings& settings) : impl_(std::make_unique<Impl>()) {
  const gateway::ListenAddress wanted = gateway::parse_listen_address(settings.option, settings.listen);
  impl_->secret = settings.secret;
  impl_->names = settings.names;
  impl_->known_hosts_alone = gateway::is_loopback(wanted) || !settings.names.empty();
  httplib::Server& server = impl_->server;
  server.new_task_queue = [threads = settings.threads] { return new httplib::ThreadPool(threads); };
  // Not SO_REUSEPORT, the library's default: a second process would take half of the first one's calls.
  server.set_socket_options([](socket_t socket) {
    const int yes = 1;
    ::setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  });
  server.set_read_timeout(patience_seconds);
  server.set_write_timeout(patience_seconds);
  server.set_keep_alive_max_count(requests_a_connection);
  server.set_keep_alive_timeout(first_byte_seconds);
  server.set_payload_max_length(settings.largest_body);
  server.set_tcp_nodelay(true);
  server.set_default_headers({{"Content-Security-Policy", content_policy},
                              {"X-Content-Type-Options", "nosniff"},
                              {"Referrer-Policy", "no-referrer"},
                              {"Cross-Origin-Resource-Policy", "same-origin"},
                              {"Cross-Origin-Opener-Policy", "same-origin"}});
  server.set_exception_handler([](const httplib::Request&, httplib::Response& response, const std::exception_ptr&) {
    response.status = 500;
    response.set_content("the request failed\n", "text/plain; charset=utf-8");
  });

  const std::string host = wanted.host.empty() ? "0.0.0.0" : wanted.host;
  int port = wanted.port;
  if (port == 0)
    port = server.bind_to_any_port(host);
  else if (!server.bind_to_port(host, port))
    port = -1;
  if (port < 0)
    throw Error::failed("cannot listen on " + settings.listen +
                        ": is the port taken, or the address not this machine's?");
  impl_->address = settings.listen.substr(0, settings.listen.rfind(':') + 1) + std::to_string(port);
}

WebServer::~WebServer() { stop(); }

void WebServer::get(const std::string& path, Handler handler) { impl_->paths[path].get = std::move(handler); }

void WebServer::post(const std::string& path, Handler handler) { impl_->paths[path].post = std::move(handler); }

void WebServer::add_files(const std::string& folder, const std::vector<PageFile>& files) {
  for (const PageFile& file : files) {
    const std::string path = folder + (file.path == "index.html" ? std::string() : std::string(file.path));
    const Answer answer{
        .type = type_of(file.path), .body = std::string(file.text), .status = 200, .tag = tag_of(file.text)};
    get(path, [answer](const Request&) { return answer; });
  }
}

void WebServer::start() {
  httplib::Server& server = impl_->server;
  // What needs no body is answered before one is read.
  server.set_pre_routing_handler([this](const httplib::Request& request, httplib::Response& response) {
    forgo_brotli(request);
    std::optional<Answer> answer = impl_->answer(request);
    if (!answer) return httplib::Server::HandlerResponse::Unhandled;
    Impl::give(request, std::move(*answer), response);
    return httplib::Server::HandlerResponse::Handled;
  });
  server.Post("/.*", [this](const httplib::Request& request, httplib::Response& response) {
    Impl::give(request, impl_->paths.at(impl_->path_of(request)).post(Impl::request_of(request)), response);
  });
  impl_->thread = std::thread([&server] { server.listen_after_bind(); });
  // stop() does nothing to a server that does not run yet.
  while (!server.is_running()) std::this_thread::yield();
}

void WebServer::stop() {
  if (!impl_->thread.joinable()) return;
  impl_->server.stop();
  impl_->thread.join();
}

const std::string& WebServer::address() const { return impl_->address; }

}  // namespace gleaner::web
