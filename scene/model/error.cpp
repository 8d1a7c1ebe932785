#include "scene/model/error.h"

namespace gleaner {

Error Error::bad_input(const std::string& file, const std::string& element, const std::string& expected,
                       const std::string& found) {
  std::string message = file;
  if (!element.empty()) message += (message.empty() ? "" : ": ") + element;
  message += (message.empty() ? "expected " : ": expected ") + expected;
  if (!found.empty()) message += ", found " + found;
  return {ErrorKind::bad_input, std::move(message)};
}

std::string item(const char* array, std::size_t index, const char* field) {
  return std::string(array) + "[" + std::to_string(index) + "]" + (*field ? "." : "") + field;
}

}  // namespace gleaner
