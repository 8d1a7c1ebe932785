#include "coordinator/plan/graph.h"

#include <algorithm>

#include "coordinator/artifacts/artifact_id.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

// As long as an artifact may be read. At its end the farm is asked to forget it, once.
struct Graph::Life {
  ArtifactId id;
  bool handed_out = false;  // the farm knows of it
  bool provided = false;    // and has its bytes, which lie here
  std::shared_ptr<std::vector<ArtifactId>> released;
  ~Life() {
    if (handed_out) released->push_back(id);
  }
};

struct Graph::Node {
  std::shared_ptr<Life> life;
  StageSpec spec{};             // of a stage
  std::vector<Input> inputs{};  // until the stage has finished
  RecordCall on_records{}, on_preview{};
  std::uint64_t taken = 0;  // items of a streamed stage
  bool finished = false;
  FinishedStage result{};  // of data: its bytes
};

struct Graph::Waiting {
  std::vector<Artifact> all;
  Continuation then;
};

namespace {

Error fault(const std::string& stage, const std::string& what) { return Error::failed("stage " + stage + ": " + what); }

// Refuses an output that is not as large as its stage said.
void check_size(const StageSpec& spec, const FinishedStage& finished, std::uint64_t taken) {
  const StageOutput& output = spec.output;
  if (output.placement == Placement::collect && !finished.records) throw fault(spec.name, "came without its records");
  std::uint64_t count = output.placement == Placement::stream ? taken : finished.record_count;
  if (finished.records) {
    if (finished.records->size() % output.record_bytes != 0)
      throw fault(spec.name, std::to_string(finished.records->size()) + " bytes, expected records of " +
                                 std::to_string(output.record_bytes));
    count = finished.records->size() / output.record_bytes;
  }
  const std::uint64_t most = spec.items * (output.counted ? output.most_records : 1);
  if (output.counted ? count > most : count != most)
    throw fault(spec.name, std::to_string(count) + " records, expected " + (output.counted ? "at most " : "") +
                               std::to_string(most));
}

}  // namespace

const ArtifactId& Graph::Artifact::id() const { return node_->life->id; }
const std::string& Graph::Artifact::stage() const { return node_->spec.name; }
bool Graph::Artifact::finished() const { return node_->finished; }

const FinishedStage& Graph::Artifact::result() const {
  if (!node_->finished) throw fault(stage(), "was read before it finished");
  return node_->result;
}

std::shared_ptr<const Bytes> Graph::Artifact::shared_records() const {
  if (!result().records) throw fault(stage(), "its records stay with the workers");
  return result().records;
}

const Bytes& Graph::Artifact::records() const { return *shared_records(); }

std::uint64_t Graph::Artifact::record_count() const { return result().record_count; }

void Graph::Artifact::read_facts(std::span<std::byte> to) const {
  const Bytes& facts = result().facts;
  if (facts.size() != to.size())
    throw fault(stage(), std::to_string(facts.size()) + " bytes of facts, expected " + std::to_string(to.size()));
  std::memcpy(to.data(), facts.data(), to.size());
}

void Graph::Artifact::check_facts(bool sound, const std::string& what) const {
  if (!sound) throw fault(stage(), "facts that cannot be: " + what);
}

Graph::Graph(SceneLineage scene) : scene_(std::move(scene)), released_(std::make_shared<std::vector<ArtifactId>>()) {}
Graph::~Graph() = default;

std::shared_ptr<Graph::Life> Graph::life_of(const ArtifactId& id) {
  std::weak_ptr<Life>& place = lives_[id];
  if (auto life = place.lock()) return life;
  auto life = std::make_shared<Life>(Life{id, false, false, released_});
  place = life;
  return life;
}

Graph::Artifact Graph::data(std::shared_ptr<const Bytes> bytes) {
  auto node = std::make_shared<Node>();
  node->life = life_of(data_id(*bytes));
  node->finished = true;
  node->result.records = std::move(bytes);
  return Artifact(std::move(node));
}

Graph::Artifact Graph::event() { return Artifact(std::make_shared<Node>()); }

void Graph::announce(const Artifact& event) {
  if (std::exchange(event.node_->finished, true)) throw Error::failed("plan: an event was announced twice");
}

Graph::Artifact Graph::add_stage(StageSpec stage, std::vector<Input> inputs) {
  if (!names_.insert(stage.name).second) throw fault(stage.name, "was asked for twice");
  for (const Input& input : inputs) stage.inputs.push_back({input.name, input.artifact.id(), input.extent});
  asked_work_ += work_of(stage);
  auto node = std::make_shared<Node>();
  node->life = life_of(artifact_id(scene_, stage));
  node->spec = std::move(stage);
  node->inputs = std::move(inputs);
  waiting_stages_.push_back(node);
  return Artifact(std::move(node));
}

void Graph::hand_out(const std::shared_ptr<Node>& node) {
  for (const Input& input : node->inputs) {
    Node& source = *input.artifact.node_;
    // Data and collected records lie here: the farm gets them with the first stage that reads them.
    if (source.result.records && !std::exchange(source.life->provided, true))
      step_.artifacts[source.life->id] = source.result.records;
    source.life->handed_out = true;
  }
  node->life->handed_out = true;
  step_.stages.push_back(node->spec);
  running_[node->spec.name] = node;
}

void Graph::when(std::vector<Artifact> all, Continuation then) {
  waiting_.push_back({std::move(all), std::move(then)});
}

void Graph::on_records(const Artifact& stage, RecordCall call) { stage.node_->on_records = std::move(call); }
void Graph::on_preview(const Artifact& stage, RecordCall call) { stage.node_->on_preview = std::move(call); }

Graph::Node& Graph::running_stage(const std::string& name) const {
  const auto found = running_.find(name);
  if (found == running_.end()) throw fault(name, names_.contains(name) ? "has finished before" : "was not asked for");
  return *found->second;
}

void Graph::take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  Node& node = running_stage(stage);
  if (first < node.taken || first + count > node.spec.items || records.size() != count * node.spec.output.record_bytes)
    throw fault(stage, "items " + std::to_string(first) + " + " + std::to_string(count) + " of " +
                           std::to_string(records.size()) + " bytes do not follow item " + std::to_string(node.taken));
  node.taken = first + count;
  if (node.on_records) node.on_records(first, count, records);
}

void Graph::preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) const {
  const auto running = running_.find(stage);
  if (running == running_.end() || !running->second->on_preview) return;
  const StageSpec& spec = running->second->spec;
  if (first + count > spec.items || records.size() < count * spec.output.record_bytes) return;
  running->second->on_preview(first, count, records);
}

void Graph::finish(const FinishedStage& finished) {
  check_size(running_stage(finished.name).spec, finished, running_stage(finished.name).taken);
  const auto found = running_.find(finished.name);
  const std::shared_ptr<Node> node = std::move(found->second);
  running_.erase(found);
  node->finished = true;
  node->result = finished;
  if (finished.records) {
    node->result.record_count = finished.records->size() / node->spec.output.record_bytes;
    if (node->on_records) node->on_records(0, node->result.record_count, *finished.records);
  }
  node->inputs.clear();
  node->on_records = node->on_preview = nullptr;
  run_continuations();
}

void Graph::run_continuations() {
  const auto ready = [](const Waiting& waiting) { return std::ranges::all_of(waiting.all, &Artifact::finished); };
  for (;;) {
    const auto next = std::ranges::find_if(waiting_, ready);
    if (next == waiting_.end()) return;
    // Out of the list before it runs: it may add others, and must not run again.
    const Waiting one = std::move(*next);
    waiting_.erase(next);
    one.then();
  }
}

void Graph::released() {
  for (const Continuation& then : std::exchange(after_release_, {})) then();
}

Step Graph::take_step() {
  run_continuations();
  const auto ready = [](const std::shared_ptr<Node>& node) {
    return std::ranges::all_of(node->inputs, [](const Input& input) { return input.artifact.finished(); });
  };
  for (const auto& node : waiting_stages_)
    if (ready(node)) hand_out(node);
  std::erase_if(waiting_stages_, ready);
  Step step = std::exchange(step_, {});
  std::erase_if(lives_, [](const auto& entry) { return entry.second.expired(); });
  step.released = std::exchange(*released_, {});
  // What was asked for again meanwhile, under the same id, is still read.
  std::erase_if(step.released, [&](const ArtifactId& id) {
    const auto found = lives_.find(id);
    const auto life = found == lives_.end() ? nullptr : found->second.lock();
    return life && life->handed_out;
  });
  step.again = !after_release_.empty();
  return step;
}

Step GraphPlan::next(const FinishedStage* finished) {
  if (finished)
    graph_.finish(*finished);
  else if (std::exchange(begun_, true))
    graph_.released();
  else
    begin();
  Step step = graph_.take_step();
  step.done = graph_.idle();
  return step;
}

namespace {}  // namespace

void GraphPlan::add_pass(const Graph::Artifact& shaded, std::shared_ptr<const Beside> beside) {
  std::vector<Graph::Artifact> after;
  if (shaded) after.push_back(shaded);
  if (beside) after.push_back(beside->known);
  if (last_pass_) after.push_back(last_pass_);
  const Graph::Artifact added = last_pass_ = graph_.event();
  graph_.when(std::move(after), [this, shaded, added, beside] {
    const std::span<const float> pass = shaded ? float_view(shaded.records()) : std::span<const float>{};
    if (beside && !beside->light.empty()) {
      std::vector<float> both = beside->light;
      for (std::size_t i = 0; i < pass.size(); ++i) both[i] += pass[i];
      film_.add_pass(both);
    } else {
      film_.add_pass(pass);
    }
    graph_.announce(added);
  });
}

void GraphPlan::preview_pass(const Graph::Artifact& shaded) {
  graph_.on_preview(shaded, [this](auto first, auto count, const Bytes& records) {
    film_.draw_pass(first, float_view(records).first(3 * count));
  });
}

const CutStage* find_cut(const std::vector<CutStage>& cut, const Graph::Artifact& artifact) {
  const auto found = std::ranges::find_if(cut, [&](const CutStage& one) { return one.stage.name == artifact.stage(); });
  return found == cut.end() ? nullptr : &*found;
}

}  // namespace gleaner::coordinator
