#pragma once
// A device that only does arithmetic, and a worker that has one.

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>

#include "scene/model/error.h"
#include "tests/farm/fake_chain.h"
#include "worker/agent/agent.h"

namespace gleaner::test {

// What a test sees of its devices, and how it holds them up.
struct Stage {
  std::atomic<int> scenes_loaded{0}, batches{0};
  std::atomic<bool> fail{false};
  std::mutex mutex;
  std::condition_variable opened;
  bool open = true;
  std::string held_kind;  // batches of this kind alone wait; empty: all

  void set_open(bool is_open, const std::string& kind = {}) {
    std::lock_guard lock(mutex);
    open = is_open;
    held_kind = kind;
    opened.notify_all();
  }
  void pass(const std::string& kind) {
    std::unique_lock lock(mutex);
    opened.wait(lock, [&] { return open || (!held_kind.empty() && held_kind != kind); });
  }
};

// The input's bytes, read in ranges of an odd size.
inline Bytes read_in_ranges(const worker::TaskInput& input) {
  Bytes bytes(input.bytes());
  constexpr std::size_t range = 50021;
  for (std::size_t at = 0; at < bytes.size(); at += range)
    input.source->read(at, std::span(bytes).subspan(at, std::min(range, bytes.size() - at)));
  return bytes;
}

class FakeRunner final : public worker::Runner {
 public:
  explicit FakeRunner(Stage& stage) : stage_(stage) {
    info_.name = "arithmetic";
    info_.tracer = "none";
  }
  const worker::DeviceInfo& info() const override { return info_; }
  bool needs_bvh() const override { return false; }
  bool holds_scene(const std::string& id) const override { return scenes_.count(id) != 0; }
  void load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                  std::shared_ptr<const scene::Bvh>) override {
    if (scene->triangle_count() != 1) throw Error::failed("another scene");
    scenes_.insert(id);
    ++stage_.scenes_loaded;
  }
  bool holds_base(const std::string& id) const override { return scenes_.count(id) != 0; }
  void load_base(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                 std::shared_ptr<const scene::Bvh> bvh) override {
    load_scene(id, std::move(scene), std::move(bvh));
  }
  worker::MotionReport load_frame(const std::string& id, const std::string&,
                                  const std::optional<scene::FrameState>&) override {
    scenes_.insert(id);
    return {};
  }
  worker::BatchResult run(const worker::StageTask& task, std::uint64_t first, std::uint64_t count) override {
    ++stage_.batches;
    stage_.pass(task.kind);
    if (stage_.fail) throw Error::failed("the device is on fire");
    if (!scenes_.count(task.scene)) throw Error::failed("no scene");
    worker::BatchResult result;
    if (task.kind == "fake-scatter") {
      result.records = fake_scatter(values_of<std::uint64_t>(task.parameters).at(0), first, count);
    } else if (task.kind == "fake-gather") {
      result.records = fake_gather(*task.inputs.at("hashes").load(), first, count);
    } else if (task.kind == "fake-spread") {
      const worker::TaskInput& input = task.inputs.at("hashes");
      auto hashes = values_of<std::uint64_t>(read_in_ranges(input));
      if (input.own_items && (input.first_item != first || hashes.size() != count))
        throw Error::failed("other items than its own");
      if (!input.own_items)
        hashes = {hashes.begin() + static_cast<long>(first), hashes.begin() + static_cast<long>(first + count)};
      std::tie(result.counts, result.records) = fake_spread(hashes, first);
    } else {
      const worker::TaskInput& spread = task.inputs.at("spread");
      result.records = fake_sums(*spread.offsets, values_of<std::uint64_t>(read_in_ranges(spread)),
                                 values_of<std::uint32_t>(*task.inputs.at("numbers").load()), first, count);
    }
    result.counters.camera_rays = count;
    return result;
  }

 private:
  Stage& stage_;
  worker::DeviceInfo info_;
  std::set<std::string> scenes_;
};

// A worker on a thread of its own.
class RunningAgent {
 public:
  RunningAgent(std::shared_ptr<grpc::Channel> channel, Stage& stage, worker::AgentSettings settings)
      : agent_(std::move(channel), std::make_unique<FakeRunner>(stage), std::move(settings)), thread_([this] {
          try {
            agent_.run();
          } catch (const std::exception& error) {
            error_ = error.what();
          }
          ended_ = true;
        }) {}
  RunningAgent(std::shared_ptr<grpc::Channel> channel, Stage& stage, const std::string& name, bool reconnect = true)
      : RunningAgent(std::move(channel), stage, settings(name, reconnect)) {}
  ~RunningAgent() { stop(); }
  void stop() {
    agent_.stop();
    if (thread_.joinable()) thread_.join();
  }
  void ask_to_stop() { agent_.stop(); }
  bool ended() const { return ended_; }
  std::string error() {
    if (thread_.joinable()) thread_.join();
    return error_;
  }

  static worker::AgentSettings settings(const std::string& name, bool reconnect = true) {
    worker::AgentSettings agent;
    agent.pack = false;  // so that tests know how many bytes travel
    agent.name = name;
    agent.reconnect = reconnect;
    return agent;
  }

 private:
  worker::Agent agent_;
  std::atomic<bool> ended_{false};
  std::string error_;
  std::thread thread_;
};

}  // namespace gleaner::test
