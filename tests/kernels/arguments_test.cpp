// Kernels' arguments by name: what the source's text says is what the driver says, and a wrong name is an error at
// once.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "worker/device/kernel.h"
#include "worker/device/kernel_sources.h"
#include "worker/stages/stage_table.h"

namespace gleaner::test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using worker::KernelParameter;

std::vector<std::string> names(const std::vector<KernelParameter>& parameters) {
  std::vector<std::string> all;
  for (const KernelParameter& p : parameters) all.push_back(p.name);
  return all;
}

TEST(KernelParameters, AreReadFromTheSource) {
  const auto kernels = worker::parse_kernels(
      "// kernel void commented(uint a)\n"
      "#define TABLES global const float *first, \\\n  global uint* second\n"
      "#define CALL(x) (x)\n"
      "kernel WIDE void one(global const Row* restrict rows, /* here */ TABLES, uint count, float share) { g(a, b); }\n"
      "kernel void none() {}\n"
      "uint kernel_like(uint x) { return x; }\n"
      "__kernel void not_ours(uint x) {}\n",
      "text");
  ASSERT_EQ(kernels.count("one"), 1u);
  const auto& one = kernels.find("one")->second;
  EXPECT_THAT(names(one), ElementsAre("rows", "first", "second", "count", "share"));
  EXPECT_EQ(one[0].kind, KernelParameter::Kind::buffer);
  EXPECT_EQ(one[2].kind, KernelParameter::Kind::buffer);
  EXPECT_EQ(one[3].kind, KernelParameter::Kind::uint);
  EXPECT_EQ(one[4].kind, KernelParameter::Kind::real);
  ASSERT_EQ(kernels.count("none"), 1u);
  EXPECT_TRUE(kernels.find("none")->second.empty());
  EXPECT_EQ(kernels.size(), 2u);
}

TEST(KernelParameters, RefuseWhatTheyCannotRead) {
  EXPECT_THROW(worker::parse_kernels("kernel void cut(uint a", "text"), Error);
  EXPECT_THROW(worker::parse_kernels("kernel void split(uint a,\n#ifdef B\nuint b,\n#endif\nuint c) {}", "text"),
               Error);
}

class KernelArguments : public testing::Test {
 protected:
  void SetUp() override {
    if (worker::list_devices().empty()) GTEST_SKIP() << "NOT TESTED: there is no OpenCL device";
    device_ = std::make_unique<worker::Device>(worker::DeviceChoice{.device = -1, .threads = 1});
  }
  std::unique_ptr<worker::Device> device_;
};

// clGetKernelArgInfo knows programs that were built from source with -cl-kernel-arg-info; ours need not be.
TEST_F(KernelArguments, AreThoseThatTheDriverSees) {
  const auto scene = std::make_shared<const scene::Scene>(scene::make_scene("cornell-glossy"));
  const scene::Bvh bvh = scene::build_bvh(*scene);
  const worker::DeviceScene held(*device_, scene, &bvh);
  std::set<std::string> files = {"kernels/bvh_trace.cl"};
  for (const worker::StageKind& kind : worker::stage_table()) files.insert(kind.programs.begin(), kind.programs.end());
  std::size_t compared = 0, parameters = 0;
  for (const std::string& file : files) {
    const worker::Program program =
        device_->build(file, held.kernel_options() + " -D FUZZINESS=2 -D STACK_SIZE=16 -cl-kernel-arg-info");
    std::vector<cl::Kernel> kernels;
    cl::Program handle = program.handle;
    handle.createKernels(&kernels);
    ASSERT_FALSE(kernels.empty()) << file;
    for (cl::Kernel& kernel : kernels) {
      const std::string name = kernel.getInfo<CL_KERNEL_FUNCTION_NAME>();
      SCOPED_TRACE(file + ": " + name);
      std::vector<std::string> told;
      for (cl_uint k = 0; k < kernel.getInfo<CL_KERNEL_NUM_ARGS>(); ++k)
        told.push_back(kernel.getArgInfo<CL_KERNEL_ARG_NAME>(k).c_str());
      const auto [begin, end] = program.kernels->equal_range(name);
      EXPECT_TRUE(std::any_of(begin, end, [&](const auto& read) { return names(read.second) == told; }));
      ++compared;
      parameters += told.size();
    }
  }
  std::printf("%zu kernels of %zu files, %zu parameters\n", compared, files.size(), parameters);
  EXPECT_GE(compared, 12u);
}

TEST_F(KernelArguments, AWrongOneIsAnErrorAtOnce) {
  const worker::Program program = device_->build("kernels/bvh_trace.cl", "-D LANES=1 -D STACK_SIZE=16");
  worker::Kernel kernel(*device_, program, "trace_any");
  const cl::Buffer buffer = device_->make_buffer(256);
  const auto message = [](auto&& call) -> std::string {
    try {
      call();
    } catch (const Error& error) {
      return error.what();
    }
    return "nothing was thrown";
  };
  EXPECT_THAT(message([&] { kernel.set("ray", buffer); }), HasSubstr("kernel trace_any has no parameter ray"));
  EXPECT_THAT(message([&] { kernel.set("rays", cl_uint{1}); }), HasSubstr("rays is of another type"));
  EXPECT_THAT(message([&] { kernel.set("count", 1.0f); }), HasSubstr("count is of another type"));
  for (const char* name : {"nodes", "slots", "triangles", "top", "entries", "inverses", "rays", "overflow"})
    kernel.set(name, buffer);
  kernel.set("count", cl_uint{0});
  cl::CommandQueue queue = device_->make_queue();
  EXPECT_THAT(message([&] { kernel.launch(queue, {.work = 1, .capacity = 1}); }), HasSubstr("without rows"));
  kernel.set("rows", cl_uint{12});
  EXPECT_EQ(message([&] { kernel.launch(queue, {.work = 1, .capacity = 1}); }), "nothing was thrown");
  queue.finish();
  EXPECT_THROW(worker::Kernel(*device_, program, "trace_all"), cl::Error);
}

}  // namespace
}  // namespace gleaner::test
