// How method `photon` chooses the counts that are not set.

#include "coordinator/plan/photon_choice.h"

#include <gtest/gtest.h>

namespace gleaner::coordinator {
namespace {

constexpr std::uint64_t kPicture = 512 * 512;

TEST(PhotonChoice, WhatIsSetStays) {
  const GivenPhotonCounts given = {.count = 1, .caustics = 2, .passes = 3, .clusters = 4, .rays = 5, .cut = 6};
  const PhotonCounts counts = choose_photon_counts(kPicture, 64, 0, true, given);
  EXPECT_EQ(counts.count, 1u);
  EXPECT_EQ(counts.caustics, 2u);
  EXPECT_EQ(counts.passes, 3u);
  EXPECT_EQ(counts.clusters, 4u);
  EXPECT_EQ(counts.rays, 5u);
  EXPECT_EQ(counts.cut, 6u);
  const PhotonCounts off =
      choose_photon_counts(kPicture, 64, 0, true, {.count = 0, .caustics = 0, .clusters = 0, .rays = 0, .cut = 0});
  EXPECT_EQ(off.count + off.caustics + off.clusters + off.rays + off.cut, 0u) << "0 switches off";
}

TEST(PhotonChoice, MoreSamplesTakeMoreOfAll) {
  PhotonCounts last = choose_photon_counts(kPicture, 1, 0, true, {});
  for (const std::uint32_t spp : {4u, 16u, 64u, 256u}) {
    const PhotonCounts next = choose_photon_counts(kPicture, spp, 0, true, {});
    EXPECT_GE(next.count, last.count) << spp;
    EXPECT_GE(next.passes, last.passes) << spp;
    EXPECT_GE(next.clusters, last.clusters) << spp;
    EXPECT_GE(next.rays, last.rays) << spp;
    // What the clusters cost stays in proportion to the samples.
    const double rays = static_cast<double>(next.clusters) * next.rays;
    EXPECT_LT(rays, 2.0 * kPicture * spp + 1e6) << spp;
    last = next;
  }
  EXPECT_GT(last.count, 500'000u);
  EXPECT_EQ(last.rays, 1024u);
}

// A target error asks for what as many samples would: half the error for four times these.
TEST(PhotonChoice, TargetsAskForWhatTheirSamplesWould) {
  const PhotonCounts wide = choose_photon_counts(kPicture, 4096, 0.05, true, {}),
                     samples = choose_photon_counts(kPicture, 4, 0, true, {}),
                     fine = choose_photon_counts(kPicture, 1, 0.025, true, {});
  EXPECT_EQ(wide.rays, samples.rays);
  EXPECT_EQ(wide.clusters, samples.clusters);
  EXPECT_GT(fine.rays, 2 * wide.rays);
  EXPECT_GT(fine.clusters, wide.clusters);
  EXPECT_GT(fine.passes, wide.passes);
  EXPECT_GE(wide.passes, 2u);
}

TEST(PhotonChoice, LeavesOutWhatDoesNotPay) {
  EXPECT_EQ(choose_photon_counts(kPicture, 16, 0, false, {}).clusters, 0u) << "the film is too large";
  EXPECT_EQ(choose_photon_counts(kPicture, 16, 0, true, {}).cut, 4096u);
  EXPECT_EQ(choose_photon_counts(32 * 32, 1, 0, true, {}).cut, 0u) << "few rays";
  EXPECT_EQ(choose_photon_counts(kPicture, 16, 0, true, {.count = 1000}).cut, 0u) << "few photons";
  EXPECT_EQ(choose_photon_counts(kPicture, 16, 0, true, {.clusters = 0}).cut, 4096u) << "samples' rays read it";
}

TEST(PhotonChoice, NoisyPathsTakeFewerRays) {
  const PhotonCounts counts = choose_photon_counts(kPicture, 16, 0, true, {});
  const auto rays = [&](double sample, double ray) { return photon_rays_beside({sample, ray}, counts); };
  EXPECT_EQ(rays(0, 1), counts.rays) << "not known";
  EXPECT_EQ(rays(0.1, 1), counts.rays) << "quiet paths";
  EXPECT_NEAR(rays(0.4, 1), counts.rays / 2.0, 1);
  EXPECT_EQ(rays(1e9, 1), 96u) << "as few as make a picture";
}

// Passes are worth their time while what they leave weighs beside the noise of paths.
TEST(PhotonChoice, PassesAreAsManyAsPay) {
  const auto passes = [](double sample_error, double pass_error, double pass_work = 1e6) {
    return worthwhile_passes(
        {.sample_error = sample_error, .pass_error = pass_error, .samples = 64, .work = 1.6e7, .pass_work = pass_work},
        16);
  };
  EXPECT_EQ(passes(0, 1), 16u) << "not known";
  EXPECT_EQ(passes(1, 0), 2u) << "no caustics";
  EXPECT_EQ(passes(1, 1e3), 16u) << "caustics alone";
  EXPECT_EQ(passes(0.1, 0.1, 0), 16u) << "they cost nothing";
  const std::uint32_t some = passes(1, 0.05);
  EXPECT_GT(some, 2u);
  EXPECT_LT(some, 16u);
  EXPECT_LT(passes(2, 0.05), some) << "noisier paths";
  EXPECT_LT(passes(1, 0.05, 1e7), some) << "dearer passes";
  EXPECT_EQ(worthwhile_passes({.sample_error = 1, .samples = 64, .work = 1, .pass_work = 1}, 1), 1u);
}

}  // namespace
}  // namespace gleaner::coordinator
