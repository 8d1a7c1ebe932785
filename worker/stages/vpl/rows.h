#pragma once
// Rows of 32-bit words, as stages read and write them on the host.

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "scene/model/error.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

// The stage's parameters. Throws Error::bad_input for another size.
template <typename Parameters>
Parameters host_parameters(const StageTask& task) {
  Parameters parameters;
  if (task.parameters.size() != sizeof parameters)
    throw Error::bad_input("stage " + task.kind, "parameters", std::to_string(sizeof parameters) + " bytes",
                           std::to_string(task.parameters.size()));
  std::memcpy(&parameters, task.parameters.data(), sizeof parameters);
  return parameters;
}

// All rows of an input, `words` words each. Throws Error::bad_input where there are none such.
std::vector<float> input_rows(const StageTask& task, const std::string& name, std::size_t words);

// One row of the k-th of `parts` equal parts of `count` rows, chosen by a hash of `key`: rows at equal steps would lie
// in columns of the picture.
std::size_t random_row(std::size_t k, std::uint64_t key, std::size_t count, std::size_t parts);

// Whether a row of POINT_WORDS holds a point to be shaded.
bool is_point(const float* row);

// The output of one item with as many records as there are rows.
BatchResult counted_rows(const std::vector<float>& rows, std::size_t words);

// What the plan reads of a solo stage beside its records.
template <typename Facts>
void set_facts(BatchResult& result, const Facts& facts) {
  result.facts.resize(sizeof facts);
  std::memcpy(result.facts.data(), &facts, sizeof facts);
}

}  // namespace gleaner::worker
