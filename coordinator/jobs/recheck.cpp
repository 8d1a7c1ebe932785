// Workers that lie, or whose memory does. A share of the accepted batches, and each worker's first one of every kind of
// stage, is computed again by another worker of the same kind, which makes the same bytes. Where the two differ a third
// one decides. Who is outvoted gets no more work, and what it made is computed again: a frame that rests on it begins
// anew, with the ranges that others made and that rest on no other stage's records. Of records that stay with their
// workers digests are compared.
//
// A worker that lies in n of its batches is found with a probability of 1 - (1 - share)^n, and surely where it lies in
// the first one.

#include <algorithm>
#include <chrono>
#include <random>
#include <tuple>
#include <utility>

#include "coordinator/blobs/sha256.h"
#include "coordinator/jobs/engine.h"
#include "coordinator/journal/journal_writer.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

// A worker that gives signs of life and no answers must not hold a frame that is whole. A comparison comes before all
// other work, and takes a batch's time.
constexpr Seconds recheck_patience = 3;
// Where none of those who could answer has ever answered anything, or all who have are quarantined.
constexpr Seconds recheck_patience_unproven = 0.5;
constexpr std::chrono::milliseconds recheck_look{200};

std::string words_of(const Recheck& recheck) {
  return "stage " + recheck.stage + ", items " + std::to_string(recheck.items.first) + " to " +
         std::to_string(recheck.items.first + recheck.items.count - 1);
}

}  // namespace

std::string device_kind(const DeviceDescription& device) {
  std::string kind;
  for (const std::string* word :
       {&device.name, &device.platform, &device.driver, &device.version, &device.tracer, &device.denoiser})
    kind += *word + "\n";
  return kind;
}

std::string digest_of(const Bytes& bytes) {
  Sha256 hash;
  hash.update(bytes);
  return hash.raw();
}

bool Farm::Impl::wants_recheck(const RunningStage& stage, Worker& worker) {
  if (!(settings.recheck_share > 0)) return false;
  // A solo stage is the whole of its work: it is done twice by chance alone.
  const bool first = !stage.spec.solo && !worker.rechecked_kinds.contains(stage.spec.kind);
  if (!first && std::uniform_real_distribution<double>(0, 1)(random) >= settings.recheck_share) return false;
  if (std::none_of(workers.begin(), workers.end(), [&](const auto& entry) {
        return entry.first != worker.id && !entry.second.draining && entry.second.kind == worker.kind;
      }))
    return false;
  if (first) worker.rechecked_kinds.insert(stage.spec.kind);
  return true;
}

std::set<WorkerId> Farm::Impl::witnesses(const Recheck& recheck) const {
  std::set<WorkerId> found;
  for (const auto& [id, worker] : workers)
    if (!worker.draining && worker.kind == recheck.device_kind &&
        std::none_of(recheck.answers.begin(), recheck.answers.end(),
                     [&, number = id](const auto& answer) { return answer.worker == number; }))
      found.insert(id);
  return found;
}

void Farm::Impl::recheck(const std::shared_ptr<RunningStage>& stage, WorkerId maker, const Lease& lease,
                         std::string digest) {
  const auto worker = workers.find(maker);
  if (worker == workers.end() || worker->second.draining) return;
  auto what = std::make_unique<Recheck>();
  what->stage = stage->spec.name;
  what->items = {lease.first, lease.count};
  what->device_kind = worker->second.kind;
  what->answers.push_back({maker, worker->second.name, std::move(digest)});
  ask_another(*stage->frame, *stage, std::move(what));
}

bool Farm::Impl::ask_another(Frame& frame, const RunningStage& like, std::unique_ptr<Recheck> what) {
  const std::set<WorkerId> asked = witnesses(*what);
  if (asked.empty()) return false;
  auto stage = std::make_shared<RunningStage>();
  stage->frame = frame.shared_from_this();
  stage->spec = like.spec;
  stage->spec.name += " (compared)";
  stage->work = like.work;
  stage->artifact = like.artifact;
  stage->reads = like.reads;
  stage->again = {what->items};
  stage->recheck = std::move(what);
  // Who has never answered anything may not answer this either.
  const bool some_proven = std::any_of(asked.begin(), asked.end(), [&](WorkerId id) { return scheduler.proven(id); });
  for (const auto& [id, worker] : workers)
    if (!asked.contains(id) || (some_proven && !scheduler.proven(id))) stage->avoid.push_back(id);
  const ItemRange& items = stage->recheck->items;
  ScheduledStage scheduled{.kind = stage->spec.kind,
                           .items = stage->spec.items,
                           .tile = static_cast<std::uint32_t>(items.count),  // in one piece
                           .solo = stage->spec.solo,
                           .at_once = true,
                           .priority = with_priority(like.computes_again ? like.spec.priority : like.spec.priority + 1,
                                                     stage->frame->job->request),
                           .preferred = {},
                           .only = {{items.first, items.count}},
                           .avoid = stage->avoid,
                           .near = {}};
  stage->id = scheduler.add_stage(scheduled, now());
  active_stages[stage->id] = stage;
  frame.rechecks.push_back(stage);
  hold_inputs(*stage);
  require_inputs(*stage);
  pause_if_inputs_lack(*stage);
  settle_pause(*stage);
  return true;
}

void Farm::Impl::end_recheck(const std::shared_ptr<RunningStage>& stage) {
  stage->delivered = true;
  revoke(scheduler.remove_stage(stage->id));
  active_stages.erase(stage->id);
  std::erase(stage->frame->rechecks, stage);
  release_inputs(*stage);
  stage->frame->events.notify_all();
}

void Farm::Impl::take_recheck(const std::shared_ptr<RunningStage>& stage, Worker& worker, const std::string& digest,
                              const std::optional<BatchOutput::Retained>& part) {
  hold_inputs(*stage);  // whoever is asked next reads them too
  const std::string accepted = stage->recheck->answers.front().digest;
  compare_answers(stage, worker, digest);
  // What equals the accepted part is a copy of it, for readers to choose from.
  if (part && digest == accepted)
    take_part(*stage, worker, part->items, *part);
  else if (part)
    worker.session->drop_part(part->artifact, part->items.first, digest);
  release_inputs(*stage);
}

void Farm::Impl::compare_answers(const std::shared_ptr<RunningStage>& stage, const Worker& worker, std::string digest) {
  Frame& frame = *stage->frame;
  auto recheck = std::make_unique<Recheck>(*stage->recheck);
  end_recheck(stage);
  if (!witnesses(*recheck).contains(worker.id)) return;  // it says nothing about the others
  ++totals.batches_rechecked;
  const auto agreed = std::find_if(recheck->answers.begin(), recheck->answers.end(),
                                   [&](const auto& answer) { return answer.digest == digest; });
  if (agreed != recheck->answers.end()) {
    for (const auto& answer : recheck->answers)
      if (answer.digest != digest) distrust(answer.worker, words_of(*recheck) + ": made other records than two others");
    return;
  }
  recheck->answers.push_back({worker.id, worker.name, std::move(digest)});
  settings.log("job " + frame.job->id + ": " + words_of(*recheck) + ": workers " + recheck->answers[0].name + " and " +
               worker.name + " made different records");
  const Recheck open = *recheck;
  if (recheck->answers.size() > 2 || !ask_another(frame, *stage, std::move(recheck))) disagree(frame, open);
}

void Farm::Impl::disagree(Frame& frame, const Recheck& recheck) {
  if (!frame.failure.empty()) return;
  std::string names;
  for (const auto& answer : recheck.answers) names += (names.empty() ? "" : ", ") + answer.name;
  frame.failure =
      words_of(recheck) + ": workers " + names + " made different records, and " +
      (recheck.answers.size() > 2 ? "no two of them agree" : "there is no third one of their kind to decide");
  frame.events.notify_all();
}

void Farm::Impl::drop_hopeless_rechecks() {
  std::vector<std::shared_ptr<RunningStage>> hopeless;
  for (const auto& [id, stage] : active_stages)
    if (stage->recheck && witnesses(*stage->recheck).empty()) hopeless.push_back(stage);
  for (const auto& stage : hopeless) {
    end_recheck(stage);
    if (stage->recheck->answers.size() > 1) disagree(*stage->frame, *stage->recheck);
  }
}

void Farm::Impl::distrust(WorkerId liar, const std::string& why) {
  if (liars.contains(liar)) return;  // frames begun since then have nothing of it
  ++totals.liars_found;
  const std::string name = name_of(liar);
  quarantine(liar, why);
  // What others made of its records may be among these.
  kept.clear();
  std::vector<ArtifactId> held;
  std::set<Frame*> readers;
  for (auto& [id, artifact] : retained) {
    artifact.untrusted = true;
    held.push_back(id);
    readers.insert(artifact.frames.begin(), artifact.frames.end());
  }
  for (const ArtifactId& id : held) release_if_unused(id);
  for (const auto& [id, job] : jobs) {
    if (ended(job->state)) continue;
    if (const auto before = job->frames_with.find(liar); before != job->frames_with.end()) {
      const std::string words = std::to_string(before->second) +
                                " of the frames before were written with the help of " + name +
                                ", which was found to make wrong records";
      settings.log("job " + id + ": " + words);
      job->warnings.push_back(words);
    }
    for (const auto& [place, frame] : job->frames) {
      if (!frame->makers.contains(liar) && !readers.contains(frame.get())) continue;
      frame->distrusted = true;
      frame->events.notify_all();
    }
  }
}

bool Farm::Impl::likely_answered(const Recheck& recheck) const {
  const std::set<WorkerId> asked = witnesses(recheck);
  return std::any_of(asked.begin(), asked.end(),
                     [&](WorkerId id) { return scheduler.proven(id) && !scheduler.quarantined_until(id); });
}

void Farm::Impl::give_up_rechecks(Frame& frame) {
  for (const auto& stage : std::vector(frame.rechecks)) {
    const bool disputed = stage->recheck->answers.size() > 1;
    const Seconds patience = disputed                           ? settings.scheduler.lease_floor
                             : likely_answered(*stage->recheck) ? recheck_patience
                                                                : recheck_patience_unproven;
    if (now() - frame.all_but_rechecks < patience) continue;
    settings.log("job " + frame.job->id + ": " + words_of(*stage->recheck) +
                 ": whoever was asked to compute it again does not answer");
    end_recheck(stage);
    if (disputed) disagree(frame, *stage->recheck);
  }
}

void Farm::Impl::await_rechecks(Frame& frame) {
  const Job& job = *frame.job;
  std::unique_lock lock(mutex);
  frame.all_but_rechecks = now();
  const auto over = [&] {
    return job.cancel || stopping || !frame.failure.empty() || frame.distrusted || frame.rechecks.empty();
  };
  while (!over()) {
    frame.events.wait_for(lock, recheck_look, over);
    if (!over() && !job.paused) give_up_rechecks(frame);
  }
  if (job.cancel || stopping) throw Cancelled{};
  if (!frame.failure.empty()) throw Error::failed(frame.failure);
  if (frame.distrusted) throw Distrusted{};
}

void Farm::Impl::start_over(Frame& frame) {
  JobRemains remains;  // destroyed last
  std::lock_guard lock(mutex);
  remains = withdraw(frame);
  frame.distrusted = false;
  frame.held.clear();
  frame.reused.clear();
  std::erase_if(frame.remembered, [&](const auto& entry) { return liars.contains(entry.second); });
  std::sort(frame.remembered.begin(), frame.remembered.end(), [](const auto& a, const auto& b) {
    return std::tie(a.first.artifact, a.first.first) < std::tie(b.first.artifact, b.first.first);
  });
  frame.makers.clear();
  if (JournalWriter* journal = journal_of(*frame.job)) journal->frame_begins_again(frame.job->id, frame.place);
  std::uint64_t items = 0;
  for (const auto& [range, maker] : frame.remembered) {
    frame.makers.insert(maker);
    settings.journal->accepted(range);
    frame.held[range.artifact].push_back(range);
    items += range.count;
  }
  settings.log("job " + frame.job->id + ": the frame begins again; " + std::to_string(items) +
               " items that other workers made are taken over");
  frame.work_asked = frame.work_done = frame.work_to_come = 0;
  frame.progress = FrameProgress(now());
  changed(*frame.job);
}

}  // namespace gleaner::coordinator
