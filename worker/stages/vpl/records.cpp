#include "worker/stages/vpl/records.h"

#include <cmath>

#include "kernels/vpl_records.h"
#include "scene/model/limits.h"

namespace gleaner::worker {
namespace {

constexpr float kMostCoordinate = 2 * scene::kMaxCoordinate;  // of a point of a triangle, rounding included

void check_albedo_table(const InputRows& input, const DeviceScene& scene, std::uint64_t row, std::uint32_t table,
                        float table_row) {
  if (table == GLEANER_NONE || scene.has_albedo_row(table, table_row)) return;
  input.fail(row, "table", "a row of one of the scene's albedo tables",
             std::to_string(table) + ", row " + std::to_string(table_row));
}

// Calls `one` with the number and the first byte of each row.
template <typename One>
InputRows::Check each_row(std::size_t row_bytes, One one) {
  return [row_bytes, one](std::uint64_t row, std::span<const std::byte> rows) {
    for (std::size_t at = 0; at < rows.size(); at += row_bytes) one(row++, &rows[at]);
  };
}

}  // namespace

InputRows::Check check_light_rows(const InputRows& input, const DeviceScene& scene) {
  return each_row(input.row_bytes(), [&](std::uint64_t row, const std::byte* light) {
    check_albedo_table(input, scene, row, row_word<std::uint32_t>(light, VPL_TABLE), row_word<float>(light, VPL_ROW));
  });
}

InputRows::Check check_point_rows(const InputRows& input, const DeviceScene& scene) {
  return each_row(input.row_bytes(), [&](std::uint64_t row, const std::byte* point) {
    const auto triangle = row_word<std::uint32_t>(point, POINT_TRIANGLE);
    if (triangle == GLEANER_NONE) return;
    if (triangle >= scene.triangles())
      input.fail(row, "triangle", "below " + std::to_string(scene.triangles()), std::to_string(triangle));
    const auto instance = row_word<std::uint32_t>(point, POINT_INSTANCE);
    if (scene.instances() > 0 && instance != GLEANER_NONE && instance >= scene.instances())
      input.fail(row, "instance", "below " + std::to_string(scene.instances()), std::to_string(instance));
    check_albedo_table(input, scene, row, row_word<std::uint32_t>(point, POINT_TABLE),
                       row_word<float>(point, POINT_ROW));
    for (unsigned k = 0; k < 3; ++k) {
      const float x = row_word<float>(point, POINT_POSITION + k), n = row_word<float>(point, POINT_NORMAL + k);
      if (!(std::abs(x) <= kMostCoordinate) || !std::isfinite(n))
        input.fail(row, "position and normal", "finite numbers of a scene's size",
                   std::to_string(x) + " and " + std::to_string(n));
    }
  });
}

InputRows::Check check_member_links(const InputRows& input, std::uint64_t lights, std::uint64_t members,
                                    bool are_members) {
  return each_row(input.row_bytes(), [&input, lights, members, are_members](std::uint64_t row, const std::byte* light) {
    const auto radius = row_word<float>(light, VPL_RADIUS), count = row_word<float>(light, VPL_COUNT);
    const auto first = row_word<std::uint32_t>(light, VPL_FIRST);
    if (are_members) {
      if (first >= lights) input.fail(row, "first", "a cluster below " + std::to_string(lights), std::to_string(first));
      if (radius > 0) input.fail(row, "radius", "0, as of every member", std::to_string(radius));
    } else if (radius > 0 && !(first >= lights && count >= 0 &&
                               static_cast<double>(first) + count <= static_cast<double>(lights + members))) {
      input.fail(row, "first", "members among the " + std::to_string(members) + " behind the lights",
                 std::to_string(first) + " + " + std::to_string(count));
    }
  });
}

}  // namespace gleaner::worker
