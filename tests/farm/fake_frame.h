#pragma once
// A frame that needs no renderer: two stages whose records are arithmetic, so that every byte that a farm delivers can
// be checked. Stage "scatter" makes a hash for each item; stage "gather" (one record a pixel) sums the hashes of its
// pixel.

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/blobs/sha256.h"
#include "coordinator/film/write.h"
#include "coordinator/plan/plan.h"
#include "scene/model/error.h"

namespace gleaner::test {

using coordinator::Bytes;
using coordinator::Film;

inline constexpr std::uint32_t items_a_pixel = 4;

inline std::uint64_t hash_of(std::uint64_t seed, std::uint64_t item) {
  std::uint64_t z = seed * 0x9e3779b97f4a7c15u + item + 1;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

template <typename T>
Bytes bytes_of(const std::vector<T>& values) {
  Bytes bytes(values.size() * sizeof(T));
  if (!bytes.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

template <typename T>
std::vector<T> values_of(const Bytes& bytes) {
  std::vector<T> values(bytes.size() / sizeof(T));
  if (!bytes.empty()) std::memcpy(values.data(), bytes.data(), values.size() * sizeof(T));
  return values;
}

inline Bytes fake_scatter(std::uint64_t seed, std::uint64_t first, std::uint64_t count) {
  std::vector<std::uint64_t> hashes(count);
  for (std::uint64_t i = 0; i < count; ++i) hashes[i] = hash_of(seed, first + i);
  return bytes_of(hashes);
}

inline Bytes fake_gather(const Bytes& scattered, std::uint64_t first, std::uint64_t count) {
  auto hashes = values_of<std::uint64_t>(scattered);
  std::vector<float> sums(count);
  for (std::uint64_t i = 0; i < count; ++i)
    for (std::uint32_t j = 0; j < items_a_pixel; ++j)
      sums[i] += static_cast<float>(hashes.at((first + i) * items_a_pixel + j) >> 40);
  return bytes_of(sums);
}

// What the whole frame must look like, computed without any farm.
inline std::string fake_pixels_sha256(const coordinator::FrameSettings& settings) {
  std::uint64_t pixels = std::uint64_t{settings.width} * settings.height;
  auto values = values_of<float>(fake_gather(fake_scatter(settings.seed, 0, pixels * items_a_pixel), 0, pixels));
  Film film{.width = settings.width, .height = settings.height, .channels = {}};
  for (const char* name : {"R", "G", "B"}) film.channel(name).values = values;
  return coordinator::pixels_sha256(film);
}

// An artifact of the frame with --set release, which is released once "scatter" has finished.
inline std::vector<int> unread_data() { return {7, 7, 7}; }

class FakePlan final : public coordinator::Plan {
 public:
  explicit FakePlan(coordinator::FrameSettings settings) : settings_(std::move(settings)) {
    film_.width = settings_.width;
    film_.height = settings_.height;
    for (const char* name : {"R", "G", "B"}) film_.channel(name);
  }

  coordinator::Step next(const coordinator::FinishedStage* finished) override {
    if (settings_.set.count("plan_throws") && finished) throw Error::failed("the plan has lost its way");
    coordinator::Step step;
    std::uint64_t pixels = std::uint64_t{settings_.width} * settings_.height;
    if (!finished) {
      if (settings_.set.count("release")) step.artifacts["unread"] = std::make_shared<Bytes>(bytes_of(unread_data()));
      step.stages.push_back({.name = "scatter",
                             .kind = "fake-scatter",
                             .items = pixels * items_a_pixel,
                             .tile = items_a_pixel,
                             .solo = false,
                             .parameters = parameters(),
                             .inputs = {},
                             .output = {.record_bytes = 8}});
    } else if (finished->name == "scatter") {
      asked_for_all_ = true;
      coordinator::ArtifactId id = settings_.set.count("input_unknown") ? "none" : "hashes";
      step.artifacts["hashes"] = finished->records;
      step.stages.push_back({.name = "gather",
                             .kind = "fake-gather",
                             .items = pixels,
                             .tile = 1,
                             .solo = settings_.set.count("solo") != 0,
                             .parameters = {},
                             .inputs = {{"hashes", id}},
                             .output = {.record_bytes = 4,
                                        .placement = settings_.set.count("stream") ? coordinator::Placement::stream
                                                                                   : coordinator::Placement::collect,
                                        .floats = true}});
      if (settings_.set.count("release")) step.released.push_back("unread");
    } else {
      if (taken_ == 0) {
        auto values = values_of<float>(*finished->records);
        for (auto& channel : film_.channels) channel.values = values;
      }
      step.done = true;
    }
    return step;
  }

  // "gather", until it is asked for.
  double predicted_work() const override {
    return asked_for_all_ ? 0 : static_cast<double>(settings_.width) * settings_.height;
  }

  // Of a streamed "gather".
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override {
    if (stage != "gather" || first != taken_) throw Error::failed("records came out of order");
    taken_ += count;
    preview(stage, first, count, records);
  }

  // "scatter" must be whole; of "gather" any part will do.
  bool conclude(const std::vector<coordinator::CutStage>& cut) override {
    if (cut.size() != 1 || cut[0].stage.name != "gather") return false;
    if (taken_ > 0) return cut[0].whole.size() == 1 && cut[0].whole[0].count == taken_;
    for (const auto& range : cut[0].whole)
      preview("gather", range.first, range.count, slice(*cut[0].stage.records, range));
    return true;
  }

  void preview(const std::string& stage, std::uint64_t first, std::uint64_t, const Bytes& records) override {
    if (stage != "gather") return;
    auto values = values_of<float>(records);
    for (auto& channel : film_.channels)
      std::copy(values.begin(), values.end(), channel.values.begin() + static_cast<long>(first));
  }

  Film preview_film(bool) const override { return film_; }
  // With --set variance=V it says of every pixel that its mean has this variance.
  Film film() const override {
    Film film = film_;
    if (const auto variance = settings_.set.find("variance"); variance != settings_.set.end())
      for (const char* name : {"variance.R", "variance.G", "variance.B"})
        film.channel(name).values.assign(std::size_t{film.width} * film.height, std::stof(variance->second));
    return film;
  }
  std::vector<coordinator::Skip> skips() const override { return {{"photons", "the fake has no light", 7}}; }
  std::vector<std::string> warnings() const override {
    const auto warning = settings_.set.find("warn");
    return warning == settings_.set.end() ? std::vector<std::string>{} : std::vector<std::string>{warning->second};
  }
  void allow(double work) override { allowed_.push_back(std::isfinite(work) ? work : -1); }
  // With what the time limit allows at each step (-1: not known).
  std::string parameters_json() const override {
    std::string allowed;
    for (const double work : allowed_) allowed += (allowed.empty() ? "" : ", ") + std::to_string(work);
    return R"({"fake": true, "allowed": [)" + allowed + "]}";
  }
  std::vector<std::string> outline() const override { return {"scatter", "gather"}; }

 private:
  // The seed; with --set padding=N, N bytes behind it.
  Bytes parameters() const {
    Bytes bytes = bytes_of(std::vector<std::uint64_t>{settings_.seed});
    if (const auto padding = settings_.set.find("padding"); padding != settings_.set.end())
      bytes.resize(bytes.size() + std::stoul(padding->second) / 8 * 8);
    return bytes;
  }

  static Bytes slice(const Bytes& records, const coordinator::ItemRange& range) {
    auto begin = records.begin() + static_cast<long>(range.first * 4);
    return {begin, begin + static_cast<long>(range.count * 4)};
  }

  coordinator::FrameSettings settings_;
  Film film_;
  std::uint64_t taken_ = 0;  // items of a streamed "gather"
  bool asked_for_all_ = false;
  std::vector<double> allowed_;
};

inline std::uint64_t check_fake_settings(const coordinator::FrameSettings& settings, const coordinator::SceneSummary&) {
  if (settings.method != "fake") throw Error::usage("--method: expected fake, found \"" + settings.method + "\"");
  return std::uint64_t{settings.width} * settings.height;
}

inline std::unique_ptr<coordinator::Plan> make_fake_plan(const coordinator::FrameSettings& settings,
                                                         const coordinator::SceneSummary&) {
  return std::make_unique<FakePlan>(settings);
}

inline coordinator::FrameSettings fake_settings(std::uint32_t width = 32, std::uint32_t height = 16) {
  coordinator::FrameSettings settings;
  settings.method = "fake";
  settings.width = width;
  settings.height = height;
  settings.seed = 5;
  settings.camera.right[0] = settings.camera.up[1] = 1;
  settings.camera.forward[2] = -1;
  settings.camera.half_width = settings.camera.half_height = 0.5f;
  return settings;
}

// A folder that goes with the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "gleaner-test-XXXXXX").string();
    if (!::mkdtemp(pattern.data())) throw Error::failed("no temporary folder");
    path_ = pattern;
  }
  ~TemporaryFolder() {
    std::error_code code;
    std::filesystem::permissions(path_, std::filesystem::perms::owner_all, code);
    std::filesystem::remove_all(path_, code);
  }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

// Polls for what another thread is to bring about.
inline bool eventually(const std::function<bool()>& condition, double seconds = 20) {
  auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  while (std::chrono::steady_clock::now() < end) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return condition();
}

}  // namespace gleaner::test
