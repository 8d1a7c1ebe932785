// A stage from the plan's step to its whole records.

#include <algorithm>
#include <cstring>
#include <new>
#include <span>
#include <utility>

#include "coordinator/artifacts/artifact_id.h"
#include "coordinator/blobs/sha256.h"
#include "coordinator/jobs/engine.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

// Of the records that a batch sends. A result is put together before the farm takes it, and so many workers may be
// sending theirs.
constexpr std::uint64_t most_batch_bytes = std::uint64_t{8} << 20;

// Why the farm cannot take the stage's output; empty: it can.
std::string refusal(const StageSpec& spec, std::uint64_t most_bytes) {
  const StageOutput& output = spec.output;
  const std::uint64_t most_records = output.counted ? output.most_records : 1;
  if (output.record_bytes == 0 || most_records == 0) return "records of no bytes";
  if (output.placement == Placement::stream)
    return output.counted    ? "counted records cannot be streamed"
           : output.reusable ? "records that nobody keeps are not reusable"
                             : "";
  // Where the records stay with the workers, it is their memory.
  if (output.placement == Placement::retain) return "";
  const std::uint64_t item_bytes = output.counted ? output.record_bytes + 4 : output.record_bytes;
  if (spec.items > most_bytes / item_bytes)
    return std::to_string(spec.items) + " records of " + std::to_string(output.record_bytes) +
           " bytes are more than this coordinator takes (" + std::to_string(most_bytes) + " bytes)";
  return "";
}

}  // namespace

void Farm::Impl::post(const std::shared_ptr<Frame>& frame, const Step& step, double work_to_come) {
  // Names are made of bytes that may be many: before the mutex is taken.
  std::map<ArtifactId, std::string> names;
  for (const auto& [id, bytes] : step.artifacts) names[id] = is_sha256_hex(id) ? id : data_id(*bytes);
  std::vector<std::shared_ptr<const ArtifactData>> released;  // destroyed where the mutex is not held
  std::vector<std::shared_ptr<const StageWork>> ended;        // likewise: they hold their inputs
  std::vector<std::shared_ptr<RunningStage>> started;
  {
    std::lock_guard lock(mutex);
    if (frame->job->cancel || stopping) throw Cancelled{};
    for (const auto& [id, bytes] : step.artifacts) provide(*frame, id, names.at(id), bytes);
    for (const StageSpec& spec : step.stages)
      if (auto stage = schedule(frame, spec)) started.push_back(std::move(stage));
    for (const ArtifactId& id : step.released) {
      if (auto data = frame->data.extract(id)) released.push_back(std::move(data.mapped()));
      frame->outputs.erase(id);
      release_retained(*frame, id);
    }
    for (const auto& stage : frame->stages)
      if (stage->delivered) ended.push_back(std::move(stage->work));
    frame->work_to_come = work_to_come;
    frame->posted = true;
    offer_to_all();
    timer_rearm = true;
    timer_wakes.notify_all();
    changed(*frame->job);
  }
  for (const auto& stage : started) prepare(*stage);
}

void Farm::Impl::prepare(RunningStage& stage) {
  std::shared_ptr<Bytes> records;
  const bool in_place = stage.collected() && !stage.spec.output.counted;
  if (in_place) try {
      records = std::make_shared<Bytes>(stage.spec.items * stage.spec.output.record_bytes);
    } catch (const std::bad_alloc&) {
    }
  if (!stage.held.empty() && (records || !in_place)) feed_held(stage, records.get());
  std::lock_guard lock(mutex);
  if (in_place) {
    stage.failed_to_allocate = !records;
    stage.records = std::move(records);
    records_ready.notify_all();
  }
  if (stage.failed_to_allocate)
    throw Error::failed("stage " + stage.spec.name + ": no memory for " + std::to_string(stage.spec.items) +
                        " records of " + std::to_string(stage.spec.output.record_bytes) + " bytes");
  deliver_if_complete(stage.shared_from_this());  // one of no items, or of which all was there
}

void Farm::Impl::provide(Frame& frame, const ArtifactId& id, const std::string& blob,
                         std::shared_ptr<const Bytes> bytes) {
  auto data = std::make_shared<ArtifactData>();
  if (auto output = frame.outputs.find(id); output != frame.outputs.end()) *data = output->second;
  data->blob = blob;
  data->records = std::move(bytes);
  if (data->index)
    blobs.lend(blob, {data->index->counts(), data->records});
  else
    blobs.lend(blob, {data->records});
  frame.data[id] = std::move(data);
}

void Farm::Impl::add_input(Frame& frame, RunningStage& stage, StageWork& work, const StageInput& input) const {
  StageWork::Input out{.name = input.name, .blob = input.artifact, .own_items = input.extent == Extent::own_items};
  std::shared_ptr<const Recipe> recipe;
  if (auto held = retained.find(input.artifact); held != retained.end() && held->second.frames.contains(&frame)) {
    recipe = held->second.recipe;
    out.counted = recipe->spec.output.counted;
    out.record_bytes = recipe->spec.output.record_bytes;
    out.items = recipe->spec.items;
  } else if (auto found = frame.data.find(input.artifact); found != frame.data.end()) {
    out.data = found->second;
    stage.reads_outputs = stage.reads_outputs || frame.outputs.contains(input.artifact);
    out.blob = out.data->blob;
    out.counted = out.data->index != nullptr;
    out.record_bytes = out.data->record_bytes;
    out.items = out.data->items;
    // A plan's own data has as many records as the stage has items, of whatever size.
    if (out.own_items && out.items == 0 && stage.spec.items > 0 && out.data->bytes() % stage.spec.items == 0) {
      out.items = stage.spec.items;
      out.record_bytes = static_cast<std::uint32_t>(out.data->bytes() / stage.spec.items);
    }
  } else {
    throw Error::failed("stage " + stage.spec.name + ": its input " + input.name +
                        " names an artifact that the plan never gave");
  }
  if (out.own_items && out.items != stage.spec.items)
    throw Error::failed("stage " + stage.spec.name + ": its input " + input.name + " has " + std::to_string(out.items) +
                        " items, expected its own " + std::to_string(stage.spec.items));
  work.inputs.push_back(std::move(out));
  stage.reads.push_back(std::move(recipe));
}

std::shared_ptr<RunningStage> Farm::Impl::schedule(const std::shared_ptr<Frame>& frame, const StageSpec& spec) {
  if (const std::string why = refusal(spec, settings.artifact_bytes); !why.empty())
    throw Error::failed("stage " + spec.name + ": " + why);
  auto work = std::make_shared<StageWork>();
  work->job = frame->job->id;
  work->stage = spec.name;
  work->kind = spec.kind;
  work->parameters = spec.parameters;
  work->output = spec.output;
  work->scene_blob = frame->scene.scene_blob;
  work->bvh_blob = frame->scene.bvh_blob;
  const std::string& state = spec.pose == Pose::earlier ? frame->scene.earlier_blob : frame->scene.state_blob;
  work->at_rest = (spec.pose == Pose::rest || state.empty()) && !frame->scene.state_blob.empty();
  if (!work->at_rest) work->state_blob = state;
  auto stage = std::make_shared<RunningStage>();
  stage->frame = frame;
  stage->spec = spec;
  for (const auto& input : spec.inputs) add_input(*frame, *stage, *work, input);
  // The plan may have given its data names of its own; what stages make is named by what the farm knows it as.
  for (std::size_t i = 0; i < spec.inputs.size(); ++i) stage->spec.inputs[i].artifact = work->inputs[i].blob;
  stage->artifact = work->artifact = artifact_id(frame->lineage, stage->spec);
  stage->work = std::move(work);
  stage->report.name = spec.name;
  stage->report.kind = spec.kind;
  stage->report.items = spec.items;
  if (stage->retained() ? retain_output(*stage) : find_kept(*stage)) {
    hand_over(stage, "made before, from the same scene, settings and inputs");
    return nullptr;
  }
  if (follow(stage)) return nullptr;
  start(stage);
  return stage;
}

void Farm::Impl::hand_over(const std::shared_ptr<RunningStage>& stage, const std::string& why) {
  Frame& frame = *stage->frame;
  stage->delivered = true;
  stage->record_count =
      stage->records ? stage->records->size() / stage->spec.output.record_bytes : registry.records(stage->artifact);
  frame.reused.push_back({"stage " + stage->spec.name, why + ": artifact " + stage->artifact, stage->spec.items});
  frame.finished.push_back(stage);
  frame.events.notify_all();
}

bool Farm::Impl::find_kept(RunningStage& stage) {
  if (!stage.spec.output.reusable) return false;
  const auto records = kept.find(stage.artifact);
  if (!records) return false;
  stage.records = std::const_pointer_cast<Bytes>(records->records);
  stage.index = records->index;
  stage.facts = records->facts;
  remember_output(stage);
  return true;
}

void Farm::Impl::remember_output(const RunningStage& stage) {
  stage.frame->outputs[stage.artifact] = {.blob = {},
                                          .records = nullptr,
                                          .index = stage.index,
                                          .items = stage.spec.items,
                                          .record_bytes = stage.spec.output.record_bytes,
                                          .facts = stage.facts};
}

int with_priority(int of_stage, const JobRequest& request) {
  constexpr int most_of_stage = 1 << 16;
  if (of_stage > most_of_stage) return of_stage;  // what was lost is made again first
  return std::clamp(request.priority, -most_priority, most_priority) * 2 * most_of_stage + of_stage;
}

void Farm::Impl::start(const std::shared_ptr<RunningStage>& stage) {
  const StageSpec& spec = stage->spec;
  ScheduledStage scheduled{.kind = spec.kind,
                           .items = spec.items,
                           .tile = spec.tile,
                           .solo = spec.solo,
                           .rank = stage->computes_again ? 0 : rank_of(*stage->frame),
                           .priority = with_priority(spec.priority, stage->frame->job->request),
                           .preferred = {},
                           .only = {},
                           .avoid = stage->avoid,
                           .near = {},
                           .adjoining = stage->retained()};
  if (spec.denoises)
    for (const auto& [id, worker] : workers)
      if (worker.hello.device.denoiser.empty()) scheduled.avoid.push_back(id);
  use_held(*stage);
  for (const ItemRange& range : stage->missing) scheduled.only.push_back({range.first, range.count});
  if (!stage->held.empty() && stage->missing.empty()) scheduled.only.push_back({0, 0});
  if (!stage->retained() && !spec.output.counted)
    scheduled.most_items = std::max<std::uint64_t>(1, most_batch_bytes / spec.output.record_bytes);
  for (const ItemRange& range : stage->again) scheduled.only.push_back({range.first, range.count});
  stage->items = stage->again.empty() ? spec.items : 0;
  for (const ItemRange& range : stage->again) stage->items += range.count;
  kinds.insert(spec.kind);
  place_near_inputs(*stage, scheduled);
  stage->id = scheduler.add_stage(scheduled, now());
  stage->complete = scheduler.complete(stage->id);
  stage->frame->stages.push_back(stage);
  stage->frame->work_asked += stage->work_per_item() * static_cast<double>(stage->items);
  stage->frame->work_done += stage->work_per_item() * static_cast<double>(stage->items_done);
  active_stages[stage->id] = stage;
  pause_if_inputs_lack(*stage);
  settle_pause(*stage);
}

// Mutex held. Puts the batches of a counted output behind each other.
void Farm::Impl::join_counted(RunningStage& stage) {
  auto counts = std::make_shared<Bytes>();
  auto records = std::make_shared<Bytes>();
  std::uint64_t bytes = 0;
  for (const auto& [first, batch] : stage.counted) bytes += batch.records.size();
  counts->reserve(stage.spec.items * 4);
  records->reserve(bytes);
  for (auto& [first, batch] : stage.counted) {
    counts->insert(counts->end(), batch.counts.begin(), batch.counts.end());
    records->insert(records->end(), batch.records.begin(), batch.records.end());
    batch = {};
  }
  stage.counted.clear();
  stage.index = std::make_shared<CountIndex>(std::move(counts));
  stage.records = std::move(records);
}

void Farm::Impl::deliver_if_complete(const std::shared_ptr<RunningStage>& shared) {
  RunningStage& stage = *shared;
  if (!stage.complete || stage.writers != 0 || stage.delivered) return;
  if (stage.streamed() && stage.arrived.given() != stage.spec.items) return;
  if (stage.collected() && stage.spec.output.counted && !stage.index) join_counted(stage);
  if (stage.collected() && !stage.records) return;
  if (stage.retained() && !registry.whole(stage.artifact)) return;  // what was lost meanwhile is computed again
  stage.delivered = true;
  stage.record_count = stage.streamed()   ? stage.spec.items
                       : stage.retained() ? registry.records(stage.artifact)
                                          : stage.records->size() / stage.spec.output.record_bytes;
  if (stage.first_lease < 0) stage.first_lease = stage.last_result = now();
  stage.report.seconds = stage.last_result - stage.first_lease;
  stage.history.clear();
  revoke(scheduler.remove_stage(stage.id));
  active_stages.erase(stage.id);
  if (stage.collected()) {
    remember_output(stage);
    if (stage.spec.output.reusable) {
      auto data = std::make_shared<ArtifactData>(stage.frame->outputs.at(stage.artifact));
      data->records = stage.records;
      kept.put(stage.artifact, std::move(data));
    }
  }
  deliver_to_followers(stage);
  stage.frame->finished.push_back(shared);
  stage.frame->events.notify_all();
}

}  // namespace gleaner::coordinator
