// The coordinator's page: what it is told, that it can only look, and that it stays small on a large farm.

#include <gmock/gmock.h>
#include <httplib.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <optional>

#include "coordinator/gateway/dashboard_files.h"
#include "coordinator/gateway/http.h"
#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using nlohmann::json;
using testing::HasSubstr;
using testing::Not;

constexpr const char* markup = "<img src=x onerror=alert(1)>";

// A farm of a clock that stands still and its page. Each test asks once, or waits for what it was told to grow old.
class Page : public FarmEngine {
 protected:
  Farm& farm() {
    if (!farm_) {
      FarmSettings page = settings();
      page.ended_jobs = 20000;
      farm_.emplace(page, blobs_);
      http_.emplace(*farm_, "127.0.0.1:0");
    }
    return *farm_;
  }
  httplib::Client client() {
    farm();
    httplib::Client client("http://" + http_->address());
    client.set_read_timeout(20);
    return client;
  }
  json told() {
    const auto answer = client().Get("/farm.json");
    EXPECT_TRUE(answer);
    EXPECT_EQ(answer->get_header_value("Content-Type"), "application/json");
    return json::parse(answer->body);
  }
  json told_when(const std::function<bool(const json&)>& so) {
    json farm;
    EXPECT_TRUE(eventually([&] { return so(farm = told()); })) << farm.dump(1);
    return farm;
  }

  std::optional<Farm> farm_;
  std::optional<gateway::HttpServer> http_;
};

TEST(PageFiles, AskNoOtherServerAndSetTextAlone) {
  std::string html, script;
  for (const web::PageFile& file : gateway::dashboard_files()) {
    const std::string text(file.text), name(file.path);
    ASSERT_FALSE(text.empty()) << name;
    std::string bare = text;  // a namespace is no address that is asked
    if (const auto at = bare.find("http://www.w3.org/2000/svg"); at != std::string::npos) bare.erase(at, 26);
    for (const char* word : {"http:", "https:", "//cdn", "@import", "url("})
      EXPECT_THAT(bare, Not(HasSubstr(word))) << name;
    if (name == "index.html") html = text;
    if (name == "dashboard.js") script = text;
  }
  // None of what makes markup or code of text.
  for (const char* word : {"innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "new Function",
                           "srcdoc", "createContextualFragment", "DOMParser", "setHTML"})
    EXPECT_THAT(script, Not(HasSubstr(word))) << word;
  // None of what the policy forbids in the page: it would not run.
  for (const char* word : {"style=", "<style", "onclick", "onload", "javascript:", "<script>"})
    EXPECT_THAT(html, Not(HasSubstr(word))) << word;
  EXPECT_THAT(html, HasSubstr("<html lang=\"en\">"));
  EXPECT_THAT(html, HasSubstr("name=\"viewport\""));
  EXPECT_THAT(html, HasSubstr("<th scope=\"col\">"));
}

TEST_F(Page, IsThere) {
  const auto page = client().Get("/");
  ASSERT_TRUE(page);
  EXPECT_EQ(page->status, 200);
  EXPECT_THAT(page->body, HasSubstr("<title>Gleaner</title>"));
  for (const char* path : {"/dashboard.js", "/dashboard.css", "/icon.svg"}) EXPECT_EQ(client().Get(path)->status, 200);
  EXPECT_EQ(client().Get("/healthz")->body, "ok\n");
  EXPECT_EQ(client().Get("/metrics")->status, 200);
}

TEST_F(Page, AFarmWithNothing) {
  const json farm = told();
  EXPECT_EQ(farm.at("workers").at("connected"), 0);
  EXPECT_TRUE(farm.at("jobs").at("shown").empty());
  for (const char* state : {"queued", "running", "done", "failed", "cancelled"}) EXPECT_EQ(farm["jobs"][state], 0);
  EXPECT_TRUE(farm.at("events").empty());
}

// What users choose arrives as it is, in JSON and in a picture's address; making text of it is the page's part.
TEST_F(Page, NamesAreDataWhateverTheyLookLike) {
  ScriptedWorker worker, broken;
  worker.join(farm(), markup);
  broken.join(farm(), "not \xff UTF-8");
  JobRequest job = request();
  job.name = markup;
  job.scene_name = std::string(markup) + "\"\\\n</script>";
  farm().submit(job);
  const json farm_now = told();
  const json& shown = farm_now["jobs"]["shown"].at(0);
  EXPECT_EQ(shown.at("name"), markup);
  EXPECT_EQ(shown.at("scene"), std::string(markup) + "\"\\\n</script>");
  const auto& workers = farm_now["workers"]["shown"];
  EXPECT_EQ(workers.at(1).at("worker"), markup);
  EXPECT_EQ(workers.at(0).at("worker"), "not \xef\xbf\xbd UTF-8");
  const auto answer = client().Get("/farm.json");
  EXPECT_EQ(answer->get_header_value("X-Content-Type-Options"), "nosniff");
  const auto reflected = client().Get("/picture.png?job=%3Cimg%20src%3Dx%20onerror%3Dalert(1)%3E");
  EXPECT_EQ(reflected->status, 404);
  EXPECT_THAT(reflected->body, Not(HasSubstr("<")));
}

TEST_F(Page, TellsOfJobsWorkersAndEvents) {
  ScriptedWorker worker;
  worker.join(farm(), "lamp");
  JobRequest two = request();
  two.last_frame = 2;
  two.name = "two frames";
  two.settings.set["variance"] = "4";
  const std::string job = farm().submit(two);
  const auto offer = worker.next();
  ASSERT_TRUE(offer);
  json now = told();
  EXPECT_EQ(now["jobs"]["running"], 1);
  const json& shown = now["jobs"]["shown"].at(0);
  EXPECT_EQ(shown.at("job"), job);
  EXPECT_EQ(shown.at("state"), "running");
  EXPECT_EQ(shown.at("frames"), 2);
  EXPECT_EQ(shown.at("frames_done"), 0);
  EXPECT_FALSE(shown.contains("error"));
  const json& lamp = now["workers"]["shown"].at(0);
  EXPECT_EQ(lamp.at("worker"), "lamp");
  EXPECT_EQ(lamp.at("device"), "a script");
  EXPECT_EQ(lamp.at("batch").at("job"), job);
  EXPECT_EQ(lamp.at("batch").at("stage"), "scatter");
  EXPECT_FALSE(lamp.contains("last_batch"));
  worker.deliver(*offer, worker.compute(*offer, blobs_), 0.5);
  serve(farm(), worker, job);
  end_of(farm(), job);
  worker.leave();
  now = told_when([](const json& farm) { return farm["jobs"]["done"] == 1 && !farm["workers"]["gone"].empty(); });
  EXPECT_EQ(now["jobs"]["shown"].at(0).at("error").at("frame"), 2);
  EXPECT_GT(now["jobs"]["shown"].at(0).at("error").at("relative"), 0);
  EXPECT_EQ(now["workers"]["connected"], 0);
  EXPECT_EQ(now["workers"]["gone"].at(0).at("worker"), "lamp");
  EXPECT_EQ(now["workers"]["gone"].at(0).at("lost"), true);
  EXPECT_EQ(now["events"].at(0).at("what"), "left");
  EXPECT_EQ(now["totals"]["frames_written"], 2);
}

TEST_F(Page, SaysWhyAJobFailedAndCutsWhatACompilerSays) {
  JobRequest failing = request();
  failing.settings.set["plan_throws"] = "1";
  ScriptedWorker worker;
  worker.join(farm());
  const std::string job = farm().submit(failing);
  serve(farm(), worker, job);
  end_of(farm(), job);
  const json now = told();
  EXPECT_EQ(now["jobs"]["failed"], 1);
  EXPECT_THAT(now["jobs"]["shown"].at(0).at("message"), HasSubstr("the plan has lost its way"));
  JobRequest verbose = request();
  verbose.settings.set["warn"] = std::string(100000, 'w');
  const std::string long_words = farm().submit(verbose);
  serve(farm(), worker, long_words);
  end_of(farm(), long_words);
  const json later = told_when([](const json& farm) { return farm["jobs"]["done"] == 1; });
  EXPECT_LT(later["jobs"]["shown"].at(0).at("message").get<std::string>().size(), 2100u);
}

TEST_F(Page, ThePictureOfAJobThatRuns) {
  ScriptedWorker worker;
  worker.join(farm());
  EXPECT_EQ(client().Get("/picture.png?job=none")->status, 404);
  EXPECT_EQ(client().Get("/picture.png")->status, 404);
  const std::string job = farm().submit(request(fake_settings(4000, 4)));
  const auto path = "/picture.png?job=" + job;
  ASSERT_TRUE(eventually([&] { return client().Get(path)->status == 204; }));  // nothing is drawn yet
  // All of "scatter", then the first batches of "gather", which are drawn.
  for (std::optional<Offered> offer; (offer = worker.next());) {
    if (offer->work->stage == "gather" && offer->lease.first > 2000) break;
    worker.deliver(*offer, worker.compute(*offer, blobs_));
  }
  httplib::Result picture = client().Get(path);
  ASSERT_TRUE(eventually([&] { return (picture = client().Get(path)) && picture->status == 200; }));
  EXPECT_EQ(picture->get_header_value("Content-Type"), "image/png");
  ASSERT_THAT(picture->body.substr(0, 4), "\x89PNG");
  // 4000 pixels are shown as 800 blocks of 5 x 4: the width stands in bytes 16 to 19.
  const auto byte = [&](std::size_t at) { return static_cast<unsigned char>(picture->body.at(at)); };
  EXPECT_EQ(byte(18) * 256 + byte(19), 800);
  EXPECT_EQ(byte(23), 1);
  const std::string tag = picture->get_header_value("ETag");
  EXPECT_EQ(client().Get(path, {{"If-None-Match", tag}})->status, 304);
  farm().cancel(job);
  ASSERT_TRUE(eventually([&] { return client().Get(path)->status == 404; }));
}

TEST_F(Page, CanOnlyLook) {
  ScriptedWorker worker;
  worker.join(farm());
  const std::string job = farm().submit(request());
  const auto before = farm().last_event();
  for (const char* path : {"/", "/farm.json", "/picture.png", "/healthz", "/metrics", "/dashboard.js"}) {
    EXPECT_EQ(client().Post(path, "{}", "application/json")->status, 405) << path;
    EXPECT_EQ(client().Put(path, "{}", "application/json")->status, 405) << path;
    EXPECT_EQ(client().Patch(path, "{}", "application/json")->status, 405) << path;
    EXPECT_EQ(client().Delete(path)->status, 405) << path;
  }
  for (const std::string verb : {"cancel", "pause", "retry", "drain", "submit"})
    EXPECT_EQ(client().Get("/" + verb + "?job=" + job)->status, 404);
  EXPECT_EQ(farm().last_event(), before);
  EXPECT_EQ(farm().status(job)->state, JobState::running);
}

TEST_F(Page, StaysSmallWithTenThousandJobsAndAThousandWorkers) {
  std::vector<std::unique_ptr<ScriptedWorker>> workers;
  for (int k = 0; k < 1000; ++k) {
    workers.push_back(std::make_unique<ScriptedWorker>());
    workers.back()->join(farm(), "worker-" + std::to_string(k));
  }
  const JobRequest job = request();
  for (int k = 0; k < 10000; ++k) farm().submit(job);
  std::vector<std::string> some;
  for (const auto& shown : farm().overview({.jobs = 5000}).jobs)
    if (shown.status.state == JobState::queued) some.push_back(shown.status.id);
  for (const std::string& id : some) farm().cancel(id);

  const auto look = [&] {
    const auto begun = std::chrono::steady_clock::now();
    const FarmOverview overview = farm().overview();
    const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - begun;
    EXPECT_LE(overview.jobs.size(), 75u);
    EXPECT_EQ(overview.workers.size(), 100u);
    return spent.count();
  };
  std::vector<double> spent;
  for (int k = 0; k < 21; ++k) spent.push_back(look());
  std::ranges::sort(spent);
  const auto answer = client().Get("/farm.json");
  ASSERT_TRUE(answer);
  const json now = json::parse(answer->body);
  std::printf("10,000 jobs, 1,000 workers: the farm is asked for %.2f ms (median of 21), the page is told %zu bytes\n",
              spent[10], answer->body.size());
  EXPECT_LT(answer->body.size(), 250000u);
  EXPECT_EQ(now["workers"]["connected"], 1000);
  EXPECT_EQ(now["jobs"]["queued"].get<int>() + now["jobs"]["running"].get<int>() + now["jobs"]["cancelled"].get<int>(),
            10000);
  EXPECT_EQ(now["jobs"]["cancelled"], 5000);
  // However many look, and however often, the farm is asked once a second.
  const auto again = client().Get("/farm.json");
  EXPECT_EQ(again->body, answer->body);
  for (const auto& worker : workers) worker->leave();
  EXPECT_EQ(told_when([](const json& farm) { return farm["workers"]["connected"] == 0; })["workers"]["gone"].size(),
            10u);
}

}  // namespace
}  // namespace gleaner::test
