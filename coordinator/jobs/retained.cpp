// Outputs that stay with the workers: where they are, what reads them, and what is computed again when they are lost.

#include <algorithm>
#include <climits>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "proto/sha256.h"

namespace gleaner::coordinator {

namespace {

// Before everything else: whoever reads what was lost waits for it.
constexpr int priority_again = INT_MAX;

// Parts of one worker that turned out to be other bytes, before all that it holds is taken for wrong.
constexpr unsigned most_wrong_copies = 3;

// How often items are computed again because workers do not agree on them, where no third worker decides.
constexpr unsigned most_rounds = 4;

ArtifactLayout layout_of(const StageSpec& spec) {
  return {.items = spec.items,
          .record_bytes = spec.output.record_bytes,
          .counted = spec.output.counted,
          .most_records = spec.output.most_records};
}

bool overlap(const ItemRange& a, const ItemRange& b) {
  return a.first < b.first + b.count && b.first < a.first + a.count;
}

std::string words_of(const ItemRange& items) {
  return "items " + std::to_string(items.first) + " to " + std::to_string(items.first + items.count - 1);
}

}  // namespace

// --- Lifetimes (mutex held)
// -------------------------------------------------------------------------------------------

bool Farm::Impl::retain_output(RunningStage& stage) {
  auto recipe = std::make_shared<Recipe>();
  recipe->id = stage.artifact;
  recipe->spec = stage.spec;
  recipe->work = stage.work;
  recipe->inputs = stage.reads;
  stage.recipe = recipe;
  RetainedArtifact& artifact = retained[stage.artifact];
  if (!artifact.recipe) artifact.recipe = std::move(recipe);
  artifact.frames.insert(stage.frame.get());
  registry.take(stage.artifact);
  registry.add(stage.artifact, layout_of(stage.spec));
  if (stage.spec.items > 0 && registry.whole(stage.artifact)) {
    stage.facts = artifact.facts;
    return true;
  }
  // Of one that another frame has made, or is about to make, what exists is not made again.
  const auto gaps = registry.gaps(stage.artifact);
  if (registry.bytes(stage.artifact) > 0)
    for (const Gap& gap : gaps) stage.again.push_back(gap.items);
  return false;
}

void Farm::Impl::release_retained(Frame& frame, const ArtifactId& id) {
  if (const auto at = retained.find(id); at != retained.end() && at->second.frames.erase(&frame) > 0)
    release_if_unused(id);
}

void Farm::Impl::release_if_unused(const ArtifactId& id) {
  const auto at = retained.find(id);
  if (at == retained.end() || !at->second.frames.empty() || at->second.readers > 0) return;
  std::vector<ArtifactId> gone = {id};
  if (at->second.recipe->spec.output.reusable && !at->second.untrusted)
    gone = registry.keep(id, settings.retained_bytes);
  for (const ArtifactId& artifact : gone) {
    for (const WorkerId holder : registry.release(artifact))
      if (auto worker = workers.find(holder); worker != workers.end()) worker->second.session->release({artifact});
    retained.erase(artifact);
  }
}

void Farm::Impl::release_all_retained(Frame& frame) {
  std::vector<ArtifactId> held;
  for (const auto& [id, artifact] : retained)
    if (artifact.frames.contains(&frame)) held.push_back(id);
  for (const ArtifactId& id : held) release_retained(frame, id);
}

// --- Placing and pausing (mutex held)
// ---------------------------------------------------------------------------------

namespace {

// A batch that reads several parts of an input holds a copy of them: more are no faster.
constexpr std::uint64_t most_span_bytes = std::uint64_t{64} << 20;

// Parts that follow each other are one span.
void add_span(std::vector<ItemSpan>& spans, const ItemRange& items, std::uint64_t most_items) {
  if (!spans.empty() && spans.back().first + spans.back().count == items.first &&
      spans.back().count + items.count <= most_items)
    spans.back().count += items.count;
  else
    spans.push_back({items.first, items.count});
}

}  // namespace

void Farm::Impl::place_near_inputs(const RunningStage& stage, ScheduledStage& scheduled) {
  std::vector<ArtifactId> read;
  ArtifactId largest;  // of those of which a batch reads its own items
  for (std::size_t i = 0; i < stage.reads.size(); ++i) {
    if (!stage.reads[i]) continue;
    const ArtifactId& id = stage.reads[i]->id;
    read.push_back(id);
    if (stage.work->inputs[i].own_items && (largest.empty() || registry.bytes(id) > registry.bytes(largest)))
      largest = id;
  }
  if (stage.spec.solo) {
    scheduled.preferred = registry.hold_most(read);
    std::erase_if(scheduled.preferred,
                  [&](WorkerId id) { return std::ranges::find(stage.avoid, id) != stage.avoid.end(); });
  } else if (!largest.empty()) {
    // A batch is a whole span where its worker can do so much in time.
    const std::uint64_t item_bytes = registry.bytes(largest) / stage.spec.items;
    const std::uint64_t most_items = most_span_bytes / std::max<std::uint64_t>(1, item_bytes);
    scheduled.near_bytes = static_cast<double>(item_bytes);
    for (const HeldPart& part : registry.parts(largest, {0, stage.spec.items}))
      for (const WorkerId holder : part.holders) add_span(scheduled.near[holder], part.items, most_items);
  }
}

bool Farm::Impl::inputs_exist(const RunningStage& stage) const {
  for (std::size_t i = 0; i < stage.reads.size(); ++i) {
    if (!stage.reads[i]) continue;
    const ArtifactId& id = stage.reads[i]->id;
    if (registry.whole(id)) continue;
    if (!stage.work->inputs[i].own_items || stage.again.empty()) return false;
    for (const ItemRange& range : stage.again)
      if (!registry.exists(id, range)) return false;
  }
  return true;
}

void Farm::Impl::pause_if_inputs_lack(RunningStage& stage) {
  const bool lack = !inputs_exist(stage);
  if (lack == stage.paused) return;
  stage.paused = lack;
  settle_pause(stage);
}

void Farm::Impl::settle_pause(const RunningStage& stage) {
  if (stage.paused || stage.frame->job->paused)
    scheduler.pause(stage.id);
  else
    scheduler.resume(stage.id);
  offer_to_unserved_soon();
}

// --- Computing again (mutex held)
// -------------------------------------------------------------------------------------

void Farm::Impl::settle_retained() {
  // Computing one again may need others again, which become known meanwhile: their ids are looked at as they come.
  std::vector<ArtifactId> ids;
  for (const auto& [id, artifact] : retained) ids.push_back(id);
  for (const ArtifactId& id : ids) {
    const auto at = retained.find(id);
    if (at == retained.end()) continue;
    if (at->second.frames.empty() && at->second.readers == 0) {
      if (!registry.whole(id)) release_if_unused(id);  // nobody computes again what nobody needs
      continue;
    }
    bool being_made = false;
    for (const auto& [stage_id, stage] : active_stages)
      being_made = being_made || (stage->artifact == id && stage->makes_output() && !stage->complete);
    if (!at->second.frames.empty()) compute_again(**at->second.frames.begin(), id, missing(id, being_made));
  }
  std::vector<std::shared_ptr<RunningStage>> stages;
  for (const auto& [id, stage] : active_stages) stages.push_back(stage);
  for (const auto& stage : stages)
    if (stage->computes_again || stage->recheck) require_inputs(*stage);
  for (const auto& stage : stages) pause_if_inputs_lack(*stage);
}

// What must be computed again, and is not yet: what was lost, or, where no stage makes the artifact any more, all gaps.
std::vector<Gap> Farm::Impl::missing(const ArtifactId& id, bool being_made) {
  RetainedArtifact& artifact = retained.at(id);
  std::vector<Gap> gaps;
  if (being_made) {
    for (const ItemRange& lost : std::exchange(artifact.lost, {}))
      for (Gap& gap : registry.gaps(id, lost)) gaps.push_back(std::move(gap));
  } else {
    artifact.lost.clear();
    gaps = registry.gaps(id);
  }
  std::erase_if(gaps, [&](const Gap& gap) {
    for (const auto& [stage_id, stage] : active_stages)
      if (stage->artifact == id && stage->computes_again)
        for (const ItemRange& again : stage->again)
          if (overlap(again, gap.items)) return true;
    return false;
  });
  return gaps;
}

void Farm::Impl::compute_again(Frame& frame, const ArtifactId& id, const std::vector<Gap>& gaps) {
  if (gaps.empty()) return;
  std::vector<ItemRange> together;
  for (const Gap& gap : gaps)
    if (gap.in_one_piece || !gap.avoid.empty())
      start_again(frame, id, {gap.items}, &gap);
    else
      together.push_back(gap.items);
  if (!together.empty()) start_again(frame, id, std::move(together), nullptr);
}

void Farm::Impl::start_again(Frame& frame, const ArtifactId& id, std::vector<ItemRange> items, const Gap* special) {
  const std::shared_ptr<const Recipe> recipe = retained.at(id).recipe;
  auto stage = std::make_shared<RunningStage>();
  stage->frame = frame.shared_from_this();
  stage->spec = recipe->spec;
  stage->spec.name += " (again)";
  stage->spec.priority = priority_again;
  stage->computes_again = true;
  if (special) {
    stage->spec.solo = stage->spec.solo || special->in_one_piece;
    stage->avoid = special->avoid;
  }
  stage->artifact = id;
  stage->recipe = recipe;
  stage->reads = recipe->inputs;
  stage->work = recipe->work;
  stage->again = std::move(items);
  stage->report.name = stage->spec.name;
  stage->report.kind = stage->spec.kind;
  for (const ItemRange& range : stage->again) stage->report.items += range.count;
  settings.log("job " + frame.job->id + ": stage " + recipe->spec.name + ": " + std::to_string(stage->report.items) +
               " items are computed again");
  hold_inputs(*stage);
  start(stage);
  require_inputs(*stage);
}

// What the stage reads may have been released meanwhile: it is needed again, as far as the stage's items read it.
void Farm::Impl::hold_inputs(const RunningStage& stage) {
  for (const auto& input : stage.reads) {
    if (!input) continue;
    RetainedArtifact& artifact = retained[input->id];
    if (!artifact.recipe) artifact.recipe = input;
    ++artifact.readers;
    registry.take(input->id);
    registry.add(input->id, layout_of(input->spec));
  }
}

void Farm::Impl::release_inputs(const RunningStage& stage) {
  for (const auto& input : stage.reads) {
    if (!input) continue;
    if (auto at = retained.find(input->id); at != retained.end() && at->second.readers > 0) --at->second.readers;
    release_if_unused(input->id);
  }
}

// What the stage reads and nobody holds is computed again too, if nobody does it already.
void Farm::Impl::require_inputs(const RunningStage& stage) {
  for (std::size_t i = 0; i < stage.reads.size(); ++i) {
    const auto& input = stage.reads[i];
    if (!input || registry.whole(input->id)) continue;
    std::vector<Gap> needed;
    if (stage.work->inputs[i].own_items)
      for (const ItemRange& range : stage.again)
        for (Gap& gap : registry.gaps(input->id, range)) needed.push_back(std::move(gap));
    else
      needed = registry.gaps(input->id);
    std::erase_if(needed, [&](const Gap& gap) { return is_computed(input->id, gap.items); });
    compute_again(*stage.frame, input->id, needed);
  }
}

// Some stage that runs makes these items.
bool Farm::Impl::is_computed(const ArtifactId& id, const ItemRange& items) const {
  for (const auto& [stage_id, stage] : active_stages) {
    if (stage->artifact != id || stage->recheck) continue;
    if (stage->again.empty() && !stage->complete) return true;
    for (const ItemRange& again : stage->again)
      if (overlap(again, items)) return true;
  }
  return false;
}

void Farm::Impl::end_again(const std::shared_ptr<RunningStage>& stage) {
  stage->delivered = true;
  if (stage->last_result >= 0) stage->report.seconds = stage->last_result - stage->first_lease;
  revoke(scheduler.remove_stage(stage->id));
  active_stages.erase(stage->id);
  release_inputs(*stage);
}

// --- Parts (mutex held)
// -----------------------------------------------------------------------------------------------

bool Farm::Impl::fits(const RunningStage& stage, const Lease& lease, const BatchOutput::Retained& part) {
  const StageOutput& output = stage.spec.output;
  if (part.digest.size() != 32) return false;
  if (!output.counted) return part.records == lease.count && part.bytes == lease.count * output.record_bytes;
  return part.records <= lease.count * output.most_records &&
         part.bytes == lease.count * 4 + part.records * output.record_bytes;
}

void Farm::Impl::take_part(const RunningStage& stage, Worker& worker, const ItemRange& items,
                           const BatchOutput::Retained& sent) {
  const Part part{
      .items = items, .bytes = sent.bytes, .records = sent.records, .digest = sent.digest, .device_kind = worker.kind};
  const ArtifactId id = stage.artifact;
  const PartOutcome outcome = registry.accept(id, part, worker.id);
  const std::string what = "job " + stage.frame->job->id + ": stage " + stage.spec.name + ", " + words_of(items);
  if (outcome.verdict == PartVerdict::disputed) {
    std::string names;
    for (const PartClaim& claim : outcome.claims) {
      names += (names.empty() ? "" : ", ") + name_of(claim.worker);
      if (auto holder = workers.find(claim.worker); holder != workers.end())
        holder->second.session->drop_part(id, items.first, claim.digest);
    }
    settings.log(what + ": workers " + names + " made different records; none counts");
    if ((outcome.claims.size() > 2 || outcome.rounds >= most_rounds) && stage.frame->failure.empty()) {
      stage.frame->failure = what + ": the records differ each time they are computed (workers " + names + ")";
      stage.frame->events.notify_all();
    }
    if (auto at = retained.find(id); at != retained.end()) at->second.lost.push_back(items);
    settle_retained();
  } else if (outcome.verdict != PartVerdict::added && outcome.verdict != PartVerdict::copy) {
    worker.session->drop_part(id, items.first, sent.digest);
  }
  made_part(id);
  for (const WorkerId liar : outcome.outvoted) distrust(liar, what + ": made other records than two others");
}

// Nothing that it made counts any more: its parts are lost, its leases go to others, and it gets none. It stays
// connected, so that people see it and nobody starts it anew.
void Farm::Impl::quarantine(WorkerId id, const std::string& why) {
  settings.log("worker " + name_of(id) + " is quarantined: " + why);
  liars.insert(id);
  const auto found = workers.find(id);
  if (found == workers.end()) return;
  Worker& worker = found->second;
  for (const Epoch epoch : std::set<Epoch>(worker.leases)) {
    worker.session->revoke(leases.at(epoch));
    forget_lease(epoch);
  }
  scheduler.worker_lost(id, now());
  worker.draining = true;
  worker.aside = why;
  tell_worker(worker, "aside", why);
  unserved.erase(id);
  lose_parts(id);
  drop_hopeless_rechecks();
  offer_to_unserved_soon();
}

void Farm::Impl::take_late_part(Worker& worker, Verdict verdict, const BatchOutput::Retained& part) {
  if (verdict == Verdict::duplicate)
    for (const auto& [stage_id, stage] : active_stages)
      if (stage->artifact == part.artifact)
        return take_part(*std::shared_ptr<RunningStage>(stage), worker, part.items, part);
  worker.session->drop_part(part.artifact, part.items.first, part.digest);
}

// Something of the artifact exists that did not: who waited for it goes on.
void Farm::Impl::made_part(const ArtifactId& id) {
  if (!registry.whole(id)) {
    // Those that compute a part of it again may have made it possible for others to go on.
    for (const auto& [stage_id, stage] : active_stages)
      if (stage->paused) pause_if_inputs_lack(*stage);
    return;
  }
  std::vector<std::shared_ptr<RunningStage>> makers;
  for (const auto& [stage_id, stage] : active_stages) {
    if (stage->paused) pause_if_inputs_lack(*stage);
    if (stage->artifact == id && stage->makes_output()) makers.push_back(stage);
  }
  for (const auto& maker : makers) deliver_if_complete(maker);
}

std::string Farm::Impl::name_of(WorkerId id) const {
  if (auto worker = workers.find(id); worker != workers.end()) return worker->second.name;
  if (auto gone = names_of_gone.find(id); gone != names_of_gone.end()) return gone->second;
  return std::to_string(id);
}

void Farm::Impl::lose_parts(WorkerId worker) {
  for (const auto& [id, items] : registry.worker_lost(worker)) {
    const auto at = retained.find(id);
    if (at == retained.end()) continue;
    at->second.lost.insert(at->second.lost.end(), items.begin(), items.end());
  }
  settle_retained();
}

// --- What workers ask about parts
// -------------------------------------------------------------------------------------

namespace {

// A number that spreads readers over holders, the same for the same pair.
std::uint64_t spread(WorkerId reader, std::uint64_t first) {
  std::uint64_t z = reader * 0x9e3779b97f4a7c15u + first;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  return z ^ (z >> 31);
}

}  // namespace

const Worker* Farm::Impl::worker_with(const std::string& token) const {
  const auto at = token.empty() ? tokens.end() : tokens.find(token);
  const auto worker = at == tokens.end() ? workers.end() : workers.find(at->second);
  return worker == workers.end() ? nullptr : &worker->second;
}

// The stage whose lease this is, where it is the worker's and reads the artifact.
const RunningStage* Farm::Impl::reader(const Worker& worker, Epoch epoch, const ArtifactId& id, ItemRange* own) const {
  const auto lease = leases.find(epoch);
  if (lease == leases.end() || lease->second.worker != worker.id) return nullptr;
  const auto stage = active_stages.find(lease->second.stage);
  if (stage == active_stages.end()) return nullptr;
  const auto& inputs = stage->second->work->inputs;
  bool reads = false, whole = false;
  for (const auto& input : inputs) {
    if (input.blob != id || input.data) continue;
    reads = true;
    whole = whole || !input.own_items;
  }
  if (!reads) return nullptr;
  *own = whole ? ItemRange{0, registry.has(id) ? registry.layout(id).items : 0}
               : ItemRange{lease->second.first, lease->second.count};
  return stage->second.get();
}

Farm::Located Farm::locate(const std::string& token, Epoch epoch, const ArtifactId& id) {
  Impl& m = *impl_;
  std::lock_guard lock(m.mutex);
  const Worker* worker = m.worker_with(token);
  ItemRange items;
  if (!worker || !m.reader(*worker, epoch, id, &items)) return {.answer = Located::refused, .parts = {}};
  if (!m.registry.exists(id, items)) return {.answer = Located::unavailable, .parts = {}};
  Located out{.answer = Located::here, .parts = {}};
  for (HeldPart& part : m.registry.parts(id, items)) {
    Located::At at;
    at.own = std::ranges::find(part.holders, worker->id) != part.holders.end();
    // Readers are spread over those that hold copies.
    std::rotate(
        part.holders.begin(),
        part.holders.begin() + static_cast<std::ptrdiff_t>(spread(worker->id, part.items.first) % part.holders.size()),
        part.holders.end());
    for (const WorkerId id_of_holder : part.holders) {
      const auto holder = m.workers.find(id_of_holder);
      if (holder == m.workers.end() || holder->second.id == worker->id) continue;
      at.holders.push_back(
          {holder->second.name, holder->second.hello.peer_address, artifact_ticket(holder->second.hello.token, id)});
    }
    at.part = std::move(part);
    out.parts.push_back(std::move(at));
  }
  return out;
}

Farm::RelaySource Farm::relay_source(const std::string& token, Epoch epoch, const std::string& holder,
                                     const PartRange& range) {
  Impl& m = *impl_;
  std::lock_guard lock(m.mutex);
  const Worker* worker = m.worker_with(token);
  ItemRange items;
  if (!worker || !m.reader(*worker, epoch, range.artifact, &items)) return {.answer = Located::refused};
  for (const HeldPart& part : m.registry.parts(range.artifact, {range.first, 1})) {
    if (part.items.first != range.first || part.digest != range.digest) continue;
    for (const WorkerId id : part.holders)
      if (m.workers.at(id).name == holder) return {.answer = Located::here, .holder = id, .part_bytes = part.bytes};
  }
  return {.answer = Located::unavailable};
}

bool Farm::ask_for_part(WorkerId holder, std::uint64_t request, const PartRange& range) {
  std::lock_guard lock(impl_->mutex);
  const auto worker = impl_->workers.find(holder);
  if (worker == impl_->workers.end()) return false;
  worker->second.session->send_part(request, range);
  return true;
}

void Farm::relayed(Epoch epoch, std::uint64_t bytes) {
  std::lock_guard lock(impl_->mutex);
  const auto lease = impl_->leases.find(epoch);
  if (lease == impl_->leases.end()) return;
  const auto stage = impl_->active_stages.find(lease->second.stage);
  if (stage == impl_->active_stages.end()) return;
  // They come from one worker, and go to another one.
  stage->second->frame->report.uploaded_bytes += bytes;
  stage->second->frame->report.downloaded_bytes += bytes;
}

std::optional<WorkerId> Farm::worker_of(const std::string& token) const {
  std::lock_guard lock(impl_->mutex);
  const Worker* worker = impl_->worker_with(token);
  return worker ? std::optional(worker->id) : std::nullopt;
}

void Farm::wrong_part(WorkerId reader, const ArtifactId& id, std::uint64_t first, const std::string& digest,
                      const std::string& holder) {
  std::lock_guard lock(impl_->mutex);
  if (!impl_->workers.contains(reader)) return;
  for (const auto& [at, worker] : impl_->workers) {
    if (worker.name != holder) continue;
    impl_->drop_copy(id, first, digest, at, "worker " + impl_->name_of(reader) + " says");
    return;
  }
}

void Farm::not_held(WorkerId holder, const ArtifactId& id, std::uint64_t first, const std::string& digest) {
  std::lock_guard lock(impl_->mutex);
  impl_->drop_copy(id, first, digest, holder, "it says itself");
}

// The worker's copy of the part turned out to be other bytes, or none. Words that name no copy change nothing.
void Farm::Impl::drop_copy(const ArtifactId& id, std::uint64_t first, const std::string& digest, WorkerId holder,
                           const std::string& who_says) {
  const auto found = workers.find(holder);
  if (found == workers.end()) return;
  ItemRange items;
  for (const HeldPart& part : registry.parts(id, {first, 1}))
    if (part.items.first == first && part.digest == digest &&
        std::ranges::find(part.holders, holder) != part.holders.end())
      items = part.items;
  if (items.count == 0) return;
  Worker& worker = found->second;
  settings.log("artifact " + id + ", " + words_of(items) + ": worker " + worker.name +
               " has not the bytes that it made, " + who_says);
  if (registry.drop_copy(id, first, digest, holder))
    if (auto artifact = retained.find(id); artifact != retained.end()) artifact->second.lost.push_back(items);
  worker.session->drop_part(id, first, digest);
  settle_retained();
  offer_to_unserved_soon();
  if (++worker.wrong_copies >= most_wrong_copies) lose(holder, "has not the bytes that it made");
}

}  // namespace gleaner::coordinator
