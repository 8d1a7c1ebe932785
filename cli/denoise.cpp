// `gleaner denoise`: a picture that was rendered before, denoised.

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "cli/commands.h"
#include "coordinator/film/read.h"
#include "coordinator/film/write.h"
#include "coordinator/plan/denoised_film.h"
#include "coordinator/plan/plan.h"
#include "scene/model/error.h"
#include "scene/model/names.h"
#include "worker/denoise/picture.h"

namespace gleaner::cli {
namespace {

namespace fs = std::filesystem;
using coordinator::Denoise;

struct DenoiseOptions {
  std::string input, output, quality = "high";
  double exposure_stops = 0;
  bool cpu = false;
};

std::span<const float> floats_of(const scene::Bytes& bytes) {
  return {reinterpret_cast<const float*>(bytes.data()), bytes.size() / sizeof(float)};
}

void tell(const kernels::DenoiseFacts& facts, bool halves) {
  std::cerr << "gleaner: Open Image Denoise " << facts.version << " on " << facts.device;
  if (halves && facts.mean > 0)
    std::cerr << ", expected error " << 100 * std::sqrt(facts.squared_error) / facts.mean << " %, "
              << 100 * facts.denoised << " % of the picture denoised";
  std::cerr << "\n";
  if (!halves)
    std::cerr << "gleaner: warning: the picture has no half.* layers (render --denoise writes them): it is denoised "
                 "everywhere, and its error is not known\n";
}

int denoise(const DenoiseOptions& options) {
  if (fs::path(options.output).extension() != ".exr")
    throw Error::usage("-o: expected a name that ends in .exr, found \"" + options.output + "\"");
  const Denoise quality = coordinator::parse_denoise(options.quality);
  if (quality == Denoise::off) throw Error::usage("--quality: expected fast or high, found \"off\"");
  coordinator::Film film = coordinator::read_exr(options.input);
  auto metadata = coordinator::read_exr_texts(options.input);
  const coordinator::DenoiserInput input = coordinator::denoiser_input(film, options.input);
  const kernels::DenoiseParameters parameters{film.width,
                                              film.height,
                                              quality == Denoise::fast ? kernels::kDenoiseFast : kernels::kDenoiseHigh,
                                              input.halves ? 1u : 0u,
                                              input.emission ? 1u : 0u,
                                              {}};
  const worker::DenoisedPicture picture =
      worker::denoise_picture(parameters, floats_of(*input.planes),
                              options.cpu ? worker::DenoiserDevice::cpu : worker::DenoiserDevice::fastest);
  coordinator::show_denoised(film, picture.pixels, input.halves);
  metadata["gleaner.denoise"] = nlohmann::json{
      {"quality", coordinator::word_of(quality)},
      {"library", std::string("Open Image Denoise ") + picture.facts.version},
      {"device", picture.facts.device},
      {"share",
       picture.facts.denoised}}.dump();
  metadata["gleaner.pixels_sha256"] = coordinator::pixels_sha256(film);
  coordinator::write_exr(film, metadata, options.output);
  const fs::path png = fs::path(options.output).replace_extension(".png");
  coordinator::write_png(film, png.string(), options.exposure_stops);
  tell(picture.facts, input.halves);
  for (const std::string& file : {options.output, png.string()})
    std::cerr << "gleaner: wrote " << printable_lines(file) << "\n";
  return 0;
}

}  // namespace

void add_denoise(CLI::App& app, Run& run) {
  auto options = std::make_shared<DenoiseOptions>();
  CLI::App* command = app.add_subcommand("denoise", "Denoise a picture that was rendered before");
  command->add_option("IN.exr", options->input, "a picture; its layers albedo.*, normal.* and half.* help")->required();
  command->add_option("-o,--output", options->output, "OUT.exr; a PNG is written beside it")->required();
  command->add_option("--quality", options->quality, "fast or high")->capture_default_str();
  command->add_option("--exposure", options->exposure_stops, "stops: the PNG's brightness is multiplied by 2^stops");
  command->add_flag("--cpu", options->cpu, "on the CPU, also where there is a GPU");
  command->callback([options, &run] { run = [options] { return denoise(*options); }; });
}

}  // namespace gleaner::cli
