// The order in which lights are queried: neighbours together (along a Morton curve), so that a packet of rays goes one
// way, and dealt out to the slices in turn, so that each slice is lit from everywhere. Behind the table of lights lie
// the members of those that are clusters.

#include <algorithm>
#include <cmath>

#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "worker/stages/curve.h"
#include "worker/stages/vpl/host_stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

using kernels::VplOrderFacts;
using kernels::VplOrderParameters;

struct Clustered {
  std::vector<float> rows;                          // of the clusters that have members
  std::vector<std::vector<std::uint32_t>> members;  // for each of them: rows of the input "lights"
};

// What vpl_cluster made: its clusters' rows, then in which of them each of the lights is.
Clustered read_clusters(const StageTask& task, std::uint32_t clusters, std::size_t lights) {
  const std::vector<float> records = input_rows(task, "clusters", VPL_WORDS);
  const std::size_t first = std::size_t{clusters} * VPL_WORDS;
  const auto refuse = [](const std::string& what, const std::string& expected, const std::string& found) {
    return Error::bad_input("stage vpl_order", "input clusters" + what, expected, found);
  };
  if (records.size() < first + lights)
    throw refuse("", std::to_string(clusters) + " clusters of " + std::to_string(lights) + " lights",
                 std::to_string(records.size()) + " words");
  Clustered clustered;
  std::vector<std::uint32_t> place(clusters, GLEANER_NONE);
  for (std::uint32_t k = 0; k < clusters; ++k) {
    const float* row = &records[std::size_t{k} * VPL_WORDS];
    if (!(row[VPL_COUNT] > 0)) continue;
    place[k] = static_cast<std::uint32_t>(clustered.rows.size() / VPL_WORDS);
    clustered.rows.insert(clustered.rows.end(), row, row + VPL_WORDS);
  }
  clustered.members.resize(clustered.rows.size() / VPL_WORDS);
  for (std::uint32_t i = 0; i < lights; ++i) {
    std::uint32_t cluster = 0;
    std::memcpy(&cluster, &records[first + i], 4);
    if (cluster >= clusters || place[cluster] == GLEANER_NONE)
      throw refuse(", light " + std::to_string(i), "a cluster that has members", std::to_string(cluster));
    clustered.members[place[cluster]].push_back(i);
  }
  return clustered;
}

void check_positions(const std::vector<float>& rows) {
  for (std::size_t at = 0; at < rows.size(); at += VPL_WORDS)
    for (std::size_t k = 0; k < 3; ++k)
      if (!std::isfinite(rows[at + k]))
        throw Error::bad_input("stage vpl_order", "light " + std::to_string(at / VPL_WORDS), "a finite position",
                               std::to_string(rows[at + k]));
}

}  // namespace

BatchResult order_lights(const StageTask& task) {
  const auto p = host_parameters<VplOrderParameters>(task);
  if (p.slices == 0) throw Error::bad_input("stage vpl_order", "slices", "1 or more", "0");
  const std::vector<float> lights = input_rows(task, "lights", VPL_WORDS);
  Clustered clustered;
  if (task.inputs.contains("clusters"))
    clustered = read_clusters(task, p.clusters, lights.size() / VPL_WORDS);
  else
    clustered.rows = lights;
  check_positions(clustered.rows);
  const std::vector<std::uint32_t> order = curve_order(clustered.rows, VPL_WORDS, 1023, false);
  const std::size_t count = order.size(), slices = p.slices;
  const std::size_t width = std::max<std::size_t>(1, ((count + slices - 1) / slices + 31) / 32) * 32;
  std::vector<float> table(width * slices * VPL_WORDS, 0.0f), members;
  for (std::size_t i = 0; i < count; ++i) {
    const auto row = static_cast<std::uint32_t>((i % slices) * width + i / slices);
    float* light = &table[std::size_t{row} * VPL_WORDS];
    std::copy_n(&clustered.rows[order[i] * VPL_WORDS], VPL_WORDS, light);
    if (!(light[VPL_RADIUS] > 0) || clustered.members.empty()) continue;
    const auto first = static_cast<std::uint32_t>(width * slices + members.size() / VPL_WORDS);
    std::memcpy(light + VPL_FIRST, &first, 4);
    for (const std::uint32_t member : clustered.members[order[i]]) {
      const float* vpl = &lights[std::size_t{member} * VPL_WORDS];
      members.insert(members.end(), vpl, vpl + VPL_WORDS);
      std::memcpy(&members[members.size() - VPL_WORDS + VPL_FIRST], &row, 4);
    }
  }
  const VplOrderFacts facts{width * slices, count, members.size() / VPL_WORDS};
  table.insert(table.end(), members.begin(), members.end());
  BatchResult result = counted_rows(table, VPL_WORDS);
  set_facts(result, facts);
  return result;
}

}  // namespace gleaner::worker
