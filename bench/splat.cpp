// Radiance cache splatting: how far interpolated irradiance is from irradiance gathered at every point, and how noisy
// gathered irradiance is.
//
//   build/bench/bench_splat accuracy [SIZE [RAYS [SEEDS [SCENE ...]]]]   default: 64 1024 4, scenes with known traps.
//       Error and bias of the cache's light against a record at every point, for falling accuracies, and the fitted
//       order. Places stay, and what they gather is of so many seeds: noise is told from bias.
//   build/bench/bench_splat rays [POINTS [BOUNCES [SCENE ...]]]   default: 10000 1 cornell-box. The error of the
//       irradiance at random points of those that the camera sees, from 64 rays to 16,384.
//   build/bench/bench_splat noise [POINTS [SEEDS [BOUNCES [SCENE ...]]]]   default: 1000 16 0 cornell-box. The noise of
//       records at random points, and what records tell of it, from 64 rays to 1,024.
//   build/bench/bench_splat orders   what orders of hemispherical harmonics leave out of rough lobes' light.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <numbers>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/pixel_cache.h"
#include "coordinator/plan/plan.h"
#include "kernels/splat_records.h"
#include "scene/bvh/build.h"
#include "scene/import/import.h"
#include "scene/library/library.h"
#include "worker/stages/splat/harmonics.h"
#include "worker/stages/splat/lobe_table.h"
#include "worker/stages/splat/points.h"

namespace {

using namespace gleaner;
using Settings = std::map<std::string, std::string>;

// A scene of the library, or a file, on an executor of this process.
struct Stage {
  explicit Stage(const std::string& name)
      : scene(std::make_shared<const scene::Scene>(name.find('.') == std::string::npos ? scene::make_scene(name, {})
                                                                                       : scene::import_scene(name))),
        on({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic}) {
    std::shared_ptr<const scene::Bvh> bvh;
    if (on.needs_bvh()) bvh = std::make_shared<const scene::Bvh>(scene::build_bvh(*scene));
    on.load_scene(name, scene, bvh);
    id = name;
  }

  std::shared_ptr<const scene::Scene> scene;
  worker::Executor on;
  std::string id;
};

// What the stages of a frame by `splat` made.
struct Frame {
  std::map<std::string, worker::BatchResult> results;
  std::map<std::string, worker::StageTask> tasks;

  std::size_t records() const { return results.at("splat.gather").records.size() / sizeof(worker::CacheRecord); }
};

Frame run(Stage& stage, std::uint32_t size, std::uint64_t seed, const Settings& set) {
  coordinator::FrameSettings settings;
  settings.method = "splat";
  settings.width = settings.height = size;
  settings.spp = 1;
  settings.seed = seed;
  settings.set = set;
  settings.camera = stage.scene->cameras.at(0).camera;
  settings.camera.half_width = settings.camera.half_height;
  auto plan = coordinator::make_plan(settings, coordinator::summarize(*stage.scene));
  Frame frame;
  cli::run_frame(
      *plan, stage.on, stage.id,
      [&](const auto& spec, const worker::StageTask& task) {
        frame.tasks[spec.name] = task;
        return true;
      },
      [&](const auto& spec, const worker::BatchResult& result) { frame.results[spec.name] = result; });
  return frame;
}

// A stage of the frame once more, of another seed.
worker::BatchResult gather_again(Stage& stage, worker::StageTask task, std::uint32_t seed) {
  kernels::SplatGatherParameters p{};
  std::memcpy(&p, task.parameters.data(), sizeof p);
  p.samples.seed_low = seed;
  std::memcpy(task.parameters.data(), &p, sizeof p);
  return stage.on.run(task, 0, p.records);
}

// The cache's light at the frame's points, RGB, by records that were gathered by this seed.
std::vector<double> shade_again(Stage& stage, const Frame& frame, std::uint32_t seed) {
  static int made = 0;
  worker::StageTask task = frame.tasks.at("splat.shade");
  auto cache = std::make_shared<const scene::Bytes>(gather_again(stage, frame.tasks.at("splat.gather"), seed).records);
  worker::TaskInput& input = task.inputs.at("cache");
  input = worker::TaskInput(cache);
  input.artifact = "cache " + std::to_string(++made);
  kernels::SplatShadeParameters p{};
  std::memcpy(&p, task.parameters.data(), sizeof p);
  const worker::BatchResult result = stage.on.run(task, 0, p.tiles);
  std::vector<float> values(result.records.size() / 4);
  std::memcpy(values.data(), result.records.data(), result.records.size());
  return {values.begin(), values.end()};
}

double mean_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

// By seeds from `first` on.
std::vector<std::vector<double>> shades(Stage& stage, const Frame& frame, std::uint32_t first, std::uint32_t seeds) {
  std::vector<std::vector<double>> all;
  for (std::uint32_t k = 0; k < seeds; ++k) all.push_back(shade_again(stage, frame, first + k));
  return all;
}

// What pictures a differ by from pictures b, squared, without the noise of either: the mean over pairs of independent
// differences.
double square_off(const std::vector<std::vector<double>>& a, const std::vector<std::vector<double>>& b) {
  double sum = 0, n = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      for (std::size_t k = 0; k < a[i].size(); ++k, ++n) sum += (a[i][k] - b[i][k]) * (a[j][k] - b[j][k]);
  return sum / n;
}

struct Mean {
  double mean = 0, error = 0;
};

Mean mean_of(const std::vector<std::vector<double>>& pictures) {
  double sum = 0, squares = 0;
  const auto n = static_cast<double>(pictures.size());
  for (const auto& picture : pictures) {
    const double mean = mean_of(picture);
    sum += mean, squares += mean * mean;
  }
  return {sum / n, std::sqrt(std::max(0.0, squares / n - sum * sum / (n * n)) / (n - 1))};
}

// The exponent of y in x, by least squares of logarithms.
double order_of(const std::vector<double>& x, const std::vector<double>& y) {
  double n = 0, a = 0, b = 0, aa = 0, ab = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (!(y[i] > 0)) continue;
    const double u = std::log(x[i]), v = std::log(y[i]);
    n += 1, a += u, b += v, aa += u * u, ab += u * v;
  }
  return (n * ab - a * b) / (n * aa - a * a);
}

void measure_accuracy(const std::string& name, std::uint32_t size, const std::string& rays, std::uint32_t seeds) {
  Stage stage(name);
  Settings set{{"splat.gather_rays", rays}, {"splat.accuracy", "0"}};
  const Frame whole = run(stage, size, 1, set);
  const auto reference = shades(stage, whole, 101, seeds);
  const Mean mean = mean_of(reference);
  std::printf("\n%s, %u x %u, %s rays, %u seeds; %zu points; standard error of the mean %.2f %%\n\n", name.c_str(),
              size, size, rays.c_str(), seeds, whole.records(), 100 * mean.error / mean.mean);
  std::printf("| accuracy | records | bias of the mean | error |\n|---|---|---|---|\n");
  std::vector<double> accuracies, errors;
  for (const char* accuracy : {"0.4", "0.3", "0.2", "0.15", "0.1", "0.07"}) {
    set["splat.accuracy"] = accuracy;
    const Frame frame = run(stage, size, 1, set);
    const auto shaded = shades(stage, frame, 1, seeds);
    const Mean found = mean_of(shaded);
    const double square = square_off(shaded, reference);
    accuracies.push_back(std::atof(accuracy));
    errors.push_back(square > 0 ? std::sqrt(square) / mean.mean : 0);
    std::printf("| %s | %zu | %+.2f +- %.2f %% | %.2f %% |\n", accuracy, frame.records(),
                100 * (found.mean / mean.mean - 1), 100 * std::hypot(found.error, mean.error) / mean.mean,
                100 * errors.back());
    std::fflush(stdout);
  }
  std::printf("\nthe error falls as the accuracy to the power %.2f\n", order_of(accuracies, errors));
}

std::vector<worker::CacheRecord> gather(Stage& stage, worker::StageTask task,
                                        const std::shared_ptr<const scene::Bytes>& places, std::uint32_t rays,
                                        std::uint32_t seed) {
  kernels::SplatGatherParameters p{};
  std::memcpy(&p, task.parameters.data(), sizeof p);
  const coordinator::Strata strata = coordinator::strata_of(rays);
  p.polar = strata.polar;
  p.azimuthal = strata.azimuthal;
  p.samples.seed_low = seed;
  p.records = static_cast<std::uint32_t>(places->size() / sizeof(worker::SplatPlace));
  std::memcpy(task.parameters.data(), &p, sizeof p);
  worker::TaskInput& input = task.inputs["places"];
  input = worker::TaskInput(places);
  input.artifact = stage.id + " random places";
  std::vector<worker::CacheRecord> records(p.records);
  const worker::BatchResult result = stage.on.run(task, 0, p.records);
  std::memcpy(records.data(), result.records.data(), result.records.size());
  return records;
}

// Squared differences of the records' irradiance, the mean of the colours: of all, and without the worst hundredth.
struct RecordError {
  double all = 0, most = 0;
};

RecordError record_square_off(const std::vector<worker::CacheRecord>& a, const std::vector<worker::CacheRecord>& b) {
  std::vector<double> squares;
  for (std::size_t i = 0; i < a.size(); ++i) {
    double sum = 0;
    for (std::size_t k = 0; k < 3; ++k) sum += std::pow(double{a[i].irradiance[k]} - b[i].irradiance[k], 2) / 3;
    squares.push_back(sum);
  }
  std::ranges::sort(squares);
  RecordError error{.all = mean_of(squares)};
  squares.resize(squares.size() - squares.size() / 100);
  error.most = mean_of(squares);
  return error;
}

// Random points of those that the camera sees, and how light is gathered at them.
struct RandomPlaces {
  RandomPlaces(Stage& stage, std::uint32_t points, const std::string& bounces) {
    const auto size = static_cast<std::uint32_t>(8 * std::ceil(std::sqrt(1.5 * points) / 8));
    Frame frame =
        run(stage, size, 1, {{"splat.accuracy", "0"}, {"splat.gather_rays", "16"}, {"splat.bounces", bounces}});
    const scene::Bytes& bytes = frame.results.at("splat.select").records;
    places.resize(bytes.size() / sizeof(worker::SplatPlace));
    std::memcpy(places.data(), bytes.data(), bytes.size());
    std::ranges::shuffle(places, std::mt19937(1));
    places.resize(std::min<std::size_t>(places.size(), points));
    chosen = std::make_shared<scene::Bytes>(places.size() * sizeof(worker::SplatPlace));
    std::memcpy(chosen->data(), places.data(), chosen->size());
    task = frame.tasks.at("splat.gather");
  }

  std::vector<worker::SplatPlace> places;
  std::shared_ptr<scene::Bytes> chosen;
  worker::StageTask task;
};

// The truth is gathered by 16,384 rays twice: what its halves differ by is taken off.
void measure_rays(const std::string& name, std::uint32_t points, const std::string& bounces) {
  Stage stage(name);
  const auto [places, chosen, task] = RandomPlaces(stage, points, bounces);
  const auto truth = gather(stage, task, chosen, 16384, 1001), second = gather(stage, task, chosen, 16384, 1002);
  const RecordError halves = record_square_off(truth, second);
  double mean = 0;
  for (const worker::CacheRecord& record : truth)
    for (const float e : record.irradiance) mean += double{e} / (3 * static_cast<double>(truth.size()));
  std::printf(
      "\n%s, %zu random points, %s bounces\n\n| rays | error of the irradiance | without the worst hundredth of the "
      "points |\n"
      "|---|---|---|\n",
      name.c_str(), places.size(), bounces.c_str());
  std::vector<double> counts, errors;
  for (const std::uint32_t rays : {64u, 256u, 1024u, 4096u, 16384u}) {
    const RecordError found =
        rays == 16384 ? halves : record_square_off(gather(stage, task, chosen, rays, 1003), truth);
    // Of what both truths differ by, each has half.
    const auto share = [&](double square, double noise) {
      return std::sqrt(std::max(0.0, rays == 16384 ? noise / 2 : square - noise / 2)) / mean;
    };
    counts.push_back(rays);
    errors.push_back(share(found.all, halves.all));
    std::printf("| %u | %.3f %% | %.3f %% |\n", rays, 100 * errors.back(), 100 * share(found.most, halves.most));
    std::fflush(stdout);
  }
  std::printf("\nthe error falls as the rays to the power %.2f\n", order_of(counts, errors));
}

double light_of(const worker::CacheRecord& record) {
  return (double{record.irradiance[0]} + record.irradiance[1] + record.irradiance[2]) / 3;
}

// What seeds differ by, beside what records say of themselves: root mean squares over the mean irradiance, without the
// worst hundredth of the points.
void measure_noise(const std::string& name, std::uint32_t points, std::uint32_t seeds, const std::string& bounces) {
  Stage stage(name);
  const auto [places, chosen, task] = RandomPlaces(stage, points, bounces);
  std::printf(
      "\n%s, %zu random points, %u seeds, bounces %s\n\n| rays | strata | noise | told | told / true |\n"
      "|---|---|---|---|---|\n",
      name.c_str(), places.size(), seeds, bounces.c_str());
  for (const std::uint32_t rays : {64u, 96u, 128u, 160u, 256u, 384u, 512u, 576u, 1024u}) {
    std::vector<double> sums(places.size()), squares(places.size()), told(places.size());
    for (std::uint32_t seed = 1; seed <= seeds; ++seed) {
      const auto records = gather(stage, task, chosen, rays, seed);
      for (std::size_t i = 0; i < records.size(); ++i) {
        const double light = light_of(records[i]), noise = double{records[i].noise()} * light;
        sums[i] += light, squares[i] += light * light, told[i] += noise * noise;
      }
    }
    const double n = seeds, mean = mean_of(sums) / n;
    std::vector<std::pair<double, double>> found;  // variance of a record, and the one it tells
    for (std::size_t i = 0; i < sums.size(); ++i)
      found.emplace_back((squares[i] - sums[i] * sums[i] / n) / (n - 1), told[i] / n);
    std::ranges::sort(found);
    found.resize(found.size() - found.size() / 100);
    double variance = 0, said = 0;
    for (const auto& [v, t] : found) variance += v, said += t;
    const auto count = static_cast<double>(found.size());
    const coordinator::Strata strata = coordinator::strata_of(rays);
    std::printf("| %u | %u x %u | %.2f %% | %.2f %% | %.3f |\n", rays, strata.polar, strata.azimuthal,
                100 * std::sqrt(variance / count) / mean, 100 * std::sqrt(said / count) / mean,
                std::sqrt(said / variance));
    std::fflush(stdout);
  }
}

// A room of random walls, each with a darker or brighter box on it, seen from a place on its floor.
class Room {
 public:
  explicit Room(std::uint32_t seed) : random_(seed) {
    place_ = {between(-0.8, 0.8), between(-0.8, 0.8)};
    for (Wall& wall : walls_)
      wall = {between(0.05, 1), between(0, 6), between(-0.6, 0.6), between(-0.1, 1.1), between(0.1, 2)};
  }

  // W/(sr m^2) from a direction of unit length, z up: walls at x and y of -1 and 1, a ceiling at z = 2.
  double radiance(const std::array<double, 3>& w) const {
    double nearest = 1e30;
    std::size_t met = 0, axis = 0;
    for (std::size_t k = 0; k < 5; ++k) {
      const std::size_t along = k / 2;
      const double from = along < 2 ? place_[along] : 0, to = along < 2 ? (k % 2 ? 1 : -1) : 2;
      const double t = (to - from) / w[along];
      if (t > 0 && t < nearest) nearest = t, met = k, axis = along;
    }
    const Wall& wall = walls_[met];
    const double across = axis == 0 ? place_[1] + nearest * w[1] : place_[0] + nearest * w[0];
    const double up = axis < 2 ? nearest * w[2] : place_[1] + nearest * w[1];
    const bool in_box = std::abs(across - wall.x) < 0.35 && std::abs(up - wall.y) < 0.35;
    return wall.light * (1 + 0.5 * std::sin(2 * across + wall.phase)) * (in_box ? wall.box : 1);
  }

 private:
  struct Wall {
    double light, phase, x, y, box;
  };
  double between(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }

  std::mt19937 random_;
  std::array<double, 2> place_{};
  std::array<Wall, 5> walls_{};
};

// Its coefficients in hemispherical harmonics: of each pair, of the cosine and of the sine.
std::vector<double> project(const Room& room, std::uint32_t order) {
  constexpr int polar = 120, azimuthal = 240;
  std::vector<double> values(worker::harmonic_pairs(order)), sums(2 * values.size());
  for (int j = 0; j < polar; ++j) {
    const double theta = std::numbers::pi / 2 * (j + 0.5) / polar, sine = std::sin(theta);
    worker::hemispherical_harmonics(order, std::cos(theta), values);
    for (int k = 0; k < azimuthal; ++k) {
      const double phi = 2 * std::numbers::pi * (k + 0.5) / azimuthal;
      const double light = room.radiance({sine * std::cos(phi), sine * std::sin(phi), std::cos(theta)}) * sine *
                           std::numbers::pi / 2 / polar * 2 * std::numbers::pi / azimuthal;
      for (std::uint32_t l = 0; l < order; ++l)
        for (std::uint32_t m = 0; m <= l; ++m) {
          const std::size_t pair = l * (l + 1) / 2 + m;
          sums[2 * pair] += light * values[pair] * std::cos(m * phi);
          sums[2 * pair + 1] += light * values[pair] * std::sin(m * phi);
        }
    }
  }
  return sums;
}

// What orders leave out of a lobe's light: of white metal, seen at up to 82 degrees. Order 24 is the truth.
void measure_orders() {
  constexpr std::uint32_t truth = 24;
  const std::vector<float> table = worker::make_lobe_table(truth);
  std::vector<std::vector<double>> rooms;
  for (std::uint32_t seed = 1; seed <= 24; ++seed) rooms.push_back(project(Room(seed), truth));
  std::printf("error of a rough lobe's light by the order of hemispherical harmonics, 24 rooms\n\n");
  std::printf("| alpha | roughness | order 5 | order 10 |\n|---|---|---|---|\n");
  for (std::uint32_t a = 0; a < LOBE_TABLE_ALPHAS; ++a) {
    double whole = 0, n = 0;
    std::map<std::uint32_t, double> squares;
    for (std::uint32_t v = 0; v + 2 < LOBE_TABLE_VIEWS; ++v)
      for (const auto& room : rooms)
        for (const double phi : {0.0, 1.3, 3.5, 5.0}) {
          const float* lobe = &table[(std::size_t{a} * LOBE_TABLE_VIEWS + v) * LOBE_TABLE_WORDS(truth)];
          std::map<std::uint32_t, double> found;
          double sum = 0;
          for (std::uint32_t l = 0; l < truth; ++l) {
            found[l] = sum;
            for (std::uint32_t m = 0; m <= l; ++m) {
              const std::size_t pair = l * (l + 1) / 2 + m;
              sum += (double{lobe[pair]} + lobe[HARMONIC_PAIRS(truth) + pair]) *
                     (std::cos(m * phi) * room[2 * pair] + std::sin(m * phi) * room[2 * pair + 1]);
            }
          }
          whole += sum;
          ++n;
          for (const std::uint32_t order : {5u, 10u}) squares[order] += (found[order] - sum) * (found[order] - sum);
        }
    const double alpha = std::pow(double{LOBE_TABLE_LEAST}, 1 - a / (LOBE_TABLE_ALPHAS - 1.0));
    std::printf("| %.2f | %.2f | %.2f %% | %.2f %% |\n", alpha, std::sqrt(alpha),
                100 * std::sqrt(squares[5] / n) / (whole / n), 100 * std::sqrt(squares[10] / n) / (whole / n));
  }
}

}  // namespace

int main(int count, char** words) {
  const auto word = [&](int k, const char* usual) { return std::string(count > k ? words[k] : usual); };
  const auto number = [&](int k, const char* usual) {
    return static_cast<std::uint32_t>(std::max(1, std::atoi(word(k, usual).c_str())));
  };
  const auto scenes = [&](int k, std::vector<std::string> usual) {
    return count > k ? std::vector<std::string>(words + k, words + count) : usual;
  };
  const std::string what = word(1, "accuracy");
  if (what == "accuracy") {
    for (const std::string& name : scenes(5, {"cornell-box", "cornell-mirror", "cornell-glossy", "punctual-lights"}))
      measure_accuracy(name, number(2, "64"), word(3, "1024"), std::max(2u, number(4, "4")));
  } else if (what == "rays") {
    for (const std::string& name : scenes(4, {"cornell-box"})) measure_rays(name, number(2, "10000"), word(3, "1"));
  } else if (what == "noise") {
    for (const std::string& name : scenes(5, {"cornell-box"}))
      measure_noise(name, number(2, "1000"), std::max(2u, number(3, "16")), word(4, "0"));
  } else if (what == "orders") {
    measure_orders();
  } else {
    std::fprintf(stderr, "expected accuracy, rays, noise or orders, found %s\n", what.c_str());
    return 2;
  }
}
