#include "worker/stages/stage_table.h"

#include <algorithm>

#include "scene/model/error.h"
#include "worker/stages/ao_stage.h"
#include "worker/stages/cluster_stage.h"
#include "worker/stages/denoise_stage.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vpl/host_stages.h"
#include "worker/stages/vpl/stages.h"
#include "worker/wavefront/counters.h"

namespace gleaner::worker {
namespace {

// A stage of the host alone: it knows no device.
template <BatchResult (*program)(const StageTask&)>
BatchResult on_host(const StageRun& run) {
  const double start = seconds_now();
  BatchResult result = program(run.task);
  result.counters.seconds = seconds_now() - start;
  return result;
}

// "points" of "points.7".
std::string_view without_number(std::string_view name) {
  const std::size_t digits = name.find_last_not_of("0123456789");
  return digits != std::string_view::npos && digits + 1 < name.size() && name[digits] == '.' ? name.substr(0, digits)
                                                                                             : name;
}

}  // namespace

const std::vector<StageKind>& stage_table() {
  constexpr StageInputRule lobes{.name = "lobes", .required = false};
  static const std::vector<StageKind> table = {
      {"path",
       run_path_stage,
       {"kernels/path.cl", "kernels/camera_samples.cl"},
       {{.name = "items", .required = false, .own_items = true}}},
      {"ao",
       run_ao_stage,
       {"kernels/ao.cl", "kernels/camera_samples.cl"},
       {{.name = "items", .required = false, .own_items = true}}},
      {"denoise", run_denoise_stage, {}, {{.name = "film"}}},
      {"photon_trace",
       run_photon_trace_stage,
       {"kernels/photon/trace.cl"},
       {{.name = "emission", .required = false}},
       // With both maps, and without clusters.
       {{.file = "kernels/photon/gather.cl", .options = " -D PATH_FILTER=7"},
        {.file = "kernels/camera_samples.cl", .options = " -D PATH_FILTER=1", .layout = true},
        {.file = "kernels/photon/caustics.cl"},
        {.file = "kernels/splat/shade.cl"}}},
      {"photon_guide", run_photon_guide_stage, {}, {{.name = "points"}, {.name = "photons"}}},
      {"photon_map", run_photon_map_stage, {}, {{.name = "photons"}}},
      {"photon_gather",
       run_photon_gather_stage,
       {"kernels/photon/gather.cl", "kernels/camera_samples.cl"},
       {{.name = "items", .required = false, .own_items = true}, {.name = "map"}, {.name = "cut", .required = false}}},
      {"photon_caustics",
       run_photon_caustics_stage,
       {"kernels/photon/caustics.cl"},
       {{.name = "guide"}, {.name = "map"}}},
      {"photon_cluster",
       run_photon_cluster_stage,
       {"kernels/cluster.cl"},
       {{.name = "points"}, {.name = "given", .required = false}}},
      {"photon_extend",
       run_photon_extend_stage,
       {"kernels/splat/points.cl", "kernels/cluster.cl"},
       {{.name = "given", .required = false}}},
      {"photon_cluster_gather",
       run_photon_cluster_gather_stage,
       {"kernels/photon/cluster_gather.cl", "kernels/photon/lobe_gather.cl"},
       {{.name = "places"}, {.name = "map"}, {.name = "cut", .required = false}}},
      {"photon_cluster_refine",
       run_photon_cluster_refine_stage,
       {},
       {{.name = "points"}, {.name = "records", .numbered = true}, {.name = "given", .required = false}}},
      {"photon_extend_refine",
       run_photon_extend_refine_stage,
       {"kernels/splat/points.cl"},
       {{.name = "records", .numbered = true}, {.name = "given", .required = false}}},
      {"photon_cluster_smooth", on_host<smooth_photon_clusters>, {}, {{.name = "records", .numbered = true}}},
      {"photon_cut", run_photon_cut_stage, {"kernels/photon/cluster_gather.cl"}, {{.name = "map"}}},
      {"vpl_trace",
       run_vpl_trace_stage,
       {"kernels/vpl/trace.cl"},
       {},
       {{.file = "kernels/vpl/points.cl"},
        {.file = "kernels/path.cl", .options = " -D PATH_FILTER=1"},
        {.file = "kernels/camera_samples.cl", .options = " -D PATH_FILTER=1", .layout = true},
        {.file = "kernels/cluster.cl", .options = " -D FUZZINESS=1", .plain = true},
        {.file = "kernels/vpl/visibility.cl", .plain = true},
        // With the usual fuzziness.
        {.file = "kernels/vpl/gather.cl", .options = " -D FUZZINESS=6"},
        {.file = "kernels/vpl/residual.cl", .options = " -D FUZZINESS=6"}}},
      {"vpl_cluster", run_cluster_stage, {"kernels/cluster.cl"}, {{.name = "lights"}}},
      {"vpl_points", run_vpl_points_stage, {"kernels/vpl/points.cl"}, {}},
      {"point_cluster", run_cluster_stage, {"kernels/cluster.cl"}, {{.name = "points"}}},
      {"vpl_visibility",
       run_vpl_visibility_stage,
       {"kernels/vpl/visibility.cl"},
       {{.name = "lights"}, {.name = "points"}}},
      {"vpl_shade",
       run_vpl_shade_stage,
       {"kernels/vpl/points.cl", "kernels/vpl/gather.cl", "kernels/vpl/residual.cl", "kernels/vpl/visibility.cl"},
       {{.name = "lights"}, {.name = "points", .required = false}, {.name = "visibility", .required = false}}},
      {"links_mesh",
       run_links_mesh_stage,
       {},
       {{.name = "coarse", .required = false},
        {.name = "probe", .required = false},
        {.name = "divided", .required = false}},
       {{.file = "kernels/links/make.cl", .reads_light = false},
        {.file = "kernels/links/probe.cl", .reads_light = false},
        {.file = "kernels/links/albedo.cl", .reads_light = false},
        {.file = "kernels/path.cl", .options = " -D PATH_FILTER=16"},
        {.file = "kernels/camera_samples.cl", .options = " -D PATH_FILTER=1", .layout = true},
        {.file = "kernels/links/light.cl"},
        {.file = "kernels/links/gather.cl", .plain = true},
        {.file = "kernels/vpl/points.cl"},
        {.file = "kernels/links/shade.cl"}}},
      {"links_probe", run_links_probe_stage, {"kernels/links/probe.cl"}, {{.name = "mesh"}}, {}, false},
      {"links_lobes", run_links_lobes_stage, {}, {{.name = "mesh"}}, {}, false},
      {"links_albedo", run_links_albedo_stage, {"kernels/links/albedo.cl"}, {{.name = "mesh"}, lobes}, {}, false},
      {"links_make",
       run_links_make_stage,
       {"kernels/links/make.cl"},
       {{.name = "mesh"}, {.name = "probe"}, lobes},
       {},
       false},
      {"links_light", run_links_light_stage, {"kernels/links/light.cl"}, {{.name = "mesh"}, {.name = "albedo"}, lobes}},
      {"links_gather",
       run_links_gather_stage,
       {"kernels/links/gather.cl"},
       {{.name = "links", .own_items = true},
        {.name = "light", .own_items = true},
        {.name = "albedo", .own_items = true},
        {.name = "radiosity"}}},
      {"links_exchange",
       run_links_exchange_stage,
       {"kernels/links/gather.cl"},
       {{.name = "mesh"}, {.name = "links"}, {.name = "light"}, {.name = "albedo"}, lobes}},
      {"links_flux",
       on_host<measure_links_flux>,
       {},
       {{.name = "mesh"}, {.name = "radiosity"}, {.name = "before"}, {.name = "earlier"}, lobes}},
      {"links_smooth",
       on_host<smooth_links>,
       {},
       {{.name = "mesh"}, {.name = "probe"}, {.name = "irradiance"}, {.name = "before", .required = false}}},
      {"links_audit",
       run_links_audit_stage,
       {"kernels/links/audit.cl", "kernels/links/shade.cl"},
       {{.name = "mesh"},
        {.name = "probe"},
        {.name = "irradiance"},
        {.name = "points"},
        lobes,
        {.name = "albedo", .required = false}}},
      {"links_shade",
       run_links_shade_stage,
       {"kernels/vpl/points.cl", "kernels/links/shade.cl"},
       {{.name = "mesh"}, {.name = "irradiance"}}},
      {"splat_points",
       run_splat_points_stage,
       {"kernels/splat/points.cl"},
       {},
       {{.file = "kernels/splat/probe.cl"},
        {.file = "kernels/splat/gather.cl"},
        {.file = "kernels/path.cl", .options = " -D PATH_FILTER=32"},
        {.file = "kernels/camera_samples.cl", .options = " -D PATH_FILTER=1", .layout = true},
        {.file = "kernels/splat/shade.cl"}}},
      {"splat_select",
       run_splat_select_stage,
       {"kernels/splat/probe.cl"},
       {{.name = "points"}, {.name = "given", .required = false}}},
      {"splat_extend",
       run_splat_extend_stage,
       {"kernels/splat/points.cl", "kernels/splat/probe.cl"},
       {{.name = "given", .required = false}}},
      {"splat_judge", on_host<judge_splat_cache>, {}, {{.name = "points"}, {.name = "cache"}}},
      {"splat_smooth", run_splat_smooth_stage, {}, {{.name = "cache"}}},
      {"splat_shape", on_host<shape_splat_places>, {}, {{.name = "places"}, {.name = "records"}}},
      {"splat_merge", on_host<merge_splat_records>, {}, {{.name = "places"}, {.name = "records", .numbered = true}}},
      {"splat_gather", run_splat_gather_stage, {"kernels/splat/gather.cl"}, {{.name = "places"}}},
      {"splat_lobe_gather", run_splat_lobe_gather_stage, {"kernels/splat/lobe_gather.cl"}, {{.name = "places"}}},
      {"splat_shade",
       run_splat_shade_stage,
       {"kernels/splat/shade.cl", "kernels/splat/lobe_shade.cl"},
       {{.name = "points", .own_items = true},
        {.name = "lobes", .required = false, .own_items = true},
        {.name = "cache"}}},
      {"vpl_resample", on_host<resample_lights>, {}, {{.name = "paths"}}},
      {"vpl_order", on_host<order_lights>, {}, {{.name = "lights"}, {.name = "clusters", .required = false}}},
      {"vpl_sample_points", on_host<sample_points>, {}, {{.name = "points"}}},
      {"vpl_merge_points", on_host<merge_points>, {}, {{.name = "cameras"}, {.name = "points", .numbered = true}}},
      {"vpl_skipped", on_host<count_skipped_queries>, {}, {{.name = "visibility", .own_items = true}}},
      {"vpl_pilot_points", on_host<choose_pilot_points>, {}, {{.name = "points"}}},
      {"vpl_pilot_lights", on_host<choose_pilot_lights>, {}, {{.name = "lights"}}},
      {"vpl_pilot",
       on_host<measure_pilot>,
       {},
       {{.name = "lights"},
        {.name = "points"},
        {.name = "queried_lights"},
        {.name = "queried_points"},
        {.name = "visibility"},
        {.name = "paths", .numbered = true}}},
  };
  return table;
}

const StageKind& stage_kind_of(const StageTask& task) {
  const auto kind = std::ranges::find(stage_table(), std::string_view(task.kind), &StageKind::kind);
  if (kind == stage_table().end()) throw Error::bad_input("stage", "kind", "one this worker knows", task.kind);
  const std::string where = "stage " + task.kind;
  for (const auto& [name, input] : task.inputs) {
    const auto rule = std::ranges::find_if(kind->inputs, [&, input_name = std::string_view(name)](const auto& one) {
      return one.name == (one.numbered ? without_number(input_name) : input_name);
    });
    if (rule == kind->inputs.end()) throw Error::bad_input(where, "input " + name, "an input that it reads", "another");
    if (input.own_items && !rule->own_items)
      throw Error::bad_input(where, "input " + name, "the whole artifact", "records of its own items");
  }
  for (const StageInputRule& rule : kind->inputs)
    if (rule.required && !rule.numbered && !task.inputs.contains(std::string(rule.name)))
      throw Error::bad_input(where, "input " + std::string(rule.name), "an artifact", "none");
  return *kind;
}

}  // namespace gleaner::worker
