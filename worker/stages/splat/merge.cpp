// Stage kind "splat_merge": what was gathered at places at several times, as one cache. Solo, on the host.
//
// Records are gathered once. How far they reach, the places tell anew whenever records are added: a new one may show
// that a surface is near, and a finer accuracy makes all reach less far.

#include <cmath>
#include <cstring>
#include <string>

#include "kernels/splat_records.h"
#include "scene/model/error.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {

void append_records(const StageTask& task, const std::string& name, std::vector<CacheRecord>& records) {
  const InputRows input(task, name, sizeof(CacheRecord));
  const std::size_t before = records.size();
  records.resize(before + input.rows());
  input.visit(0, input.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&records[before + first], piece.data(), piece.size());
  });
}

std::vector<SplatPlace> places_of(const StageTask& task, const std::vector<CacheRecord>& records) {
  const InputRows input(task, "places", sizeof(SplatPlace));
  input.expect_rows(records.size());
  std::vector<SplatPlace> places(records.size());
  input.visit(0, places.size(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&places[first], piece.data(), piece.size());
  });
  for (std::size_t i = 0; i < places.size(); ++i)
    if (places[i].point.position != records[i].position) input.fail(i, "position", "that of its record", "another");
  return places;
}

BatchResult cache_result(const std::vector<CacheRecord>& records) {
  BatchResult result;
  result.records.resize(records.size() * sizeof(CacheRecord));
  if (!records.empty()) std::memcpy(result.records.data(), records.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(records.size())};
  return result;
}

BatchResult merge_splat_records(const StageTask& task) {
  const auto p = host_parameters<kernels::SplatMergeParameters>(task);
  std::vector<CacheRecord> records;
  for (unsigned part = 0; task.inputs.contains("records." + std::to_string(part)); ++part)
    append_records(task, "records." + std::to_string(part), records);
  if (records.size() != p.records)
    throw Error::bad_input("stage splat_merge", "records", std::to_string(p.records), std::to_string(records.size()));
  const std::vector<SplatPlace> places = places_of(task, records);
  for (std::size_t i = 0; i < records.size(); ++i) {
    records[i].radius = places[i].point.factor[0];
    records[i].accuracy = places[i].point.factor[1];
    records[i].hessian = {places[i].narrow[0], places[i].narrow[1], 0};
  }
  return cache_result(records);
}

}  // namespace gleaner::worker
