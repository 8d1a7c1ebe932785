#include "coordinator/gateway/previews.h"

#include <algorithm>
#include <optional>
#include <stop_token>
#include <system_error>
#include <utility>

#include "coordinator/film/shrink.h"
#include "coordinator/film/write.h"
#include "scene/model/error.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;

namespace {

// A worker that denoises does not render: of its time a tenth at most goes there.
constexpr int kPauses = 9;
constexpr double kLeastPause = 0.7;  // s; nobody looks more often

std::chrono::steady_clock::duration pause_of(double seconds) {
  return std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
}

}  // namespace

std::string Previews::png_of(const Film& film, double exposure_stops) const {
  const Bytes bytes = settings_.longest_side > 0 ? encode_png(shrink(film, settings_.longest_side), exposure_stops)
                                                 : encode_png(film, exposure_stops);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

Previews::~Previews() {
  std::map<std::string, Shown> last;
  {
    std::lock_guard lock(mutex_);
    last = std::exchange(shown_, {});
  }
}

std::string Previews::show(const std::string& job, double exposure_stops, bool denoise) {
  std::vector<std::jthread> ended;  // joined without the mutex
  {
    std::lock_guard lock(mutex_);
    forget_ended(ended);
    if (denoise && farm_.can_denoise()) {
      Shown& shown = shown_[job];
      if (!shown.busy && Clock::now() >= shown.due) begin(shown, job, exposure_stops);
      if (!shown.denoised.empty()) return shown.denoised;
    }
    if (settings_.least_pause > 0) {
      Shown& shown = shown_[job];
      if (Clock::now() < shown.draw_due) return shown.sampled;
      // Who asks while it is drawn gets the one before.
      shown.draw_due = Clock::now() + pause_of(settings_.least_pause);
    }
  }
  const auto begun = Clock::now();
  const std::optional<Film> film = farm_.preview(job);
  std::string picture = film ? png_of(*film, exposure_stops) : std::string();
  std::lock_guard lock(mutex_);
  Shown& shown = shown_[job];
  if (!picture.empty()) shown.sampled = std::move(picture);
  // Drawing takes a tenth of one core at most.
  shown.draw_due = Clock::now() + std::max(pause_of(settings_.least_pause), kPauses * (Clock::now() - begun));
  return shown.sampled;
}

void Previews::begin(Shown& shown, const std::string& job, double exposure_stops) {
  if (shown.thread.joinable()) shown.thread.join();  // it is not busy any more
  shown.busy = true;
  try {
    shown.thread = std::jthread([this, job, exposure_stops](const std::stop_token& stop) {
      Denoised picture = denoised(job, exposure_stops, stop);
      const auto pause = pause_of(std::max(kLeastPause, kPauses * picture.worker_seconds));
      std::lock_guard lock(mutex_);
      const auto at = shown_.find(job);
      if (at == shown_.end()) return;
      if (!picture.png.empty()) at->second.denoised = std::move(picture.png);
      at->second.due = Clock::now() + pause;
      at->second.busy = false;
    });
  } catch (const std::system_error&) {  // no thread is to be had: what was sampled is shown
    shown.busy = false;
  }
}

Previews::Denoised Previews::denoised(const std::string& job, double exposure_stops, const std::stop_token& stop) {
  try {
    std::optional<Film> film = farm_.preview(job, true);
    if (!film) return {};
    const std::optional<Farm::Picture> picture = farm_.denoise(job, std::move(*film), stop);
    if (!picture) return {};
    Denoised result{png_of(picture->film, exposure_stops), 0};
    for (const StageReport& stage : picture->report.stages)
      for (const auto& [worker, share] : stage.workers) result.worker_seconds += share.seconds;
    return result;
  } catch (const Error&) {
    // Jobs that run have the memory, or a worker fails, which the job itself tells: what was sampled is shown.
    return {};
  }
}

void Previews::forget_ended(std::vector<std::jthread>& ended) {
  for (auto at = shown_.begin(); at != shown_.end();) {
    const auto status = farm_.status(at->first);
    if (at->second.busy || (status && status->state == JobState::running)) {
      ++at;
      continue;
    }
    ended.push_back(std::move(at->second.thread));
    at = shown_.erase(at);
  }
}

}  // namespace gleaner::gateway
