#pragma once
// Samples of a frame's pixels, as stages of a graph: a first stage gives every pixel a few chunks of samples; the next
// ones go where the error is. Method `path` is this alone; others take from it the light that they do not carry, or
// have its samples made by a stage of their own.

#include <cstdint>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "coordinator/film/accumulator.h"
#include "coordinator/plan/graph.h"
#include "kernels/path_records.h"

namespace gleaner::coordinator {

class PathSampler {
 public:
  // Part of a method that has some classes of light by itself (kernels/path_filter.h): paths bring the rest, and
  // compensate the bounded geometry term of virtual point lights.
  struct Complement {
    std::uint32_t classes = 0;  // PATH_CLASS_...; 0: all light is the paths'
    float limit = 0;            // PathParameters::clamp, with any class; infinity: none
    bool compensates = false;   // what paths add for the bound is a layer of its own
    // What the method's own light is predicted to add to the picture: mean radiance, and squared error (a mean over
    // pixels and channels), for which the samples have to leave room where a target error is given.
    double mean = 0, squared_error = 0;
    // An event, until which the two above are not known: no samples but the first are asked for before, where a target
    // error is given.
    Graph::Artifact known{};
  };

  // Which stage makes a sample. A method with a kind of its own gives parameters that begin with PathParameters.
  struct Program {
    std::string kind = "path";           // stages are kind.0, kind.1 and so on
    Bytes method_parameters{};           // follow PathParameters
    std::vector<Graph::Input> inputs{};  // beside the list of items
    bool sees_emission = true;           // its records are light
  };

  PathSampler(Graph& graph, Accumulator& film, const FrameSettings& settings, Program program);
  PathSampler(Graph& graph, Accumulator& film, const FrameSettings& settings)
      : PathSampler(graph, film, settings, Program()) {}

  void begin(const Complement& complement);
  // The same with a program that was not known before.
  void begin(const Complement& complement, Program program);
  bool begun() const { return !stages_.empty(); }
  // The first samples of all pixels.
  const Graph::Artifact& first_samples() const { return stages_.front().artifact; }
  // What a sample of a pixel is off by (sample_error() of allocation.h), by those so far; 0: not known.
  double sample_error() const;
  // What the complement could not say. Before its event.
  void tell(double mean, double squared_error) {
    complement_.mean = mean;
    complement_.squared_error = squared_error;
  }
  bool done() const { return done_; }
  // Makes do with what a cut stage has brought. False: some pixels have no sample yet, and nothing has changed.
  bool conclude(const std::vector<CutStage>& cut, std::vector<Skip>& skips);

  nlohmann::json parameters() const;
  std::vector<std::string> outline() const;
  std::vector<std::string> warnings() const { return warnings_; }
  double predicted_work() const;  // of what is still to be asked for, in samples
  double asked_work() const { return static_cast<double>(spent_) + seen_work_; }

 private:
  // A stage that was asked for: which pixel and chunk each of its items is.
  struct Asked {
    Graph::Artifact artifact;
    std::uint64_t items = 0;
    bool features = false;
    std::uint32_t last_item_samples = 0;
    std::shared_ptr<const Bytes> list{};  // PathItem each; null: pixel = item % pixels
    std::uint32_t seen = PATH_SEEN_WITHIN;
  };

  std::uint64_t pixels() const { return std::uint64_t{settings_.width} * settings_.height; }
  std::uint64_t budget() const;        // samples in all, at most
  std::uint64_t planned() const;       // that a time limit is predicted to allow, or all
  std::uint64_t next_samples() const;  // of the next stage, where there is no target error
  std::uint32_t samples_of(const Asked& asked, std::uint64_t item) const;
  std::uint64_t samples_of(const Asked& asked, const ItemRange& range) const;
  std::size_t record_bytes(const Asked& asked) const;
  kernels::PathItem item_of(const Asked& asked, std::uint64_t item) const;
  // Emission that is seen directly has records of its own, for a picture that will be denoised.
  bool tells_emission() const { return program_.sees_emission && settings_.denoise != Denoise::off; }
  std::uint32_t samples_per_item(const Asked& asked) const;
  kernels::PathParameters parameters_of(const Asked& asked) const;
  // Asks for the stage; returns its output, which asked.artifact then is.
  Graph::Artifact add_stage(const Asked& asked, const std::string& name, double work);
  PixelNoise noise_so_far() const;
  void ask(Asked asked);
  // Where the first samples saw edges of emission: camera rays that look for nothing else.
  void ask_seen();
  void absorb_seen(std::uint64_t first, std::uint64_t count, const Bytes& records);
  void spend(std::uint64_t samples);
  void absorb(std::uint64_t first, std::uint64_t count, const Bytes& records);
  void continue_or_end();
  // What the picture of these samples will be once it is denoised: asked for, then told.
  void ask_judgement();
  void take_judgement();
  void reach_for_target();
  std::uint64_t wanted_for_target();

  Graph& graph_;
  Accumulator& film_;
  FrameSettings settings_;
  Program program_;
  Complement complement_;
  std::uint32_t chunk_samples_ = 1, first_chunks_ = 1;
  std::uint64_t spent_ = 0;    // samples asked for so far
  std::vector<Asked> stages_;  // the last one runs
  std::vector<std::string> warnings_;
  std::optional<Asked> seen_;  // what ask_seen() asked for
  double seen_work_ = 0;
  std::uint64_t target_samples_ = 0;  // that the target error is predicted to take in all
  // Where the picture is denoised and has a target error: what its last look said. Only the samples are looked at, not
  // the passes of the method's own, of which there are more or fewer at any moment.
  Graph::Artifact judgement_;             // while it is asked for
  std::optional<double> denoised_bound_;  // as Accumulator::squared_error_bound()
  std::vector<float> denoised_error_;     // squared, a pixel
  bool done_ = false;
};

// What a plan with a sampler holds a pixel beside its film, at most: a stage's list of a few items a pixel, and either
// what its allocation needs or records that have arrived out of order.
inline constexpr std::uint64_t kPathBytesAPixel = 2 * sizeof(kernels::PathItem) + 24;

// What a path tracer leaves out where the scene does not need it.
std::vector<Skip> path_skips(const scene::SceneNeeds& needs);

}  // namespace gleaner::coordinator
