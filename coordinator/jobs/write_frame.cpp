// A frame's files: EXR, PNG and report.

#include <chrono>
#include <future>
#include <span>
#include <system_error>

#include "coordinator/film/metrics.h"
#include "coordinator/film/write.h"
#include "coordinator/jobs/engine.h"
#include "proto/atomic_file.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

constexpr std::chrono::seconds between_tries{2};  // to write on a full disk

std::optional<FrameError> error_of(const Film& film, std::uint32_t frame) {
  try {
    const OwnNoise noise = own_noise({film, "the frame"});
    if (!noise.standard_error) return std::nullopt;
    return FrameError{.frame = frame, .relative = *noise.standard_error, .denoised = noise.denoised};
  } catch (const Error&) {
    return std::nullopt;  // without RGB, or not finite: nothing is known of its error, and the files say what it is
  }
}

}  // namespace

void Farm::Impl::write(Frame& frame, const Film& film) {
  const Seconds begun = now();
  for (;;) {
    try {
      write_files(frame, film);
      break;
    } catch (const DiskFull& error) {
      if (now() - begun >= settings.disk_patience) throw;
      std::unique_lock lock(mutex);
      if (frame.full_disk.empty())
        settings.log("job " + frame.job->id + ": " + error.what() + "; the frame waits until there is room");
      frame.full_disk = error.what();
      frame.events.wait_for(lock, between_tries, [&] { return frame.job->cancel || stopping; });
      if (frame.job->cancel || stopping) throw Cancelled{};
    }
  }
  std::lock_guard lock(mutex);
  frame.full_disk.clear();
}

void Farm::Impl::write_files(Frame& frame, const Film& film) {
  const Job& job = *frame.job;
  FrameReport report;
  {
    std::lock_guard lock(mutex);
    if (job.cancel) throw Cancelled{};
    report = frame.report;
  }
  FramePaths paths = settings.paths(job.id, report.frame);
  for (const fs::path& path : {paths.exr, paths.png, paths.report}) {
    if (path.empty() || path.parent_path().empty()) continue;
    std::error_code code;
    fs::create_directories(path.parent_path(), code);
    const std::string words = path.parent_path().string() + ": cannot make the folder: " + code.message();
    if (code == std::errc::no_space_on_device) throw DiskFull(words);
    if (code) throw Error::failed(words);
  }
  Seconds begun_writing = now();
  // Compressing takes longer than the disk does: the PNG is made beside the EXR.
  std::future<void> png;
  if (!paths.png.empty())
    png = std::async(std::launch::async, [&] { write_png(film, paths.png.string(), job.request.exposure_stops); });
  report.pixels_sha256 = pixels_sha256(film);
  report.seconds = now() - frame.waited_from;
  report.write_seconds = now() - begun_writing;
  try {
    if (!paths.exr.empty()) write_exr(film, report_metadata(report), paths.exr.string());
  } catch (...) {
    // A PNG alone would look like a frame that was written.
    if (png.valid()) {
      png.wait();
      std::error_code ignored;
      fs::remove(paths.png, ignored);
    }
    throw;
  }
  if (png.valid()) png.get();
  report.seconds = now() - frame.waited_from;
  report.write_seconds = now() - begun_writing;
  if (!paths.report.empty()) {
    std::string text = report_json(report);
    write_atomically(paths.report.string(), std::as_bytes(std::span(text)));
  }
  const std::optional<FrameError> error = error_of(film, report.frame);
  std::lock_guard lock(mutex);
  frame.report = std::move(report);
  if (error) frame.job->error = error;
}

}  // namespace gleaner::coordinator
