#pragma once
// Device memory that batches of a stage use again: taking 64 MB anew for each batch costs a page fault every 4 KiB.
// And what a stage made of its inputs, for the next batch that reads the same.

#include <any>
#include <map>
#include <string>

#include "worker/device/device.h"

namespace gleaner::worker {

class Workspace {
 public:
  explicit Workspace(const Device& device) : device_(device) {}

  // A buffer of at least `bytes`, its contents whatever the last user left. The same name gives the same memory: two
  // users at a time need two names. Not thread-safe. Throws cl::Error.
  cl::Buffer take(const std::string& name, std::size_t bytes) {
    Entry& entry = entries_[name];
    if (entry.bytes < bytes) {
      entry = {};  // give back before taking more
      entry.buffer = device_.make_buffer(bytes);
      entry.bytes = bytes;
    }
    return entry.buffer;
  }

  // A place to put it, empty at first.
  std::any& keep(const std::string& name) { return kept_[name]; }

 private:
  struct Entry {
    cl::Buffer buffer{};
    std::size_t bytes = 0;
  };
  const Device& device_;
  std::map<std::string, Entry> entries_;
  std::map<std::string, std::any> kept_;
};

}  // namespace gleaner::worker
