// What libFuzzer calls first, in every target. With $GLEANER_FUZZ_SEEDS the target writes its seeds into that folder,
// and ends.

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "bench/fuzzers/seeds.h"

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  const char* folder = std::getenv("GLEANER_FUZZ_SEEDS");
  if (!folder) return 0;
  std::filesystem::create_directories(folder);
  const std::vector<std::string> seeds = gleaner::fuzz::seeds();
  for (std::size_t i = 0; i < seeds.size(); ++i)
    std::ofstream(std::filesystem::path(folder) / std::to_string(i), std::ios::binary) << seeds[i];
  std::_Exit(0);
}
