// What workers answer: accepted records, and failures.

#include <chrono>
#include <cstring>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "coordinator/journal/record_file.h"

namespace gleaner::coordinator {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t most_nonfinite_items = 16;  // in a report
constexpr std::size_t most_facts_bytes = std::size_t{64} << 10;
constexpr Seconds unavailable_for = 60;  // that inputs may lack, beyond the time in which a lost worker is noticed

// Sums of a film's samples must stay finite: a record beyond is no light.
constexpr int most_exponent = 108;

// The first of the 32-bit floats that is not a number of sane size; their count: none.
std::size_t first_insane(const Bytes& image) {
  const std::size_t words = image.size() / sizeof(std::uint32_t);
  constexpr std::uint32_t sign = 0x80000000u, most = static_cast<std::uint32_t>(most_exponent + 127) << 23;
  for (std::size_t word = 0; word < words; ++word) {
    std::uint32_t bits;
    std::memcpy(&bits, image.data() + word * sizeof bits, sizeof bits);
    if ((bits & ~sign) >= most) return word;
  }
  return words;
}

// Adds the time from here on to a total, until it is stopped.
class Stopwatch {
 public:
  explicit Stopwatch(double& total) : total_(total), begun_(Clock::now()) {}
  ~Stopwatch() { stop(); }
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;
  void stop() {
    if (!std::exchange(stopped_, true)) total_ += std::chrono::duration<double>(Clock::now() - begun_).count();
  }

 private:
  double& total_;
  Clock::time_point begun_;
  bool stopped_ = false;
};

}  // namespace

std::string Farm::Impl::misfit(const RunningStage& stage, const Lease& lease, const BatchOutput& output) {
  const StageOutput& wanted = stage.spec.output;
  if (output.facts.size() > most_facts_bytes)
    return "sent " + std::to_string(output.facts.size()) + " bytes of facts, expected at most " +
           std::to_string(most_facts_bytes);
  if (wanted.placement == Placement::retain) {
    if (!output.part) return "sent its records, which it was to keep";
    return fits(stage, lease, *output.part) ? "" : "keeps a part of a shape that its items cannot have";
  }
  if (output.part) return "kept its records, which it was to send";
  std::uint64_t expected = lease.count * wanted.record_bytes;
  if (wanted.counted) {
    if (output.image.size() < lease.count * count_bytes) return "sent fewer counts than items";
    std::uint64_t records = 0;
    for (std::uint64_t item = 0; item < lease.count; ++item) {
      std::uint32_t count;
      std::memcpy(&count, output.image.data() + item * count_bytes, count_bytes);
      if (count > wanted.most_records)
        return "sent " + std::to_string(count) + " records of item " + std::to_string(lease.first + item) +
               ", expected at most " + std::to_string(wanted.most_records);
      records += count;
    }
    expected = lease.count * count_bytes + records * wanted.record_bytes;
  }
  if (output.image.size() != expected)
    return "sent " + std::to_string(output.image.size()) + " bytes instead of " + std::to_string(expected);
  if (!wanted.floats) return "";
  const std::size_t words = output.image.size() / sizeof(float), bad = first_insane(output.image);
  if (bad == words) return "";
  float value;
  std::memcpy(&value, output.image.data() + bad * sizeof value, sizeof value);
  return "sent " + std::to_string(value) + " in the record of item " +
         std::to_string(lease.first + bad * sizeof value / wanted.record_bytes) + ", expected finite numbers below 2^" +
         std::to_string(most_exponent);
}

std::shared_ptr<RunningStage> Farm::Impl::stage_of(WorkerId id, LeaseId lease_id, Epoch epoch, Lease& lease) const {
  const auto known = leases.find(epoch);
  if (known == leases.end() || known->second.worker != id || known->second.id != lease_id) return nullptr;
  lease = known->second;
  const auto found = active_stages.find(lease.stage);
  return found == active_stages.end() ? nullptr : found->second;
}

Verdict Farm::Impl::result(WorkerId id, LeaseId lease_id, Epoch epoch, BatchOutput output, const BatchCost& cost) {
  Lease lease;
  std::shared_ptr<RunningStage> stage;
  std::unique_lock lock(mutex);
  {
    const Stopwatch held(totals.result_lock_seconds);
    stage = stage_of(id, lease_id, epoch, lease);
  }
  if (stage) {
    lock.unlock();
    if (const std::string why = misfit(*stage, lease, output); !why.empty()) {
      failed(id, lease_id, epoch, why, false);
      return Verdict::stale;
    }
    lock.lock();
  }
  Stopwatch held(totals.result_lock_seconds);
  const auto worker = workers.find(id);
  if (worker == workers.end()) return Verdict::unknown_lease;
  worker->second.heard = now();
  stage = stage_of(id, lease_id, epoch, lease);  // it may have ended meanwhile
  ResultOutcome outcome = scheduler.result(id, lease_id, epoch, cost.seconds, now());
  if (const auto known = leases.find(epoch);
      known != leases.end() && known->second.worker == id && known->second.id == lease_id)
    forget_lease(epoch);
  revoke(outcome.revoke);
  offer(worker->second);  // it gets its next batch before this one is put away
  offer_to_unserved_soon();
  if (outcome.verdict != Verdict::accepted || !stage) {
    if (output.part) take_late_part(worker->second, outcome.verdict, *output.part);
    return outcome.verdict;
  }
  bool rechecked = false;
  if (!stage->recheck) {
    rechecked = wants_recheck(*stage, worker->second);
    account(*stage, worker->second, lease, cost, output.sent_bytes ? output.sent_bytes : output.image.size());
    stage->complete = outcome.stage_complete;
    stage->unavailable_since = -1;
    if (stage->spec.solo) stage->facts = std::move(output.facts);
    changed(*stage->frame->job);
  }
  held.stop();
  std::optional<std::uint64_t> on_file;
  if (stage->recheck || stage->file || rechecked) on_file = put_on_record(stage, id, lease, output, rechecked, lock);
  if (stage->recheck) return outcome.verdict;
  if (stage->streamed())
    stream_in(*stage, lease, std::move(output.image), on_file, lock);
  else if (stage->retained())
    keep(stage, worker->second, lease, *output.part);
  else if (stage->spec.output.counted)
    collect_counted(stage, lease, std::move(output.image));
  else
    collect(stage, lease, output.image, lock);
  return outcome.verdict;
}

std::optional<std::uint64_t> Farm::Impl::put_on_record(const std::shared_ptr<RunningStage>& stage, WorkerId id,
                                                       const Lease& lease, const BatchOutput& output, bool rechecked,
                                                       std::unique_lock<std::mutex>& lock) {
  ++stage->writers;  // the stage is not whole before this batch is put away
  const Bytes facts = stage->facts;
  lock.unlock();
  const std::string digest = output.part ? output.part->digest : digest_of(output.image);
  std::optional<JournalRange> range;
  if (stage->file) range = store(*stage, lease, output.image, facts, digest);
  lock.lock();
  --stage->writers;
  const auto worker = workers.find(id);
  if (stage->delivered) {  // the frame is over, or begins again
    if (stage->recheck && output.part && worker != workers.end())
      worker->second.session->drop_part(output.part->artifact, lease.first, digest);
    return std::nullopt;
  }
  std::optional<std::uint64_t> offset;
  if (range) offset = range->offset;
  if (range) remember(*stage, id, std::move(*range));
  if (rechecked) recheck(stage, id, lease, digest);
  if (stage->recheck && worker != workers.end()) take_recheck(stage, worker->second, digest, output.part);
  return offset;
}

void Farm::Impl::collect_counted(const std::shared_ptr<RunningStage>& stage, const Lease& lease, Bytes image) {
  const auto records = image.begin() + static_cast<std::ptrdiff_t>(lease.count * count_bytes);
  stage->counted[lease.first] = {Bytes(image.begin(), records), Bytes(records, image.end())};
  deliver_if_complete(stage);
}

void Farm::Impl::keep(const std::shared_ptr<RunningStage>& stage, Worker& worker, const Lease& lease,
                      const BatchOutput::Retained& part) {
  take_part(*stage, worker, {lease.first, lease.count}, part);
  if (!stage->complete) return;
  if (stage->computes_again) {
    end_again(stage);
    settle_retained();
    return;
  }
  if (auto at = retained.find(stage->artifact); at != retained.end() && !stage->facts.empty())
    at->second.facts = stage->facts;
  if (registry.whole(stage->artifact))
    deliver_if_complete(stage);
  else
    settle_retained();  // what was lost or disputed on the way
}

void Farm::Impl::collect(const std::shared_ptr<RunningStage>& stage, const Lease& lease, const Bytes& records,
                         std::unique_lock<std::mutex>& lock) {
  ++stage->writers;
  records_ready.wait(lock, [&] { return stage->records || stage->failed_to_allocate || stage->delivered; });
  std::shared_ptr<Bytes> target = stage->records;
  lock.unlock();
  if (target)
    std::memcpy(target->data() + lease.first * stage->spec.output.record_bytes, records.data(), records.size());
  lock.lock();
  const Stopwatch held(totals.result_lock_seconds);
  if (target) stage->copied.push_back({lease.first, lease.count});
  --stage->writers;
  deliver_if_complete(stage);
  if (!settings.preview || stage->delivered || !target) return;
  std::deque<UndrawnItems>& undrawn = stage->frame->undrawn;
  if (!undrawn.empty() && undrawn.back().stage == stage && undrawn.back().first + undrawn.back().count == lease.first)
    undrawn.back().count += lease.count;
  else
    undrawn.push_back({stage, lease.first, lease.count});
  stage->frame->events.notify_all();
}

void Farm::Impl::stream_in(RunningStage& stage, const Lease& lease, Bytes records, std::optional<std::uint64_t> on_file,
                           std::unique_lock<std::mutex>& lock) {
  Stopwatch held(totals.result_lock_seconds);
  ArrivedRecords::Batch batch{lease.first, lease.count, std::move(records)};
  const bool full = stage.arrived.bytes() + batch.records.size() > settings.arrived_bytes;
  if (on_file && full && !stage.arrived.ready() && lease.first != stage.arrived.given()) {
    // It waits for a batch that is late, and lies in a file anyway: a slow worker costs the coordinator no memory.
    batch.read = [file = stage.file, offset = *on_file, bytes = batch.records.size()] {
      return file->read(offset, bytes);
    };
    batch.records = {};
    ++totals.batches_read_back;
  }
  stage.arrived.put(std::move(batch));
  stage.frame->events.notify_all();
  // A plan that takes records in more slowly than they arrive holds their workers up; one that waits for a batch that
  // has not arrived does not, or that batch might never come.
  const auto room = [&] {
    return stage.delivered || !stage.arrived.ready() || stage.arrived.bytes() <= settings.arrived_bytes;
  };
  if (room()) return;
  held.stop();
  const WorkerId id = lease.worker;
  if (auto worker = workers.find(id); worker != workers.end()) ++worker->second.waits;
  records_ready.wait(lock, room);
  if (auto worker = workers.find(id); worker != workers.end()) {
    --worker->second.waits;
    worker->second.heard = now();
  }
}

void Farm::Impl::account(RunningStage& stage, Worker& worker, const Lease& lease, const BatchCost& cost,
                         std::size_t bytes) {
  Seconds time = now();
  stage.items_done += lease.count;
  totals.items_accepted += lease.count;
  ++totals.batches_accepted;
  stage.last_result = time;
  remember_progress(stage, time);
  worker.last_batch = {
      .stage = stage.spec.name, .kind = stage.spec.kind, .items = lease.count, .seconds = cost.seconds};
  Frame& frame = *stage.frame;
  frame.makers.insert(worker.id);
  frame.work_done += stage.work_per_item() * static_cast<double>(lease.count);
  frame.progress.update(time, frame.work_done, frame.work_asked - frame.work_done + frame.work_to_come);
  update_progress(*frame.job, time);
  ++stage.report.batches;
  stage.report.trace_seconds += cost.trace_seconds;
  stage.report.kernel_seconds += cost.kernel_seconds;
  auto& share = stage.report.workers[worker.name];
  share.items += lease.count;
  share.seconds += cost.seconds;
  FrameReport& report = frame.report;
  report.camera_rays += cost.camera_rays;
  report.scatter_rays += cost.scatter_rays;
  report.shadow_rays += cost.shadow_rays;
  frame.job->worker_seconds += cost.seconds;
  frame.job->rays += cost.camera_rays + cost.scatter_rays + cost.shadow_rays;
  report.uploaded_bytes += cost.fetched_bytes;
  report.peer_bytes += cost.peer_bytes;
  report.downloaded_bytes += bytes;
  if (cost.shown) report.motion.emplace_back(worker.name, *cost.shown);
  report.nonfinite += cost.nonfinite;
  for (std::uint64_t item : cost.nonfinite_items)
    if (report.nonfinite_items.size() < most_nonfinite_items)
      report.nonfinite_items.push_back({stage.spec.name, item, worker.name});
  report.devices.emplace(worker.name, worker.hello.device);
}

void Farm::Impl::failed(WorkerId id, LeaseId lease_id, Epoch epoch, const std::string& message,
                        bool input_unavailable) {
  std::lock_guard lock(mutex);
  auto worker = workers.find(id);
  if (worker == workers.end()) return;
  worker->second.heard = now();
  auto known = leases.find(epoch);
  std::shared_ptr<RunningStage> stage;
  if (known != leases.end())
    if (auto found = active_stages.find(known->second.stage); found != active_stages.end()) stage = found->second;
  // Nobody's fault, unless it lasts: by then who held the inputs is known to be lost.
  bool blameless = input_unavailable && stage;
  if (blameless) {
    if (stage->unavailable_since < 0) stage->unavailable_since = now();
    blameless = now() - stage->unavailable_since <= unavailable_for + settings.silence;
  }
  FailureOutcome outcome = scheduler.failed(id, lease_id, epoch, now(), blameless);
  if (outcome.known && stage) {
    ++totals.batches_failed;
    const Lease& lease = known->second;
    stage->last_failure = "stage " + stage->spec.name + ", items " + std::to_string(lease.first) + " to " +
                          std::to_string(lease.first + lease.count - 1) + ", worker " + worker->second.name + ": " +
                          message;
    settings.log("job " + stage->frame->job->id + ": " + stage->last_failure);
    if (outcome.stage_failed && !stage->recheck && stage->frame->failure.empty()) {
      stage->frame->failure = stage->last_failure;
      stage->frame->events.notify_all();
    }
    forget_lease(epoch);
    if (stage->recheck && (outcome.stage_failed || input_unavailable)) {
      // Nobody can compare: where the answers so far differ, nobody decides.
      end_recheck(stage);
      if (stage->recheck->answers.size() > 1) disagree(*stage->frame, *stage->recheck);
    }
  }
  offer(worker->second);
  offer_to_unserved_soon();
}

FarmTotals Farm::totals() const {
  std::lock_guard lock(impl_->mutex);
  return impl_->totals;
}

std::optional<std::uint64_t> Farm::expected_bytes(WorkerId worker, LeaseId lease, Epoch epoch) const {
  std::lock_guard lock(impl_->mutex);
  auto found = impl_->leases.find(epoch);
  if (found == impl_->leases.end() || found->second.worker != worker || found->second.id != lease) return std::nullopt;
  auto stage = impl_->active_stages.find(found->second.stage);
  if (stage == impl_->active_stages.end()) return std::nullopt;
  const StageOutput& output = stage->second->spec.output;
  if (output.placement == Placement::retain) return 0;
  const std::uint64_t item_bytes =
      output.counted ? count_bytes + std::uint64_t{output.most_records} * output.record_bytes : output.record_bytes;
  return found->second.count * item_bytes;
}

Verdict Farm::result(WorkerId worker, LeaseId lease, Epoch epoch, BatchOutput output, const BatchCost& cost) {
  return impl_->result(worker, lease, epoch, std::move(output), cost);
}

void Farm::failed(WorkerId worker, LeaseId lease, Epoch epoch, const std::string& message, bool input_unavailable) {
  impl_->failed(worker, lease, epoch, message, input_unavailable);
}

}  // namespace gleaner::coordinator
