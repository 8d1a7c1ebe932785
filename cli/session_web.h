#pragma once
// `gleaner session --web`: the session in a browser.

#include "cli/session_stream.h"

namespace gleaner::cli {

// Until Ctrl-C, or until the farm ends the session. Throws as SessionStream, and what ended the session.
int session_in_browser(const SessionOptions& options);

}  // namespace gleaner::cli
