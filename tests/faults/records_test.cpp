// Blobs and tables that a worker gets from others: what would have a kernel look up what is not there is refused, by
// the name of the input and the row, and the next batch runs as if nothing had been.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>

#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"
#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "worker/stages/executor.h"

namespace gleaner::test {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const float kNan = std::numeric_limits<float>::quiet_NaN();

std::string refusal(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::bad_input) << error.what();
    return error.what();
  }
  return "nothing was thrown";
}

// --- BVH ---

TEST(BvhBlob, OfAHugeDepthIsRefused) {
  const scene::Scene box = scene::make_scene("cornell-box");
  scene::Bvh bvh = scene::build_bvh(box);
  ASSERT_LE(bvh.max_depth, scene::kMaxBvhDepth);
  for (const std::uint32_t depth : {scene::kMaxBvhDepth + 1, 1u << 20, 0xffffffffu}) {
    bvh.max_depth = depth;
    EXPECT_THAT(refusal([&] { scene::parse_bvh(scene::serialize(bvh), box.triangle_count(), "blob"); }),
                AllOf(HasSubstr("max_depth"), HasSubstr(std::to_string(depth))));
  }
  bvh.max_depth = scene::kMaxBvhDepth;
  EXPECT_NO_THROW(scene::parse_bvh(scene::serialize(bvh), box.triangle_count(), "blob"));
}

TEST(BvhBlob, OfAHugeDepthNeverBecomesACompileOption) {
  const auto box = std::make_shared<scene::Scene>(scene::make_scene("cornell-box"));
  scene::Bvh bvh = scene::build_bvh(*box);
  worker::Executor executor({.device = -1, .threads = 1, .trace = worker::TraceKind::opencl});
  scene::Bvh deep = bvh;
  deep.max_depth = 0x7fffffff;
  EXPECT_THAT(refusal([&] { executor.load_scene("deep", box, std::make_shared<scene::Bvh>(deep)); }),
              HasSubstr("max_depth"));
  EXPECT_FALSE(executor.holds_scene("deep"));
  EXPECT_NO_THROW(executor.load_scene("right", box, std::make_shared<scene::Bvh>(bvh)));
}

// --- Tables ---

// The stages of one small frame, and what each answered.
struct Recorded {
  std::map<std::string, worker::StageTask> tasks;  // by kind, the last of it
  std::map<std::string, scene::Bytes> records;
  std::map<std::string, std::uint64_t> items;
};

class BadRows : public testing::Test {
 protected:
  void SetUp() override {
    if (worker::list_devices().empty()) GTEST_SKIP() << "NOT TESTED: there is no OpenCL device";
    // Textured roughness: albedo tables of many rows.
    scene_ = std::make_shared<scene::Scene>(scene::make_scene("cornell-textured"));
    executor_ = std::make_unique<worker::Executor>(worker::DeviceChoice{.device = -1, .threads = 2});
    std::shared_ptr<scene::Bvh> bvh;
    if (executor_->needs_bvh()) bvh = std::make_shared<scene::Bvh>(scene::build_bvh(*scene_));
    executor_->load_scene("scene", scene_, bvh);
    coordinator::FrameSettings settings;
    settings.method = "vpl";
    settings.width = settings.height = 32;
    settings.spp = 2;
    settings.camera = scene_->cameras.front().camera;
    settings.set = {{"vpl.count", "500"}, {"vpl.clusters", "100"}, {"vpl.point_clusters", "64"}};
    auto plan = coordinator::make_plan(settings, coordinator::summarize(*scene_));
    cli::run_frame(
        *plan, *executor_, "scene",
        [&](const coordinator::StageSpec& stage, const worker::StageTask& task) {
          seen_.tasks[stage.kind] = task;
          seen_.items[stage.kind] = stage.items;
          return true;
        },
        [&](const coordinator::StageSpec& stage, const worker::BatchResult& result) {
          seen_.records[stage.kind] = result.records;
        });
  }

  // The task with other bytes of one input.
  template <typename Change>
  worker::StageTask changed(const std::string& kind, const std::string& input, Change change) {
    worker::StageTask task = seen_.tasks.at(kind);
    auto bytes = std::make_shared<scene::Bytes>(*task.inputs.at(input).load());
    change(*bytes);
    task.inputs[input] = worker::TaskInput(bytes);
    return task;
  }
  template <typename T>
  static void set_word(scene::Bytes& bytes, std::size_t row, unsigned row_words, unsigned word, T value) {
    ASSERT_LE((row + 1) * row_words * 4, bytes.size());
    std::memcpy(&bytes[(row * row_words + word) * 4], &value, 4);
  }
  // The first row, from `from` on, whose word fits.
  template <typename T, typename Fits>
  static std::size_t find_row(const scene::Bytes& bytes, unsigned row_words, unsigned word, Fits fits,
                              std::size_t from) {
    for (std::size_t row = from; row < bytes.size() / 4 / row_words; ++row) {
      T value;
      std::memcpy(&value, &bytes[(row * row_words + word) * 4], 4);
      if (fits(value)) return row;
    }
    ADD_FAILURE() << "no row to spoil";
    return 0;
  }

  // Puts `value` in the first row that `fits` says holds something; the error must name input and row.
  template <typename T, typename Fits>
  void refuses(const std::string& kind, const std::string& input, unsigned row_words, unsigned word, T value,
               unsigned seen_word, Fits fits, std::size_t from = 0) {
    std::size_t row = 0;
    const worker::StageTask task = changed(kind, input, [&](scene::Bytes& bytes) {
      row = find_row<std::uint32_t>(bytes, row_words, seen_word, fits, from);
      set_word(bytes, row, row_words, word, value);
    });
    EXPECT_THAT(refusal([&] { executor_->run(task, 0, seen_.items.at(kind)); }),
                AllOf(HasSubstr("stage " + kind), HasSubstr("input " + input + "[" + std::to_string(row) + "]")))
        << "word " << word << " = " << value;
    ++refused_;
  }

  // Rows of clusters of lights that vpl_shade reads.
  std::uint32_t clusters() const {
    kernels::VplPointParameters p;
    std::memcpy(&p, seen_.tasks.at("vpl_shade").parameters.data(), sizeof p);
    return p.clusters;
  }

  void still_runs(const std::string& kind) {
    EXPECT_EQ(executor_->run(seen_.tasks.at(kind), 0, seen_.items.at(kind)).records, seen_.records.at(kind));
  }

  std::shared_ptr<scene::Scene> scene_;
  std::unique_ptr<worker::Executor> executor_;
  Recorded seen_;
  int refused_ = 0;
};

bool exists(std::uint32_t word) { return word != GLEANER_NONE; }
bool any(std::uint32_t) { return true; }
bool positive(std::uint32_t bits) { return bits != 0 && bits < 0x7f800000u; }

TEST_F(BadRows, OfPoints) {
  const auto triangles = static_cast<std::uint32_t>(scene_->triangle_count());
  const auto beyond = static_cast<std::uint32_t>(scene_->albedo_tables.size());
  for (const std::string kind : {"vpl_visibility", "vpl_shade"}) {
    refuses(kind, "points", POINT_WORDS, POINT_TRIANGLE, triangles, POINT_TRIANGLE, exists);
    refuses(kind, "points", POINT_WORDS, POINT_TRIANGLE, 0x7fffffffu, POINT_TRIANGLE, exists);
    refuses(kind, "points", POINT_WORDS, POINT_TABLE, beyond, POINT_TRIANGLE, exists);
    refuses(kind, "points", POINT_WORDS, POINT_TABLE, 1u, POINT_TRIANGLE, exists);
    for (const float x : {kNan, std::numeric_limits<float>::infinity(), 1e30f})
      refuses(kind, "points", POINT_WORDS, POINT_POSITION + 1, x, POINT_TRIANGLE, exists);
    refuses(kind, "points", POINT_WORDS, POINT_NORMAL, kNan, POINT_TRIANGLE, exists);
    still_runs(kind);
  }
  refuses("point_cluster", "points", POINT_WORDS, POINT_POSITION, kNan, POINT_TRIANGLE, exists);
  refuses("point_cluster", "points", POINT_WORDS, POINT_NORMAL, 1e30f, POINT_TRIANGLE, exists);
  still_runs("point_cluster");
  std::printf("%d spoilt rows refused\n", refused_);
}

TEST_F(BadRows, OfAlbedoTables) {
  for (const std::string kind : {"vpl_visibility", "vpl_shade"}) {
    for (const float row : {-1.0f, 33.0f, 1e9f, kNan})
      refuses(kind, "lights", VPL_WORDS, VPL_ROW, row, VPL_TABLE, exists);
    refuses(kind, "lights", VPL_WORDS, VPL_TABLE, static_cast<std::uint32_t>(scene_->albedo_tables.size()), VPL_TABLE,
            any);
    refuses(kind, "lights", VPL_WORDS, VPL_TABLE, 0x7fffffffu, VPL_TABLE, any);
    still_runs(kind);
  }
  refuses("vpl_shade", "lights", VPL_WORDS, VPL_TABLE, 0x7fffffffu, VPL_TABLE, any, clusters());
  still_runs("vpl_shade");
}

TEST_F(BadRows, OfMembers) {
  // Members stand behind the clusters.
  refuses("vpl_shade", "lights", VPL_WORDS, VPL_FIRST, clusters(), VPL_FIRST, any, clusters());
  refuses("vpl_shade", "lights", VPL_WORDS, VPL_RADIUS, 1.0f, VPL_FIRST, any, clusters());
  refuses("vpl_shade", "lights", VPL_WORDS, VPL_FIRST, 0u, VPL_RADIUS, positive);
  refuses("vpl_shade", "lights", VPL_WORDS, VPL_FIRST, 0xfffffff0u, VPL_RADIUS, positive);
  for (const float count : {1e9f, -1.0f, kNan, std::numeric_limits<float>::infinity()})
    refuses("vpl_shade", "lights", VPL_WORDS, VPL_COUNT, count, VPL_RADIUS, positive);
  still_runs("vpl_shade");
}

TEST_F(BadRows, OfAPathList) {
  kernels::PathParameters p{};
  p.camera = scene_->cameras.front().camera;
  p.width = p.height = 8;
  p.samples_per_item = p.last_item_samples = 1;
  constexpr std::uint32_t kItems = 64;
  p.items_low = kItems;
  std::vector<kernels::PathItem> list(kItems);
  for (std::uint32_t i = 0; i < kItems; ++i) list[i] = {(i * 37u) % 64u, i % 3u};
  const auto task_of = [&](std::uint32_t first, std::uint32_t count, bool own) {
    worker::StageTask task{.kind = "path", .parameters = {}, .inputs = {}, .scene = "scene"};
    task.parameters.resize(sizeof p);
    std::memcpy(task.parameters.data(), &p, sizeof p);
    auto bytes = std::make_shared<scene::Bytes>(count * sizeof(kernels::PathItem));
    std::memcpy(bytes->data(), &list[first], bytes->size());
    task.inputs["items"] = worker::TaskInput(bytes);
    task.inputs["items"].own_items = own;
    task.inputs["items"].first_item = own ? first : 0;
    return task;
  };
  // A batch that is given the entries of its own items alone answers as one that is given all.
  const scene::Bytes whole = executor_->run(task_of(0, kItems, false), 16, 32).records;
  EXPECT_EQ(executor_->run(task_of(16, 32, true), 16, 32).records, whole);
  EXPECT_EQ(executor_->run(task_of(8, 48, true), 16, 32).records, whole);
  EXPECT_THAT(refusal([&] { executor_->run(task_of(16, 31, true), 16, 32); }), HasSubstr("records of items 16 + 32"));
  EXPECT_THAT(refusal([&] { executor_->run(task_of(0, 32, false), 16, 16); }), HasSubstr("64 rows"));
  list[20].pixel = 64;
  EXPECT_THAT(refusal([&] { executor_->run(task_of(0, kItems, false), 16, 32); }),
              AllOf(HasSubstr("input items[20].pixel"), HasSubstr("below 64"), HasSubstr("found 64")));
  EXPECT_NO_THROW(executor_->run(task_of(0, kItems, false), 32, 32)) << "another batch's rows are its own affair";
}

TEST_F(BadRows, InputsThatAStageDoesNotRead) {
  worker::StageTask task = seen_.tasks.at("vpl_visibility");
  task.inputs["photons"] = task.inputs["lights"];
  EXPECT_THAT(refusal([&] { executor_->run(task, 0, 16); }), HasSubstr("input photons"));
  task = seen_.tasks.at("vpl_visibility");
  task.inputs.erase("points");
  EXPECT_THAT(refusal([&] { executor_->run(task, 0, 16); }), HasSubstr("input points: expected an artifact"));
  task = seen_.tasks.at("vpl_visibility");
  task.inputs["points"].own_items = true;
  EXPECT_THAT(refusal([&] { executor_->run(task, 0, 16); }), HasSubstr("expected the whole artifact"));
  task.kind = "photon_trace";
  EXPECT_THAT(refusal([&] { executor_->run(task, 0, 16); }), HasSubstr("photon_trace"));
  still_runs("vpl_visibility");
}

}  // namespace
}  // namespace gleaner::test
