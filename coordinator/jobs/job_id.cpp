#include "coordinator/jobs/job_id.h"

#include <cstdio>
#include <ctime>
#include <mutex>
#include <random>

namespace gleaner::coordinator {

std::string new_job_id() {
  static std::mutex mutex;
  static std::mt19937_64 random{std::random_device{}()};
  std::lock_guard lock(mutex);
  std::time_t now = std::time(nullptr);
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[64];
  std::snprintf(text, sizeof text, "%04d%02d%02d-%02d%02d%02d-%06llx", parts.tm_year + 1900, parts.tm_mon + 1,
                parts.tm_mday, parts.tm_hour, parts.tm_min, parts.tm_sec,
                static_cast<unsigned long long>(random() & 0xffffff));
  return text;
}

}  // namespace gleaner::coordinator
