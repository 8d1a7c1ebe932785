#pragma once
// Method `path`: the reference. A first stage gives every pixel a few chunks of samples; the next ones go where the
// error is.

#include <memory>

#include "coordinator/plan/path_film.h"
#include "coordinator/plan/plan.h"

namespace gleaner::coordinator {

class PathPlan final : public Plan {
 public:
  // Part of another method: light that a non-specular surface sends straight to the first one is left to virtual point
  // lights, but for what they clamp (kernels/path_records.h).
  struct Covered {
    bool covered = false;
    float clamp = 0;  // of the geometry term, 1/m^2; infinity: none
    // What the lights are foreseen to add to the picture: mean radiance, and squared error (a mean over pixels and
    // channels), which the samples have to leave room for where an error is wished for.
    double mean = 0, squared_error = 0;
  };
  PathPlan(const FrameSettings& settings, const SceneSummary& scene, Covered covered);
  PathPlan(const FrameSettings& settings, const SceneSummary& scene) : PathPlan(settings, scene, Covered{}) {}

  // Bytes that the plan of such a frame takes at most, its film and files included.
  static std::uint64_t memory(const FrameSettings& settings);

  Step next(const FinishedStage* finished) override;
  bool conclude(const std::vector<CutStage>& cut) override;
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  Film preview_film() const override;
  Film film() const override { return film_.film(); }
  std::vector<Skip> skips() const override { return skips_; }
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  // A stage that has been planned: which pixel and chunk each of its items is.
  struct Planned {
    std::string name;
    std::uint64_t items = 0;
    bool features = false;
    std::uint32_t last_item_samples = 0;
    std::shared_ptr<const Bytes> list;  // PathItem each; null: pixel = item % pixels
  };

  std::uint64_t pixels() const { return std::uint64_t{settings_.width} * settings_.height; }
  std::uint64_t budget() const;  // samples in all, for now
  std::uint64_t samples_of(const Planned& planned, const ItemRange& range) const;
  void absorb(const Planned& planned, const FinishedStage& finished, const ItemRange& range);
  std::size_t record_bytes(const Planned& planned) const;
  Step stage(Planned planned);
  Step spend(std::uint64_t samples);
  kernels::PathItem item_of(const Planned& planned, std::uint64_t item) const;

  FrameSettings settings_;
  SceneSummary scene_;
  Covered covered_;
  std::vector<Skip> skips_;
  std::uint32_t chunk_samples_ = 1, first_chunks_ = 1;
  PathFilm film_;
  std::vector<std::uint32_t> used_chunks_;  // chunks handed out a pixel, the short last one included
  std::uint64_t spent_ = 0;                 // samples planned so far
  std::vector<Planned> planned_;

  struct PreviewPixel {
    float sum[3] = {};
    float samples = 0;
  };
  std::vector<PreviewPixel> preview_;
};

}  // namespace gleaner::coordinator
