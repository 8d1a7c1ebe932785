// The listener that our pages stand on: what it answers, to whom, and with which headers.

#include "coordinator/web/web_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <httplib.h>

#include <chrono>
#include <vector>

#include "coordinator/web/page_file.h"
#include "scene/model/error.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;
using testing::Not;
using web::Answer;
using web::WebServer;

const std::vector<web::PageFile>& page() {
  static const std::vector<web::PageFile> files = {{"index.html", "<!doctype html><title>p</title>"},
                                                   {"page.css", "body {}"},
                                                   {"page.js", "1;"},
                                                   {"icon.svg", "<svg/>"}};
  return files;
}

class Web : public testing::Test {
 protected:
  Web() {
    server_.add_files("/", page());
    server_.add_files("/other/", page());
    server_.get("/echo", [](const web::Request& request) {
      const auto word = request.parameters.find("word");
      return web::text_answer(200, word == request.parameters.end() ? "" : word->second);
    });
    server_.get("/broken", [](const web::Request&) -> Answer { throw Error::failed("what nobody may read"); });
    server_.get("/empty", [](const web::Request&) { return Answer{.type = {}, .body = {}, .status = 204}; });
    server_.post("/take", [](const web::Request& request) { return web::text_answer(200, "took " + request.body); });
    server_.start();
  }
  httplib::Client client() const {
    httplib::Client client("http://" + server_.address());
    client.set_read_timeout(20);
    return client;
  }
  httplib::Result post(const httplib::Headers& headers, const std::string& type = "application/json",
                       const std::string& body = "{}") {
    return client().Post("/take", headers, body, type);
  }

  WebServer server_{{.option = "--http", .listen = "127.0.0.1:0", .threads = 4}};
};

TEST_F(Web, FilesHaveTheirTypesAndTheFolderItsIndex) {
  const std::vector<std::pair<std::string, std::string>> types = {{"/", "text/html; charset=utf-8"},
                                                                  {"/page.css", "text/css; charset=utf-8"},
                                                                  {"/page.js", "text/javascript; charset=utf-8"},
                                                                  {"/icon.svg", "image/svg+xml"},
                                                                  {"/other/", "text/html; charset=utf-8"},
                                                                  {"/other/page.js", "text/javascript; charset=utf-8"}};
  for (const auto& [path, type] : types) {
    const auto answer = client().Get(path);
    ASSERT_TRUE(answer) << path;
    EXPECT_EQ(answer->status, 200) << path;
    EXPECT_EQ(answer->get_header_value("Content-Type"), type) << path;
  }
  EXPECT_EQ(client().Get("/")->body, page()[0].text);
}

TEST_F(Web, EveryAnswerForbidsWhatPagesDoNotNeed) {
  for (const char* path : {"/", "/page.js", "/echo", "/nowhere", "/broken", "/empty", "/take"}) {
    const auto answer = client().Get(path);
    ASSERT_TRUE(answer) << path;
    const std::string policy = answer->get_header_value("Content-Security-Policy");
    EXPECT_THAT(policy, HasSubstr("default-src 'none'")) << path;
    EXPECT_THAT(policy, HasSubstr("script-src 'self'")) << path;
    EXPECT_THAT(policy, HasSubstr("frame-ancestors 'none'")) << path;
    EXPECT_THAT(policy, Not(HasSubstr("unsafe"))) << path;
    EXPECT_THAT(policy, Not(HasSubstr("http"))) << path;  // no other server
    EXPECT_EQ(answer->get_header_value("X-Content-Type-Options"), "nosniff") << path;
    EXPECT_EQ(answer->get_header_value("Referrer-Policy"), "no-referrer") << path;
    EXPECT_EQ(answer->get_header_value("Cross-Origin-Resource-Policy"), "same-origin") << path;
    EXPECT_FALSE(answer->has_header("Access-Control-Allow-Origin")) << path;
  }
}

TEST_F(Web, UnknownPathsAndWrongMethods) {
  for (const char* path : {"/nowhere", "/page.js/", "/other", "/../etc/passwd", "/%2e%2e/etc/passwd", "//", "/PAGE.JS"})
    EXPECT_EQ(client().Get(path)->status, 404) << path;
  EXPECT_EQ(client().Post("/", "{}", "application/json")->status, 405);
  EXPECT_EQ(client().Put("/page.js", "{}", "application/json")->status, 405);
  EXPECT_EQ(client().Delete("/echo")->status, 405);
  EXPECT_EQ(client().Options("/echo")->status, 405);
  EXPECT_EQ(client().Delete("/echo")->get_header_value("Allow"), "GET, HEAD");
  EXPECT_EQ(client().Get("/take")->status, 405);
  EXPECT_EQ(client().Get("/take")->get_header_value("Allow"), "POST");
  EXPECT_EQ(client().Post("/nowhere", "{}", "application/json")->status, 404);
}

TEST_F(Web, HeadIsGetWithoutTheBody) {
  const auto head = client().Head("/page.css");
  ASSERT_TRUE(head);
  EXPECT_EQ(head->status, 200);
  EXPECT_TRUE(head->body.empty());
  EXPECT_EQ(head->get_header_value("Content-Length"), "7");
  EXPECT_EQ(head->get_header_value("ETag"), client().Get("/page.css")->get_header_value("ETag"));
}

TEST_F(Web, WhoHasAFileAlreadyGetsNone) {
  const auto first = client().Get("/page.js");
  ASSERT_TRUE(first);
  const std::string tag = first->get_header_value("ETag");
  ASSERT_FALSE(tag.empty());
  EXPECT_NE(tag, client().Get("/page.css")->get_header_value("ETag"));
  EXPECT_EQ(first->get_header_value("Cache-Control"), "no-cache");
  const auto again = client().Get("/page.js", {{"If-None-Match", tag}});
  ASSERT_TRUE(again);
  EXPECT_EQ(again->status, 304);
  EXPECT_TRUE(again->body.empty());
  EXPECT_EQ(client().Get("/page.js", {{"If-None-Match", "\"other\", " + tag}})->status, 304);
  EXPECT_EQ(client().Get("/page.js", {{"If-None-Match", "\"other\""}})->status, 200);
  EXPECT_EQ(client().Get("/echo", {{"If-None-Match", "*"}})->status, 200);  // it has no tag
  EXPECT_EQ(client().Get("/echo")->get_header_value("Cache-Control"), "no-store");
}

// Brotli as the library does it takes a hundred times as long: a peer that asks every second would keep a core busy.
TEST_F(Web, WhatIsPackedIsPackedByGzip) {
  const std::vector<std::pair<std::string, std::string>> asked = {
      {"gzip", "gzip"}, {"gzip, deflate, br", "gzip"}, {"br", ""}, {"br;q=1, gzip;q=0.5", "gzip"}, {"identity", ""}};
  for (const auto& [accepts, gets] : asked) {
    const auto answer = client().Get("/page.css", {{"Accept-Encoding", accepts}});
    ASSERT_TRUE(answer) << accepts;
    EXPECT_EQ(answer->get_header_value("Content-Encoding"), gets) << accepts;
    EXPECT_EQ(answer->body, page()[1].text) << accepts;
  }
}

TEST_F(Web, ParametersAreDecodedAndErrorsAreNotTold) {
  EXPECT_EQ(client().Get("/echo?word=a%20%3Cb%3E&x=1")->body, "a <b>");
  EXPECT_EQ(client().Get("/empty")->status, 204);
  const auto broken = client().Get("/broken");
  ASSERT_TRUE(broken);
  EXPECT_EQ(broken->status, 500);
  EXPECT_THAT(broken->body, Not(HasSubstr("nobody")));
  for (const auto& [name, value] : broken->headers) EXPECT_THAT(value, Not(HasSubstr("nobody"))) << name;
}

TEST(WebHost, NamesOfThisMachine) {
  for (const char* host : {"localhost", "localhost:8781", "LOCALHOST:1", "127.0.0.1", "127.0.0.1:8781", "127.1.2.3:80",
                           "[::1]", "[::1]:8781", "198.18.0.1:8781"})
    EXPECT_TRUE(web::is_own_host(host)) << host;
  for (const char* host : {"", ":80", "evil.example", "evil.example:8781", "localhost.evil.example:8781",
                           "localhost.:80", "127.0.0.1.evil.example", "evil.example:127.0.0.1", "[evil.example]:80",
                           "[::1", "2130706433", "127.1:80", "user@127.0.0.1:80"})
    EXPECT_FALSE(web::is_own_host(host)) << host;
}

// A site whose name is pointed at 127.0.0.1 could else read what is shown here.
TEST_F(Web, OnLoopbackOtherNamesAreRefused) {
  const std::string port = server_.address().substr(server_.address().rfind(':'));
  for (const std::string& host : {"localhost" + port, "127.0.0.1" + port, "[::1]" + port})
    EXPECT_EQ(client().Get("/", {{"Host", host}})->status, 200) << host;
  const auto refused = client().Get("/", {{"Host", "evil.example" + port}});
  ASSERT_TRUE(refused);
  EXPECT_EQ(refused->status, 403);
  EXPECT_THAT(refused->body, Not(HasSubstr("<title>")));
}

TEST(WebListener, WhoListensForOthersGoesByAnyName) {
  WebServer server({.option = "--http", .listen = "0.0.0.0:0"});
  server.add_files("/", page());
  server.start();
  httplib::Client client("http://127.0.0.1" + server.address().substr(server.address().rfind(':')));
  EXPECT_EQ(client.Get("/", {{"Host", "farm.example:8781"}})->status, 200);
}

TEST(WebListener, WhoIsToldItsNamesGoesByNoOther) {
  WebServer server({.option = "--http", .listen = "0.0.0.0:0", .names = {"farm", "farm.example"}});
  server.add_files("/", page());
  server.start();
  httplib::Client client("http://127.0.0.1" + server.address().substr(server.address().rfind(':')));
  for (const char* host : {"farm", "FARM:8781", "farm.example:8781", "localhost:1", "198.18.0.1:8781"})
    EXPECT_EQ(client.Get("/", {{"Host", host}})->status, 200) << host;
  for (const char* host : {"evil.example:8781", "farm.example.evil:8781", "x.farm:8781"})
    EXPECT_EQ(client.Get("/", {{"Host", host}})->status, 403) << host;
}

TEST_F(Web, PostsComeFromThisServersPagesAndAreJson) {
  EXPECT_EQ(post({})->body, "took {}");
  EXPECT_EQ(post({{"Origin", "http://" + server_.address()}})->status, 200);
  EXPECT_EQ(post({}, "application/json; charset=utf-8")->status, 200);
  for (const char* origin : {"http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1"})
    EXPECT_EQ(post({{"Origin", origin}})->status, 403) << origin;
  // What a form or a fetch without a preflight can send.
  for (const char* type : {"text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"})
    EXPECT_EQ(post({}, type)->status, 415) << type;
  const auto large = post({}, "application/json", std::string(1 << 20, ' '));
  if (large) {
    EXPECT_EQ(large->status, 413);
  }
  EXPECT_EQ(post({})->status, 200);
}

// More connections that say nothing than there are threads, as browsers open ahead of their requests.
TEST_F(Web, SilentConnectionsDoNotKeepOthersWaiting) {
  std::vector<int> silent;
  const auto port = static_cast<std::uint16_t>(std::stoi(server_.address().substr(server_.address().rfind(':') + 1)));
  for (int k = 0; k < 8; ++k) {
    const int socket = ::socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    to.sin_port = htons(port);
    ASSERT_EQ(::connect(socket, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
    silent.push_back(socket);
  }
  const auto begun = std::chrono::steady_clock::now();
  const auto answer = client().Get("/page.js");
  ASSERT_TRUE(answer) << httplib::to_string(answer.error());
  EXPECT_EQ(answer->status, 200);
  // Two rounds of silence; a library that keeps connections waits five seconds for each.
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(8));
  for (const int socket : silent) ::close(socket);
  EXPECT_EQ(client().Get("/page.js")->get_header_value("Connection"), "close");
}

TEST(WebListener, APortThatIsTakenAndWordsThatAreNoAddress) {
  const WebServer server({.option = "--http", .listen = "127.0.0.1:0"});
  EXPECT_THROW(WebServer({.option = "--http", .listen = server.address()}), Error);
  try {
    WebServer({.option = "--web", .listen = "nowhere"});
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::usage);
    EXPECT_THAT(error.what(), HasSubstr("--web: expected HOST:PORT"));
  }
}

}  // namespace
}  // namespace gleaner::test
