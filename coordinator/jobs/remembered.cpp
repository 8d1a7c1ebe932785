// Accepted records that outlive this coordinator: they lie in files, a folder a frame, and the journal knows where. The
// next coordinator asks the plan anew; stages whose artifacts it finds there are run for what is missing only.

#include <algorithm>
#include <cstring>
#include <system_error>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/record_file.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

// The range can be the answer to a lease of the stage.
bool answers(const RunningStage& stage, const JournalRange& range) {
  const StageSpec& spec = stage.spec;
  if (range.count == 0 || range.first > spec.items || range.count > spec.items - range.first) return false;
  const std::uint64_t end = range.first + range.count;
  if (spec.solo ? range.count != spec.items : range.first % spec.tile != 0) return false;
  if (end % spec.tile != 0 && end != spec.items) return false;
  return spec.output.counted ? range.bytes >= range.count * count_bytes
                             : range.bytes == range.count * spec.output.record_bytes;
}

}  // namespace

fs::path Farm::Impl::records_of(const Frame& frame) const {
  return settings.records / frame.job->id / std::to_string(frame_at(frame.job->request, frame.place));
}

void Farm::Impl::drop_left_records(const std::set<std::string>& waiting) const {
  if (settings.records.empty()) return;
  std::error_code code;
  for (const auto& entry : fs::directory_iterator(settings.records, code))
    if (std::error_code ignored; !waiting.contains(entry.path().filename().string()))
      fs::remove_all(entry.path(), ignored);
}

void Farm::Impl::recall(Frame& frame) {
  if (!settings.journal || settings.records.empty()) return;
  const std::string& id = frame.job->id;
  const fs::path folder = records_of(frame);
  std::string trouble;
  std::map<ArtifactId, std::unique_ptr<RecordFile>> files;
  for (JournalRange& range : settings.journal->ranges(id, frame.place)) {
    std::vector<JournalRange>& held = frame.held[range.artifact];
    if (!held.empty() && range.first < held.back().first + held.back().count) continue;
    auto& file = files[range.artifact];
    if (!file) file = std::make_unique<RecordFile>(folder / range.artifact);
    try {
      if (digest_of(file->read(range.offset, range.bytes)) != range.digest)
        throw Error::failed(file->path().string() + ": the bytes at " + std::to_string(range.offset) +
                            " are not those that were written");
      held.push_back(std::move(range));
    } catch (const Error& error) {
      trouble = error.what();
    }
  }
  if (!trouble.empty()) settings.log("job " + id + ": " + trouble + "; what cannot be read back is computed again");
}

void Farm::Impl::use_held(RunningStage& stage) {
  Frame& frame = *stage.frame;
  if (!journal_of(*frame.job) || settings.records.empty() || stage.retained() || stage.computes_again) return;
  stage.file = std::make_shared<RecordFile>(records_of(frame) / stage.artifact);
  const auto found = frame.held.extract(stage.artifact);
  if (!found) return;
  std::uint64_t next = 0;
  for (JournalRange& range : found.mapped()) {
    if (!answers(stage, range)) continue;
    if (range.first > next) stage.missing.push_back({next, range.first - next});
    next = range.first + range.count;
    stage.items_done += range.count;
    if (stage.spec.solo) stage.facts = range.facts;
    stage.held.push_back(std::move(range));
  }
  if (stage.held.empty()) {
    stage.missing.clear();
    return;
  }
  if (next < stage.spec.items) stage.missing.push_back({next, stage.spec.items - next});
  ++stage.writers;  // until feed_held() has read them
  frame.reused.push_back({"stage " + stage.spec.name, "accepted before the frame was begun again", stage.items_done});
}

void Farm::Impl::feed_held(RunningStage& stage, Bytes* records) {
  std::vector<ArrivedRecords::Batch> batches;
  std::map<std::uint64_t, CountedBatch> counted;
  for (const JournalRange& range : stage.held) {
    if (stage.streamed()) {
      // Read when the plan's turn has come: all of them may be more than memory holds.
      batches.push_back({range.first, range.count, {}, [file = stage.file, offset = range.offset, bytes = range.bytes] {
                           return file->read(offset, bytes);
                         }});
      continue;
    }
    const Bytes image = stage.file->read(range.offset, range.bytes);
    const auto middle = image.begin() + static_cast<std::ptrdiff_t>(range.count * count_bytes);
    if (stage.spec.output.counted)
      counted[range.first] = {Bytes(image.begin(), middle), Bytes(middle, image.end())};
    else
      std::memcpy(records->data() + range.first * stage.spec.output.record_bytes, image.data(), image.size());
  }
  std::lock_guard lock(mutex);
  for (ArrivedRecords::Batch& batch : batches) stage.arrived.put(std::move(batch));
  stage.counted.merge(counted);
  if (records)
    for (const JournalRange& range : stage.held) {
      stage.copied.push_back({range.first, range.count});
      if (settings.preview) stage.frame->undrawn.push_back({stage.shared_from_this(), range.first, range.count});
    }
  stage.held.clear();
  --stage.writers;
}

std::optional<JournalRange> Farm::Impl::store(RunningStage& stage, const Lease& lease, const Bytes& image,
                                              const Bytes& facts, const std::string& digest) {
  try {
    return JournalRange{.job = stage.frame->job->id,
                        .frame = stage.frame->place,
                        .artifact = stage.artifact,
                        .first = lease.first,
                        .count = lease.count,
                        .offset = stage.file->append(image),
                        .bytes = image.size(),
                        .digest = digest,
                        .facts = facts};
  } catch (const Error& error) {
    // The frame does not need the file; a coordinator after this one would.
    if (!std::exchange(stage.frame->said_unremembered, true))
      settings.log("job " + stage.frame->job->id + ": " + error.what() +
                   "; the frame goes on, but after a restart these records are computed again");
    return std::nullopt;
  }
}

void Farm::Impl::remember(RunningStage& stage, WorkerId maker, JournalRange range) {
  if (stage.rests_on_no_stage()) stage.frame->remembered.emplace_back(range, maker);
  settings.journal->accepted(std::move(range));
}

void Farm::Impl::forget_records(const Frame& frame, const std::string& failure) {
  JournalWriter* const journal = journal_of(*frame.job);
  if (!journal) return;
  journal->frame_over({.job = frame.job->id, .frame = frame.place, .failure = failure},
                      [folder = settings.records.empty() ? fs::path() : records_of(frame)] {
                        std::error_code ignored;
                        if (!folder.empty()) fs::remove_all(folder, ignored);
                      });
}

void Farm::Impl::forget_records(const Job& job) {
  JournalWriter* const journal = journal_of(job);
  if (!journal || settings.records.empty()) return;
  journal->job_over(job.id, [folder = settings.records / job.id] {
    std::error_code ignored;
    fs::remove_all(folder, ignored);
  });
}

}  // namespace gleaner::coordinator
