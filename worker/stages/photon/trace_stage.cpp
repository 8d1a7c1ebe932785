// Stage kind "photon_trace": light paths, which leave photons (kernels/photon/trace.cl).

#include <algorithm>
#include <cstring>

#include "kernels/path_layout.h"
#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/guide.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/wavefront/joined_records.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonTraceParameters;

constexpr std::size_t kPhotonBytes = PHOTON_WORDS * 4;
constexpr std::size_t kPathBytes = PHOTON_PATH_SLOTS * kPhotonBytes;
constexpr std::size_t kBalanceWords = 6;

std::uint32_t wave_capacity(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 17; }

class PhotonThread : public HostThread {
 public:
  PhotonThread(const StageRun& run, const Program& program, const PhotonTraceParameters& p,
               const cl::Buffer& parameters, const cl::Buffer& guide, JoinedRecords& joined, WorkQueue& work,
               unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        joined_(joined),
        first_item_(run.first),
        balance_wanted_(p.balance != 0),
        powers_(p.pilot == 0),
        capacity_(wave_capacity(run.device)),
        path_rows_(run.scene.path_rows()),
        emit_(run.device, program, "photon_emit"),
        step_(run.device, program, "photon_trace_step"),
        pack_(run.device, program, "pack_paths"),
        paths_(take("paths", PathWave::bytes(capacity_, run.scene.path_rows()))),
        spare_(take("next_paths", PathWave::bytes(capacity_, run.scene.path_rows()))),
        // Lanes with nothing to store do so behind the records.
        records_(take("photons", std::size_t{capacity_ + 1} * kPathBytes)),
        arrivals_(take("arrivals", std::size_t{capacity_ + 1} * 4)),
        balance_(take("balance", std::size_t{capacity_ + 1} * kBalanceWords * 4)),
        arrived_(capacity_),
        balances_(balance_wanted_ ? capacity_ * kBalanceWords : 0) {
    run.scene.set_arguments(emit_);
    emit_.set("parameters", parameters).set("emission", run.scene.emission()).set("paths", paths_);
    // Without a guide any buffer stands for it.
    const bool guided = guide() != nullptr;
    emit_.set("guide", guided ? guide : run.scene.emission()).set("guided", cl_uint{guided});
    run.scene.set_arguments(step_);
    step_.set("parameters", parameters)
        .set("slots", capacity_)
        .set("records", records_)
        .set("arrivals", arrivals_)
        .set("balance", balance_)
        .set("counters", device_counters());
    pack_.set("capacity", capacity_).set("counters", device_counters());
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      queue_.enqueueFillBuffer(arrivals_, cl_uint{0}, 0, std::size_t{count} * 4);
      if (balance_wanted_) queue_.enqueueFillBuffer(balance_, cl_float{0}, 0, std::size_t{count} * kBalanceWords * 4);
      emit_.set_words("first", first_item_ + block.first).set("count", count);
      launch(emit_, count, capacity_);
      counters.scatter += count;
      step_packed(step_, pack_, {paths_, spare_}, path_rows_, count, capacity_);
      queue_.enqueueReadBuffer(arrivals_, CL_TRUE, 0, std::size_t{count} * 4, arrived_.data());
      if (balance_wanted_)
        queue_.enqueueReadBuffer(balance_, CL_TRUE, 0, std::size_t{count} * kBalanceWords * 4, balances_.data());
      // Most slots are empty: on a CPU device nothing is copied but what is in the others.
      void* const slots = queue_.enqueueMapBuffer(records_, CL_TRUE, CL_MAP_READ, 0, count * kPathBytes);
      pack(static_cast<const std::byte*>(slots), count, &result.counts[block.first]);
      joined_.add(block.first, block.count, packed_);
      queue_.enqueueUnmapMemObject(records_, slots);
    }
  }

 private:
  // Packs what is in the slots. Photons of a path that arrived more often carry the power of those that were dropped as
  // well. `counts`: of the photons left of each path.
  void pack(const std::byte* slots, std::uint32_t count, std::uint32_t* counts) {
    packed_.clear();
    for (std::uint32_t item = 0; item < count; ++item) {
      const std::uint32_t kept = std::min(arrived_[item], PHOTON_PATH_SLOTS);
      const std::byte* from = slots + item * kPathBytes;
      const std::size_t at = packed_.size();
      packed_.insert(packed_.end(), from, from + kept * kPhotonBytes);
      if (arrived_[item] > kept && powers_)
        scale_power(&packed_[at], kept, static_cast<float>(arrived_[item]) / static_cast<float>(kept));
      if (balance_wanted_) {
        const float* balance = &balances_[item * kBalanceWords];
        add_balance(packed_, balance, PHOTON_ABSORBED);
        add_balance(packed_, balance + 3, PHOTON_ESCAPED);
      }
      counts[item] = kept + (balance_wanted_ ? 2 : 0);
    }
  }

  static void scale_power(std::byte* rows, std::uint32_t count, float factor) {
    for (std::uint32_t k = 0; k < count; ++k, rows += kPhotonBytes) {
      float power[3];
      std::memcpy(power, rows + PHOTON_POWER * 4, sizeof power);
      for (float& channel : power) channel *= factor;
      std::memcpy(rows + PHOTON_POWER * 4, power, sizeof power);
    }
  }

  static void add_balance(scene::Bytes& records, const float* power, std::uint32_t what) {
    std::byte row[kPhotonBytes] = {};
    const std::uint32_t surface = what << PHOTON_CLASS_SHIFT;
    std::memcpy(row + PHOTON_POWER * 4, power, 12);
    std::memcpy(row + PHOTON_SURFACE * 4, &surface, 4);
    records.insert(records.end(), row, row + kPhotonBytes);
  }

  JoinedRecords& joined_;
  std::uint64_t first_item_;
  bool balance_wanted_;
  bool powers_;  // what photons carry, not the numbers of a pilot
  std::uint32_t capacity_;
  unsigned path_rows_;
  Kernel emit_, step_, pack_;
  cl::Buffer paths_, spare_, records_, arrivals_, balance_;
  std::vector<std::uint32_t> arrived_;
  std::vector<float> balances_;
  scene::Bytes packed_;
};

}  // namespace

BatchResult run_photon_trace_stage(const StageRun& run) {
  const auto p = run.parameters<PhotonTraceParameters>();
  run.check_range(wide(p.items_high, p.items_low));
  if (p.classes & ~PHOTON_ALL_CLASSES)
    throw Error::bad_input(run.where(), "classes", "up to " + std::to_string(PHOTON_ALL_CLASSES),
                           std::to_string(p.classes));
  const double start = seconds_now();
  BatchResult result;
  if (!run.scene.shines()) {
    result.counts.assign(run.count, 0);
    return result;
  }
  result.counts.resize(run.count);
  cl::CommandQueue queue = run.device.make_queue();
  const cl::Buffer guide = run.task.inputs.contains("emission") ? guide_table(run, queue) : cl::Buffer();
  JoinedRecords joined(run.count);
  run_split(run, "trace.cl", result,
            [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
              return std::make_unique<PhotonThread>(run, program, p, parameters, guide, joined, work, index);
            });
  result.records = joined.take();
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
