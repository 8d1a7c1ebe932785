#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <iostream>
#include <memory>

#include "cli/commands.h"
#include "coordinator/film/metrics.h"
#include "coordinator/film/read.h"

namespace gleaner::cli {
namespace {

using coordinator::Comparison;
using coordinator::LayerComparison;
using nlohmann::json;

struct Options {
  std::string test, reference, reference_error;
  bool as_json = false;
};

// JSON has no infinity and no NaN: what does not exist is null.
json or_null(const std::optional<double>& value) { return value ? json(*value) : json(nullptr); }

json json_of(const LayerComparison& layer) {
  json channels = json::object();
  for (const auto& channel : layer.channels)
    channels[channel.name] = {{"mean_test", channel.test},
                              {"mean", channel.reference},
                              {"bias", channel.deviation},
                              {"sigmas", or_null(channel.sigmas)}};
  return {{"mse", layer.mse},
          {"mse_measured", layer.mse_measured},
          {"rmse", layer.rmse},
          {"error", layer.error},
          {"error_robust", layer.error_robust},
          {"relmse", layer.relmse},
          {"psnr", or_null(layer.psnr)},
          {"bias", layer.bias},
          {"mean", layer.mean},
          {"mean_test", layer.test_mean},
          {"channels", channels}};
}

json json_of(const Options& options, const Comparison& comparison) {
  json result = json_of(comparison.picture);
  result["test"] = options.test;
  result["reference"] = options.reference;
  result["reference_noise_mse"] = comparison.reference_noise;
  result["below_reference_noise"] = !options.reference_error.empty() && comparison.picture.mse <= 0;
  result["variance_ratio"] = or_null(comparison.variance_ratio);
  result["variance_ratio_robust"] = or_null(comparison.variance_ratio_robust);
  result["layers"] = json::object();
  for (const auto& layer : comparison.layers) result["layers"][layer.name] = json_of(layer);
  result["blocks"] = nullptr;
  if (const auto& blocks = comparison.blocks)
    result["blocks"] = {{"count", blocks->count},
                        {"off", blocks->off},
                        {"share", blocks->share()},
                        {"worst", {{"x", blocks->worst_x}, {"y", blocks->worst_y}, {"sigmas", blocks->worst_sigmas}}}};
  return result;
}

void print(const LayerComparison& layer) {
  fmt::print("{}\n", layer.name.empty() ? "picture (R, G, B)" : "layer " + layer.name);
  fmt::print("  error         {:>11.4f} %   RMSE over the reference's mean\n", 100 * layer.error);
  fmt::print("  error, robust {:>11.4f} %   without the 0.1 % of the pixels that differ most\n",
             100 * layer.error_robust);
  fmt::print("  MSE           {:>13.6g}   RMSE {:.6g}\n", layer.mse, layer.rmse);
  fmt::print("  relative MSE  {:>13.6g}\n", layer.relmse);
  if (layer.psnr)
    fmt::print("  PSNR          {:>13.2f} dB\n", *layer.psnr);
  else
    fmt::print("  PSNR            no difference seen\n");
  fmt::print("  mean          {:>13.6g}   bias {:+.4f} %\n", layer.mean, 100 * layer.bias);
  for (const auto& channel : layer.channels) {
    fmt::print("    {:<12}{:>13.6g} against {:.6g}: {:+.4f} %", channel.name, channel.test, channel.reference,
               100 * channel.deviation);
    if (channel.sigmas) fmt::print(", {:+.2f} standard errors", *channel.sigmas);
    fmt::print("\n");
  }
}

void print(const Options& options, const Comparison& comparison) {
  print(comparison.picture);
  if (options.reference_error.empty()) {
    fmt::print("  the reference's own noise is not taken off (--stderr FILE.exr)\n");
  } else {
    fmt::print("  the reference's own noise is taken off: {:.6g} of an MSE of {:.6g}\n", comparison.reference_noise,
               comparison.picture.mse_measured);
    if (comparison.picture.mse <= 0) fmt::print("  nearer to the reference than the reference is to the truth\n");
  }
  if (const auto& blocks = comparison.blocks) {
    fmt::print("  blocks of 16x16 off by more than 5 standard errors and 1 %: {} of {} ({:.2f} %)\n", blocks->off,
               blocks->count, 100 * blocks->share());
    if (blocks->off > 0)
      fmt::print("    the worst stands at pixel {},{}: {:.1f} standard errors\n", blocks->worst_x, blocks->worst_y,
                 blocks->worst_sigmas);
  }
  if (comparison.variance_ratio)
    fmt::print("  variance layer over squared error seen: {:.3f}\n", *comparison.variance_ratio);
  if (comparison.variance_ratio_robust)
    fmt::print("  the same without the 0.1 % of the pixels that differ most: {:.3f}\n",
               *comparison.variance_ratio_robust);
  for (const auto& layer : comparison.layers) print(layer);
}

int tell_noise(const Options& options) {
  const auto film = coordinator::read_exr(options.test);
  const auto noise = coordinator::own_noise({film, options.test});
  if (options.as_json) {
    std::cout << json{{"mean", noise.mean},
                      {"standard_error", or_null(noise.standard_error)},
                      {"denoised", noise.denoised}}
                     .dump(2)
              << '\n';
    return 0;
  }
  fmt::print("mean           {:>13.6g}\n", noise.mean);
  if (noise.standard_error)
    fmt::print("{} {:>11.4f} %   of the mean, as the {} layer tells\n",
               noise.denoised ? "expected error" : "standard error", 100 * *noise.standard_error,
               noise.denoised ? "error" : "variance");
  else
    fmt::print("standard error   not known: there is no variance layer\n");
  return 0;
}

int compare(const Options& options) {
  if (options.reference.empty()) return tell_noise(options);
  const auto test = coordinator::read_exr(options.test);
  const auto reference = coordinator::read_exr(options.reference);
  Comparison result;
  if (options.reference_error.empty()) {
    result = coordinator::compare({test, options.test}, {reference, options.reference}, nullptr);
  } else {
    const auto error = coordinator::read_exr(options.reference_error);
    const coordinator::Picture picture{error, options.reference_error};
    result = coordinator::compare({test, options.test}, {reference, options.reference}, &picture);
  }
  if (options.as_json)
    std::cout << json_of(options, result).dump(2) << '\n';
  else
    print(options, result);
  return 0;
}

}  // namespace

void add_compare(CLI::App& app, Run& run) {
  auto* command = app.add_subcommand("compare", "how far a picture is from a reference; alone: its own noise");
  auto options = std::make_shared<Options>();
  command->add_option("A.exr", options->test, "the picture that is judged")->required();
  auto* reference = command->add_option("B.exr", options->reference, "the reference");
  command->add_option("--stderr", options->reference_error, "EXR with the standard error of the reference's R, G, B")
      ->needs(reference);
  command->add_flag("--json", options->as_json, "one JSON object on standard output");
  command->callback([options, &run] { run = [options] { return compare(*options); }; });
}

}  // namespace gleaner::cli
