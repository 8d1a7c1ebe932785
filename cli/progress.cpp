#include "cli/progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace gleaner::cli {

using coordinator::JobState;
using coordinator::JobStatus;
using coordinator::StageStatus;

namespace {

constexpr std::chrono::milliseconds bar_interval{100};
constexpr std::chrono::seconds line_interval{10};  // plain lines: at every tenth of a job, and at least so often

// The stage that runs, the oldest of several; null: none.
const StageStatus* running_stage(const JobStatus& status) {
  for (const StageStatus& stage : status.stages)
    if (stage.items_done < stage.items) return &stage;
  return nullptr;
}

// "frame 2 of 5", "3 of 40 frames done, 2 side by side"
std::string frames_of(const JobStatus& status) {
  const std::vector<std::uint32_t>& running = status.running;
  if (running.size() < 2)
    return fmt::format("frame {} of {}", std::min(status.frames_done + 1, status.frames), status.frames);
  return fmt::format("{} of {} frames done, {} side by side", status.frames_done, status.frames, running.size());
}

// "37 %, frame 2 of 5, path.1 at 3.2 M items/s, 12 s left"
std::string words(const JobStatus& status) {
  if (status.paused && !ended(status.state)) return "paused";
  if (status.state != JobState::running) return job_state_name(status.state);
  std::string text = fmt::format("{:.0f} %", std::floor(100 * status.progress));
  if (status.frames > 1) text += ", " + frames_of(status);
  if (status.frames_failed > 0) text += fmt::format(", {} failed", status.frames_failed);
  const StageStatus* stage = running_stage(status);
  if (stage) text += ", " + stage->name;
  if (stage && stage->items_per_second > 0) text += " at " + format_rate(stage->items_per_second);
  if (!stage && status.frame_progress >= 1) text += ", writing";
  if (status.seconds_left > 0) text += fmt::format(", {} left", format_duration(status.seconds_left));
  return text;
}

}  // namespace

std::string format_rate(double rate) {
  if (rate >= 1e9) return fmt::format("{:.1f} G items/s", rate / 1e9);
  if (rate >= 1e6) return fmt::format("{:.1f} M items/s", rate / 1e6);
  if (rate >= 1e3) return fmt::format("{:.1f} k items/s", rate / 1e3);
  return fmt::format("{:.1f} items/s", rate);
}

std::string format_duration(double seconds) {
  auto whole = std::llround(std::max(0.0, seconds));
  if (whole < 60) return fmt::format("{} s", whole);
  if (whole < 3600) return fmt::format("{} min {} s", whole / 60, whole % 60);
  return fmt::format("{} h {} min", whole / 3600, whole / 60 % 60);
}

ProgressDisplay::ProgressDisplay(bool quiet) : quiet_(quiet), terminal_(::isatty(STDERR_FILENO) == 1) {}

ProgressDisplay::~ProgressDisplay() { clear(); }

void ProgressDisplay::clear() {
  if (drawn_) std::fputs("\r\x1b[K", stderr);
  drawn_ = false;
}

void ProgressDisplay::show(const JobStatus& status) {
  if (quiet_ || ended(status.state)) return;
  auto now = std::chrono::steady_clock::now();
  if (terminal_) {
    if (drawn_ && now - last_ < bar_interval) return;
    winsize size{};
    int columns = ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
    std::string text = words(status);
    int width = std::clamp(columns - static_cast<int>(text.size()) - 4, 0, 40);
    std::string bar;
    if (width >= 8) {
      int full = static_cast<int>(status.progress * width);
      bar = fmt::format("[{:#<{}}{:.<{}}] ", "", full, "", width - full);
    }
    std::fprintf(stderr, "\r%s%s\x1b[K", bar.c_str(), text.c_str());
    std::fflush(stderr);
    drawn_ = true;
    last_ = now;
    return;
  }
  int tenth = static_cast<int>(status.progress * 10);
  if (status.state == last_state_ && tenth == last_tenth_ && now - last_ < line_interval) return;
  last_state_ = status.state;
  last_tenth_ = tenth;
  last_ = now;
  std::fprintf(stderr, "gleaner: %s\n", words(status).c_str());
}

}  // namespace gleaner::cli
