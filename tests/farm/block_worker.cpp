// A worker of its own process for frames of blocks (block_frame.h).
//
//   block_worker HOST:PORT NAME RETAINED_BYTES CACHE_BYTES [PEERS]
//     PEERS: HOST:PORT on which other workers fetch its parts; none: through the coordinator.

#include <cstdio>
#include <exception>
#include <string>

#include "tests/farm/block_frame.h"
#include "worker/agent/agent.h"

int main(int argc, char** argv) {
  using namespace gleaner;
  if (argc < 5) {
    std::fputs("usage: block_worker HOST:PORT NAME RETAINED_BYTES CACHE_BYTES [PEERS]\n", stderr);
    return 2;
  }
  try {
    worker::AgentSettings settings;
    settings.name = argv[2];
    settings.retained_bytes = std::stoull(argv[3]);
    settings.cache_bytes = std::stoull(argv[4]);
    if (argc > 5) settings.peers = argv[5];
    settings.reconnect = false;
    settings.log = [](const std::string& line) { std::fprintf(stderr, "%s\n", line.c_str()); };
    worker::Agent(worker::dial(argv[1]), std::make_unique<test::BlockRunner>(), settings).run();
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
