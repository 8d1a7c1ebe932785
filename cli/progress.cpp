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
constexpr std::chrono::seconds line_interval{10};  // plain lines: at every tenth of a stage, and at least so often

std::string words(const JobStatus& status, const StageStatus* stage) {
  std::string text;
  if (status.frames > 1)
    text += fmt::format("frame {} of {}, ", std::min(status.frames_done + 1, status.frames), status.frames);
  if (!stage) return text + job_state_name(status.state);
  text += fmt::format("{} {} %", stage->name, stage->items > 0 ? 100 * stage->items_done / stage->items : 100);
  if (stage->items_per_second > 0) text += fmt::format(", {}", format_rate(stage->items_per_second));
  if (stage->seconds_left > 0) text += fmt::format(", {} left", format_duration(stage->seconds_left));
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
  const StageStatus* stage = nullptr;
  for (const StageStatus& candidate : status.stages)
    if (!stage || stage->items_done == stage->items) stage = &candidate;
  auto now = std::chrono::steady_clock::now();
  double part =
      stage && stage->items > 0 ? static_cast<double>(stage->items_done) / static_cast<double>(stage->items) : 0;
  if (terminal_) {
    if (drawn_ && now - last_ < bar_interval) return;
    winsize size{};
    int columns = ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
    std::string text = words(status, stage);
    int width = std::clamp(columns - static_cast<int>(text.size()) - 4, 0, 40);
    std::string bar;
    if (width >= 8) {
      int full = static_cast<int>(part * width);
      bar = fmt::format("[{:#<{}}{:.<{}}] ", "", full, "", width - full);
    }
    std::fprintf(stderr, "\r%s%s\x1b[K", bar.c_str(), text.c_str());
    std::fflush(stderr);
    drawn_ = true;
    last_ = now;
    return;
  }
  std::string name = stage ? stage->name : job_state_name(status.state);
  int tenth = static_cast<int>(part * 10);
  if (name == last_stage_ && tenth == last_tenth_ && now - last_ < line_interval) return;
  last_stage_ = name;
  last_tenth_ = tenth;
  last_ = now;
  std::fprintf(stderr, "gleaner: %s\n", words(status, stage).c_str());
}

}  // namespace gleaner::cli
