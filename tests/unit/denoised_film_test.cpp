// What a denoiser reads of a film, and what it leaves there.

#include "coordinator/plan/denoised_film.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "coordinator/film/accumulator.h"
#include "coordinator/plan/seen_emission.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using testing::HasSubstr;

Film film_of(std::initializer_list<std::pair<const char*, float>> channels) {
  Film film{2, 1, {}};
  for (const auto& [name, value] : channels) film.channels.push_back({name, {value, value + 1}});
  return film;
}

std::vector<float> floats_of(const DenoiserInput& input) {
  std::vector<float> values(input.planes->size() / sizeof(float));
  std::memcpy(values.data(), input.planes->data(), input.planes->size());
  return values;
}

std::string error_of(const Film& film) {
  try {
    denoiser_input(film, "some.exr");
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST(DenoisedFilm, PlanesLieOneBehindTheOther) {
  Film film = film_of({{"R", 1},
                       {"G", 2},
                       {"B", 3},
                       {"half.R", 4},
                       {"half.G", 5},
                       {"half.B", 6},
                       {"albedo.R", 7},
                       {"albedo.G", 8},
                       {"albedo.B", 9},
                       {"normal.Z", 10}});
  film.channels.push_back({"half.A", {0.5f, 0.25f}});
  const DenoiserInput input = denoiser_input(film, "some.exr");
  EXPECT_TRUE(input.halves);
  EXPECT_THAT(floats_of(input), testing::ElementsAre(4, 5, 6, 5, 6, 7,    // the first half
                                                     -2, -1, 0, 1, 2, 3,  // (all - a first) / (1 - a)
                                                     7, 8, 9, 8, 9, 10, 0, 0, 10, 0, 0, 11, 0.5, 0.25));
}

TEST(DenoisedFilm, EmissionSeenDirectlyFollows) {
  Film film = film_of({{"R", 1}, {"G", 2}, {"B", 3}, {"emission.R", 0.5}, {"emission.G", 0}, {"emission.B", 0}});
  const DenoiserInput plain = denoiser_input(film, "some.exr");
  EXPECT_TRUE(plain.emission);
  const std::vector<float> whole = floats_of(plain);
  ASSERT_EQ(whole.size(), 2 * (kernels::kDenoiseWords + kernels::kDenoiseEmissionWords));
  EXPECT_THAT(std::vector(whole.begin() + 26, whole.begin() + 32), testing::ElementsAre(0.5, 0, 0, 1.5, 1, 1));
  for (const char* color : {"half.R", "half.G", "half.B"}) film.channels.push_back({color, {1, 1}});
  film.channels.push_back({"half.A", {0.5f, 0.25f}});
  EXPECT_FALSE(denoiser_input(film, "some.exr").emission) << "not known of the halves";
  for (const char* color : {"half.emission.R", "half.emission.G", "half.emission.B"})
    film.channels.push_back({color, {0.25f, 1}});
  const std::vector<float> halves = floats_of(denoiser_input(film, "some.exr"));
  ASSERT_EQ(halves.size(), whole.size());
  EXPECT_THAT(std::vector(halves.begin() + 26, halves.begin() + 29), testing::ElementsAre(0.25, 0.25, 0.25));
  EXPECT_FLOAT_EQ(halves[32], 0.75f) << "(all - a first) / (1 - a)";
  EXPECT_FLOAT_EQ(halves[35], (1.5f - 0.25f) / 0.75f);
}

TEST(DenoisedFilm, FilmsWithoutHalvesAndFilmsThatWereDenoised) {
  const DenoiserInput plain = denoiser_input(film_of({{"R", 1}, {"G", 2}, {"B", 3}}), "some.exr");
  EXPECT_FALSE(plain.halves);
  EXPECT_EQ(floats_of(plain)[4], 3);
  const DenoiserInput again = denoiser_input(
      film_of({{"R", 1}, {"G", 2}, {"B", 3}, {"noisy.R", 7}, {"noisy.G", 8}, {"noisy.B", 9}}), "some.exr");
  EXPECT_EQ(floats_of(again)[0], 7);
}

TEST(DenoisedFilm, BadFilmsAreNamed) {
  EXPECT_THAT(error_of(film_of({{"R", 1}, {"G", 2}})), testing::AllOf(HasSubstr("some.exr"), HasSubstr("no layer B")));
  Film odd = film_of({{"R", 1}, {"G", 2}, {"B", 3}, {"albedo.G", 1}});
  odd.channel("albedo.G").values[1] = std::nanf("");
  EXPECT_THAT(error_of(odd), HasSubstr("layer albedo.G, pixel 1,0"));
}

TEST(DenoisedFilm, ThePictureIsDenoisedAndTheOldOneStays) {
  Film film = film_of({{"R", 1}, {"G", 2}, {"B", 3}});
  const kernels::DenoiseRecord records[] = {{{10, 20, 30}, 0.5f}, {{11, 21, 31}, 0.25f}};
  show_denoised(film, records, true);
  EXPECT_EQ(film.find("G")->values[1], 21);
  EXPECT_EQ(film.find("noisy.G")->values[1], 3);
  EXPECT_EQ(film.find("error.Y")->values[1], 0.25f);
  show_denoised(film, records, true);
  EXPECT_EQ(film.find("noisy.G")->values[1], 3) << "the raw picture, not the one that was denoised before";

  const kernels::DenoiseRecord odd[] = {{{10, 20, 30}, 0.5f}, {{11, 21, std::nanf("")}, 0.25f}};
  EXPECT_THROW(show_denoised(film, odd, true), Error);
  EXPECT_THROW(show_denoised(film, std::span(records).first(1), true), Error);
}

// The halves of an accumulator add up to its picture, also where a pixel has more of one than of the other.
TEST(DenoisedFilm, HalvesAreIndependentAndWhole) {
  Accumulator film(2, 1);
  film.keep_halves();
  const float none[3] = {};
  const auto add = [&](std::uint32_t pixel, std::uint32_t chunk, float radiance) {
    const float sums[3] = {2 * radiance, 2 * radiance, 2 * radiance};
    film.add(pixel, chunk, sums, none, 2, true);
  };
  add(0, 0, 1), add(0, 1, 5), add(0, 2, 3);
  add(1, 0, 1), add(1, 1, 2);
  film.add_pass(std::vector<float>(6, 10.0f));
  film.add_pass(std::vector<float>(6, 20.0f));
  const Film made = film.film();
  EXPECT_FLOAT_EQ(made.find("half.R")->values[0], 2 + 10);
  EXPECT_FLOAT_EQ(made.find("half.A")->values[0], 2 / 3.0f);
  EXPECT_FLOAT_EQ(made.find("half.R")->values[1], 1 + 10);
  // What is left is the second half of both: 5 + 20.
  EXPECT_FLOAT_EQ(made.find("R")->values[0], (2 * (2 + 10) + (5 + 20)) / 3.0f);
  EXPECT_FLOAT_EQ(film.film_of_samples().find("R")->values[0], 3);
  EXPECT_FLOAT_EQ(film.film_of_samples().find("half.R")->values[0], 2);
}

// What is seen directly is part of the picture and of its half; rays of their own, where there are more of them than
// samples, say what it is.
TEST(DenoisedFilm, RaysThatLookForEmissionAloneSayWhatIsSeen) {
  Accumulator film(2, 1);
  film.keep_halves();
  const float none[3] = {}, reflected[3] = {2, 2, 2}, bright[3] = {40, 40, 40}, most[3] = {900, 900, 900};
  for (std::uint32_t chunk = 0; chunk < 2; ++chunk)
    for (std::uint32_t pixel = 0; pixel < 2; ++pixel) film.add(pixel, chunk, reflected, none, 2, true);
  EXPECT_FALSE(film.film().find("emission.R")) << "nothing was seen";
  film.add_seen(0, 0, bright);
  film.add_seen(1, 0, bright);
  EXPECT_EQ(film.noise().chunk_variance[0], 0) << "of what is reflected";
  EXPECT_FLOAT_EQ(film.seen(0)[0], 20);
  EXPECT_FLOAT_EQ(film.seen(1)[0], 0);
  EXPECT_FLOAT_EQ(film.mean_radiance(), 11);
  EXPECT_FLOAT_EQ(film.preview().find("G")->values[0], 11);
  film.add_seen_alone(0, 0, most, 100);
  film.add_seen_alone(0, 1, most, 90);
  film.add_seen_alone(1, 0, most, 1);
  const Film made = film.film();
  EXPECT_FLOAT_EQ(made.find("R")->values[0], 1 + (9 + 10) / 2.0f);
  EXPECT_FLOAT_EQ(made.find("direct.R")->values[0], 1 + (9 + 10) / 2.0f);
  EXPECT_FLOAT_EQ(made.find("emission.R")->values[0], (9 + 10) / 2.0f);
  EXPECT_FLOAT_EQ(made.find("half.R")->values[0], 1 + 9);
  EXPECT_FLOAT_EQ(made.find("half.emission.R")->values[0], 9);
  EXPECT_FLOAT_EQ(made.find("variance.R")->values[0], 0.25f);
  EXPECT_FLOAT_EQ(made.find("R")->values[1], 11) << "two samples say more than one ray";
}

TEST(SeenEmission, EdgesAreWhereNeighboursDiffer) {
  std::vector<float> lamp(25);  // 5 x 5, a bright pixel in a corner
  lamp[0] = 2;
  EXPECT_THAT(emission_edges(lamp, 5, 5, 1, 25), testing::ElementsAre(0, 1, 5, 6));
  EXPECT_THAT(emission_edges(lamp, 5, 5, 2, 25), testing::IsEmpty());
  lamp[24] = 3;
  EXPECT_THAT(emission_edges(lamp, 5, 5, 1, 5), testing::ElementsAre(0, 18, 19, 23, 24)) << "those that differ most";
  EXPECT_THAT(emission_edges(std::vector<float>(9, 7.0f), 3, 3, 0, 9), testing::IsEmpty());
}

}  // namespace
}  // namespace gleaner::coordinator
