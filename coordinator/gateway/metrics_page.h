#pragma once
// What a farm tells of itself, in Prometheus' text format 0.0.4.

#include <string>
#include <string_view>

#include "coordinator/jobs/farm.h"

namespace gleaner::gateway {

std::string metrics_page(const coordinator::Farm& farm);

// Between the quotes of a label: backslash, quote and newline escaped, what is not UTF-8 replaced by '?'. Workers
// choose their devices' names themselves.
std::string escape_label(std::string_view text);

}  // namespace gleaner::gateway
