#include "coordinator/jobs/report.h"

#include <nlohmann/json.hpp>

namespace gleaner::coordinator {

using nlohmann::json;

namespace {

json parameters_of(const FrameReport& report) {
  json parameters = {{"spp", report.settings.spp}, {"seed", report.settings.seed}, {"depth", report.settings.depth}};
  if (report.settings.target_error > 0) parameters["target_error"] = report.settings.target_error;
  if (!report.camera.empty()) parameters["camera"] = report.camera;
  for (const auto& [key, value] : report.settings.set) parameters[key] = value;
  // What the method settled on stands above what was asked for.
  json settled = json::parse(report.plan_parameters, nullptr, false);
  if (settled.is_object()) parameters.update(settled);
  return parameters;
}

json stage_json(const StageReport& stage) {
  json workers = json::object();
  for (const auto& [id, share] : stage.workers) workers[id] = {{"items", share.items}, {"seconds", share.seconds}};
  return {{"name", stage.name},
          {"kind", stage.kind},
          {"items", stage.items},
          {"batches", stage.batches},
          {"seconds", stage.seconds},
          {"workers", workers},
          {"trace_seconds", stage.trace_seconds},
          {"kernel_seconds", stage.kernel_seconds}};
}

json motion_json(const std::string& worker, const ShownFrame& shown) {
  return {{"worker", worker},
          {"load_seconds", shown.load_seconds},
          {"pose_seconds", shown.pose_seconds},
          {"table_seconds", shown.table_seconds},
          {"written_bytes", shown.written_bytes},
          {"refitted", shown.refitted},
          {"refit_seconds", shown.refit_seconds},
          {"rebuilt", shown.rebuilt},
          {"rebuild_seconds", shown.rebuild_seconds},
          {"top_level_seconds", shown.top_level_seconds},
          {"most_growth", shown.most_growth}};
}

}  // namespace

std::string report_json(const FrameReport& report) {
  json stages = json::array(), skips = json::array(), devices = json::array(), nonfinite_items = json::array();
  for (const StageReport& stage : report.stages) stages.push_back(stage_json(stage));
  for (const Skip& skip : report.skips)
    skips.push_back({{"what", skip.what}, {"why", skip.why}, {"count", skip.count}});
  for (const auto& [worker, device] : report.devices)
    devices.push_back({{"worker", worker},
                       {"name", device.name},
                       {"platform", device.platform},
                       {"driver", device.driver},
                       {"version", device.version},
                       {"tracer", device.tracer},
                       {"denoiser", device.denoiser},
                       {"cpu", device.cpu},
                       {"compute_units", device.compute_units},
                       {"threads", device.threads},
                       {"memory_bytes", device.memory_bytes}});
  for (const auto& item : report.nonfinite_items)
    nonfinite_items.push_back({{"stage", item.stage}, {"item", item.item}, {"worker", item.worker}});
  json root = {
      {"scene", report.scene},
      {"method", report.settings.method},
      {"size", {report.settings.width, report.settings.height}},
      {"parameters", parameters_of(report)},
      {"seconds", report.seconds},
      {"plan_seconds", report.plan_seconds},
      {"write_seconds", report.write_seconds},
      {"stages", stages},
      {"rays",
       {{"camera", report.camera_rays},
        {"scatter", report.scatter_rays},
        {"shadow", report.shadow_rays},
        {"total", report.camera_rays + report.scatter_rays + report.shadow_rays}}},
      {"bytes",
       {{"uploaded", report.uploaded_bytes}, {"downloaded", report.downloaded_bytes}, {"peers", report.peer_bytes}}},
      {"skips", skips},
      {"warnings", report.warnings},
      {"nonfinite", report.nonfinite},
      {"nonfinite_items", nonfinite_items},
      {"devices", devices},
      {"pixels_sha256", report.pixels_sha256},
      {"frame", report.frame},
      {"job", report.job}};
  for (const auto& [worker, shown] : report.motion) root["motion"].push_back(motion_json(worker, shown));
  if (report.time_limit > 0)
    root["time_limit"] = {{"seconds", report.time_limit}, {"reached", report.time_limit_reached}};
  // Names come from people and drivers: bytes that are not UTF-8 are replaced instead of failing the frame.
  return root.dump(2, ' ', false, json::error_handler_t::replace) + "\n";
}

std::map<std::string, std::string> report_metadata(const FrameReport& report) {
  return {{"gleaner.scene", report.scene},
          {"gleaner.method", report.settings.method},
          {"gleaner.seconds", std::to_string(report.seconds)},
          {"gleaner.parameters", parameters_of(report).dump(-1, ' ', false, json::error_handler_t::replace)},
          {"gleaner.pixels_sha256", report.pixels_sha256},
          {"gleaner.report", report_json(report)}};
}

}  // namespace gleaner::coordinator
