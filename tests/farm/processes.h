#pragma once
// Programs as child processes, and a farm made of them.

#include <fcntl.h>
#include <grpcpp/grpcpp.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "gleaner/v1/farm.grpc.pb.h"
#include "scene/model/error.h"
#include "tests/farm/fake_frame.h"

extern char** environ;

namespace gleaner::test {

inline std::string read_text(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

// Standard output and error go to files; the process is killed with its object.
class Process {
 public:
  Process(const std::vector<std::string>& words, const std::filesystem::path& log_stem,
          const std::map<std::string, std::string>& environment = {})
      : out_(log_stem.string() + ".out"), err_(log_stem.string() + ".err") {
    std::vector<std::string> variables;
    for (char** variable = environ; *variable; ++variable) {
      std::string entry = *variable;
      if (!environment.count(entry.substr(0, entry.find('=')))) variables.push_back(entry);
    }
    for (const auto& [name, value] : environment) variables.push_back(std::string(name).append("=").append(value));
    std::vector<char*> arguments, variable_pointers;
    for (const auto& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
    for (const auto& variable : variables) variable_pointers.push_back(const_cast<char*>(variable.c_str()));
    arguments.push_back(nullptr);
    variable_pointers.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_addopen(&actions, 1, out_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    posix_spawn_file_actions_addopen(&actions, 2, err_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    int error = posix_spawn(&pid_, arguments[0], &actions, nullptr, arguments.data(), variable_pointers.data());
    posix_spawn_file_actions_destroy(&actions);
    if (error != 0) throw Error::failed(words[0] + ": cannot start");
  }
  ~Process() {
    if (!status_) {
      ::kill(pid_, SIGKILL);
      wait();
    }
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  pid_t id() const { return pid_; }
  void signal(int number) const { ::kill(pid_, number); }
  bool running() {
    int status = 0;
    if (!status_ && ::waitpid(pid_, &status, WNOHANG) == pid_) set(status);
    return !status_;
  }
  // The exit status; 128 + the signal that ended it.
  int wait() {
    int status = 0;
    if (!status_ && ::waitpid(pid_, &status, 0) == pid_) set(status);
    return status_.value_or(-1);
  }
  std::string out() const { return read_text(out_); }
  std::string err() const { return read_text(err_); }

 private:
  void set(int status) { status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status); }

  pid_t pid_ = 0;
  std::filesystem::path out_, err_;
  std::optional<int> status_;
};

struct Ran {
  int status = -1;
  std::string out, err;
};

// gleaner-coordinator and gleaner-workers on ports that the system chose. Each worker traces and computes on one
// thread.
class ProcessFarm {
 public:
  ProcessFarm(std::filesystem::path folder, std::filesystem::path programs,
              std::vector<std::string> coordinator_words = {})
      : folder_(std::move(folder)), programs_(std::move(programs)), words_(std::move(coordinator_words)) {
    std::filesystem::create_directories(folder_);
    start("127.0.0.1:0");
  }

  const std::string& address() const { return address_; }
  // Ends the coordinator by the signal; another one begins at its address, on its data.
  void restart(int signal = SIGKILL) {
    coordinator_->signal(signal);
    coordinator_->wait();
    start(address_);
  }
  Process& coordinator() { return *coordinator_; }
  std::filesystem::path data() const { return folder_ / "data"; }

  Process& add_worker(const std::string& name, unsigned threads = 1) {
    const std::string count = std::to_string(threads);
    workers_[name] = std::make_unique<Process>(
        std::vector<std::string>{(programs_ / "gleaner-worker").string(), "--coordinator", address_, "--name", name,
                                 "--threads", count},
        folder_ / name, std::map<std::string, std::string>{{"POCL_MAX_PTHREAD_COUNT", count}});
    return *workers_[name];
  }
  // Starts `gleaner WORDS...` against this farm.
  std::unique_ptr<Process> begin_gleaner(std::vector<std::string> words) {
    words.insert(words.begin(), (programs_ / "gleaner").string());
    return std::make_unique<Process>(words, folder_ / (std::string("gleaner").append(std::to_string(calls_++))),
                                     std::map<std::string, std::string>{{"GLEANER_COORDINATOR", address_}});
  }
  Ran gleaner(const std::vector<std::string>& words) {
    const auto process = begin_gleaner(words);
    Ran ran;
    ran.status = process->wait();
    ran.out = process->out();
    ran.err = process->err();
    return ran;
  }

  // The job's id.
  std::string submit(std::vector<std::string> words) {
    words.insert(words.begin(), "submit");
    Ran ran = gleaner(words);
    if (ran.status != 0) throw Error::failed("submit: " + ran.err);
    return ran.out.substr(0, ran.out.find('\n'));
  }
  nlohmann::json show(const std::string& job) { return nlohmann::json::parse(gleaner({"show", job, "--json"}).out); }

  // What tests must know at once is asked over the wire: starting a program takes longer than a frame may last.
  v1::Job job(const std::string& id) {
    grpc::ClientContext context;
    v1::GetJobRequest request;
    request.set_job(id);
    v1::Job reply;
    if (grpc::Status status = stub_->GetJob(&context, request, &reply); !status.ok())
      throw Error::failed(status.error_message());
    return reply;
  }
  // Of the stage of this name, or of all.
  std::uint64_t items_done(const std::string& id, const std::string& name = {}) {
    std::uint64_t done = 0;
    const v1::Job status = job(id);
    for (const auto& stage : status.stages())
      if (name.empty() || stage.name() == name) done += stage.items_done();
    return done;
  }
  bool ended(const std::string& id) {
    v1::JobState state = job(id).state();
    return state != v1::JOB_STATE_QUEUED && state != v1::JOB_STATE_RUNNING;
  }
  std::vector<v1::Worker> workers() {
    grpc::ClientContext context;
    v1::ListWorkersReply reply;
    if (grpc::Status status = stub_->ListWorkers(&context, {}, &reply); !status.ok())
      throw Error::failed(status.error_message());
    return {reply.workers().begin(), reply.workers().end()};
  }
  bool wait_for_workers(std::size_t count) {
    return eventually([&] { return workers().size() == count; }, 120);
  }

  // Where finish() puts a job's files.
  std::filesystem::path fetched(const std::string& job) const { return folder_ / (std::string("fetched-") + job); }
  // Waits for the job's end and fetches its files; returns the first frame's report.
  nlohmann::json finish(const std::string& job) {
    Ran watched = gleaner({"watch", job, "--quiet"});
    if (watched.status != 0) throw Error::failed("job " + job + ": " + watched.err);
    const std::filesystem::path into = fetched(job);
    const Ran ran = gleaner({"fetch", job, "-o", into.string(), "--force"});
    if (ran.status != 0) throw Error::failed("fetch " + job + ": " + ran.err);
    return nlohmann::json::parse(read_text(into / "frame_0001.json"));
  }

 private:
  void start(const std::string& listen) {
    std::vector<std::string> words = {(programs_ / "gleaner-coordinator").string(), "--listen", listen, "--data",
                                      (folder_ / "data").string()};
    words.insert(words.end(), words_.begin(), words_.end());
    coordinator_ = std::make_unique<Process>(
        words, folder_ / std::string("coordinator").append(starts_ == 0 ? "" : std::to_string(starts_)));
    ++starts_;
    if (!eventually([&] { return coordinator_->out().find('\n') != std::string::npos || !coordinator_->running(); }) ||
        !coordinator_->running())
      throw Error::failed("the coordinator does not start: " + coordinator_->err());
    address_ = coordinator_->out();
    address_.erase(address_.find('\n'));
    stub_ = v1::Farm::NewStub(grpc::CreateChannel(address_, grpc::InsecureChannelCredentials()));
  }

  std::filesystem::path folder_, programs_;
  std::vector<std::string> words_;
  unsigned starts_ = 0;
  std::unique_ptr<Process> coordinator_;
  std::string address_;
  std::unique_ptr<v1::Farm::Stub> stub_;
  std::map<std::string, std::unique_ptr<Process>> workers_;
  unsigned calls_ = 0;
};

}  // namespace gleaner::test
