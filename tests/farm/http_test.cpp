// What probes and Prometheus get over HTTP, and which addresses other machines can reach.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <httplib.h>

#include <regex>
#include <set>

#include "coordinator/gateway/address.h"
#include "coordinator/gateway/http.h"
#include "coordinator/gateway/metrics_page.h"
#include "tests/farm/wire_farm.h"

namespace gleaner::test {
namespace {

using gateway::escape_label;
using gateway::is_loopback;
using gateway::parse_listen_address;
using testing::HasSubstr;
using testing::Not;

bool loopback(const std::string& text) { return is_loopback(parse_listen_address("--listen", text)); }

TEST(ListenAddress, ThisMachineAloneOrOthersToo) {
  for (const char* text : {"127.0.0.1:0", "127.3.2.1:8780", "localhost:80", "[::1]:80", "[::ffff:127.0.0.1]:1"})
    EXPECT_TRUE(loopback(text)) << text;
  for (const char* text : {"0.0.0.0:0", ":8780", "[::]:8780", "198.18.0.1:80", "[::ffff:198.18.0.1]:80",
                           "[2001:db8::1]:80", "no-such-host.invalid:80", "128.0.0.1:80"})
    EXPECT_FALSE(loopback(text)) << text;
}

TEST(ListenAddress, AnythingElseIsWrongUsage) {
  for (const char* text :
       {"", "8780", "127.0.0.1", "127.0.0.1:", "127.0.0.1:-1", "127.0.0.1:65536", "127.0.0.1:http", "127.0.0.1:80 ",
        "::1:80", "unix:/tmp/socket", "http://127.0.0.1:80", "[]:80", "127.0.0.1:99999999999999999999"}) {
    try {
      parse_listen_address("--listen", text);
      ADD_FAILURE() << "accepted: " << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::usage);
      EXPECT_THAT(error.what(), HasSubstr("--listen: expected HOST:PORT"));
    }
  }
}

TEST(MetricsPage, LabelsAreEscapedAndUtf8) {
  EXPECT_EQ(escape_label("plain"), "plain");
  EXPECT_EQ(escape_label("a\"b\\c\nd"), "a\\\"b\\\\c\\nd");
  EXPECT_EQ(escape_label("caf\xc3\xa9 \xe2\x82\xac \xf0\x9f\x98\x80"), "caf\xc3\xa9 \xe2\x82\xac \xf0\x9f\x98\x80");
  EXPECT_EQ(escape_label("cut \xe2\x82"), "cut ??");
  EXPECT_EQ(escape_label("\xff\x80 \xc0\xaf"), "?? ??");
  EXPECT_EQ(escape_label("\xe0\x80\x80"), "???");       // longer than it must be
  EXPECT_EQ(escape_label("\xed\xa0\x80"), "???");       // a surrogate
  EXPECT_EQ(escape_label("\xf4\x90\x80\x80"), "????");  // past the last character
}

class Http : public testing::Test {
 protected:
  httplib::Client client() const {
    httplib::Client client("http://" + http_.address());
    client.set_read_timeout(20);
    return client;
  }
  std::string metrics() const {
    auto answer = client().Get("/metrics");
    return answer ? answer->body : "no answer: " + httplib::to_string(answer.error());
  }

  // A worker that joined and never works.
  class Idle final : public coordinator::WorkerSession {
   public:
    void welcome(const std::string&) override {}
    void lease(const coordinator::Lease& lease, std::shared_ptr<const coordinator::StageWork>) override {
      last = lease;
      ++leases;
    }
    void revoke(const coordinator::Lease&) override {}
    void drain() override {}
    void release(const std::vector<coordinator::ArtifactId>&) override {}
    void drop_part(const coordinator::ArtifactId&, std::uint64_t, const std::string&) override {}
    void send_part(std::uint64_t, const coordinator::PartRange&) override {}
    void close(const std::string&) override {}
    coordinator::Lease last;
    int leases = 0;
  };

  std::string submit() {
    pb::Farm::Stub people(farm_.socket_channel());
    grpc::ClientContext context;
    pb::SubmitJobReply reply;
    EXPECT_TRUE(people.SubmitJob(&context, farm_.good_request(), &reply).ok());
    return reply.job();
  }

  WireFarm farm_;
  gateway::HttpServer http_{farm_.farm(), "127.0.0.1:0"};
};

TEST_F(Http, HealthAndWhatElseIsAsked) {
  auto health = client().Get("/healthz");
  ASSERT_TRUE(health);
  EXPECT_EQ(health->status, 200);
  EXPECT_EQ(health->body, "ok\n");
  auto other = client().Get("/../etc/passwd");
  ASSERT_TRUE(other);
  EXPECT_EQ(other->status, 404);
  auto posted = client().Post("/metrics", std::string(1 << 20, 'x'), "text/plain");
  if (posted) {
    EXPECT_GE(posted->status, 400);
  }
  EXPECT_EQ(client().Get("/healthz")->status, 200);
}

TEST_F(Http, APortThatIsTakenIsSaid) {
  EXPECT_THROW(gateway::HttpServer(farm_.farm(), http_.address()), Error);
  EXPECT_THROW(gateway::HttpServer(farm_.farm(), "nowhere"), Error);
}

TEST_F(Http, MetricsTellWorkersFramesJobsAndBatches) {
  EXPECT_THAT(metrics(), HasSubstr("gleaner_workers{state=\"serving\"} 0\n"));
  EXPECT_THAT(metrics(), HasSubstr("gleaner_frames_queued 0\n"));

  coordinator::WorkerHello hello{.name = "idle", .address = "", .device = {}, .needs_bvh = false};
  hello.device.name = "a \"device\"\n\xff";
  hello.device.tracer = "none";
  auto session = std::make_shared<Idle>();
  const auto worker = farm_.farm().join(hello, session).id;
  const std::string job = submit();
  ASSERT_TRUE(eventually([&] { return farm_.farm().workers().at(0).leases > 0; }));
  std::string page = metrics();
  EXPECT_THAT(page, HasSubstr("gleaner_workers{state=\"serving\"} 1\n"));
  EXPECT_THAT(page, HasSubstr("gleaner_frames_queued 1\n"));
  EXPECT_THAT(page, HasSubstr("gleaner_jobs{state=\"running\"} 1\n"));
  EXPECT_THAT(page, HasSubstr("gleaner_batches_in_flight 2\n"));
  EXPECT_THAT(page, HasSubstr("gleaner_batches_total{end=\"accepted\"} 0\n"));
  EXPECT_THAT(page, HasSubstr("gleaner_items_per_second{kind=\"fake-scatter\"}"));
  EXPECT_THAT(page,
              HasSubstr("gleaner_worker_info{worker=\"idle\",device=\"a \\\"device\\\"\\n?\",tracer=\"none\"} 1\n"));

  farm_.farm().failed(worker, session->last.id, session->last.epoch, "no");
  page = metrics();
  EXPECT_THAT(page, HasSubstr("gleaner_batches_total{end=\"failed\"} 1\n"));

  const auto lease = session->last;
  const auto seed = fake_settings().seed;
  EXPECT_EQ(farm_.farm().result(worker, lease.id, lease.epoch, fake_scatter(seed, lease.first, lease.count), {}),
            coordinator::Verdict::accepted);
  page = metrics();
  EXPECT_THAT(page, HasSubstr("gleaner_batches_total{end=\"accepted\"} 1\n"));
  EXPECT_THAT(page, HasSubstr("gleaner_items_accepted_total 256\n"));

  farm_.farm().drain(worker);
  EXPECT_THAT(metrics(), HasSubstr("gleaner_workers{state=\"draining\"} 1\n"));
  farm_.farm().cancel(job);
  EXPECT_TRUE(eventually([&] { return metrics().find("gleaner_jobs{state=\"cancelled\"} 1\n") != std::string::npos; }));
  EXPECT_THAT(metrics(), HasSubstr("gleaner_frames_queued 0\n"));
}

// Every line is a comment or a sample of the family that the last comment declared, and no sample comes twice.
TEST_F(Http, MetricsHaveTheFormatThatPrometheusReads) {
  coordinator::WorkerHello hello{.name = "idle", .address = "", .device = {}, .needs_bvh = false};
  farm_.farm().join(hello, std::make_shared<Idle>());
  submit();
  const std::regex comment("# (HELP|TYPE) ([a-z_]+) (.+)");
  const std::regex sample("([a-z_]+)(\\{[a-z]+=\"[^\"\\\\\n]*\"(,[a-z]+=\"[^\"\\\\\n]*\")*\\})? [-+0-9.e]+");
  std::set<std::string> families, samples;
  std::string line, family;
  std::istringstream page(metrics());
  while (std::getline(page, line)) {
    std::smatch parts;
    if (std::regex_match(line, parts, comment)) {
      family = parts[2];
      if (parts[1] == "HELP") {
        EXPECT_TRUE(families.insert(family).second) << family;
      }
      if (parts[1] == "TYPE") {
        EXPECT_EQ(parts[3] == "counter", family.ends_with("_total")) << line;
      }
    } else {
      ASSERT_TRUE(std::regex_match(line, parts, sample)) << line;
      EXPECT_EQ(parts[1], family);
      EXPECT_TRUE(samples.insert(parts[1].str() + parts[2].str()).second) << line;
    }
  }
  EXPECT_GE(families.size(), 10u);
  EXPECT_GE(samples.size(), 14u);
}

}  // namespace
}  // namespace gleaner::test
