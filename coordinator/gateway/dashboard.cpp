#include "coordinator/gateway/dashboard.h"

#include <utility>

#include "coordinator/gateway/dashboard_files.h"
#include "coordinator/gateway/status_json.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;

namespace {

constexpr std::chrono::milliseconds between_looks{900};  // the page asks every second
// Pictures are for a page, whatever the job's size. They are drawn as they were sampled: looking costs no worker time.
constexpr PreviewSettings pictures{.longest_side = 960, .least_pause = 1};

}  // namespace

Dashboard::Dashboard(Farm& farm) : farm_(farm), previews_(farm, pictures) {}

void Dashboard::add_to(web::WebServer& server) {
  server.add_files("/", web::common_files());
  server.add_files("/", dashboard_files());
  server.get("/farm.json",
             [this](const web::Request&) { return web::Answer{.type = "application/json", .body = told()}; });
  server.get("/picture.png", [this](const web::Request& request) {
    const auto job = request.parameters.find("job");
    return picture(job == request.parameters.end() ? std::string() : job->second);
  });
}

void Dashboard::look_again(Clock::time_point now) {
  if (now < due_) return;
  const FarmOverview overview = farm_.overview();
  told_ = dump(overview_json(overview));
  exposures_.clear();
  for (const auto& job : overview.jobs)
    if (job.status.state == JobState::running) exposures_[job.status.id] = job.status.exposure_stops;
  due_ = now + between_looks;
}

std::string Dashboard::told() {
  std::lock_guard lock(mutex_);
  look_again(Clock::now());
  return told_;
}

web::Answer Dashboard::picture(const std::string& job) {
  double exposure_stops = 0;
  {
    std::lock_guard lock(mutex_);
    look_again(Clock::now());
    const auto shown = exposures_.find(job);
    if (shown == exposures_.end()) return web::text_answer(404, "no such job runs\n");
    exposure_stops = shown->second;
  }
  std::string png = previews_.show(job, exposure_stops, false);
  if (png.empty()) return {.type = {}, .body = {}, .status = 204};  // nothing to show yet
  std::string tag = web::tag_of(png);
  return {.type = "image/png", .body = std::move(png), .status = 200, .tag = std::move(tag)};
}

}  // namespace gleaner::gateway
