// Workers that lie or say nothing, thousands of idle connections and of silent streams, all at once: the farm renders,
// in time, and the same bits. $GLEANER_SIEGE_CONNECTIONS and $GLEANER_SIEGE_STREAMS are their numbers, and
// $GLEANER_SIEGE_SAMPLES a pixel's samples, $GLEANER_SIEGE_THREADS those of each worker (bench/siege sets them).

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <algorithm>
#include <set>

#include "gleaner/v1/farm.grpc.pb.h"
#include "tests/farm/mute_worker.h"
#include "tests/farm/processes.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using testing::HasSubstr;

const fs::path programs = GLEANER_BIN_DIR;

std::size_t number(const char* variable, std::size_t usual) {
  const char* text = std::getenv(variable);
  return text ? std::stoul(text) : usual;
}

// Connections that never say a word.
class IdleConnections {
 public:
  IdleConnections(const std::string& coordinator, std::size_t count) : coordinator_(coordinator) {
    for (std::size_t i = 0; i < count; ++i) connect();
  }
  ~IdleConnections() {
    for (const int socket : sockets_) ::close(socket);
  }
  std::size_t count() const { return sockets_.size(); }

 private:
  void connect() {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(coordinator_.substr(coordinator_.rfind(':') + 1))));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (socket < 0) throw Error::failed("no descriptor for connection " + std::to_string(sockets_.size()));
    if (::connect(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
      ::close(socket);
      return;
    }
    sockets_.push_back(socket);
  }

  const std::string coordinator_;
  std::vector<int> sockets_;
};

// Streams that were begun and say nothing: half of them uploads, half of them workers'. One that the coordinator
// ends for its silence is begun again, as long as this lasts.
class SilentStreams {
 public:
  SilentStreams(const std::string& coordinator, std::size_t count) {
    constexpr std::size_t streams_a_channel = 500;
    for (std::size_t i = 0; i < count; ++i) {
      if (i % streams_a_channel == 0) {
        grpc::ChannelArguments arguments;
        arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
        channels_.push_back(grpc::CreateCustomChannel(coordinator, grpc::InsecureChannelCredentials(), arguments));
      }
      begin(i % 2 == 0, channels_.back());
    }
    thread_ = std::thread([this] { run(); });
  }
  ~SilentStreams() {
    ending_ = true;
    {
      std::lock_guard lock(mutex_);
      for (Stream* stream : streams_) stream->context.TryCancel();
    }
    thread_.join();
  }
  std::size_t begun() const { return begun_; }

 private:
  struct Stream {
    grpc::ClientContext context;
    std::unique_ptr<grpc::ClientAsyncWriter<v1::UploadBlobRequest>> upload;
    std::unique_ptr<grpc::ClientAsyncReaderWriter<v1::WorkerMessage, v1::HubMessage>> work;
    v1::UploadBlobReply reply;
    grpc::Status status;
    bool started = false;
    std::shared_ptr<grpc::Channel> channel;
  };

  void begin(bool upload, const std::shared_ptr<grpc::Channel>& channel) {
    auto* stream = new Stream;
    stream->channel = channel;
    if (upload)
      stream->upload = v1::Farm::NewStub(channel)->AsyncUploadBlob(&stream->context, &stream->reply, &queue_, stream);
    else
      stream->work = v1::WorkerHub::NewStub(channel)->AsyncWork(&stream->context, &queue_, stream);
    ++begun_;
    std::lock_guard lock(mutex_);
    streams_.insert(stream);
    if (ending_) stream->context.TryCancel();
  }

  // A stream is told of twice: that it has begun, and that it has ended.
  void run() {
    void* tag = nullptr;
    bool ok = false;
    for (;;) {
      {
        std::lock_guard lock(mutex_);
        if (ending_ && streams_.empty()) return;
      }
      if (!queue_.Next(&tag, &ok)) return;
      auto* stream = static_cast<Stream*>(tag);
      if (!std::exchange(stream->started, true)) {
        stream->upload ? stream->upload->Finish(&stream->status, stream)
                       : stream->work->Finish(&stream->status, stream);
        continue;
      }
      const bool upload = stream->upload != nullptr;
      const auto channel = stream->channel;
      const bool refused = stream->status.error_code() == grpc::StatusCode::RESOURCE_EXHAUSTED;
      {
        std::lock_guard lock(mutex_);
        streams_.erase(stream);
      }
      delete stream;
      if (!ending_ && !refused) begin(upload, channel);
    }
  }

  grpc::CompletionQueue queue_;
  std::vector<std::shared_ptr<grpc::Channel>> channels_;
  std::mutex mutex_;
  std::set<Stream*> streams_;
  std::atomic<bool> ending_{false};
  std::atomic<std::size_t> begun_{0};
  std::thread thread_;
};

// Who works, beside one that is mute.
struct Crew {
  const char* name;
  const char* lie;
  std::vector<std::string> honest;
};

class Siege : public testing::TestWithParam<Crew> {
 protected:
  struct Rendered {
    std::string sha256;
    double seconds = 0;
  };
  static Rendered render(ProcessFarm& farm, const std::string& scene, const std::string& method, int seed) {
    const auto begun = Clock::now();
    const std::string job =
        farm.submit({scene, "--size", "160x120", "--spp", std::to_string(number("GLEANER_SIEGE_SAMPLES", 32)), "--seed",
                     std::to_string(seed), "--method", method});
    const nlohmann::json report = farm.finish(job);
    return {report["pixels_sha256"], std::chrono::duration<double>(Clock::now() - begun).count()};
  }

  TemporaryFolder folder_;
};
// One word against another decides nothing: with one honest worker, the lie is one that the coordinator sees.
INSTANTIATE_TEST_SUITE_P(Crew, Siege,
                         testing::Values(Crew{"one_honest_one_nan", "nan", {"ada"}},
                                         Crew{"one_honest_one_huge", "huge", {"ada"}},
                                         Crew{"two_honest_one_zeros", "zeros", {"ada", "bob"}},
                                         Crew{"two_honest_one_others", "others", {"ada", "bob"}}),
                         [](const auto& crew) { return std::string(crew.param.name); });

TEST_P(Siege, TheFarmRendersTheSameInTime) {
  const std::size_t connections = number("GLEANER_SIEGE_CONNECTIONS", 500);
  const std::size_t streams = number("GLEANER_SIEGE_STREAMS", 300);
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  if (limit.rlim_max < connections + 200)
    GTEST_SKIP() << "this process may have " << limit.rlim_max << " descriptors, expected " << connections + 200;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);
  const std::string scene = (folder_.path() / "box.glb").string();
  Process made({(programs / "gleaner").string(), "scene", "cornell-box", "-o", scene}, folder_.path() / "made");
  ASSERT_EQ(made.wait(), 0) << made.err();
  const std::vector<std::string> methods = {"path", "vpl"};
  const auto threads = static_cast<unsigned>(number("GLEANER_SIEGE_THREADS", 1));

  std::map<std::string, Rendered> honest;
  {
    ProcessFarm farm(folder_.path() / "honest", programs);
    for (const char* name : {"ada", "bob"}) farm.add_worker(name, threads);
    ASSERT_TRUE(farm.wait_for_workers(2));
    for (const std::string& method : methods) {
      render(farm, scene, method, 1);  // compiles
      honest[method] = render(farm, scene, method, 7);
    }
  }
  ProcessFarm farm(folder_.path() / "siege", programs);
  for (const std::string& name : GetParam().honest) farm.add_worker(name, threads);
  ASSERT_TRUE(farm.wait_for_workers(GetParam().honest.size()));
  for (const std::string& method : methods) render(farm, scene, method, 1);
  const MuteWorker mute(farm.address(), "mute", farm.workers().front().device());
  Process eve({GLEANER_LYING_WORKER, farm.address(), "eve", GetParam().lie, "0"}, folder_.path() / "eve",
              {{"POCL_MAX_PTHREAD_COUNT", std::to_string(threads)}});
  ASSERT_TRUE(farm.wait_for_workers(GetParam().honest.size() + 2)) << eve.err();
  const IdleConnections idle(farm.address(), connections);
  const SilentStreams silent(farm.address(), streams);
  EXPECT_EQ(idle.count(), connections);
  for (const std::string& method : methods) {
    const Rendered besieged = render(farm, scene, method, 7);
    std::printf("%s: two honest workers %.2f s; %s, %zu idle connections, %zu silent streams %.2f s\n", method.c_str(),
                honest[method].seconds, GetParam().name, connections, streams, besieged.seconds);
    EXPECT_EQ(besieged.sha256, honest[method].sha256) << method;
    // Half the honest workers take twice as long. What is beside that is counted in seconds, as frames here are short.
    EXPECT_LT(besieged.seconds, 2 * honest[method].seconds + 10) << method;
  }
  EXPECT_NE(eve.out(), "") << "it was never asked";
  const std::string lies = eve.out();
  std::printf("lies told: %ld\n", static_cast<long>(std::count(lies.begin(), lies.end(), '\n')));
}

}  // namespace
}  // namespace gleaner::test
