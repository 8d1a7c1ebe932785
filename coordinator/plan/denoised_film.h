#pragma once
// What a denoiser reads of a film, and what it makes of it (kernels/denoise_records.h).

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "coordinator/film/film.h"
#include "kernels/denoise_records.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

struct DenoiserInput {
  std::shared_ptr<const scene::Bytes> planes;
  bool halves = false;    // the film tells two halves of its samples apart
  bool emission = false;  // and what of them is emission that the camera sees directly
};

// Of a film that was denoised before, its noisy.* layers are the picture. Guides that it does not have are black.
// Throws Error::bad_input, with `name` of the film, where it has no picture or a value is not finite.
DenoiserInput denoiser_input(const Film& film, const std::string& name);

// Throws Error::failed, which begins with `where`, for a record that is no number.
void check_denoised(std::span<const kernels::DenoiseRecord> records, const std::string& where);

// R G B become the denoised picture, noisy.* what they were, and error.Y the squared error where it is known
// (`halves`). Throws Error::failed for a record that is no number.
void show_denoised(Film& film, std::span<const kernels::DenoiseRecord> records, bool halves);

}  // namespace gleaner::coordinator
