#pragma once
// Stages that gather light at records: paths over strata of each record's hemisphere, and the record of their slots
// (kernels/splat/record_rays.h). Which light that is, the method's program says.

#include <cstring>
#include <functional>
#include <memory>
#include <utility>

#include "worker/stages/camera_samples.h"
#include "worker/stages/splat/irradiance.h"

namespace gleaner::worker {

// The batch's places on the device, and which of them a part begins with.
struct PlaceTable {
  cl::Buffer buffer;
  std::uint32_t first = 0;
};

// Threads of a stage that shades paths in its own way, Base, made to begin at records.
template <typename Base>
class RecordThread : public Base {
 public:
  template <typename... Arguments>
  explicit RecordThread(const PlaceTable& places, const SamplePart& part, Arguments&&... arguments)
      : Base(part, std::forward<Arguments>(arguments)...), first_hits_(part.device, part.program, "splat_first_hits") {
    part.scene.set_arguments(this->generate_);
    this->generate_.set("places", places.buffer).set("first_record", places.first);
    first_hits_.set("slots", part.slots).set("slot_count", part.slot_count());
  }

 private:
  std::uint32_t step(const RayRange& range, std::uint32_t fresh) override {
    // No camera sent these.
    this->counters.camera -= fresh;
    this->counters.scatter += fresh;
    first_hits_.set("paths", this->wave_.paths()).set("base", this->wave_.fresh_base()).set("count", fresh);
    if (fresh) this->launch(first_hits_, fresh);
    return Base::step(range, fresh);
  }

  Kernel first_hits_;
};

// Throws Error::bad_input for parameters that are out of range, and for a batch that is not of the stage.
void check_record_parameters(const StageRun& run, const kernels::SplatGatherParameters& parameters);

// Makes the state of a host thread: a RecordThread.
using MakeRecordThread = std::function<std::unique_ptr<SampleThread>(const PlaceTable& places, const SamplePart& part,
                                                                     WorkQueue& work, unsigned index)>;
// Makes a record of a place and of what its rays found.
struct RecordMaker {
  std::size_t bytes = 0;        // of a record
  std::size_t place_bytes = 0;  // of a row of the places, which begins with a SplatPoint
  std::function<void(const SplatPoint& place, const HemisphereGrid& grid, std::span<const HemisphereSample> samples,
                     std::byte* record)>
      make;
};
// Of a function that returns it, and rows of places of this type.
template <typename Place, typename Make>
RecordMaker record_maker(Make make) {
  return {sizeof(CacheRecord), sizeof(Place), [make](const auto& place, const auto& grid, auto samples, std::byte* to) {
            const CacheRecord record = make(place, grid, samples);
            std::memcpy(to, &record, sizeof record);
          }};
}

// Runs a batch. `parameters` have been checked; the stage's own begin with them.
BatchResult gather_records(const StageRun& run, const kernels::SplatGatherParameters& parameters,
                           const Program& program, const MakeRecordThread& make_thread, const RecordMaker& maker);

}  // namespace gleaner::worker
