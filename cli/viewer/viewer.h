#pragma once
// A session's page: it shows pictures as they come, and says what its user changes. Whoever knows its address, which
// holds a random word, may do that; pages of other sites do not know it, nor do others on this machine.
//
// The page asks for the newest picture after the one that it has, and waits. So a page that is slow misses pictures
// instead of falling behind, and no page holds up the session. One that is closed changes nothing; another may be
// opened, and shows the scene as it is by then.

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include "cli/viewer/viewer_scene.h"
#include "coordinator/web/web_server.h"
#include "gleaner/v1/farm.pb.h"

namespace gleaner::cli {

class Viewer {
 public:
  // `say` gets each change, numbered from 1 on, one at a time. Throws as web::WebServer.
  Viewer(const std::string& listen, ViewerScene scene, std::function<void(v1::SessionChange)> say);
  ~Viewer();

  std::string url() const;
  void show(const v1::SessionPicture& picture);  // in RGB8; or a change that was refused

 private:
  web::Answer picture_after(const std::string& seen);
  web::Answer take(const std::string& body);

  std::mutex mutex_;
  std::condition_variable wakes_;
  ViewerScene scene_;
  std::function<void(v1::SessionChange)> say_;
  std::uint64_t said_ = 0;  // number of the last change
  // What came from the farm: its number here, what is said of it, its bytes.
  std::uint64_t shown_ = 0;
  nlohmann::json words_;
  std::shared_ptr<const std::string> pixels_;
  std::string refused_;  // why the last change that was refused was, and its number here
  std::uint64_t refused_at_ = 0;
  unsigned waiting_ = 0;  // pages
  bool ending_ = false;
  const std::string secret_;
  web::WebServer server_;
};

}  // namespace gleaner::cli
