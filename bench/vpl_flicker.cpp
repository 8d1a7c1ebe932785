// Flicker of point clusters: how much their error changes from frame to frame while the camera moves, where the frames
// of its trajectory share their clusters, and where each frame is clustered for itself.
//
//   build/bench/bench_vpl_flicker SCENE WIDTHxHEIGHT FRAMES STEP [KEY=VALUE ...]
//
// The scene's first camera moves to its right, STEP metres a frame; KEY=VALUE are settings of the method. The error is
// the light of VPLs with clusters, less their light where every point queries all of them
// (vpl.point_clusters=0); all else is the same bit by bit. Figures are RMS over the mean of that light: over pixels,
// and over means of blocks of 8x8 pixels, some cluster's part of the picture: the noise of residual samples
// (vpl.residual_threshold), which pixels do not share, is mostly gone from these.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/trajectory.h"
#include "scene/import/import.h"

namespace {

using namespace gleaner;
using Values = std::vector<float>;

// The VPLs' light in each pixel, RGB.
Values light_of(const coordinator::FrameSettings& settings, worker::Executor& executor,
                const coordinator::SceneSummary& summary) {
  Values light;
  auto plan = coordinator::make_plan(settings, summary);
  cli::run_frame(*plan, executor, "scene", {}, [&](const auto& stage, const worker::BatchResult& result) {
    if (stage.kind != "vpl_shade") return;
    light.resize(result.records.size() / 4);
    std::memcpy(light.data(), result.records.data(), result.records.size());
  });
  return light;
}

constexpr std::size_t kBlock = 8;

// Means of whole blocks of pixels.
Values blocks_of(const Values& values, std::size_t width, std::size_t height) {
  const std::size_t columns = width / kBlock, rows = height / kBlock;
  Values means(columns * rows * 3, 0.0f);
  for (std::size_t y = 0; y < rows * kBlock; ++y)
    for (std::size_t x = 0; x < columns * kBlock; ++x)
      for (std::size_t k = 0; k < 3; ++k)
        means[(y / kBlock * columns + x / kBlock) * 3 + k] +=
            values[(y * width + x) * 3 + k] / static_cast<float>(kBlock * kBlock);
  return means;
}

// Over frames: the clusters' error, and its change.
struct Errors {
  double square = 0, change = 0;
  std::size_t values = 0, changes = 0;
  Values before;

  void add(const Values& clustered, const Values& exact) {
    Values error(exact.size());
    for (std::size_t i = 0; i < error.size(); ++i) {
      error[i] = clustered[i] - exact[i];
      square += double{error[i]} * error[i];
      if (!before.empty()) change += std::pow(double{error[i]} - before[i], 2);
    }
    values += error.size();
    if (!before.empty()) changes += error.size();
    before = std::move(error);
  }
  double rms() const { return std::sqrt(square / static_cast<double>(values)); }
  double flicker() const { return std::sqrt(change / static_cast<double>(changes)); }
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 5) {
    std::fprintf(stderr, "usage: bench_vpl_flicker SCENE WIDTHxHEIGHT FRAMES STEP [KEY=VALUE ...]\n");
    return 2;
  }
  try {
    coordinator::FrameSettings settings;
    if (std::sscanf(argv[2], "%ux%u", &settings.width, &settings.height) != 2)
      throw Error::usage(std::string("size: expected WIDTHxHEIGHT, found ") + argv[2]);
    const int frames = std::atoi(argv[3]);
    const float step = std::strtof(argv[4], nullptr);
    if (settings.width < kBlock || settings.height < kBlock)
      throw Error::usage(std::string("size: expected at least 8x8, found ") + argv[2]);
    if (frames < 2) throw Error::usage(std::string("frames: expected at least 2, found ") + argv[3]);
    auto scene = std::make_shared<const scene::Scene>(scene::import_scene(argv[1]));
    if (scene->cameras.empty()) throw Error::bad_input(argv[1], "cameras", "one", "none");
    settings.method = "vpl";
    settings.spp = 1;  // of the paths, which are not looked at
    settings.camera = scene->cameras.front().camera;
    settings.camera.half_width =
        settings.camera.half_height * static_cast<float>(settings.width) / static_cast<float>(settings.height);
    settings.set = {{"vpl.compensate", "0"}, {"vpl.passes", "1"}, {"vpl.samples", "16"}};
    for (int k = 5; k < argc; ++k) {
      const std::string word = argv[k];
      const std::size_t equals = word.find('=');
      if (equals == std::string::npos) throw Error::usage("expected KEY=VALUE, found " + word);
      settings.set[word.substr(0, equals)] = word.substr(equals + 1);
    }
    std::vector<scene::Camera> cameras(static_cast<std::size_t>(frames), settings.camera);
    for (std::size_t frame = 0; frame < cameras.size(); ++frame)
      for (int k = 0; k < 3; ++k)
        cameras[frame].origin[k] += step * static_cast<float>(frame) * settings.camera.right[k];

    worker::Executor executor({});
    executor.load_scene("scene", scene, nullptr);
    const auto summary = coordinator::summarize(*scene);
    const std::vector<scene::Camera> trajectory = coordinator::trajectory_of(cameras);
    Errors alone, shared, alone_blocks, shared_blocks;
    double light = 0;
    for (const scene::Camera& camera : cameras) {
      settings.camera = camera;
      settings.trajectory.clear();
      const Values each = light_of(settings, executor, summary);
      coordinator::FrameSettings pairs = settings;
      pairs.set["vpl.point_clusters"] = std::to_string(0);
      const Values exact = light_of(pairs, executor, summary);
      settings.trajectory = trajectory;
      const Values common = light_of(settings, executor, summary);
      const auto blocks = [&](const Values& values) { return blocks_of(values, settings.width, settings.height); };
      alone.add(each, exact);
      shared.add(common, exact);
      alone_blocks.add(blocks(each), blocks(exact));
      shared_blocks.add(blocks(common), blocks(exact));
      for (const float value : exact) light += value;
    }
    const double mean = light / static_cast<double>(alone.values);
    std::printf("%s %s, %d frames, %g m a frame:\n", argv[1], argv[2], frames, static_cast<double>(step));
    const auto print = [&](const char* what, const Errors& each, const Errors& common) {
      std::printf(
          "  %-10s error %.3f %%, on the trajectory %.3f %%; its change %.3f %%, on the trajectory %.3f %%: %.2f times "
          "less\n",
          what, 100 * each.rms() / mean, 100 * common.rms() / mean, 100 * each.flicker() / mean,
          100 * common.flicker() / mean, each.flicker() / common.flicker());
    };
    print("pixels:", alone, shared);
    print("8x8:", alone_blocks, shared_blocks);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_vpl_flicker: %s\n", error.what());
    return 1;
  }
}
