#pragma once
// The coordinator's page: what a farm does, for people who look. Nothing of the farm can be changed by it.
//
// The page asks again every second. What it is told is put together once a second at most, for however many who look,
// and holds so many jobs and workers at most (coordinator/jobs/overview.h). It asks rather than being told by a stream:
// a stream would hold one of the listener's few threads for each page that somebody leaves open.

#include <chrono>
#include <map>
#include <mutex>
#include <string>

#include "coordinator/gateway/previews.h"
#include "coordinator/jobs/farm.h"
#include "coordinator/web/web_server.h"

namespace gleaner::gateway {

class Dashboard {
 public:
  explicit Dashboard(coordinator::Farm& farm);
  void add_to(web::WebServer& server);

 private:
  using Clock = std::chrono::steady_clock;

  std::string told();                           // JSON
  web::Answer picture(const std::string& job);  // of a job that runs and is shown
  void look_again(Clock::time_point now);       // mutex held

  coordinator::Farm& farm_;
  Previews previews_;
  std::mutex mutex_;
  std::string told_;
  Clock::time_point due_{};
  std::map<std::string, double> exposures_;  // of the jobs that run and are shown
};

}  // namespace gleaner::gateway
