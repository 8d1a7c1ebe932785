// The n-th call of an OpenCL function fails: the batch ends with an error that names it, nothing leaks, and the next
// batch on the same device gives the right bits.
//
// The functions are defined in this program, before the loader's: what the device library calls comes by here and is
// passed on, so that no product code knows of it. References to OpenCL's objects are counted the same way.

#include <dlfcn.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>

#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/numerics/rendering.h"

namespace gleaner::test {
namespace {

// Counts the calls of one function, and fails one of them.
class Fault {
 public:
  void count(const char* call) { arm(call, 0); }
  void arm(const char* call, long at) {
    call_ = call;
    at_ = at;
    seen_ = 0;
    fired_ = false;
  }
  void disarm() { call_ = nullptr; }
  bool strikes(const char* call) {
    const char* armed = call_;
    if (!armed || std::strcmp(armed, call) != 0 || ++seen_ != at_) return false;
    fired_ = true;
    return true;
  }
  long seen() const { return seen_; }
  bool fired() const { return fired_; }

 private:
  std::atomic<const char*> call_{nullptr};
  std::atomic<long> at_{0}, seen_{0};
  std::atomic<bool> fired_{false};
};

struct References {
  std::atomic<long> buffers{0}, queues{0}, kernels{0}, programs{0};
  std::array<long, 4> now() const { return {buffers, queues, kernels, programs}; }
};

Fault fault;
References references;

template <typename Function>
Function* next(const char* name) {
  auto* found = reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
  if (!found) std::abort();
  return found;
}

}  // namespace
}  // namespace gleaner::test

#define PASS_ON(function, ...)                                                  \
  static auto* const real = gleaner::test::next<decltype(function)>(#function); \
  return real(__VA_ARGS__)

// A call that gives an error code.
#define FAILING(function, code, parameters, ...)              \
  extern "C" cl_int function parameters {                     \
    if (gleaner::test::fault.strikes(#function)) return code; \
    PASS_ON(function, __VA_ARGS__);                           \
  }

FAILING(clEnqueueNDRangeKernel, CL_OUT_OF_RESOURCES,
        (cl_command_queue queue, cl_kernel kernel, cl_uint dimensions, const size_t* offset, const size_t* global,
         const size_t* local, cl_uint waits, const cl_event* wait, cl_event* event),
        queue, kernel, dimensions, offset, global, local, waits, wait, event)
FAILING(clEnqueueWriteBuffer, CL_OUT_OF_RESOURCES,
        (cl_command_queue queue, cl_mem buffer, cl_bool blocking, size_t offset, size_t size, const void* from,
         cl_uint waits, const cl_event* wait, cl_event* event),
        queue, buffer, blocking, offset, size, from, waits, wait, event)
FAILING(clEnqueueReadBuffer, CL_OUT_OF_RESOURCES,
        (cl_command_queue queue, cl_mem buffer, cl_bool blocking, size_t offset, size_t size, void* to, cl_uint waits,
         const cl_event* wait, cl_event* event),
        queue, buffer, blocking, offset, size, to, waits, wait, event)
FAILING(clSetKernelArg, CL_OUT_OF_RESOURCES, (cl_kernel kernel, cl_uint index, size_t size, const void* value), kernel,
        index, size, value)
FAILING(clFinish, CL_OUT_OF_RESOURCES, (cl_command_queue queue), queue)

extern "C" void* clEnqueueMapBuffer(cl_command_queue queue, cl_mem buffer, cl_bool blocking, cl_map_flags flags,
                                    size_t offset, size_t size, cl_uint waits, const cl_event* wait, cl_event* event,
                                    cl_int* error) {
  if (gleaner::test::fault.strikes("clEnqueueMapBuffer")) {
    if (error) *error = CL_MAP_FAILURE;
    return nullptr;
  }
  PASS_ON(clEnqueueMapBuffer, queue, buffer, blocking, flags, offset, size, waits, wait, event, error);
}

// A call that makes an object, and those that share and drop it.
#define MAKING(object, counter, make, retain, release, code, parameters, ...) \
  extern "C" object make parameters {                                         \
    if (gleaner::test::fault.strikes(#make)) {                                \
      if (error) *error = code;                                               \
      return nullptr;                                                         \
    }                                                                         \
    static auto* const real = gleaner::test::next<decltype(make)>(#make);     \
    object made = real(__VA_ARGS__);                                          \
    if (made) ++gleaner::test::references.counter;                            \
    return made;                                                              \
  }                                                                           \
  extern "C" cl_int retain(object shared) {                                   \
    ++gleaner::test::references.counter;                                      \
    PASS_ON(retain, shared);                                                  \
  }                                                                           \
  extern "C" cl_int release(object dropped) {                                 \
    --gleaner::test::references.counter;                                      \
    PASS_ON(release, dropped);                                                \
  }

MAKING(cl_mem, buffers, clCreateBuffer, clRetainMemObject, clReleaseMemObject, CL_MEM_OBJECT_ALLOCATION_FAILURE,
       (cl_context context, cl_mem_flags flags, size_t size, void* host, cl_int* error), context, flags, size, host,
       error)
MAKING(cl_command_queue, queues, clCreateCommandQueue, clRetainCommandQueue, clReleaseCommandQueue,
       CL_OUT_OF_HOST_MEMORY,
       (cl_context context, cl_device_id device, cl_command_queue_properties properties, cl_int* error), context,
       device, properties, error)
MAKING(cl_kernel, kernels, clCreateKernel, clRetainKernel, clReleaseKernel, CL_OUT_OF_RESOURCES,
       (cl_program program, const char* name, cl_int* error), program, name, error)
MAKING(cl_program, programs, clCreateProgramWithSource, clRetainProgram, clReleaseProgram, CL_OUT_OF_HOST_MEMORY,
       (cl_context context, cl_uint count, const char** texts, const size_t* lengths, cl_int* error), context, count,
       texts, lengths, error)

extern "C" cl_program clCreateProgramWithBinary(cl_context context, cl_uint count, const cl_device_id* devices,
                                                const size_t* lengths, const unsigned char** binaries, cl_int* status,
                                                cl_int* error) {
  static auto* const real = gleaner::test::next<decltype(clCreateProgramWithBinary)>("clCreateProgramWithBinary");
  cl_program made = real(context, count, devices, lengths, binaries, status, error);
  if (made) ++gleaner::test::references.programs;
  return made;
}

namespace gleaner::test {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// Which of a run's calls are made to fail: all, or as many as this, spread evenly.
constexpr long kMostPlaces = 12;

std::vector<long> places(long calls) {
  std::vector<long> at;
  const long count = std::min(calls, kMostPlaces);
  for (long i = 0; i < count; ++i) at.push_back(count == 1 ? 1 : 1 + i * (calls - 1) / (count - 1));
  return at;
}

class FailingDevice : public testing::TestWithParam<std::tuple<worker::TraceKind, const char*>> {
 protected:
  void SetUp() override {
    if (!open_device(kind()))
      GTEST_SKIP() << "NOT TESTED: no OpenCL device here traces with " << worker::trace_kind_name(kind());
    if (kind() == worker::TraceKind::opencl && std::strcmp(call(), "clEnqueueMapBuffer") == 0)
      GTEST_SKIP() << "only Embree looks at a device's memory from the host";
    scene_ = std::make_shared<scene::Scene>(scene::make_scene("cornell-box"));
    bvh_ = std::make_shared<scene::Bvh>(scene::build_bvh(*scene_));
    before_ = references.now();
  }
  void TearDown() override {
    fault.disarm();
    EXPECT_EQ(references.now(), before_) << "buffers, queues, kernels, programs that outlive their executors";
  }

  worker::TraceKind kind() const { return std::get<0>(GetParam()); }
  const char* call() const { return std::get<1>(GetParam()); }

  // With one thread, a run's calls are the same every time.
  std::unique_ptr<worker::Executor> open(int threads = 1) const {
    worker::DeviceChoice choice{.device = -1, .threads = threads, .trace = kind()};
    if (kind() == worker::TraceKind::embree)
      for (const auto& info : worker::list_devices())
        if (info.trace == kind()) choice.device = info.index;
    return std::make_unique<worker::Executor>(choice);
  }
  void load(worker::Executor& executor) const { executor.load_scene("scene", scene_, bvh_); }
  scene::Bytes run(worker::Executor& executor) const {
    const auto parameters = path_parameters(scene_->cameras[0].camera, Shot{.width = 16, .height = 16, .samples = 16});
    worker::StageTask task{.kind = "path", .parameters = {}, .inputs = {}, .scene = "scene"};
    task.parameters.resize(sizeof parameters);
    std::memcpy(task.parameters.data(), &parameters, sizeof parameters);
    return executor.run(task, 0, 256).records;
  }

  // Calls work() with the fault armed; it must fail and say of what.
  template <typename Work>
  void fails(long at, const std::string& in, Work&& work) {
    fault.arm(call(), at);
    try {
      work();
      ADD_FAILURE() << "call " << at << " of " << call() << (fault.fired() ? " failed unseen" : " was never made");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::failed);
      EXPECT_THAT(error.what(), AllOf(HasSubstr(call()), HasSubstr(in)));
    }
    EXPECT_TRUE(fault.fired());
    fault.disarm();
  }

 private:
  std::shared_ptr<const scene::Scene> scene_;
  std::shared_ptr<const scene::Bvh> bvh_;
  std::array<long, 4> before_{};
};

TEST_P(FailingDevice, FailsTheBatchAndNothingElse) {
  fault.count(call());
  auto untouched = open();
  load(*untouched);
  const long before_run = fault.seen();
  const scene::Bytes expected = run(*untouched);
  const long cold = fault.seen() - before_run;
  const auto idle = references.now();
  ASSERT_EQ(run(*untouched), expected) << "without any fault two runs differ";
  const long warm = fault.seen() - before_run - cold;
  EXPECT_EQ(references.now(), idle) << "a run that succeeds leaks";
  fault.disarm();

  // The first batch of an executor, which takes its memory, then a later one.
  for (const long at : places(cold)) {
    SCOPED_TRACE("first batch, call " + std::to_string(at) + " of " + std::to_string(cold));
    auto executor = open();
    load(*executor);
    fails(at, "stage path", [&] { run(*executor); });
    EXPECT_EQ(run(*executor), expected);
    EXPECT_EQ(run(*executor), expected);
  }
  for (const long at : places(warm)) {
    SCOPED_TRACE("later batch, call " + std::to_string(at) + " of " + std::to_string(warm));
    fails(at, "stage path", [&] { run(*untouched); });
    EXPECT_EQ(run(*untouched), expected);
    EXPECT_EQ(references.now(), idle) << "a run that fails leaks";
  }
  std::printf("%s: %ld calls in a first batch, %ld in a later one\n", call(), cold, warm);
  EXPECT_GT(cold, 0);
}

// Two lanes run at a time, and one of them fails: the other must end, too. How many calls each makes is up to chance,
// so that a late one may never come; then the batch must be right.
TEST_P(FailingDevice, FailsTheOtherLanesToo) {
  auto executor = open(2);
  load(*executor);
  const scene::Bytes expected = run(*executor);
  fault.count(call());
  ASSERT_EQ(run(*executor), expected);
  const long calls = fault.seen();
  const auto idle = references.now();
  long fired = 0;
  for (const long at : places(calls)) {
    SCOPED_TRACE("call " + std::to_string(at) + " of about " + std::to_string(calls));
    fault.arm(call(), at);
    try {
      EXPECT_EQ(run(*executor), expected);
      EXPECT_FALSE(fault.fired()) << "failed unseen";
    } catch (const Error& error) {
      EXPECT_TRUE(fault.fired());
      EXPECT_THAT(error.what(), AllOf(HasSubstr(call()), HasSubstr("stage path")));
    }
    fired += fault.fired();
    fault.disarm();
    EXPECT_EQ(run(*executor), expected);
    EXPECT_EQ(references.now(), idle) << "a run that fails leaks";
  }
  std::printf("%s: %ld of %zu places among about %ld calls failed\n", call(), fired, places(calls).size(), calls);
  if (calls == 0) GTEST_SKIP() << "a batch that finds its memory taken does not call " << call();
  EXPECT_GT(fired, 0);
}

TEST_P(FailingDevice, FailsTheLoadAndNothingElse) {
  fault.count(call());
  auto executor = open();
  load(*executor);
  const long calls = fault.seen();
  fault.disarm();
  const scene::Bytes expected = run(*executor);
  for (const long at : places(calls)) {
    SCOPED_TRACE("call " + std::to_string(at) + " of " + std::to_string(calls));
    auto other = open();
    fails(at, "loading scene", [&] { load(*other); });
    EXPECT_FALSE(other->holds_scene("scene"));
    load(*other);
    EXPECT_EQ(run(*other), expected);
  }
  if (calls == 0) GTEST_SKIP() << "loading a scene does not call " << call();
}

INSTANTIATE_TEST_SUITE_P(Calls, FailingDevice,
                         testing::Combine(testing::Values(worker::TraceKind::embree, worker::TraceKind::opencl),
                                          testing::Values("clCreateBuffer", "clEnqueueNDRangeKernel",
                                                          "clEnqueueMapBuffer", "clEnqueueWriteBuffer",
                                                          "clEnqueueReadBuffer", "clSetKernelArg", "clCreateKernel",
                                                          "clCreateCommandQueue", "clFinish")),
                         [](const testing::TestParamInfo<FailingDevice::ParamType>& made) {
                           return std::string(worker::trace_kind_name(std::get<0>(made.param))) + "_" +
                                  std::get<1>(made.param);
                         });

}  // namespace
}  // namespace gleaner::test
