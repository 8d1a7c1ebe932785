#pragma once
// What `gleaner session` and a farm say to each other, however its user says what is to change.

#include <grpcpp/client_context.h>

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "cli/client.h"
#include "cli/embedded.h"
#include "cli/frame_options.h"

namespace gleaner::cli {

struct SessionOptions {
  FrameOptions frame;
  std::string coordinator, output, trace = "auto";
  std::vector<std::string> movable;
  std::uint32_t refine_to = 16;
  unsigned workers = 1;
  int device = -1;
  std::string web;  // HOST:PORT of the page; empty: words on standard input
  bool insecure = false;
};

struct SessionScene {
  LoadedFrame frame;                             // at rest
  std::map<std::string, std::uint32_t> objects;  // that may move: numbers of their matrices by names of meshes
};
// Throws as load_frame(), and Error::bad_input for an object that cannot move.
SessionScene load_session_scene(const SessionOptions& options);

class SessionStream {
 public:
  // Uploads the scene and opens the session with the coordinator, or with a farm of this process's own. Throws as
  // Client and EmbeddedFarm do.
  SessionStream(const SessionOptions& options, LoadedFrame frame, gleaner::v1::PictureFormat format);

  // Whatever is still to come is given up: else a farm of this process's own would wait for more to be said.
  ~SessionStream() { cancel(); }
  SessionStream(const SessionStream&) = delete;
  SessionStream& operator=(const SessionStream&) = delete;

  Client::Session& stream() { return *stream_; }
  void cancel() { context_.TryCancel(); }
  // Once stream() has no more to read. Throws what ended the session, unless it was asked to.
  void end() { client_.end(*stream_); }

 private:
  std::unique_ptr<EmbeddedFarm> embedded_;  // null: a coordinator is called
  Client client_;
  grpc::ClientContext context_;
  std::unique_ptr<Client::Session> stream_;
};

}  // namespace gleaner::cli
