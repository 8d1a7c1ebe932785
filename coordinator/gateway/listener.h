#pragma once
// A listening socket that outlives a process without free descriptors. gRPC's own never accepts again after EMFILE.

#include <functional>
#include <memory>
#include <string>

namespace gleaner::gateway {

class Listener {
 public:
  // Listens at HOST:PORT; port 0 takes a free one. `take` gets each connection's descriptor, owns it, and is called by
  // one thread, from start() on. Throws Error::usage for what is no HOST:PORT, Error::failed where it cannot listen.
  Listener(const std::string& listen, std::function<void(int descriptor)> take);
  ~Listener();
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;

  int port() const;
  void start();
  void stop();  // takes no more; connections that were taken stay

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Allows this process as many descriptors as it may have without privileges.
void raise_descriptor_limit();

}  // namespace gleaner::gateway
