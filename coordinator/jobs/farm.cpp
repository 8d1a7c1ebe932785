#include "coordinator/jobs/farm.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <future>
#include <list>
#include <random>
#include <span>
#include <utility>

#include "coordinator/blobs/sha256.h"
#include "coordinator/film/atomic_file.h"
#include "coordinator/film/write.h"
#include "coordinator/jobs/frame.h"
#include "coordinator/jobs/report.h"
#include "coordinator/plan/way_points.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t most_nonfinite_items = 16;
constexpr Seconds idle_look =
    0.1;  // while stages run: how often workers that wait are offered work anew (a slow lease's copy)

struct Worker {
  WorkerId id = 0;
  WorkerHello hello;
  std::string name;
  std::shared_ptr<WorkerSession> session;
  Seconds joined = 0, heard = 0;
  bool draining = false;
  std::set<Epoch> leases;
};

struct Cancelled {};

// The job's settings, with the camera that sees this frame; the way on which it lies was put there by submit().
FrameSettings settings_of(const JobRequest& request, std::uint32_t frame) {
  FrameSettings settings = request.settings;
  if (!request.cameras.empty()) settings.camera = request.cameras[frame - request.first_frame];
  return settings;
}

// Records of stages that other frames may want, the least recently used going first.
class KeptRecords {
 public:
  explicit KeptRecords(std::uint64_t most) : most_(most) {}

  std::shared_ptr<const Bytes> find(const std::string& address) {
    for (auto entry = entries_.begin(); entry != entries_.end(); ++entry)
      if (entry->first == address) {
        entries_.splice(entries_.begin(), entries_, entry);
        return entry->second;
      }
    return nullptr;
  }

  void put(const std::string& address, std::shared_ptr<const Bytes> records) {
    if (find(address)) return;
    bytes_ += records->size();
    entries_.emplace_front(address, std::move(records));
    while (bytes_ > most_ && !entries_.empty()) {
      bytes_ -= entries_.back().second->size();
      entries_.pop_back();
    }
  }

 private:
  std::uint64_t most_, bytes_ = 0;
  std::list<std::pair<std::string, std::shared_ptr<const Bytes>>> entries_;
};

Seconds steady_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Sorts by the time of submission, cannot be guessed from another one, and is short enough to type.
std::string new_job_id() {
  static std::mutex mutex;
  static std::mt19937_64 random{std::random_device{}()};
  std::lock_guard lock(mutex);
  std::time_t now = std::time(nullptr);
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[64];
  std::snprintf(text, sizeof text, "%04d%02d%02d-%02d%02d%02d-%06llx", parts.tm_year + 1900, parts.tm_mon + 1,
                parts.tm_mday, parts.tm_hour, parts.tm_min, parts.tm_sec,
                static_cast<unsigned long long>(random() & 0xffffff));
  return text;
}

}  // namespace

struct Farm::Impl {
  Impl(FarmSettings farm_settings, BlobStore& store)
      : settings(std::move(farm_settings)), blobs(store), scheduler(settings.scheduler) {
    if (!settings.clock) settings.clock = steady_seconds;
    if (!settings.plan)
      settings.plan = [](const FrameSettings& frame, const SceneSummary& scene) { return make_plan(frame, scene); };
    if (!settings.log) settings.log = [](const std::string&) {};
    timer = std::thread([this] { watch_clock(); });
  }

  Seconds now() const { return settings.clock(); }

  // --- Workers (mutex held) ---

  // Offers work to every worker that could hold more.
  void pump() {
    for (auto& [id, worker] : workers) pump(worker);
  }

  void pump(Worker& worker) {
    if (active_stages.empty()) return;
    while (auto lease = scheduler.next_lease(worker.id, now())) {
      auto found = active_stages.find(lease->stage);
      if (found == active_stages.end()) continue;
      RunningStage& stage = *found->second;
      if (stage.first_lease < 0) {
        stage.first_lease = lease->issued;
        remember_progress(stage, lease->issued);
      }
      leases[lease->epoch] = *lease;
      worker.leases.insert(lease->epoch);
      worker.session->lease(*lease, stage.work);
    }
    timer_wakes.notify_all();
  }

  void forget_lease(Epoch epoch) {
    auto found = leases.find(epoch);
    if (found == leases.end()) return;
    if (auto worker = workers.find(found->second.worker); worker != workers.end()) worker->second.leases.erase(epoch);
    leases.erase(found);
  }

  void revoke(const std::vector<Lease>& revoked) {
    for (const Lease& lease : revoked) {
      if (auto worker = workers.find(lease.worker); worker != workers.end()) worker->second.session->revoke(lease);
      forget_lease(lease.epoch);
    }
  }

  void lose(WorkerId id, const std::string& why) {
    auto found = workers.find(id);
    if (found == workers.end()) return;
    scheduler.worker_lost(id, now());
    settings.log("worker " + found->second.name + " is gone" + (why.empty() ? "" : ": " + why) + "; it held " +
                 std::to_string(found->second.leases.size()) + " batches");
    for (Epoch epoch : std::set<Epoch>(found->second.leases)) leases.erase(epoch);
    if (!why.empty()) found->second.session->close(why);
    workers.erase(found);
    pump();
  }

  void watch_clock() {
    std::unique_lock lock(mutex);
    while (!stopping) {
      if (active_stages.empty() && workers.empty()) {
        timer_wakes.wait(lock);
      } else {
        Seconds sleep = active_stages.empty() ? 1.0 : idle_look;
        if (auto next = scheduler.next_expiry()) sleep = std::clamp(*next - now(), 0.001, sleep);
        // Not woken by every lease: what is due next is never nearer than `idle_look` unless next_expiry() said so.
        timer_stops.wait_for(lock, std::chrono::duration<double>(sleep));
      }
      if (stopping) return;
      tick();
    }
  }

  void tick() {
    Seconds time = now();
    for (const Lease& lease : scheduler.expire(time)) {
      if (auto worker = workers.find(lease.worker); worker != workers.end()) worker->second.session->revoke(lease);
      forget_lease(lease.epoch);
    }
    std::vector<WorkerId> silent;
    for (const auto& [id, worker] : workers)
      if (time - worker.heard > settings.silence) silent.push_back(id);
    for (WorkerId id : silent)
      lose(id, "not heard of for " + std::to_string(static_cast<int>(settings.silence)) + " s");
    pump();
  }

  // --- Jobs ---

  void changed(Job& job) {  // mutex held
    ++job.version;
    job_changed.notify_all();
  }

  std::shared_ptr<Job> find(const std::string& id) const {  // mutex held
    auto found = jobs.find(id);
    return found == jobs.end() ? nullptr : found->second;
  }

  void start_queued() {  // mutex held
    std::size_t running = 0;
    for (const auto& id : order) running += jobs[id]->state == JobState::running;
    for (const auto& id : order) {
      if (running >= settings.active_jobs || stopping) return;
      auto job = jobs[id];
      if (job->state != JobState::queued) continue;
      job->state = JobState::running;
      changed(*job);
      ++running;
      job->thread = std::thread([this, job] { run(job); });
    }
  }

  void join_ended_threads() {
    std::vector<std::thread> threads;
    {
      std::lock_guard lock(mutex);
      for (auto& [id, job] : jobs)
        if (job->thread_ended && job->thread.joinable()) threads.push_back(std::move(job->thread));
    }
    for (std::thread& thread : threads) thread.join();
  }

  void run(const std::shared_ptr<Job>& job) {
    JobState state = JobState::done;
    std::string message;
    try {
      run_frames(job);
    } catch (const Cancelled&) {
      state = JobState::cancelled;
    } catch (const std::bad_alloc&) {
      state = JobState::failed;
      message = "the coordinator is out of memory";
    } catch (const std::exception& error) {
      state = JobState::failed;
      message = error.what();
    }
    end_frame(*job);
    {
      // The plan goes while nobody looks at it, and not under the farm's mutex: its records may be large.
      std::lock_guard plan_lock(job->plan_mutex);
      job->plan.reset();
    }
    std::lock_guard lock(mutex);
    // Who cancelled while the last frame was written was told that the job ends so.
    if (state == JobState::done && job->cancel) state = JobState::cancelled;
    job->state = state;
    job->message = message;
    job->ended = now();
    settings.log("job " + job->id + " " + job_state_name(state) + (message.empty() ? "" : ": " + message));
    changed(*job);
    job->thread_ended = true;
    start_queued();
  }

  void run_frames(const std::shared_ptr<Job>& job) {
    Film film;
    Seconds begun = job->accepted;
    const std::uint32_t first = job->request.first_frame;
    std::uint32_t rendered = first;
    for (std::uint32_t frame = first; frame <= job->request.last_frame; ++frame) {
      if (frame == first || !same_camera(*job, frame, rendered)) {
        if (frame != first) aim(*job, frame);
        film = render(job, frame);
        rendered = frame;
      } else {
        // Nothing but the camera moves: what was made for the one frame holds for the other.
        reuse(*job, frame, rendered);
      }
      write(*job, frame, film, begun);
      begun = now();
      std::lock_guard lock(mutex);
      ++job->frames_done;
      changed(*job);
    }
  }

  static bool same_camera(const Job& job, std::uint32_t a, std::uint32_t b) {
    const scene::Camera first = settings_of(job.request, a).camera, second = settings_of(job.request, b).camera;
    return std::memcmp(&first, &second, sizeof first) == 0;
  }

  // A plan for another frame of the job.
  void aim(Job& job, std::uint32_t frame) {
    std::shared_ptr<Plan> plan = settings.plan(settings_of(job.request, frame), job.request.scene);
    std::lock_guard plan_lock(job.plan_mutex);
    job.plan = std::move(plan);
    job.drawn = false;
    std::lock_guard lock(mutex);
    job.stages.clear();
    changed(job);
  }

  FrameReport new_report(const Job& job, std::uint32_t frame) const {
    FrameReport report;
    report.scene = job.request.scene_name;
    report.camera = job.request.camera_name;
    report.job = job.id;
    report.frame = frame;
    report.settings = settings_of(job.request, frame);
    report.time_limit = job.request.time_limit;
    return report;
  }

  Film render(const std::shared_ptr<Job>& job, std::uint32_t frame) {
    {
      std::lock_guard lock(mutex);
      job->report = new_report(*job, frame);
    }
    double plan_seconds = 0;
    // The plan's calls are timed: with the stages' seconds they say where a frame's time went.
    auto timed = [&](auto call) {
      std::lock_guard plan_lock(job->plan_mutex);
      Seconds before = now();
      auto value = call(*job->plan);
      plan_seconds += now() - before;
      return value;
    };
    Step step = timed([](Plan& plan) { return plan.next(nullptr); });
    while (!step.done) {
      post(job, step);
      std::optional<FinishedStage> finished = await_stage(*job);
      if (!finished) break;  // the time limit; the plan has made do with what there is
      step = timed([&](Plan& plan) { return plan.next(&*finished); });
    }
    end_frame(*job);
    Film film = timed([](Plan& plan) { return plan.film(); });
    std::lock_guard plan_lock(job->plan_mutex);
    std::lock_guard lock(mutex);
    job->report.skips = job->plan->skips();
    for (Skip& skip : job->reused) job->report.skips.push_back(std::move(skip));
    job->reused.clear();
    job->report.plan_parameters = job->plan->parameters_json();
    job->report.plan_seconds = plan_seconds;
    return film;
  }

  void reuse(Job& job, std::uint32_t frame, std::uint32_t rendered) {
    std::lock_guard lock(mutex);
    FrameReport report = new_report(job, frame);
    report.plan_parameters = job.report.plan_parameters;
    report.devices = job.report.devices;
    report.skips = job.report.skips;
    std::erase_if(report.skips, [](const Skip& skip) { return skip.what == "frame"; });
    report.skips.push_back({"frame", "same scene, camera and settings as frame " + std::to_string(rendered), 1});
    job.report = std::move(report);
  }

  // Hands a step's stages to the scheduler. The memory for their results is taken while the first batches run.
  void post(const std::shared_ptr<Job>& job, const Step& step) {
    std::map<ArtifactId, std::string> ids;
    for (const auto& [id, artifact] : step.artifacts) ids[id] = blobs.lend(artifact);
    std::vector<std::shared_ptr<RunningStage>> posted;
    {
      std::lock_guard lock(mutex);
      if (job->cancel) throw Cancelled{};
      for (const auto& [id, artifact] : step.artifacts) job->artifacts.push_back(artifact);
      job->artifact_blobs.insert(ids.begin(), ids.end());
      for (const StageSpec& spec : step.stages)
        if (auto stage = schedule(job, spec)) posted.push_back(stage);
      pump();
      changed(*job);
    }
    timer_wakes.notify_all();
    for (const auto& stage : posted) {
      std::shared_ptr<Bytes> records;
      try {
        records = std::make_shared<Bytes>(stage->spec.items * stage->spec.output.record_bytes);
      } catch (const std::bad_alloc&) {
      }
      std::lock_guard lock(mutex);
      stage->failed_to_allocate = !records;
      stage->records = std::move(records);
      if (stage->failed_to_allocate)
        throw Error::failed("stage " + stage->spec.name + ": no memory for " + std::to_string(stage->spec.items) +
                            " records of " + std::to_string(stage->spec.output.record_bytes) + " bytes");
      deliver_if_complete(stage);
      records_ready.notify_all();
    }
  }

  // Names what a stage makes by what it makes it of: the same address, the same records.
  static std::string address_of(const StageWork& work, const StageSpec& spec) {
    Sha256 hash;
    const auto add = [&](const std::string& text) {
      const std::string length = std::to_string(text.size()) + ":";
      hash.update(std::as_bytes(std::span(length)));
      hash.update(std::as_bytes(std::span(text)));
    };
    add(work.scene_blob);
    add(work.kind);
    add(std::to_string(spec.items) + " of " + std::to_string(spec.output.record_bytes));
    add(std::string(reinterpret_cast<const char*>(spec.parameters.data()), spec.parameters.size()));
    for (const auto& input : work.inputs) {
      add(input.name);
      add(input.blob);
    }
    return hash.hex();
  }

  // Mutex held. Null: the stage's records are there already, and were handed to the job.
  std::shared_ptr<RunningStage> schedule(const std::shared_ptr<Job>& job, const StageSpec& spec) {
    if (spec.output.record_bytes == 0 || spec.items > settings.artifact_bytes / spec.output.record_bytes)
      throw Error::failed("stage " + spec.name + ": " + std::to_string(spec.items) + " records of " +
                          std::to_string(spec.output.record_bytes) + " bytes are more than this coordinator takes (" +
                          std::to_string(settings.artifact_bytes) + " bytes)");
    auto work = std::make_shared<StageWork>();
    work->job = job->id;
    work->stage = spec.name;
    work->kind = spec.kind;
    work->parameters = spec.parameters;
    work->record_bytes = spec.output.record_bytes;
    work->scene_blob = job->request.scene_blob;
    work->bvh_blob = job->request.bvh_blob;
    for (const auto& input : spec.inputs) {
      auto blob = job->artifact_blobs.find(input.artifact);
      if (blob == job->artifact_blobs.end())
        throw Error::failed("stage " + spec.name + ": its input " + input.name +
                            " names an artifact that the plan never gave");
      work->inputs.push_back({input.name, blob->second});
    }
    auto stage = std::make_shared<RunningStage>();
    stage->job = job.get();
    stage->spec = spec;
    if (spec.output.reusable) {
      stage->address = address_of(*work, spec);
      if (auto records = kept.find(stage->address)) {
        stage->records = std::const_pointer_cast<Bytes>(records);
        stage->delivered = true;
        job->reused.push_back({"stage " + spec.name,
                               "made before, from the same scene, settings and inputs: artifact " + stage->address,
                               spec.items});
        job->finished.push_back(stage);
        job->events.notify_all();
        return nullptr;
      }
    }
    stage->work = std::move(work);
    stage->report.name = spec.name;
    stage->report.kind = spec.kind;
    stage->report.items = spec.items;
    ScheduledStage scheduled{.kind = spec.kind,
                             .items = spec.items,
                             .tile = spec.tile,
                             .solo = spec.solo,
                             .priority = spec.priority,
                             .preferred = {}};
    stage->id = scheduler.add_stage(scheduled, now());
    stage->complete = scheduler.complete(stage->id);
    job->stages.push_back(stage);
    active_stages[stage->id] = stage;
    return stage;
  }

  // Mutex held. The last of {all accepted, all copied in, memory there} hands the stage to its job.
  void deliver_if_complete(const std::shared_ptr<RunningStage>& shared) {
    RunningStage& stage = *shared;
    if (!stage.complete || stage.writers != 0 || !stage.records || stage.delivered) return;
    stage.delivered = true;
    if (stage.first_lease < 0) stage.first_lease = stage.last_result = now();
    stage.report.seconds = stage.last_result - stage.first_lease;
    stage.history.clear();
    revoke(scheduler.remove_stage(stage.id));
    active_stages.erase(stage.id);
    if (!stage.address.empty()) kept.put(stage.address, stage.records);
    stage.job->finished.push_back(shared);
    stage.job->events.notify_all();
  }

  // The job's thread: draws accepted batches until a stage is whole. None: the time limit has ended the frame.
  std::optional<FinishedStage> await_stage(Job& job) {
    const double limit = job.request.time_limit;
    bool concludes = limit > 0;
    std::unique_lock lock(mutex);
    for (;;) {
      if (job.cancel || stopping) throw Cancelled{};
      if (!job.failure.empty()) throw Error::failed(job.failure);
      if (!job.finished.empty()) {
        auto stage = job.finished.front();
        job.finished.pop_front();
        return FinishedStage{stage->spec.name, std::exchange(stage->records, nullptr)};
      }
      const double left = job.accepted + limit - now();
      if (concludes && left <= 0) {
        if (conclude(job, lock)) return std::nullopt;
        concludes = false;  // too early for a picture: this stage must be whole, the next one need not
        continue;
      }
      if (!job.undrawn.empty()) {
        UndrawnBatch batch = std::move(job.undrawn.front());
        job.undrawn.pop_front();
        lock.unlock();
        {
          std::lock_guard plan_lock(job.plan_mutex);
          job.plan->preview(batch.stage, batch.first, batch.count, batch.records);
          job.drawn = true;
        }
        lock.lock();
        continue;
      }
      if (concludes)
        job.events.wait_for(lock, std::chrono::duration<double>(left));
      else
        job.events.wait(lock);
    }
  }

  // Offers the plan what came in of the stages that run. The lock is held before and after.
  bool conclude(Job& job, std::unique_lock<std::mutex>& lock) {
    std::vector<CutStage> cut;
    std::vector<std::shared_ptr<RunningStage>> stages;
    for (const auto& stage : job.stages)
      if (!stage->delivered) {
        stages.push_back(stage);
        cut.push_back({{stage->spec.name, stage->records}, stage->copied});
      }
    lock.unlock();
    for (CutStage& part : cut)
      std::sort(part.whole.begin(), part.whole.end(),
                [](const ItemRange& a, const ItemRange& b) { return a.first < b.first; });
    bool concluded;
    {
      std::lock_guard plan_lock(job.plan_mutex);
      concluded = job.plan->conclude(cut);
    }
    lock.lock();
    if (!concluded) return false;
    job.report.time_limit_reached = true;
    for (std::size_t i = 0; i < cut.size(); ++i) {
      stages[i]->report.items = 0;  // what the picture is made of
      for (const ItemRange& range : cut[i].whole) stages[i]->report.items += range.count;
    }
    return true;
  }

  // Whatever the frame still has with scheduler and workers is taken back; its figures move into the report.
  void end_frame(Job& job) {
    std::deque<UndrawnBatch> undrawn;
    std::vector<std::shared_ptr<const Bytes>> artifacts;
    std::lock_guard lock(mutex);
    for (const auto& stage : job.stages) {
      if (!stage->delivered) {
        revoke(scheduler.remove_stage(stage->id));
        active_stages.erase(stage->id);
        stage->delivered = true;
      }
      if (stage->last_result >= 0) stage->report.seconds = stage->last_result - stage->first_lease;
      stage->records.reset();
    }
    records_ready.notify_all();
    job.finished.clear();
    job.undrawn.swap(undrawn);
    job.artifacts.swap(artifacts);
    job.artifact_blobs.clear();
    if (job.report.stages.empty())
      for (const auto& stage : job.stages) job.report.stages.push_back(stage->report);
    pump();
  }

  void write(Job& job, std::uint32_t frame, const Film& film, Seconds begun) {
    FrameReport report;
    {
      std::lock_guard lock(mutex);
      if (job.cancel) throw Cancelled{};
      report = job.report;
    }
    FramePaths paths = settings.paths(job.id, frame);
    for (const fs::path& path : {paths.exr, paths.png, paths.report}) {
      if (path.empty() || path.parent_path().empty()) continue;
      std::error_code code;
      fs::create_directories(path.parent_path(), code);
      if (code) throw Error::failed(path.parent_path().string() + ": cannot make the folder: " + code.message());
    }
    Seconds begun_writing = now();
    // Compressing takes longer than the disk does: the PNG is made beside the EXR.
    std::future<void> png;
    if (!paths.png.empty())
      png = std::async(std::launch::async, [&] { write_png(film, paths.png.string(), job.request.exposure_stops); });
    report.pixels_sha256 = pixels_sha256(film);
    report.seconds = now() - begun;
    report.write_seconds = now() - begun_writing;
    if (!paths.exr.empty()) write_exr(film, report_metadata(report), paths.exr.string());
    if (png.valid()) png.get();
    report.seconds = now() - begun;
    report.write_seconds = now() - begun_writing;
    if (!paths.report.empty()) {
      std::string text = report_json(report);
      write_atomically(paths.report.string(), std::as_bytes(std::span(text)));
    }
    std::lock_guard lock(mutex);
    for (const fs::path& path : {paths.exr, paths.png, paths.report})
      if (!path.empty()) job.files.push_back(path);
    job.report = std::move(report);
  }

  Verdict result(WorkerId id, LeaseId lease_id, Epoch epoch, Bytes records, const BatchCost& cost) {
    std::unique_lock lock(mutex);
    auto worker = workers.find(id);
    if (worker == workers.end()) return Verdict::unknown_lease;
    worker->second.heard = now();
    auto known = leases.find(epoch);
    const bool own = known != leases.end() && known->second.worker == id && known->second.id == lease_id;
    const Lease lease = own ? known->second : Lease{};
    std::shared_ptr<RunningStage> stage;
    if (auto found = active_stages.find(lease.stage); own && found != active_stages.end()) stage = found->second;
    if (stage && records.size() != lease.count * stage->spec.output.record_bytes) {
      lock.unlock();
      failed(id, lease_id, epoch,
             "sent " + std::to_string(records.size()) + " bytes instead of " +
                 std::to_string(lease.count * stage->spec.output.record_bytes));
      return Verdict::stale;
    }
    ResultOutcome outcome = scheduler.result(id, lease_id, epoch, cost.seconds, now());
    if (own) forget_lease(epoch);
    revoke(outcome.revoke);
    if (outcome.verdict != Verdict::accepted || !stage) {
      pump();
      return outcome.verdict;
    }
    Job& job = *stage->job;
    account(*stage, worker->second, lease, cost, records.size());
    stage->complete = outcome.stage_complete;
    ++stage->writers;
    pump();  // the worker gets its next batch before this one is put away
    records_ready.wait(lock, [&] { return stage->records || stage->failed_to_allocate || stage->delivered; });
    std::shared_ptr<Bytes> target = stage->records;
    lock.unlock();
    if (target)
      std::memcpy(target->data() + lease.first * stage->spec.output.record_bytes, records.data(), records.size());
    lock.lock();
    if (target) stage->copied.push_back({lease.first, lease.count});
    --stage->writers;
    deliver_if_complete(stage);
    if (settings.preview && !stage->delivered) {
      job.undrawn.push_back({stage->spec.name, lease.first, lease.count, std::move(records)});
      job.events.notify_all();
    }
    changed(job);
    return outcome.verdict;
  }

  void account(RunningStage& stage, const Worker& worker, const Lease& lease, const BatchCost& cost,
               std::size_t bytes) {
    Seconds time = now();
    stage.items_done += lease.count;
    stage.last_result = time;
    remember_progress(stage, time);
    ++stage.report.batches;
    stage.report.trace_seconds += cost.trace_seconds;
    stage.report.kernel_seconds += cost.kernel_seconds;
    auto& share = stage.report.workers[worker.name];
    share.items += lease.count;
    share.seconds += cost.seconds;
    FrameReport& report = stage.job->report;
    report.camera_rays += cost.camera_rays;
    report.scatter_rays += cost.scatter_rays;
    report.shadow_rays += cost.shadow_rays;
    report.uploaded_bytes += cost.fetched_bytes;
    report.downloaded_bytes += bytes;
    report.nonfinite += cost.nonfinite;
    for (std::uint64_t item : cost.nonfinite_items)
      if (report.nonfinite_items.size() < most_nonfinite_items)
        report.nonfinite_items.push_back({stage.spec.name, item, worker.name});
    report.devices.emplace(worker.name, worker.hello.device);
  }

  void failed(WorkerId id, LeaseId lease_id, Epoch epoch, const std::string& message) {
    std::lock_guard lock(mutex);
    auto worker = workers.find(id);
    if (worker == workers.end()) return;
    worker->second.heard = now();
    auto known = leases.find(epoch);
    std::shared_ptr<RunningStage> stage;
    if (known != leases.end())
      if (auto found = active_stages.find(known->second.stage); found != active_stages.end()) stage = found->second;
    FailureOutcome outcome = scheduler.failed(id, lease_id, epoch, now());
    if (outcome.known && stage) {
      const Lease& lease = known->second;
      stage->last_failure = "stage " + stage->spec.name + ", items " + std::to_string(lease.first) + " to " +
                            std::to_string(lease.first + lease.count - 1) + ", worker " + worker->second.name + ": " +
                            message;
      settings.log("job " + stage->job->id + ": " + stage->last_failure);
      if (outcome.stage_failed && stage->job->failure.empty()) {
        stage->job->failure = stage->last_failure;
        stage->job->events.notify_all();
      }
      forget_lease(epoch);
    }
    pump();
  }

  FarmSettings settings;
  BlobStore& blobs;

  mutable std::mutex mutex;
  mutable std::condition_variable job_changed;
  std::condition_variable records_ready;
  std::condition_variable timer_wakes, timer_stops;
  bool stopping = false;
  Scheduler scheduler;
  std::map<WorkerId, Worker> workers;
  WorkerId last_worker = 0;
  std::map<Epoch, Lease> leases;  // handed out and not yet answered
  std::map<StageId, std::shared_ptr<RunningStage>> active_stages;
  KeptRecords kept{settings.kept_bytes};
  std::map<std::string, std::shared_ptr<Job>> jobs;
  std::vector<std::string> order;  // of submission
  std::thread timer;
};

Farm::Farm(FarmSettings settings, BlobStore& blobs) : impl_(std::make_unique<Impl>(std::move(settings), blobs)) {}

Farm::~Farm() {
  std::vector<std::shared_ptr<Job>> all;
  {
    std::lock_guard lock(impl_->mutex);
    impl_->stopping = true;
    for (auto& [id, job] : impl_->jobs) {
      job->cancel = true;
      job->events.notify_all();
      all.push_back(job);
    }
    impl_->timer_wakes.notify_all();
    impl_->timer_stops.notify_all();
    impl_->job_changed.notify_all();
  }
  for (auto& job : all)
    if (job->thread.joinable()) job->thread.join();
  impl_->timer.join();
}

std::string Farm::submit(const JobRequest& request) {
  if (request.last_frame < request.first_frame || request.last_frame - request.first_frame >= 100000)
    throw Error::usage("frames " + std::to_string(request.first_frame) + "-" + std::to_string(request.last_frame) +
                       ": expected first <= last, and at most 100000 frames");
  if (!request.cameras.empty() && request.cameras.size() != request.last_frame - request.first_frame + 1)
    throw Error::usage("cameras: expected one for each of " +
                       std::to_string(request.last_frame - request.first_frame + 1) + " frames, found " +
                       std::to_string(request.cameras.size()));
  for (const std::string& id : {request.scene_blob, request.bvh_blob})
    if (!id.empty() && !impl_->blobs.has(id)) throw Error::bad_input("blob " + id, "", "to be uploaded first");
  auto job = std::make_shared<Job>();
  job->request = request;
  if (!request.cameras.empty()) job->request.settings.way = way_of(request.cameras);
  job->plan = impl_->settings.plan(settings_of(job->request, request.first_frame), request.scene);
  job->submitted_unix_seconds =
      std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
  impl_->join_ended_threads();
  std::lock_guard lock(impl_->mutex);
  do job->id = new_job_id();
  while (impl_->jobs.count(job->id));
  job->accepted = impl_->now();
  impl_->jobs[job->id] = job;
  impl_->order.push_back(job->id);
  impl_->settings.log("job " + job->id + " accepted: " + request.scene_name + ", " + request.settings.method + ", " +
                      std::to_string(request.settings.width) + "x" + std::to_string(request.settings.height));
  impl_->start_queued();
  return job->id;
}

std::optional<JobStatus> Farm::cancel(const std::string& id) {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  if (job->state == JobState::queued) {
    job->state = JobState::cancelled;
    job->ended = impl_->now();
    impl_->changed(*job);
  } else if (job->state == JobState::running) {
    job->cancel = true;
    job->events.notify_all();
    impl_->changed(*job);
  }
  return status_of(*job, impl_->now());
}

std::optional<JobStatus> Farm::status(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  return status_of(*job, impl_->now());
}

std::vector<JobStatus> Farm::list() const {
  std::lock_guard lock(impl_->mutex);
  std::vector<JobStatus> all;
  for (const auto& id : impl_->order) all.push_back(status_of(*impl_->jobs.at(id), impl_->now()));
  return all;
}

std::optional<JobStatus> Farm::wait(const std::string& id, std::uint64_t seen, Seconds timeout) const {
  std::unique_lock lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  impl_->job_changed.wait_for(lock, std::chrono::duration<double>(timeout),
                              [&] { return job->version > seen || ended(job->state) || impl_->stopping; });
  return status_of(*job, impl_->now());
}

std::optional<Film> Farm::preview(const std::string& id) {
  std::shared_ptr<Job> job;
  {
    std::lock_guard lock(impl_->mutex);
    job = impl_->find(id);
  }
  if (!job) return std::nullopt;
  std::lock_guard plan_lock(job->plan_mutex);
  if (!job->plan || !job->drawn) return std::nullopt;
  return job->plan->preview_film();
}

std::optional<std::vector<std::string>> Farm::why(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  std::vector<std::string> reasons;
  if (job->state == JobState::queued)
    reasons.push_back("the job waits until one of the " + std::to_string(impl_->settings.active_jobs) +
                      " that run has ended");
  if (job->state == JobState::running && impl_->workers.empty()) reasons.push_back("no worker is connected");
  for (const auto& stage : job->stages) {
    if (stage->delivered || !impl_->active_stages.count(stage->id)) continue;
    std::string reason = impl_->scheduler.why_waiting(stage->id, impl_->now());
    if (!reason.empty()) reasons.push_back("stage " + stage->spec.name + ": " + reason);
    if (!stage->last_failure.empty()) reasons.push_back("last failure: " + stage->last_failure);
  }
  return reasons;
}

std::vector<fs::path> Farm::files(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  return job ? job->files : std::vector<fs::path>{};
}

Farm::Joined Farm::join(const WorkerHello& hello, std::shared_ptr<WorkerSession> session) {
  std::lock_guard lock(impl_->mutex);
  auto taken = [&](const std::string& name) {
    return std::any_of(impl_->workers.begin(), impl_->workers.end(),
                       [&](const auto& entry) { return entry.second.name == name; });
  };
  std::string name = hello.name;
  for (unsigned number = 2; taken(name); ++number) name = hello.name + "-" + std::to_string(number);
  WorkerId id = ++impl_->last_worker;
  Worker worker;
  worker.id = id;
  worker.hello = hello;
  worker.name = name;
  worker.session = std::move(session);
  worker.joined = worker.heard = impl_->now();
  Worker& stored = impl_->workers[id] = std::move(worker);
  impl_->settings.log("worker " + name + " joined: " + hello.device.name + ", " + hello.device.tracer);
  impl_->scheduler.worker_joined(id, impl_->now());
  stored.session->welcome(name);
  impl_->pump(stored);
  impl_->timer_wakes.notify_all();
  return {id, name};
}

void Farm::leave(WorkerId worker) {
  std::lock_guard lock(impl_->mutex);
  impl_->lose(worker, "");
}

void Farm::drain(WorkerId id) {
  std::lock_guard lock(impl_->mutex);
  auto worker = impl_->workers.find(id);
  if (worker == impl_->workers.end()) return;
  worker->second.draining = true;
  impl_->scheduler.worker_draining(id);
  worker->second.session->drain();
}

void Farm::heard(WorkerId id) {
  std::lock_guard lock(impl_->mutex);
  if (auto worker = impl_->workers.find(id); worker != impl_->workers.end()) worker->second.heard = impl_->now();
}

std::vector<WorkerStatus> Farm::workers() const {
  std::lock_guard lock(impl_->mutex);
  Seconds time = impl_->now();
  std::set<std::string> kinds;
  for (const auto& [id, job] : impl_->jobs)
    for (const auto& stage : job->stages) kinds.insert(stage->spec.kind);
  std::vector<WorkerStatus> all;
  for (const auto& [id, worker] : impl_->workers) {
    WorkerStatus status{.id = worker.name,
                        .address = worker.hello.address,
                        .device = worker.hello.device,
                        .leases = static_cast<std::uint32_t>(worker.leases.size()),
                        .draining = worker.draining,
                        .connected_seconds = time - worker.joined,
                        .silent_seconds = time - worker.heard,
                        .items_per_second = {}};
    for (const auto& kind : kinds)
      if (double rate = impl_->scheduler.items_per_second(id, kind); rate > 0) status.items_per_second[kind] = rate;
    all.push_back(std::move(status));
  }
  return all;
}

std::optional<std::uint64_t> Farm::expected_bytes(WorkerId worker, LeaseId lease, Epoch epoch) const {
  std::lock_guard lock(impl_->mutex);
  auto found = impl_->leases.find(epoch);
  if (found == impl_->leases.end() || found->second.worker != worker || found->second.id != lease) return std::nullopt;
  auto stage = impl_->active_stages.find(found->second.stage);
  if (stage == impl_->active_stages.end()) return std::nullopt;
  return found->second.count * stage->second->spec.output.record_bytes;
}

Verdict Farm::result(WorkerId worker, LeaseId lease, Epoch epoch, Bytes records, const BatchCost& cost) {
  return impl_->result(worker, lease, epoch, std::move(records), cost);
}

void Farm::failed(WorkerId worker, LeaseId lease, Epoch epoch, const std::string& message) {
  impl_->failed(worker, lease, epoch, message);
}

}  // namespace gleaner::coordinator
