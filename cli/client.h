#pragma once
// A coordinator, as the commands call it. Every call throws: Error::connection where it cannot be reached,
// Error::bad_input where it refuses what it was asked, Error::failed otherwise.

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "coordinator/jobs/event_log.h"
#include "coordinator/jobs/job.h"
#include "gleaner/v1/farm.grpc.pb.h"
#include "scene/model/blob.h"

namespace CLI {
class App;
}

namespace gleaner::cli {

// --coordinator HOST:PORT, or $GLEANER_COORDINATOR; and --keys.
void add_coordinator_option(CLI::App& command, std::string& address);

class Client {
 public:
  // Empty address: what $GLEANER_COORDINATOR says. Throws Error::usage where neither is given, Error::connection where
  // nobody answers within a few seconds.
  explicit Client(const std::string& address);
  // Of a farm of this process's own.
  explicit Client(const std::shared_ptr<grpc::Channel>& channel);

  void upload_missing(const std::vector<std::pair<std::string, const scene::Bytes*>>& blobs);  // (id, bytes)
  std::string submit(const gleaner::v1::SubmitJobRequest& request);
  std::vector<coordinator::JobStatus> list();
  coordinator::JobStatus show(const std::string& job);
  coordinator::JobStatus cancel(const std::string& job);
  coordinator::JobStatus pause(const std::string& job, bool paused);
  coordinator::JobStatus retry(const std::string& job);
  // Calls `on_change` for every change until the job has ended or it returns false; returns the last status.
  coordinator::JobStatus watch(const std::string& job,
                               const std::function<bool(const coordinator::JobStatus&)>& on_change);
  // Calls `on_event` for what happens after the event of that number (0: from now on): of a job until it has ended, of
  // all (empty) until the coordinator goes away.
  void events(std::uint64_t after, const std::string& job,
              const std::function<void(const coordinator::FarmEvent&)>& on_event);
  // PNG bytes; empty: nothing to show yet.
  std::string preview(const std::string& job, bool denoise);
  std::vector<std::string> why(const std::string& job);
  std::vector<gleaner::v1::File> files(const std::string& job);
  void fetch_file(const std::string& job, const std::string& name,
                  const std::function<void(const std::string&)>& on_piece);
  using Session = grpc::ClientReaderWriter<gleaner::v1::SessionRequest, gleaner::v1::SessionPicture>;
  std::unique_ptr<Session> session(grpc::ClientContext& context) { return stub_->Session(&context); }
  void end(Session& session) const { check(session.Finish()); }
  std::vector<coordinator::WorkerStatus> workers();
  void drain(const std::string& worker);

 private:
  void check(const grpc::Status& status) const;
  // The answer to a call that is one message each way.
  template <typename Request, typename Reply>
  Reply call(grpc::Status (gleaner::v1::Farm::Stub::*method)(grpc::ClientContext*, const Request&, Reply*),
             const Request& request);

  std::string address_;
  std::unique_ptr<gleaner::v1::Farm::Stub> stub_;
};

}  // namespace gleaner::cli
