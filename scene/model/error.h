#pragma once
// The one error type of the project: made once where the fault is seen, shown once where a person reads it.

#include <cstddef>
#include <exception>
#include <string>

namespace gleaner {

// What a program's exit status says (design: 1 failed, 2 usage, 3 bad input, 4 no connection).
enum class ErrorKind { failed = 1, usage = 2, bad_input = 3, connection = 4 };

class Error : public std::exception {
 public:
  Error(ErrorKind kind, std::string message) : kind_(kind), message_(std::move(message)) {}

  // "FILE: ELEMENT: expected EXPECTED, found FOUND"; empty parts are left out.
  static Error bad_input(const std::string& file, const std::string& element, const std::string& expected,
                         const std::string& found = {});
  static Error usage(std::string message) { return {ErrorKind::usage, std::move(message)}; }
  static Error failed(std::string message) { return {ErrorKind::failed, std::move(message)}; }
  static Error connection(std::string message) { return {ErrorKind::connection, std::move(message)}; }

  ErrorKind kind() const { return kind_; }
  const char* what() const noexcept override { return message_.c_str(); }

 private:
  ErrorKind kind_;
  std::string message_;
};

// "ARRAY[INDEX].FIELD": how an error names an element of an array; without the point where there is no field.
std::string item(const char* array, std::size_t index, const char* field = "");

}  // namespace gleaner
