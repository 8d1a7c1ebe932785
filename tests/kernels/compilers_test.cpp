// Kernels that other processes compile: what is asked in which order, who waits for whom, and what goes wrong.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <future>
#include <set>
#include <sstream>

#include "scene/model/error.h"
#include "worker/device/compile_turn.h"
#include "worker/device/kernel.h"
#include "worker/device/kernel_compilers.h"
#include "worker/stages/stage_table.h"

namespace gleaner::worker {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;

// A compiler that writes down what it is asked, and answers after `seconds`.
class Compilers : public testing::Test {
 protected:
  std::vector<std::string> command(const std::string& seconds) const {
    return {"/bin/sh", "-c",
            "while IFS= read -r line; do echo \"$line\" >>" + log_ + "; sleep " + seconds + "; echo compiled; done"};
  }
  std::vector<std::string> asked() const {
    std::vector<std::string> lines;
    std::ifstream file(log_);
    for (std::string line; std::getline(file, line);) lines.push_back(line);
    return lines;
  }
  void wait_for_lines(std::size_t lines) const {
    for (int turn = 0; turn < 1000 && asked().size() < lines; ++turn) std::this_thread::sleep_for(10ms);
    ASSERT_GE(asked().size(), lines);
  }
  void SetUp() override {
    std::string name = testing::TempDir() + "compilers-XXXXXX";
    ASSERT_NE(::mkdtemp(name.data()), nullptr);
    folder_ = name;
    log_ = name + "/log";
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
  std::string log_;
  std::promise<std::string> whole_;
  KernelCompilers::Compiled compiled_ = [this](const std::string& file, const std::string& options) {
    whole_.set_value(file + options);
  };
};

TEST_F(Compilers, CompileAProgramAndThenItsKernels) {
  KernelCompilers compilers(command("0"), 3, 1, compiled_);
  compilers.ask("a.cl", "-D X", {"first", "second"});
  auto whole = whole_.get_future();
  ASSERT_EQ(whole.wait_for(10s), std::future_status::ready);
  EXPECT_EQ(whole.get(), "a.cl-D X");
  EXPECT_THAT(asked(), ElementsAre("a.cl\t-D X\t", "a.cl\t-D X\tfirst", "a.cl\t-D X\tsecond"));
}

TEST_F(Compilers, BeginAtTheOtherEndOfWhatIsBuiltHere) {
  KernelCompilers compilers(command("0.1"), 0, 1, compiled_);
  compilers.claim("a.cl", "");
  compilers.ask_kernels("a.cl", "", {"first", "second", "third"});
  compilers.claim("a.cl", "", "first");
  auto whole = whole_.get_future();
  ASSERT_EQ(whole.wait_for(10s), std::future_status::ready);
  EXPECT_THAT(asked(), ElementsAre("a.cl\t\tthird", "a.cl\t\tsecond"));
}

TEST_F(Compilers, DoNotCompileWhatWasClaimed) {
  KernelCompilers compilers(command("0.3"), 0, 1, [](auto&&...) {});
  compilers.ask("a.cl", "", {"one"});
  wait_for_lines(1);
  compilers.ask("b.cl", "", {"one"});
  compilers.claim("b.cl", "");
  compilers.ask("c.cl", "", {});
  wait_for_lines(3);
  EXPECT_THAT(asked(), ElementsAre("a.cl\t\t", "a.cl\t\tone", "c.cl\t\t"));
}

TEST_F(Compilers, AreWaitedForWhereTheyAreAtIt) {
  KernelCompilers compilers(command("0.5"), 0, 1, [](auto&&...) {});
  compilers.ask("a.cl", "", {});
  wait_for_lines(1);
  const auto start = std::chrono::steady_clock::now();
  compilers.claim("a.cl", "");
  EXPECT_GT(std::chrono::steady_clock::now() - start, 100ms);
}

TEST_F(Compilers, ThatEndOrCannotStartKeepNobodyWaiting) {
  for (const std::vector<std::string>& gone :
       {std::vector<std::string>{"/bin/sh", "-c", "read line; exit 1"}, {"/nonexistent/compiler"}}) {
    KernelCompilers compilers(gone, 0, 1, [](auto&&...) { ADD_FAILURE() << "nothing was compiled"; });
    compilers.ask("a.cl", "", {"one", "two"});
    std::this_thread::sleep_for(100ms);
    compilers.claim("a.cl", "");
    compilers.ask_kernels("a.cl", "", {"one", "two"});
    compilers.claim("a.cl", "", "two");
  }
}

TEST_F(Compilers, EndAtOnce) {
  const auto start = std::chrono::steady_clock::now();
  {
    KernelCompilers compilers(command("30"), 0, 2, [](auto&&...) {});
    compilers.ask("a.cl", "", {});
    compilers.ask("b.cl", "", {});
    wait_for_lines(2);
  }
  EXPECT_LT(std::chrono::steady_clock::now() - start, 20s);
}

TEST_F(Compilers, TakeTurns) {
  const auto mark = folder_ / "a" / "kernel";
  auto first = std::make_unique<CompileTurn>(mark);
  std::atomic<bool> had_turn = false;
  auto second = std::async(std::launch::async, [&] {
    CompileTurn turn(mark);
    had_turn = true;
    turn.done();
  });
  std::this_thread::sleep_for(100ms);
  EXPECT_FALSE(had_turn) << "while another compiled";
  first.reset();  // as if it had been killed: nothing is compiled
  second.wait();
  // From here on nobody waits for anybody.
  CompileTurn third(mark), fourth(mark);
}

TEST_F(Compilers, WaitOnlySoLongForATurn) {
  const auto mark = folder_ / "kernel";
  const CompileTurn stopped(mark);
  const auto begun = std::chrono::steady_clock::now();
  CompileTurn impatient(mark, 50ms);
  EXPECT_GE(std::chrono::steady_clock::now() - begun, 50ms);
  impatient.done();
  CompileTurn other(mark);
}

TEST_F(Compilers, WithoutAFolderCompileAtOnce) {
  CompileTurn(std::filesystem::path()).done();
  CompileTurn("/proc/no/such/folder/kernel").done();
}

// What serve_kernel_compiler() relies on: a kernel that is told of no work returns. One lane at a time: that compiles
// in a third of the time.
TEST(IdleKernels, ReturnAtOnce) {
  const Device device({.device = -1, .threads = 1, .trace = TraceKind::automatic, .lanes = 1});
  cl::CommandQueue queue = device.make_queue();
  const std::string lanes = "-D LANES=" + std::to_string(device.lanes());
  std::set<std::string_view> programs;
  for (const StageKind& kind : stage_table()) programs.insert(kind.programs.begin(), kind.programs.end());
  unsigned launched = 0;
  for (const std::string_view file : programs) {
    const Program program = device.build(
        std::string(file), lanes + " -D FUZZINESS=6 -D NEED_SPECULAR -D NEED_EMISSIVE_TRIANGLES -D CLUSTERS=8");
    for (const auto& [name, parameters] : *program.kernels) {
      // The preprocessor may have chosen another.
      try {
        cl::Kernel(program.handle, name.c_str());
      } catch (const cl::Error&) {
        continue;
      }
      Kernel(device, program, name).launch_idle(queue);
      ++launched;
    }
  }
  EXPECT_GT(launched, programs.size());
}

TEST(ServeKernelCompiler, AnswersEveryLine) {
  std::istringstream in("kernels/cluster.cl\t-D LANES=16 -D FUZZINESS=1\tcluster_assign\nkernels/none.cl\t\t\n");
  std::ostringstream out;
  serve_kernel_compiler({.device = -1, .threads = 1, .trace = TraceKind::automatic}, in, out);
  EXPECT_EQ(out.str(), "compiled\nfailed\n");
}

}  // namespace
}  // namespace gleaner::worker
