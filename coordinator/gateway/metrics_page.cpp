#include "coordinator/gateway/metrics_page.h"

#include <array>
#include <charconv>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "gleaner/version.h"
#include "scene/model/names.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;

namespace {

using Labels = std::vector<std::pair<const char*, std::string>>;

class Page {
 public:
  void family(const char* name, const char* type, const char* help) {
    name_ = name;
    text_.append("# HELP ").append(name).append(" ").append(help).append("\n");
    text_.append("# TYPE ").append(name).append(" ").append(type).append("\n");
  }

  void sample(double value, const Labels& labels = {}) {
    text_.append(name_);
    const char* separator = "{";
    for (const auto& [label, content] : labels) {
      text_.append(separator).append(label).append("=\"").append(escape_label(content)).append("\"");
      separator = ",";
    }
    if (!labels.empty()) text_.append("}");
    std::array<char, 32> digits;
    char* const end = std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr;
    text_.append(" ").append(digits.data(), end).append("\n");
  }

  std::string take() { return std::move(text_); }

 private:
  std::string text_;
  const char* name_ = "";
};

void workers_section(Page& page, const std::vector<WorkerStatus>& workers) {
  std::size_t draining = 0;
  double batches = 0;
  for (const WorkerStatus& worker : workers) {
    draining += worker.draining;
    batches += worker.leases;
  }
  page.family("gleaner_workers", "gauge", "Workers that are connected, by what they do.");
  page.sample(static_cast<double>(workers.size() - draining), {{"state", "serving"}});
  page.sample(static_cast<double>(draining), {{"state", "draining"}});
  page.family("gleaner_worker_info", "gauge", "1 for each worker that is connected.");
  for (const WorkerStatus& worker : workers)
    page.sample(1, {{"worker", worker.id}, {"device", worker.device.name}, {"tracer", worker.device.tracer}});
  page.family("gleaner_worker_items_per_second", "gauge",
              "Throughput of a worker in its last batches of a stage kind.");
  for (const WorkerStatus& worker : workers)
    for (const auto& [kind, rate] : worker.items_per_second) page.sample(rate, {{"worker", worker.id}, {"kind", kind}});
  page.family("gleaner_batches_in_flight", "gauge", "Batches that workers hold.");
  page.sample(batches);
}

void jobs_section(Page& page, const std::vector<JobStatus>& jobs) {
  constexpr std::array states = {JobState::queued, JobState::running, JobState::done, JobState::failed,
                                 JobState::cancelled};
  std::map<JobState, double> jobs_in;
  double frames_queued = 0;
  std::map<std::string, double> items_per_second;  // by stage kind
  for (const JobStatus& job : jobs) {
    ++jobs_in[job.state];
    if (ended(job.state)) continue;
    frames_queued += job.frames - job.frames_done - job.frames_failed;
    for (const StageStatus& stage : job.stages)
      if (stage.items_done < stage.items) items_per_second[stage.kind] += stage.items_per_second;
  }
  page.family("gleaner_jobs", "gauge", "Jobs that the coordinator knows, by state.");
  for (JobState state : states) page.sample(jobs_in[state], {{"state", job_state_name(state)}});
  page.family("gleaner_frames_queued", "gauge", "Frames of queued and running jobs that are not written yet.");
  page.sample(frames_queued);
  page.family("gleaner_items_per_second", "gauge", "Items accepted a second over the last seconds, by stage kind.");
  for (const auto& [kind, rate] : items_per_second) page.sample(rate, {{"kind", kind}});
}

void totals_section(Page& page, const FarmTotals& totals) {
  page.family("gleaner_batches_total", "counter", "Batches since the coordinator started, by how they ended.");
  page.sample(static_cast<double>(totals.batches_accepted), {{"end", "accepted"}});
  page.sample(static_cast<double>(totals.batches_failed), {{"end", "failed"}});
  page.sample(static_cast<double>(totals.batches_expired), {{"end", "expired"}});
  page.family("gleaner_items_accepted_total", "counter", "Items accepted since the coordinator started.");
  page.sample(static_cast<double>(totals.items_accepted));
  page.family("gleaner_frames_written_total", "counter", "Frames written since the coordinator started.");
  page.sample(static_cast<double>(totals.frames_written));
}

}  // namespace

std::string escape_label(std::string_view text) {
  std::string escaped;
  while (!text.empty()) {
    const std::size_t length = utf8_length(text);
    if (length == 0)
      escaped += '?';
    else if (text[0] == '\\')
      escaped += "\\\\";
    else if (text[0] == '"')
      escaped += "\\\"";
    else if (text[0] == '\n')
      escaped += "\\n";
    else
      escaped += text.substr(0, length);
    text.remove_prefix(length == 0 ? 1 : length);
  }
  return escaped;
}

std::string metrics_page(const Farm& farm) {
  Page page;
  page.family("gleaner_build_info", "gauge", "1; the version that runs.");
  page.sample(1, {{"version", version}});
  workers_section(page, farm.workers());
  jobs_section(page, farm.list());
  totals_section(page, farm.totals());
  return page.take();
}

}  // namespace gleaner::gateway
