#pragma once
// HTTP for browsers and probes: what every page of ours stands on. Pages get nothing from other servers and run no
// script but their own files (Content-Security-Policy), no other site may frame or embed them. A listener on loopback,
// or one that is told its names, answers to no other name: nobody can point a site's name at it and read what it shows
// with that site's scripts (DNS rebinding).

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "coordinator/web/page_file.h"

namespace gleaner::web {

struct Request {
  std::map<std::string, std::string> parameters;  // of the query
  std::string body;
  std::string host, origin;  // headers; empty where they are not there
};

struct Answer {
  std::string type, body;
  int status = 200;
  // Names the body: who has it already gets none. Empty: it is always sent, and never kept.
  std::string tag{};
  std::map<std::string, std::string> headers{};  // further ones
};
inline Answer text_answer(int status, const std::string& words) { return {"text/plain; charset=utf-8", words, status}; }

// A tag for what these bytes are.
std::string tag_of(std::string_view bytes);

// Whether a Host header names this machine by "localhost" or by an address: a site's name does neither.
bool is_own_host(const std::string& host);

struct WebSettings {
  std::string option;  // that asked for it, for messages
  std::string listen;  // HOST:PORT, port 0 = any free one
  // By which it may be asked for, beside localhost and addresses. None: by any, but on loopback by no other.
  std::vector<std::string> names{};
  // All paths lie below the folder of this name, which is told to those alone who may come. Empty: they do not.
  std::string secret{};
  std::size_t threads = 8;
  std::size_t largest_body = 1 << 10;
};

class WebServer {
 public:
  using Handler = std::function<Answer(const Request&)>;

  // Binds. Throws Error::usage where `listen` is no HOST:PORT, Error::failed where it cannot be listened on.
  explicit WebServer(const WebSettings& settings);
  ~WebServer();  // ends all calls
  WebServer(const WebServer&) = delete;
  WebServer& operator=(const WebServer&) = delete;

  // Before start(). Handlers are called from several threads at once. Other methods than a path's are refused (405).
  void get(const std::string& path, Handler handler);   // HEAD as well
  void post(const std::string& path, Handler handler);  // of JSON, by a page of this server's own
  // Files below `folder`, which ends with "/"; its index.html is the folder itself.
  void add_files(const std::string& folder, const std::vector<PageFile>& files);
  void start();
  void stop();  // waits for the calls that are being answered

  const std::string& address() const;  // HOST:PORT as bound

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::web
