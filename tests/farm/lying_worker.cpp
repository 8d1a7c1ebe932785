// A worker of its own process that computes its batches on a device, as gleaner-worker does, and answers something
// else.
//
//   lying_worker HOST:PORT NAME zeros|nan|huge|others FIRST
//     FIRST: its batches before this one are honest.
//     zeros: records of zero bytes. nan, huge: a number that no light has, in the middle of the batch.
//     others: the records of other items, such as another worker makes.

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>
#include <string>
#include <utility>

#include "worker/agent/agent.h"

namespace gleaner::test {
namespace {

class LyingRunner final : public worker::Runner {
 public:
  LyingRunner(std::unique_ptr<Runner> honest, std::string lie, unsigned first)
      : honest_(std::move(honest)), lie_(std::move(lie)), first_(first) {}

  const worker::DeviceInfo& info() const override { return honest_->info(); }
  bool needs_bvh() const override { return honest_->needs_bvh(); }
  bool holds_scene(const std::string& id) const override { return honest_->holds_scene(id); }
  void load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                  std::shared_ptr<const scene::Bvh> bvh) override {
    honest_->load_scene(id, std::move(scene), std::move(bvh));
  }
  bool holds_base(const std::string& id) const override { return honest_->holds_base(id); }
  void load_base(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                 std::shared_ptr<const scene::Bvh> bvh) override {
    honest_->load_base(id, std::move(scene), std::move(bvh));
  }
  worker::MotionReport load_frame(const std::string& id, const std::string& base,
                                  const std::optional<scene::FrameState>& state) override {
    return honest_->load_frame(id, base, state);
  }
  worker::BatchResult run(const worker::StageTask& task, std::uint64_t first, std::uint64_t count) override {
    worker::BatchResult result = honest_->run(task, first, count);
    scene::Bytes& records = result.records;
    if (batches_++ < first_ || records.empty()) return result;
    std::printf("%s %llu %llu\n", task.kind.c_str(), static_cast<unsigned long long>(first),
                static_cast<unsigned long long>(count));
    std::fflush(stdout);
    if (lie_ == "zeros") std::fill(records.begin(), records.end(), std::byte{0});
    if (lie_ == "others") {
      scene::Bytes other = first > 0 ? honest_->run(task, 0, count).records : records;
      if (first == 0)
        std::rotate(other.begin(), other.begin() + static_cast<std::ptrdiff_t>(other.size() / 2), other.end());
      std::copy_n(other.begin(), std::min(other.size(), records.size()), records.begin());
    }
    if (lie_ == "nan" || lie_ == "huge") {
      const float number = lie_ == "nan" ? std::numeric_limits<float>::quiet_NaN() : 3e38f;
      if (records.size() >= sizeof number)
        std::memcpy(records.data() + records.size() / 2 / sizeof number * sizeof number, &number, sizeof number);
    }
    return result;
  }

 private:
  std::unique_ptr<Runner> honest_;
  std::string lie_;
  unsigned first_, batches_ = 0;
};

}  // namespace
}  // namespace gleaner::test

int main(int argc, char** argv) {
  using namespace gleaner;
  if (argc != 5) {
    std::fputs("usage: lying_worker HOST:PORT NAME zeros|nan|huge|others FIRST\n", stderr);
    return 2;
  }
  try {
    worker::AgentSettings settings;
    settings.name = argv[2];
    settings.reconnect = false;
    settings.peers = "127.0.0.1:0";
    settings.log = [](const std::string& line) { std::fprintf(stderr, "%s\n", line.c_str()); };
    worker::DeviceChoice choice;
    choice.threads = 1;
    auto runner = std::make_unique<test::LyingRunner>(worker::open_device(choice), argv[3],
                                                      static_cast<unsigned>(std::stoul(argv[4])));
    worker::Agent(worker::dial(argv[1]), std::move(runner), settings).run();
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
