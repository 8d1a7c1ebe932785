#pragma once
// A plan as a graph. Stages are added with their parameters and the artifacts they read; continuations run when the
// stages they wait for have finished. Nothing depends on the order in which stages finish. Pure: no clock, no threads.
//
//   auto lights = graph.add({.name = "lights", .kind = "trace", .items = n, .output = {...}}, parameters);
//   auto order = graph.add({.name = "order", ...}, OrderParameters{...}, {{"lights", lights}});
//   graph.when({order}, [=, this] { shade(order.facts<OrderFacts>().rows, order); });
//   Step step = graph.take_step();  // to the farm; what comes back goes to finish()

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "coordinator/film/accumulator.h"
#include "coordinator/plan/plan.h"
#include "coordinator/plan/stage.h"

namespace gleaner::coordinator {

// Priority of what a method prepares. Its stages wait for each other and paths for nothing: paths fill what they leave
// free.
inline constexpr int kFirst = 1;

template <typename Struct>
Bytes bytes_of(const Struct& value) {
  static_assert(std::is_trivially_copyable_v<Struct>);
  Bytes bytes(sizeof value);
  std::memcpy(bytes.data(), &value, sizeof value);
  return bytes;
}

template <typename Value>
std::shared_ptr<const Bytes> bytes_of(const std::vector<Value>& values) {
  static_assert(std::is_trivially_copyable_v<Value>);
  auto bytes = std::make_shared<Bytes>(values.size() * sizeof(Value));
  if (!values.empty()) std::memcpy(bytes->data(), values.data(), bytes->size());
  return bytes;
}

class Graph {
  struct Node;

 public:
  // A stage's output, or data of the plan's own. Copies name the same artifact. It is released once no copy exists and
  // every stage that reads it has finished.
  class Artifact {
   public:
    Artifact() = default;
    explicit operator bool() const { return node_ != nullptr; }
    const ArtifactId& id() const;
    const std::string& stage() const;  // name of the stage that makes it; empty: data
    bool finished() const;             // data always is

    // Of a finished stage. Each throws Error::failed, naming the stage, where there is no such thing.
    const Bytes& records() const;  // collected ones
    std::shared_ptr<const Bytes> shared_records() const;
    std::uint64_t record_count() const;
    template <typename Facts>
    Facts facts() const {
      Facts facts;
      read_facts(std::as_writable_bytes(std::span(&facts, 1)));
      return facts;
    }

    // Throws Error::failed where a worker's facts are not what its stage can say.
    void check_facts(bool sound, const std::string& what) const;

   private:
    friend class Graph;
    explicit Artifact(std::shared_ptr<Node> node) : node_(std::move(node)) {}
    const FinishedStage& result() const;
    void read_facts(std::span<std::byte> to) const;
    std::shared_ptr<Node> node_;
  };

  struct Input {
    std::string name;  // what the stage program calls it
    Artifact artifact;
    Extent extent = Extent::whole;
  };

  using Continuation = std::function<void()>;
  // Records of items [first, first + count).
  using RecordCall = std::function<void(std::uint64_t first, std::uint64_t count, const Bytes& records)>;

  // `scene`: its parts are a part of every output's name.
  explicit Graph(SceneLineage scene);
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;
  ~Graph();

  Artifact data(std::shared_ptr<const Bytes> bytes);
  template <typename Value>
  Artifact data(const std::vector<Value>& values) {
    return data(bytes_of(values));
  }

  // Asks for a stage: now, or as soon as all of its inputs exist. `stage` comes without parameters and inputs. Throws
  // Error::failed where the frame had a stage of that name.
  template <typename Parameters>
  Artifact add(StageSpec stage, const Parameters& parameters, std::vector<Input> inputs = {}) {
    stage.parameters = bytes_of(parameters);
    return add_stage(std::move(stage), std::move(inputs));
  }
  // The same for a stage that comes with its parameters.
  Artifact add(StageSpec stage, std::vector<Input> inputs = {}) {
    return add_stage(std::move(stage), std::move(inputs));
  }

  // Something that the plan itself makes happen: it finishes when it is announced, once.
  Artifact event();
  void announce(const Artifact& event);

  // `then` runs once, when all of these have finished; at the latest before the next step is taken.
  void when(std::vector<Artifact> all, Continuation then);
  // `then` runs once, when the memory of all that nobody reads any more is free: for what is large itself.
  void when_released(Continuation then) { after_release_.push_back(std::move(then)); }
  // `call` gets every record of the stage once, before a continuation that waits for it: streamed ones as they arrive,
  // in item order; collected ones all at once.
  void on_records(const Artifact& stage, RecordCall call);
  // `call` gets batches of a running stage as they arrive, in any order: for the live preview.
  void on_preview(const Artifact& stage, RecordCall call);

  // Throws Error::failed for a stage that was not asked for, that finished before, or whose records are not as many as
  // it has.
  void finish(const FinishedStage& finished);
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records);
  // What does not fit a running stage is passed over.
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) const;
  // What was asked for, provided and released since the last call.
  Step take_step();
  // Of all stages that were added, StageSpec::work.
  double asked_work() const { return asked_work_; }
  // Nothing was asked for that has not finished.
  bool idle() const { return running_.empty() && waiting_stages_.empty() && after_release_.empty(); }
  // What waits for the release of the step before.
  void released();

 private:
  struct Life;
  struct Waiting;

  Artifact add_stage(StageSpec stage, std::vector<Input> inputs);
  std::shared_ptr<Life> life_of(const ArtifactId& id);
  Node& running_stage(const std::string& name) const;
  void hand_out(const std::shared_ptr<Node>& node);
  void run_continuations();

  SceneLineage scene_;
  Step step_;
  std::shared_ptr<std::vector<ArtifactId>> released_;
  std::map<ArtifactId, std::weak_ptr<Life>> lives_;
  std::set<std::string> names_;
  std::map<std::string, std::shared_ptr<Node>> running_;
  std::vector<std::shared_ptr<Node>> waiting_stages_;  // for their inputs, in the order in which they were added
  std::vector<Waiting> waiting_;
  std::vector<Continuation> after_release_;
  double asked_work_ = 0;
};

// Records that are floats and nothing else, as they lie.
inline std::span<const float> float_view(const Bytes& records) {
  return {reinterpret_cast<const float*>(records.data()), records.size() / sizeof(float)};
}

// A plan that is a graph, and what its records add up to: the base of the methods' plans.
class GraphPlan : public Plan {
 public:
  Step next(const FinishedStage* finished) final;
  void allow(double work) final { allowed_work_ = work; }
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) final {
    graph_.take(stage, first, count, records);
  }
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) final {
    graph_.preview(stage, first, count, records);
  }
  Film preview_film(bool guides = false) const final { return film_.preview(guides); }
  Film film() const final { return film_.film(); }
  Film take_film() final { return film_.take_film(); }
  Film take_picture() final { return film_.take_picture(); }
  std::vector<Skip> skips() const override { return skips_; }

 protected:
  GraphPlan(const FrameSettings& settings, const SceneSummary& scene)
      : graph_(scene.lineage), film_(settings.width, settings.height) {
    if (settings.denoise != Denoise::off) film_.keep_halves();
  }
  // Asks for the first stages. The film is whole once nothing is left that was asked for.
  virtual void begin() = 0;
  // Adds a pass, RGB a pixel, to the film once it is there: after the passes that were added before, whichever ends
  // first, for sums of floats depend on their order. No artifact: the pass is dark.
  void add_pass(const Graph::Artifact& shaded) { add_pass(shaded, nullptr); }
  // Light that each pass is a part beside, RGB a pixel or nothing. A pass waits until it is known.
  struct Beside {
    explicit Beside(Graph::Artifact event) : known(std::move(event)) {}
    Graph::Artifact known;  // an event
    std::vector<float> light{};
  };
  void add_pass(const Graph::Artifact& shaded, std::shared_ptr<const Beside> beside);
  // Of a method that predicts so much work for its own stages, what they will still ask for; `others` of what was asked
  // for is not theirs.
  double work_to_come(double predicted, double others) const {
    return own_stages_asked_ ? 0 : std::max(0.0, predicted - (graph_.asked_work() - others));
  }
  // The live preview shows the pass while it is shaded.
  void preview_pass(const Graph::Artifact& shaded);

  Graph graph_;
  Accumulator film_;
  std::vector<Skip> skips_;

  std::optional<double> allowed_work_;  // that fits in what is left of a time limit; none: there is no limit
  bool own_stages_asked_ = false;       // the method asks for no more stages but paths

 private:
  bool begun_ = false;
  Graph::Artifact last_pass_;  // an event: it is in the film
};

// The cut stage that makes `artifact`, or null.
const CutStage* find_cut(const std::vector<CutStage>& cut, const Graph::Artifact& artifact);

}  // namespace gleaner::coordinator
