#pragma once
// What is said of a session's picture, on standard output and to the page.

#include <nlohmann/json.hpp>

#include "gleaner/v1/farm.pb.h"

namespace gleaner::cli {

// `behind`: changes that had come by then and are not in it. `links_behind`: changes since those that its links know.
inline nlohmann::json picture_json(const v1::SessionPicture& picture) {
  return {{"shows", picture.shows()},
          {"behind", picture.received() - picture.shows()},
          {"links_behind", picture.shows() - picture.links_of()},
          {"samples", picture.samples_per_pixel()},
          {"seconds", picture.seconds()},
          {"latency_seconds", picture.latency_seconds()},
          {"frames_per_second", picture.frames_per_second()},
          {"made", picture.made()},
          {"reused", picture.reused()},
          {"last", picture.last()}};
}

}  // namespace gleaner::cli
