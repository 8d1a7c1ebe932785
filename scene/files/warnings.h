#pragma once
// What an importer wants a person to know. Each thing is said once, with the element where it was met first and the
// number of further ones.

#include <cstddef>
#include <map>
#include <string>
#include <vector>

namespace gleaner::scene {

class Warnings {
 public:
  // `where` names an element of the file, or is empty.
  void add(const std::string& where, const std::string& what);
  void add(const std::string& what) { add("", what); }

  // "WHERE: WHAT", in the order in which they were met first.
  std::vector<std::string> list() const;

 private:
  struct Entry {
    std::string where, last, what;
    std::size_t count = 0;
  };
  std::vector<Entry> entries_;
  std::map<std::string, std::size_t> by_what_;
};

}  // namespace gleaner::scene
