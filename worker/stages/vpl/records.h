#pragma once
// Checks of rows that other workers made (kernels/vpl_records.h): what kernels look up by them is there.

#include "worker/stages/device_scene.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {

// Rows of virtual point lights, or clusters of them: the albedo tables that they name.
InputRows::Check check_light_rows(const InputRows& input, const DeviceScene& scene);

// Rows of points, or clusters of them: triangles, albedo tables, and places and normals that a grid can hold.
InputRows::Check check_point_rows(const InputRows& input, const DeviceScene& scene);

// Rows of lights followed by their clusters' members, `lights` and `members` of them: that the rows between `first` and
// the members that a cluster names exist, and the clusters that members name. Members have none of their own.
InputRows::Check check_member_links(const InputRows& input, std::uint64_t lights, std::uint64_t members,
                                    bool are_members);

}  // namespace gleaner::worker
