// The denoiser's library by a double of its interface: where it is looked for, what it is asked for, and what its
// errors become.

#include "worker/denoise/denoiser.h"

#include <dlfcn.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <filesystem>

#include "scene/model/error.h"
#include "worker/denoise/picture.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class DenoiserOfADouble : public testing::Test {
 protected:
  void SetUp() override {
    ::setenv("GLEANER_OIDN", FAKE_OIDN, 1);
    library_ = dlopen(FAKE_OIDN, RTLD_NOW | RTLD_LOCAL);
    ASSERT_NE(library_, nullptr) << dlerror();
    reinterpret_cast<void (*)()>(dlsym(library_, "fake_oidn_forget"))();
  }
  void TearDown() override {
    for (const char* name : {"GLEANER_OIDN", "FAKE_OIDN_FAILS", "FAKE_OIDN_VERSION"}) ::unsetenv(name);
    // Whatever happened, nothing is left behind.
    EXPECT_EQ(reinterpret_cast<int (*)()>(dlsym(library_, "fake_oidn_live"))(), 0);
  }
  std::string calls() const { return reinterpret_cast<const char* (*)()>(dlsym(library_, "fake_oidn_calls"))(); }
  std::string error_of(const std::function<void()>& act) const {
    try {
      act();
    } catch (const Error& error) {
      return error.what();
    }
    return "no error";
  }

  void* library_ = nullptr;
};

const std::vector<float> kSix = {1, 2, 3, 4, 5, 6};
const DenoiserImage kImage{2, 1, kSix};

TEST_F(DenoiserOfADouble, IsAskedInOrder) {
  Denoiser denoiser(DenoiserDevice::cpu);
  EXPECT_EQ(denoiser.version(), "2.5.1");
  EXPECT_EQ(denoiser.device(), "CPU");
  EXPECT_EQ(calls(), "new device 1\nsetAffinity off\ncommit device\n");
  reinterpret_cast<void (*)()>(dlsym(library_, "fake_oidn_forget"))();
  const std::vector<float> twice = {2, 4, 6, 8, 10, 12};
  EXPECT_THAT(denoiser.denoise(std::array{kImage, DenoiserImage{2, 1, twice}}, kImage, kImage, DenoiseQuality::high),
              testing::ElementsAre(testing::ElementsAre(2, 3, 4, 5, 6, 7), testing::ElementsAre(3, 5, 7, 9, 11, 13)));
  EXPECT_EQ(calls(),
            "new filter RT\nnew buffer\nimage color 3 2x1\nnew buffer\nimage albedo 3 2x1\nnew buffer\nimage normal 3 "
            "2x1\nnew buffer\nimage output 3 2x1\nhdr on\ncleanAux on\nquality 6\nmaxMemoryMB 1024\ncommit "
            "filter\nexecute filter\nread buffer\nexecute filter\nread buffer\n");
  EXPECT_THAT(denoiser.prefilter("normal", kImage), testing::ElementsAre(0.5, 1, 1.5, 2, 2.5, 3));
}

TEST_F(DenoiserOfADouble, ErrorsSayWhatFailed) {
  const std::pair<const char*, const char*> steps[] = {{"new device 1", "no device"},
                                                       {"commit device", "opening its device"},
                                                       {"new filter RT", "making its filter"},
                                                       {"new buffer", "taking memory"},
                                                       {"commit filter", "preparing its filter"},
                                                       {"execute filter", "running its filter"},
                                                       {"read buffer", "reading what it made"}};
  for (const auto& [step, words] : steps) {
    ::setenv("FAKE_OIDN_FAILS", step, 1);
    const std::string error = error_of([] {
      Denoiser(DenoiserDevice::cpu).denoise({&kImage, 1}, kImage, kImage, DenoiseQuality::fast);
    });
    EXPECT_THAT(error, HasSubstr(words));
    EXPECT_THAT(error, HasSubstr(std::string(step) + " fails as it was told to"));
  }
}

TEST_F(DenoiserOfADouble, StopsWhereNobodyWantsThePicture) {
  std::atomic<bool> given_up = false;
  const WantedScope wanted(&given_up);
  Denoiser denoiser(DenoiserDevice::cpu);
  denoiser.prefilter("normal", kImage);
  given_up = true;
  EXPECT_THAT(error_of([&] { denoiser.prefilter("normal", kImage); }), HasSubstr(nobody_wants_it));
}

TEST_F(DenoiserOfADouble, OtherVersionsAreRefused) {
  for (const char* version : {"10402", "30000"}) {
    ::setenv("FAKE_OIDN_VERSION", version, 1);
    EXPECT_THAT(error_of([] { Denoiser{DenoiserDevice::cpu}; }), HasSubstr("expected 2"));
  }
}

TEST_F(DenoiserOfADouble, IsWhereItWasNamedOrNowhere) {
  ::setenv("GLEANER_OIDN", FAKE_OIDN_PART, 1);
  EXPECT_THAT(error_of([] { Denoiser{DenoiserDevice::cpu}; }), HasSubstr("oidnSetFilterInt"));
  ::setenv("GLEANER_OIDN", "/nowhere", 1);
  EXPECT_THAT(error_of([] { Denoiser{DenoiserDevice::cpu}; }), HasSubstr("found /nowhere"));

  const fs::path folder = fs::path(testing::TempDir()) / ("denoiser" + std::to_string(::getpid()));
  fs::create_directories(folder / "lib");
  ::setenv("GLEANER_OIDN", folder.c_str(), 1);
  EXPECT_THAT(error_of([] { Denoiser{DenoiserDevice::cpu}; }), HasSubstr("libOpenImageDenoise.so.2"));
  fs::copy_file(FAKE_OIDN_PART, folder / "lib/libOpenImageDenoise.so.2");
  EXPECT_THAT(error_of([] { Denoiser{DenoiserDevice::cpu}; }), HasSubstr("oidnSetFilterInt"));
  fs::remove_all(folder);
}

TEST_F(DenoiserOfADouble, ImagesOfOtherSizesAreRefused) {
  const DenoiserImage small{1, 1, std::span(kSix).first(3)};
  EXPECT_THAT(error_of([&] {
                Denoiser(DenoiserDevice::cpu).denoise({&kImage, 1}, small, kImage, DenoiseQuality::fast);
              }),
              HasSubstr("image albedo"));
}

// Planes of a picture of 2 x 1 pixels: kernels/denoise_records.h.
std::vector<float> planes() {
  std::vector<float> values(2 * kernels::kDenoiseWords, 0.5f);
  std::fill_n(values.begin(), 6, 1.0f);
  std::fill_n(values.begin() + 6, 6, 3.0f);
  return values;
}

TEST_F(DenoiserOfADouble, PicturesWithoutHalvesAreDenoisedWhole) {
  const kernels::DenoiseParameters parameters{2, 1, kernels::kDenoiseFast, 0, 0, {}};
  const DenoisedPicture picture = denoise_picture(parameters, planes(), DenoiserDevice::cpu);
  EXPECT_EQ(picture.pixels.at(1).color[2], 2);
  EXPECT_EQ(picture.pixels.at(1).squared_error, 0);
  EXPECT_EQ(picture.facts.denoised, 1);
  EXPECT_STREQ(picture.facts.version, "2.5.1");
}

TEST_F(DenoiserOfADouble, EmissionSeenDirectlyIsTakenOutAndPutBack) {
  const kernels::DenoiseParameters parameters{2, 1, kernels::kDenoiseFast, 0, 1, {}};
  std::vector<float> values = planes();
  values.resize(2 * (kernels::kDenoiseWords + kernels::kDenoiseEmissionWords), 0.75f);
  ::setenv("FAKE_OIDN_DOUBLES", "1", 1);
  const DenoisedPicture picture = denoise_picture(parameters, values, DenoiserDevice::cpu);
  ::unsetenv("FAKE_OIDN_DOUBLES");
  EXPECT_FLOAT_EQ(picture.pixels.at(0).color[0], 2 * (1 - 0.75f) + 0.75f);
  EXPECT_THAT(error_of([&] { denoise_picture(parameters, planes(), DenoiserDevice::cpu); }), HasSubstr("38 numbers"));
}

// What a worker without the library makes of a picture.
TEST_F(DenoiserOfADouble, WhatIsNotDenoisedStaysAsItWas) {
  const kernels::DenoiseParameters parameters{2, 1, kernels::kDenoiseFast, 1, 0, {}};
  const DenoisedPicture picture = sampled_picture(parameters, planes(), "for a reason");
  EXPECT_FLOAT_EQ(picture.pixels.at(0).color[0], 2);       // the mean of both halves
  EXPECT_FLOAT_EQ(picture.pixels.at(0).squared_error, 1);  // (1 - 3)^2 / 4
  EXPECT_EQ(picture.facts.denoised, 0);
  EXPECT_STREQ(picture.facts.version, "");
  EXPECT_STREQ(picture.facts.why, "for a reason");
}

TEST_F(DenoiserOfADouble, PlanesAreChecked) {
  const kernels::DenoiseParameters parameters{2, 1, kernels::kDenoiseFast, 1, 0, {}};
  std::vector<float> odd = planes();
  odd[7] = std::nanf("");
  EXPECT_THAT(error_of([&] { denoise_picture(parameters, odd, DenoiserDevice::cpu); }), HasSubstr("number 7"));
  odd.pop_back();
  EXPECT_THAT(error_of([&] { denoise_picture(parameters, odd, DenoiserDevice::cpu); }), HasSubstr("26 numbers"));
}

}  // namespace
}  // namespace gleaner::worker
