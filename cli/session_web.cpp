#include "cli/session_web.h"

#include <iostream>
#include <utility>

#include "cli/listeners.h"
#include "cli/signals.h"
#include "cli/viewer/viewer.h"
#include "cli/viewer/viewer_scene.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;

int session_in_browser(const SessionOptions& options) {
  if (!options.insecure)
    refuse_strangers("--web", options.web, "listen on 127.0.0.1, or say --insecure on a network that you trust");
  Signals signals;
  SessionScene loaded = load_session_scene(options);
  ViewerScene scene(loaded.frame.scene, loaded.frame.scene_name, loaded.frame.settings, loaded.objects);
  SessionStream stream(options, std::move(loaded.frame), pb::PICTURE_FORMAT_RGB8);
  {
    Viewer viewer(options.web, std::move(scene), [&](pb::SessionChange change) {
      pb::SessionRequest request;
      *request.mutable_change() = std::move(change);
      stream.stream().Write(request);
    });
    signals.watch([&] { stream.cancel(); });
    // Alone on standard output, so that scripts learn it.
    std::cout << viewer.url() << std::endl;
    if (!options.frame.quiet) std::cerr << "gleaner: open it in a browser; Ctrl-C ends the session" << std::endl;
    for (pb::SessionPicture picture; stream.stream().Read(&picture);) viewer.show(picture);
  }
  signals.watch({});
  if (signals.raised())
    stream.stream().Finish();  // cancelled, as was asked
  else
    stream.end();
  return 0;
}

}  // namespace gleaner::cli
