#pragma once
// Method `vpl`: virtual point lights with fuzzy clusters. Stages, of which those of one line run at the same time:
//
//   vpl.trace.S                       light paths of set S              vpl.points      some points to be shaded
//   vpl.pilot.visibility, vpl.pilot.path.K   what a few of both tell of the numbers to take (set 0)
//   vpl.cluster.S (solo)              clusters of its VPLs              vpl.point_cluster (solo)
//   vpl.visibility.S                  which light cluster sees which point cluster          path.N   what VPLs leave
//   out vpl.shade.S                       every pixel's indirect light
//
// On a camera's way the points are those of several of its cameras, vpl.points.K, and all stages but the last line's
// ask for the same in every frame: point clusters, and with them their errors, stay where they are while the camera
// moves.
//
// Direct light and all that reaches a surface through mirrors, glass or a specular lobe comes from the path tracer,
// whose paths end where a VPL would be (PathPlan, Complement). Sets are independent of each other: their mean has less
// error, and their differences tell how much.

#include <memory>
#include <optional>

#include "coordinator/plan/path_plan.h"
#include "coordinator/plan/plan.h"
#include "coordinator/plan/vpl_pilot.h"
#include "coordinator/plan/vpl_settings.h"
#include "coordinator/plan/way_points.h"
#include "kernels/cluster_records.h"
#include "kernels/vpl_records.h"

namespace gleaner::coordinator {

class VplPlan final : public Plan {
 public:
  VplPlan(const FrameSettings& settings, const SceneSummary& scene);

  Step next(const FinishedStage* finished) override;
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override {
    if (paths_) paths_->take(stage, first, count, records);
  }
  bool conclude(const std::vector<CutStage>& cut) override;
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  Film preview_film() const override;
  Film film() const override { return with_lights(paths_->film()); }
  Film take_film() override { return with_lights(paths_->take_film()); }
  std::vector<Skip> skips() const override;
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  Film with_lights(Film film) const;
  // Data that stages read, under the name of its bytes.
  struct Table {
    ArtifactId id;
    std::shared_ptr<const Bytes> bytes;
  };
  struct Set {
    std::vector<float> vpls;  // rows of VPL_WORDS, while they are clustered
    Table lights;             // rows of VPL_WORDS: slices of equal width, padded with rows of no flux
    Table members;            // rows of VPL_WORDS: those of the lights that stand for several
    std::uint32_t rows = 0, made = 0, kept = 0, clusters = 0;
    Table visibility;
    bool traced = false, shading = false;
  };

  // What light paths left: rows of VPL_WORDS, and what each weighs where some of them are drawn.
  struct Made {
    std::vector<float> rows;
    std::vector<double> weight;
    double total = 0;
  };

  std::uint64_t pixels() const { return std::uint64_t{settings_.width} * settings_.height; }
  bool indirect() const { return settings_.depth != 1; }
  StageSpec trace(std::uint32_t set) const;
  StageSpec points() const;
  StageSpec way_points(std::size_t camera) const;
  std::uint64_t points_of_a_camera() const;
  std::uint64_t most_way_clusters() const;
  void absorb_lights(std::uint32_t set, const Bytes& records, Step& step);
  static Made made_of(const Bytes& records);
  std::vector<float> draw_lights(std::uint32_t set, const Made& made) const;
  void take_lights(std::uint32_t set, std::vector<float> rows, Step& step);
  void begin_pilot(Step& step);
  StageSpec path_pilot(std::uint32_t number, Step& step) const;
  void absorb_path_pilot(std::uint32_t number, const Bytes& records);
  void end_pilot(Step& step);
  void absorb_light_clusters(std::uint32_t set, const Bytes& records, Step& step);
  void absorb_points(std::shared_ptr<const Bytes> records, Step& step);
  void absorb_way_points(std::size_t camera, std::shared_ptr<const Bytes> records, Step& step);
  void absorb_point_clusters(const Bytes& records, Step& step);
  void settle_lights(std::uint32_t set, std::vector<float> rows, const std::vector<std::vector<std::uint32_t>>& members,
                     Step& step);
  void ask_visibility(std::uint32_t set, Step& step);
  void shade(std::uint32_t set, Step& step);
  void absorb_shade(std::uint32_t set, const Bytes& records);
  void begin_set(std::uint32_t set, Step& step) const;
  void begin_paths(Step& step);
  static bool take(Step paths, Step& step);
  static Table table_of(std::shared_ptr<const Bytes> bytes);
  StageSpec cluster(Step& step, const char* input, const Table& table, const kernels::ClusterParameters& p) const;
  void put(Step& step, const Table& table) const { step.artifacts[table.id] = table.bytes; }

  FrameSettings settings_;
  SceneSummary scene_;
  VplSettings vpl_;
  std::unique_ptr<PathPlan> paths_;  // from when the clamp is known
  bool paths_done_ = false;
  // Until the pilot is done, what waits for it.
  std::optional<Made> made_;
  std::shared_ptr<const Bytes> point_records_;
  std::unique_ptr<VplPilot> pilot_;
  std::vector<PathForecast> path_pilots_;  // of the least and the highest bound
  std::uint32_t pilots_left_ = 0;
  std::optional<VplForecast> forecast_;
  std::uint32_t light_paths_ = 0;  // of a set
  double density_ = 0;             // VPLs of set 0 a square metre, where there are any
  float clamp_ = 0;                // of the geometry term, 1/m^2
  std::vector<Set> sets_;
  std::vector<CameraPoints> seen_;  // of the way's cameras, until all are there
  std::size_t seen_cameras_ = 0;
  std::uint64_t merged_points_ = 0;
  std::uint32_t point_clusters_ = 0;  // asked for; of a way: settled when its points are there
  Table points_;                      // rows of POINT_WORDS: the point clusters
  std::uint32_t point_rows_ = 0;
  bool points_ready_ = false;
  std::vector<Skip> skips_;
  std::uint64_t faced_away_ = 0, brought_little_ = 0, asked_ = 0;
  std::uint32_t shaded_sets_ = 0;
  std::vector<float> sum_, square_;  // a pixel's RGB over the shaded sets
  std::vector<float> preview_;       // of the set that is being shaded
};

Method vpl_method();

}  // namespace gleaner::coordinator
