// Coordinators to which the system allows little: descriptors, fewer than there are peers; files, smaller than
// pictures.

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include "tests/farm/processes.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;

const fs::path programs = GLEANER_BIN_DIR;

class Limits : public testing::Test {
 protected:
  void TearDown() override { leave(); }

  // A coordinator under `ulimit WORDS`.
  void start(const std::string& limit) {
    const std::string program = (programs / "gleaner-coordinator").string();
    coordinator_ = std::make_unique<Process>(
        std::vector<std::string>{"/bin/sh", "-c", "ulimit " + limit + "; exec \"$@\"", "sh", program, "--listen",
                                 "127.0.0.1:0", "--data", (folder_.path() / "data").string()},
        folder_.path() / "coordinator");
    ASSERT_TRUE(eventually([&] { return coordinator_->out().find('\n') != std::string::npos; })) << coordinator_->err();
    address_ = coordinator_->out();
    address_.erase(address_.find('\n'));
  }
  void join(int count) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(address_.substr(address_.rfind(':') + 1))));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    for (int i = 0; i < count; ++i) {
      peers_.push_back(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
      ASSERT_EQ(::connect(peers_.back(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0) << i;
    }
  }
  void leave() {
    for (const int peer : peers_) ::close(peer);
    peers_.clear();
  }
  Ran gleaner(std::vector<std::string> words, const std::string& log) {
    words.insert(words.begin(), (programs / "gleaner").string());
    Process process(words, folder_.path() / log, {{"GLEANER_COORDINATOR", address_}});
    Ran ran;
    ran.status = process.wait();
    ran.out = process.out();
    ran.err = process.err();
    return ran;
  }
  bool answers() {
    return Process({(programs / "gleaner-coordinator").string(), "--check", address_}, folder_.path() / "check")
               .wait() == 0;
  }

  TemporaryFolder folder_;
  std::unique_ptr<Process> coordinator_;
  std::string address_;
  std::vector<int> peers_;
};

TEST_F(Limits, TheSoftLimitIsRaised) {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  if (limit.rlim_max < 1024)
    GTEST_SKIP() << "this process may have " << limit.rlim_max << " descriptors, expected 1024";
  ASSERT_NO_FATAL_FAILURE(start("-S -n 128"));
  ASSERT_NO_FATAL_FAILURE(join(300));
  EXPECT_TRUE(answers());
}

TEST_F(Limits, WithoutDescriptorsTheCoordinatorLivesAndAnswersWhenSomeAreFree) {
  ASSERT_NO_FATAL_FAILURE(start("-n 128"));
  ASSERT_NO_FATAL_FAILURE(join(300));
  EXPECT_TRUE(coordinator_->running());
  leave();
  EXPECT_TRUE(eventually([&] { return answers(); })) << coordinator_->err();
}

TEST_F(Limits, WhoSaysNothingDoesNotKeepItsPlace) {
  ASSERT_NO_FATAL_FAILURE(start("-n 128"));
  ASSERT_NO_FATAL_FAILURE(join(300));
  EXPECT_TRUE(eventually([&] { return answers(); }, 40)) << "while they are still connected";
}

// SIGXFSZ would end the process.
TEST_F(Limits, AFileThatMayNotGrowFailsItsJobAlone) {
  const std::string scene = (folder_.path() / "box.glb").string();
  ASSERT_EQ(gleaner({"scene", "cornell-box", "-o", scene}, "scene").status, 0);
  ASSERT_NO_FATAL_FAILURE(start("-f 2048"));  // a mebibyte
  Process worker({(programs / "gleaner-worker").string(), "--coordinator", address_, "--threads", "1"},
                 folder_.path() / "worker", {{"POCL_MAX_PTHREAD_COUNT", "1"}});
  const auto render = [&](const std::string& size) {
    const Ran submitted = gleaner({"submit", scene, "--size", size, "--spp", "1", "--method", "path"}, "submit" + size);
    EXPECT_EQ(submitted.status, 0) << submitted.err;
    return gleaner({"watch", submitted.out.substr(0, submitted.out.find('\n'))}, "watch" + size);
  };
  const Ran large = render("512x512");
  EXPECT_EQ(large.status, 1);
  EXPECT_THAT(large.err, testing::HasSubstr("File too large"));
  const Ran small = render("64x64");
  EXPECT_EQ(small.status, 0) << small.err;
  EXPECT_TRUE(coordinator_->running());
}

}  // namespace
}  // namespace gleaner::test
