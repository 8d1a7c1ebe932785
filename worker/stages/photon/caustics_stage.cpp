// Stage kind "photon_caustics": pixels lit by caustic photons (kernels/photon/caustics.cl).

#include <bit>
#include <cmath>

#include "kernels/lobe_rows.h"
#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/map_table.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonCausticsParameters;

std::uint32_t wave_capacity(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 17; }

PhotonCausticsParameters caustics_parameters(const StageRun& run) {
  const auto p = run.parameters<PhotonCausticsParameters>();
  run.check_film(p.camera, p.width, p.height);
  if (!std::has_single_bit(p.samples) || p.samples > 64)
    throw Error::bad_input(run.where(), "samples", "a power of two up to 64", std::to_string(p.samples));
  check_photon_estimate(run, p.estimate);
  if (!(p.shrink > 0) || !(p.shrink <= 1))
    throw Error::bad_input(run.where(), "shrink", "above 0, at most 1", std::to_string(p.shrink));
  run.check_range(std::uint64_t{p.width} * p.height);
  return p;
}

class CausticsThread : public HostThread {
 public:
  CausticsThread(const StageRun& run, const Program& program, const PhotonCausticsParameters& p,
                 const cl::Buffer& parameters, const PhotonMapTable& guide, const PhotonMapTable& map, WorkQueue& work,
                 unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        first_item_(run.first),
        samples_(p.samples),
        capacity_(wave_capacity(run.device)),
        path_rows_(run.scene.path_rows()),
        paths_(take("paths", PathWave::bytes(capacity_, run.scene.path_rows()))),
        // Lanes that found nothing write behind the others.
        reads_(take("reads", std::size_t{capacity_ + 1} * READ_WORDS * 4)),
        lobes_(take("lobes", std::size_t{capacity_ + 1} * LOBE_WORDS * 4)),
        radii_(take("radii", std::size_t{capacity_} * CAUSTIC_RADIUS_WORDS * 4)),
        radiance_(take("radiance", std::size_t{capacity_} * 12)),
        records_(take("records", std::size_t{capacity_} * 12)),
        report_(take("report", FiniteReport::kWords * 4)),
        camera_rays_(run.device, program, "photon_camera_rays"),
        step_(run.device, program, "photon_point_step"),
        choose_radii_(run.device, program, "photon_caustics_radii"),
        read_(run.device, program, "photon_caustics_read"),
        resolve_(run.device, program, "photon_caustics_resolve") {
    const auto media = run.scene.media_of(p.camera);
    camera_rays_.set("parameters", parameters)
        .set("paths", paths_)
        .set("reads", reads_)
        .set("media_high", media[0])
        .set("media_low", media[1]);
    run.scene.set_arguments(step_);
    step_.set("parameters", parameters)
        .set("paths", paths_)
        .set("reads", reads_)
        .set("lobes", lobes_)
        .set("counters", device_counters());
    guide.set_arguments(choose_radii_, "guide");
    choose_radii_.set("reads", reads_)
        .set("samples", samples_)
        .set("neighbours", p.estimate.neighbours)
        .set("most_radius", p.estimate.most_radius)
        .set("radii", radii_);
    run.scene.set_arguments(read_);
    guide.set_arguments(read_, "guide");
    map.set_arguments(read_, "map");
    read_.set("reads", reads_)
        .set("lobes", lobes_)
        .set("neighbours", p.estimate.neighbours)
        .set("most_radius", p.estimate.most_radius)
        .set("shrink", p.shrink)
        .set("radii", radii_)
        .set("samples", samples_)
        .set("radiance", radiance_);
    resolve_.set("radiance", radiance_)
        .set("samples", samples_)
        .set("records", records_)
        .set("report", report_.buffer());
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_ / samples_)) {
      const auto paths = static_cast<std::uint32_t>(block.count) * samples_;
      camera_rays_.set_words("first", first_item_ + block.first).set("count", paths);
      launch(camera_rays_, paths, capacity_);
      counters.camera += paths;
      step_in_place(step_, paths_, path_rows_, paths, capacity_);
      choose_radii_.set("count", static_cast<cl_uint>(block.count));
      launch(choose_radii_, block.count, capacity_, 1);
      read_.set("count", paths);
      launch(read_, paths, capacity_, 1);
      report_.clear(queue_);
      resolve_.set("count", static_cast<cl_uint>(block.count));
      launch(resolve_, block.count, capacity_, 1);
      report_.add_to(counters, queue_, first_item_ + block.first);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, block.count * 12, result.records.data() + block.first * 12);
    }
  }

 private:
  std::uint64_t first_item_;
  std::uint32_t samples_, capacity_;
  unsigned path_rows_;
  cl::Buffer paths_, reads_, lobes_, radii_, radiance_, records_;
  FiniteReport report_;
  Kernel camera_rays_, step_, choose_radii_, read_, resolve_;
};

}  // namespace

BatchResult run_photon_caustics_stage(const StageRun& run) {
  const PhotonCausticsParameters p = caustics_parameters(run);
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(run.count * 12);
  const auto guide = photon_map_table(run, "guide"), map = photon_map_table(run, "map");
  run_split(run, "caustics.cl", result,
            [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
              return std::make_unique<CausticsThread>(run, program, p, parameters, *guide, *map, work, index);
            });
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker
