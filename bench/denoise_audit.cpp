// Whether the error that a denoised picture tells of itself is true: pixels spread over the picture, path traced with
// many samples, beside its layers R, G, B and error.Y.
//
//   build/bench/bench_denoise_audit SCENE DENOISED.exr [PIXELS] [SAMPLES]
//
// PIXELS: a few per mille of the picture, one in each cell of a grid; 256 where they are not given. SAMPLES: of each,
// 4096 where they are not given. Prints the share of pixels that are off by no more than twice what they tell, and the
// root of the mean square of what they tell over that of what they are off by; the audit's own noise is taken off.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>

#include "cli/local_frame.h"
#include "coordinator/film/read.h"
#include "kernels/path_records.h"
#include "scene/import/import.h"

namespace {

using namespace gleaner;
using kernels::PathItem;

struct Truth {
  std::array<double, 3> color{}, variance{};  // variance: of this mean
};

// Pixels of a jittered grid.
std::vector<std::uint32_t> stratified_pixels(std::uint32_t width, std::uint32_t height, std::uint32_t wanted) {
  std::mt19937 random(1);
  const double cell = std::sqrt(double(width) * height / wanted);
  std::vector<std::uint32_t> pixels;
  for (double y = 0; y < height; y += cell)
    for (double x = 0; x < width; x += cell) {
      const auto at = [&](double first) {
        return static_cast<std::uint32_t>(first + cell * std::uniform_real_distribution<>(0, 1)(random));
      };
      const std::uint32_t column = at(x), row = at(y);
      if (column < width && row < height) pixels.push_back(row * width + column);
    }
  return pixels;
}

class Audit {
 public:
  Audit(const char* file, std::uint32_t width, std::uint32_t height)
      : scene_(std::make_shared<const scene::Scene>(scene::import_scene(file))) {
    if (scene_->cameras.empty()) throw Error::bad_input(file, "cameras", "one", "none");
    settings_.width = width;
    settings_.height = height;
    settings_.method = "path";
    settings_.seed = 0x61756469;  // not that of the picture
    settings_.spp = 4 * GLEANER_PATH_MAX_ITEM_SAMPLES;
    settings_.camera = scene_->cameras.front().camera;
    settings_.camera.half_width = settings_.camera.half_height * static_cast<float>(width) / static_cast<float>(height);
    executor_.load_scene("scene", scene_, nullptr);
  }

  std::vector<Truth> trace(const std::vector<std::uint32_t>& pixels, std::uint32_t samples) {
    auto plan = coordinator::make_plan(settings_, coordinator::summarize(*scene_));
    std::vector<Truth> truths;
    cli::run_frame(*plan, executor_, "scene", [&](const auto&, worker::StageTask task) {
      kernels::PathParameters p;
      std::memcpy(&p, task.parameters.data(), sizeof p);
      const std::uint32_t chunks = std::max(2u, samples / p.samples_per_item);
      const std::uint64_t items = std::uint64_t{pixels.size()} * chunks;
      p.features = 0;
      p.last_item_samples = p.samples_per_item;
      p.items_low = static_cast<std::uint32_t>(items);
      p.items_high = static_cast<std::uint32_t>(items >> 32);
      std::memcpy(task.parameters.data(), &p, sizeof p);
      auto list = std::make_shared<scene::Bytes>(items * sizeof(PathItem));
      auto* item = reinterpret_cast<PathItem*>(list->data());
      for (const std::uint32_t pixel : pixels)
        for (std::uint32_t chunk = 0; chunk < chunks; ++chunk) *item++ = {pixel, chunk};
      task.inputs["items"] = worker::TaskInput(list);
      const worker::BatchResult result = executor_.run(task, 0, items);
      truths = truths_of(result.records, chunks, p.samples_per_item);
      return false;
    });
    return truths;
  }

 private:
  static std::vector<Truth> truths_of(const scene::Bytes& records, std::uint32_t chunks, std::uint32_t samples) {
    std::vector<Truth> truths;
    for (std::size_t at = 0; at < records.size();) {
      std::array<double, 3> sum{}, squares{};
      for (std::uint32_t chunk = 0; chunk < chunks; ++chunk, at += sizeof(kernels::PathRecord)) {
        kernels::PathRecord r;
        std::memcpy(&r, records.data() + at, sizeof r);
        for (std::size_t c = 0; c < 3; ++c) {
          const double value = (double{r.direct[c]} + r.indirect[c]) / samples;
          sum[c] += value;
          squares[c] += value * value;
        }
      }
      Truth truth;
      for (std::size_t c = 0; c < 3; ++c) {
        const double mean = truth.color[c] = sum[c] / chunks;
        truth.variance[c] = std::max(0.0, squares[c] / chunks - mean * mean) / (chunks - 1);
      }
      truths.push_back(truth);
    }
    return truths;
  }

  std::shared_ptr<const scene::Scene> scene_;
  coordinator::FrameSettings settings_;
  worker::Executor executor_{{}};
};

const std::vector<float>& layer(const coordinator::Film& film, const char* file, const char* name) {
  const coordinator::Channel* channel = film.find(name);
  if (!channel) throw Error::bad_input(file, name, "a layer of a denoised picture", "none");
  return channel->values;
}

void audit(const char* scene, const char* file, std::uint32_t wanted, std::uint32_t samples) {
  const coordinator::Film film = coordinator::read_exr(file);
  const std::array<const std::vector<float>*, 3> picture = {&layer(film, file, "R"), &layer(film, file, "G"),
                                                            &layer(film, file, "B")};
  const std::vector<float>& error = layer(film, file, "error.Y");
  const std::vector<std::uint32_t> pixels = stratified_pixels(film.width, film.height, wanted);
  const std::vector<Truth> truths = Audit(scene, film.width, film.height).trace(pixels, samples);
  double told = 0, off = 0, noise = 0, mean = 0;
  std::size_t within = 0;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const std::uint32_t pixel = pixels[i];
    double squared = 0, variance = 0;  // means over the channels
    for (std::size_t c = 0; c < 3; ++c) {
      squared += std::pow((*picture[c])[pixel] - truths[i].color[c], 2) / 3;
      variance += truths[i].variance[c] / 3;
      mean += truths[i].color[c] / 3;
    }
    told += error[pixel];
    off += squared;
    noise += variance;
    within += squared <= 4 * (error[pixel] + variance);
  }
  const auto count = static_cast<double>(pixels.size());
  const double share = std::sqrt(std::max(0.0, off - noise) / count) / (mean / count);
  std::printf(
      "%s: %zu pixels of %u samples: %.1f %% within twice what they tell; off by %.2f %% of the mean, told %.2f %%, "
      "told/true %.2f\n",
      file, pixels.size(), samples, 100 * static_cast<double>(within) / count, 100 * share,
      100 * std::sqrt(told / count) / (mean / count), std::sqrt(told / std::max(off - noise, 1e-30)));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: bench_denoise_audit SCENE DENOISED.exr [PIXELS] [SAMPLES]\n");
    return 2;
  }
  try {
    const auto number = [&](int at, std::uint32_t otherwise) {
      return argc > at ? static_cast<std::uint32_t>(std::max(1, std::atoi(argv[at]))) : otherwise;
    };
    audit(argv[1], argv[2], number(3, 256), number(4, 4096));
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_denoise_audit: %s\n", error.what());
    return 1;
  }
}
