// The random numbers, and the shapes that are drawn with them, as the kernels compute them.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <unordered_map>

#include "kernels/path_layout.h"
#include "kernels/path_records.h"
#include "tests/kernels/kernel_bench.h"
#include "tests/radiometry/statistics.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;

constexpr const char* kText = R"CL(
#include "kernels/sampling.h"
#include "kernels/path_records.h"

// As camera_generate makes it of seed, pixel and sequence.
FN vu key_of(uint seed, vu pixel, vu sequence) {
  return hash_combine(hash_combine(hash_combine((vu)seed, (vu)0u), pixel), sequence);
}
FN vu lane_id(void) { return (vu)((uint)get_global_id(0) * LANES) + lane_index(); }

kernel void keys(uint seed, uint pixels, global uint* out) {
  vu i = lane_id();
  scatter_u(out, i, key_of(seed, i % pixels, i / pixels));
}

// Run i / samples, each of a pixel of its own: an aligned run of the pixel's sequence.
kernel void pairs(uint seed, uint sequence, uint samples, uint dimension, global float* a, global float* b) {
  vu i = lane_id();
  vf u0, u1;
  vu run = i / samples;
  vu first = (hash_u(run) & (GLEANER_PATH_SEQUENCE / samples - 1u)) * samples;
  sample_pair(key_of(seed, run, (vu)sequence), first + (i & (samples - 1u)), GLEANER_PATH_SEQUENCE, dimension, &u0, &u1);
  scatter_f(a, i, u0);
  scatter_f(b, i, u1);
}

// The numbers of a path's vertices (path_shade keys them by the bounce).
kernel void vertex_pairs(uint seed, uint bounce, uint dimension, global float* a, global float* b) {
  vu i = lane_id();
  vf u0, u1;
  vu key = hash_combine(key_of(seed, i, (vu)0u), (vu)(bounce * 4u + 1u));
  sample_pair(key, hash_u(i) & (GLEANER_PATH_SEQUENCE - 1u), GLEANER_PATH_SEQUENCE, dimension, &u0, &u1);
  scatter_f(a, i, u0);
  scatter_f(b, i, u1);
}

kernel void turn(global const float* u, global float* s, global float* c) {
  vu i = lane_id();
  vf sine, cosine;
  sincos_2pi(gather_f(u, i), &sine, &cosine);
  scatter_f(s, i, sine);
  scatter_f(c, i, cosine);
}

kernel void cosine_lobe(uint seed, global float* x, global float* y, global float* z) {
  vu i = lane_id();
  vf u0, u1;
  sample_pair(key_of(seed, i, (vu)0u), (vu)0u, 1u, 2u, &u0, &u1);
  v3 d = sample_cosine(u0, u1);
  scatter_f(x, i, d.x);
  scatter_f(y, i, d.y);
  scatter_f(z, i, d.z);
}

kernel void triangle(uint seed, global float* a, global float* b) {
  vu i = lane_id();
  vf u0, u1, b1, b2;
  sample_pair(key_of(seed, i, (vu)0u), (vu)0u, 1u, 3u, &u0, &u1);
  sample_triangle(u0, u1, &b1, &b2);
  scatter_f(a, i, b1);
  scatter_f(b, i, b2);
}
)CL";

class Sampling : public ::testing::TestWithParam<unsigned> {
 protected:
  Sampling() : bench_(GetParam()), program_(bench_.build(kText)) {}

  std::pair<std::vector<float>, std::vector<float>> pairs(cl_uint seed, cl_uint sequence, cl_uint samples,
                                                          cl_uint dimension, std::size_t count) {
    cl::Kernel kernel(program_, "pairs");
    cl::Buffer a = bench_.space(count), b = bench_.space(count);
    set_arguments(kernel, 0, seed, sequence, samples, dimension, a, b);
    bench_.run(kernel, count);
    return {bench_.read<float>(a, count), bench_.read<float>(b, count)};
  }
  std::vector<std::uint32_t> keys(cl_uint seed, cl_uint pixels, std::size_t count) {
    cl::Kernel kernel(program_, "keys");
    cl::Buffer out = bench_.space(count);
    set_arguments(kernel, 0, seed, pixels, out);
    bench_.run(kernel, count);
    return bench_.read<std::uint32_t>(out, count);
  }

  KernelBench bench_;
  cl::Program program_;
};

INSTANTIATE_TEST_SUITE_P(Lanes, Sampling, ::testing::Values(1u, 16u),
                         [](const auto& lanes) { return "LANES" + std::to_string(lanes.param); });

void check_uniform(const std::vector<float>& u, const std::string& what, double level) {
  Sample sample;
  std::vector<double> bins(1001);
  for (const float x : u) {
    ASSERT_GE(x, 0) << what;
    ASSERT_LT(x, 1) << what;
    sample.add(x);
    ++bins[static_cast<std::size_t>(1001.0 * x)];
  }
  const double n = static_cast<double>(u.size());
  const double t = (sample.mean - 0.5) / std::sqrt(1 / (12 * n));
  // The variance of the sample variance of a uniform number is (1/80 - 1/144) / n.
  const double tv = (sample.variance() - 1.0 / 12) / std::sqrt((1.0 / 80 - 1.0 / 144) / n);
  const ChiSquare chi = chi_square(bins, std::vector<double>(1001, 1.0));
  std::printf("  %-32s mean %.5f (%.2f sigma), variance %.6f (%.2f sigma), chi-square p = %.3f\n", what.c_str(),
              sample.mean, t, sample.variance(), tv, chi.p);
  EXPECT_GE(student_p(t, 1e6), level / 3) << what;
  EXPECT_GE(student_p(tv, 1e6), level / 3) << what;
  EXPECT_GE(chi.p, level / 3) << what;
}

TEST_P(Sampling, UniformAlongAndAcross) {
  constexpr std::size_t count = 1 << 20;
  // One sample a pixel; and the pixels' samples of a net.
  for (const auto& [samples, dimension] : {std::pair<cl_uint, cl_uint>{1, 0}, {1, 3}, {16, 0}, {64, 2}}) {
    const auto [a, b] = pairs(5, 3, samples, dimension, count);
    const std::string what = std::to_string(samples) + " samples, dimension " + std::to_string(dimension);
    check_uniform(a, what + "a", sidak(kFamily, 8));
    check_uniform(b, what + "b", sidak(kFamily, 8));
    if (samples > 1) continue;  // a net is more even than chance
    std::vector<double> cells(31 * 37);
    for (std::size_t i = 0; i < count; ++i)
      ++cells[static_cast<std::size_t>(31.0 * a[i]) * 37 + static_cast<std::size_t>(37.0 * b[i])];
    const ChiSquare chi = chi_square(cells, std::vector<double>(31 * 37, 1.0));
    std::printf("  %-32s chi-square of the pair p = %.3f\n", what.c_str(), chi.p);
    EXPECT_GE(chi.p, sidak(kFamily, 2)) << what;
  }
}

// Sobol's points stay a (0, m, 2)-net under Owen scrambling: every elementary interval of area 1 / n holds one of n,
// for the samples of any item and for aligned runs of items.
TEST_P(Sampling, EveryRunIsANet) {
  for (const cl_uint samples : {2u, 4u, 16u, 64u, 4096u}) {
    const std::size_t sets = std::min(1024u, 262144u / samples), count = sets * samples;
    for (const cl_uint dimension : {0u, 1u, 3u}) {
      const auto [a, b] = pairs(9, 1, samples, dimension, count);
      std::size_t broken = 0;
      for (std::size_t set = 0; set < sets; ++set)
        for (std::size_t columns = 1; columns <= samples; columns *= 2) {
          std::vector<int> cell(samples);
          for (std::size_t s = set * samples; s < (set + 1) * samples; ++s) {
            const std::size_t rows = samples / columns;
            ++cell[static_cast<std::size_t>(a[s] * static_cast<float>(columns)) * rows +
                   static_cast<std::size_t>(b[s] * static_cast<float>(rows))];
          }
          broken += !std::all_of(cell.begin(), cell.end(), [](int n) { return n == 1; });
        }
      EXPECT_EQ(broken, 0u) << samples << " samples, dimension " << dimension;
    }
  }
}

// Numbers that must not know of each other: dimensions, bounces, pixels beside and below, chunks, seeds.
TEST_P(Sampling, NothingIsCorrelated) {
  constexpr std::size_t count = 1 << 16;
  std::vector<std::pair<std::string, std::vector<float>>> columns;
  const auto add = [&](const std::string& what, std::pair<std::vector<float>, std::vector<float>> pair) {
    columns.emplace_back(what + "a", std::move(pair.first));
    columns.emplace_back(what + "b", std::move(pair.second));
  };
  for (cl_uint d = 0; d < 4; ++d) add("dimension " + std::to_string(d), pairs(7, 0, 1, d, count));
  for (const cl_uint bounce : {0u, 1u, 2u})
    for (const cl_uint d : {0u, 3u}) {
      cl::Kernel kernel(program_, "vertex_pairs");
      cl::Buffer a = bench_.space(count), b = bench_.space(count);
      set_arguments(kernel, 0, cl_uint{7}, bounce, d, a, b);
      bench_.run(kernel, count);
      add("bounce " + std::to_string(bounce) + ", dimension " + std::to_string(d),
          {bench_.read<float>(a, count), bench_.read<float>(b, count)});
    }
  for (const cl_uint s : {1u, 2u, 64u}) add("sequence " + std::to_string(s), pairs(7, s, 1, 0, count));
  add("seed 8", pairs(8, 0, 1, 0, count));
  const auto first = columns[0].second;
  for (const std::size_t away : {1u, 2u, 16u, 512u}) {
    std::vector<float> moved(count);
    for (std::size_t i = 0; i < count; ++i) moved[i] = first[(i + away) % count];
    columns.emplace_back(std::to_string(away) + " pixels on", std::move(moved));
  }
  const std::size_t tests = columns.size() * (columns.size() - 1) / 2;
  const double critical = student_critical(sidak(kFamily, tests), 1e6);
  double worst = 0;
  for (std::size_t i = 0; i < columns.size(); ++i)
    for (std::size_t j = 0; j < i; ++j) {
      double sum = 0;
      for (std::size_t k = 0; k < count; ++k) sum += (columns[i].second[k] - 0.5) * (columns[j].second[k] - 0.5);
      const double sigmas = std::abs(sum) * 12 / std::sqrt(static_cast<double>(count));
      worst = std::max(worst, sigmas);
      EXPECT_LT(sigmas, critical) << columns[i].first << " and " << columns[j].first << ": correlation "
                                  << sum * 12 / static_cast<double>(count);
    }
  std::printf("  %zu pairs of columns, worst correlation %.2f sigma of %.2f allowed\n", tests, worst, critical);
}

// Within an item the samples of one dimension pair must not follow those of another.
TEST_P(Sampling, DimensionsOfANetAreShuffledApart) {
  constexpr std::size_t sets = 4096, count = sets * 16;
  const auto d0 = pairs(3, 0, 16, 0, count), d1 = pairs(3, 0, 16, 1, count);
  for (const auto* a : {&d0.first, &d0.second})
    for (const auto* b : {&d1.first, &d1.second}) {
      std::vector<double> cells(16 * 16);
      for (std::size_t i = 0; i < count; ++i)
        ++cells[static_cast<std::size_t>(16 * (*a)[i]) * 16 + static_cast<std::size_t>(16 * (*b)[i])];
      // Each set is a permutation: a cell's count is one of 16 draws without replacement, of variance 15/16 of
      // chance's.
      const ChiSquare chi = chi_square(cells, std::vector<double>(256, 1.0));
      EXPECT_GE(chi.p, sidak(kFamily, 4));
    }
}

// For one pixel no two sequences share a key, for one sequence no two pixels.
TEST_P(Sampling, StreamsAreDisjoint) {
  constexpr std::size_t pixels = 1 << 14, sequences = 64, count = pixels * sequences;
  const std::vector<std::uint32_t> all = keys(1, pixels, count);
  for (const std::size_t sequence : {std::size_t{0}, std::size_t{63}}) {
    std::vector<std::uint32_t> some(all.begin() + static_cast<std::ptrdiff_t>(sequence * pixels),
                                    all.begin() + static_cast<std::ptrdiff_t>((sequence + 1) * pixels));
    std::sort(some.begin(), some.end());
    EXPECT_EQ(std::adjacent_find(some.begin(), some.end()), some.end()) << "sequence " << sequence;
  }
  for (std::size_t pixel = 0; pixel < pixels; pixel += 97) {
    std::vector<std::uint32_t> some;
    for (std::size_t sequence = 0; sequence < sequences; ++sequence) some.push_back(all[sequence * pixels + pixel]);
    std::sort(some.begin(), some.end());
    ASSERT_EQ(std::adjacent_find(some.begin(), some.end()), some.end()) << "pixel " << pixel;
  }
  // Over pixels and sequences together 32 bits collide as often as chance has it: n^2 / 2^33 pairs.
  std::vector<std::uint32_t> sorted = all;
  std::sort(sorted.begin(), sorted.end());
  std::size_t collisions = 0;
  for (std::size_t i = 1; i < count; ++i) collisions += sorted[i] == sorted[i - 1];
  const double expected = std::pow(static_cast<double>(count), 2) / std::exp2(33);
  std::printf("  %zu of %zu keys collide, chance gives %.0f\n", collisions, count, expected);
  // They come in twos: where (p, c) and (q, d) meet, so do (p, d) and (q, c).
  EXPECT_LT(static_cast<double>(collisions), expected + 5 * std::sqrt(2 * expected));
}

// camera_generate's keys are those tested here; chunks go by turns to two sequences, and no two chunks of a pixel share
// a sample.
TEST_P(Sampling, TheTracerUsesTheseKeys) {
  constexpr std::uint32_t width = 4, height = 2, pixels = width * height, samples = 2;
  // As many as two pairs of sequences hold, and one more.
  constexpr std::uint32_t chunks = 2 * 2 * GLEANER_PATH_SEQUENCE / samples + 1, count = pixels * chunks * samples;
  kernels::PathParameters p{};
  p.camera.type = GLEANER_CAMERA_ORTHOGRAPHIC;
  p.camera.right[0] = p.camera.up[1] = 1;
  p.camera.forward[2] = -1;
  p.camera.half_width = width / 2.0f;
  p.camera.half_height = height / 2.0f;
  p.width = width;
  p.height = height;
  p.samples_per_item = p.last_item_samples = samples;
  p.seed_low = 21;
  p.items_low = pixels * chunks;
  cl::Program program = bench_.build("#include \"kernels/camera_samples.cl\"\n");
  cl::Kernel generate(program, "camera_generate");
  cl::Buffer parameters = bench_.buffer(std::vector<kernels::PathParameters>{p});
  cl::Buffer paths = bench_.space(count * PATH_ROWS), slots = bench_.space((count + 1) * SLOT_WORDS);
  cl::Buffer nothing = bench_.space(4);
  set_arguments(generate, 0, parameters, nothing, cl_uint{0}, cl_uint{0}, cl_uint{0}, cl_uint{0}, cl_uint{0},
                cl_uint{count}, paths, slots, nothing, cl_uint{0}, cl_uint{0});
  bench_.run(generate, count);
  const auto rows = bench_.read<std::uint32_t>(paths, count * PATH_ROWS);
  const auto floats = bench_.read<float>(paths, count * PATH_ROWS);
  const auto keys_of_sequences = keys(21, pixels, pixels * 16);
  std::vector<std::vector<std::uint64_t>> used(pixels);
  for (std::uint32_t i = 0; i < count; ++i) {
    const auto row = [&](std::uint32_t r) { return (i / 16) * 16 * PATH_ROWS + r * 16 + i % 16; };
    const std::uint32_t pixel = i / samples % pixels, chunk = i / samples / pixels;
    const std::uint32_t sequence = chunk / (2 * GLEANER_PATH_SEQUENCE / samples) * 2 + chunk % 2;
    ASSERT_EQ(rows[row(ROW_KEY)], keys_of_sequences[sequence * pixels + pixel]) << "path " << i;
    const std::uint32_t sample = (rows[row(ROW_META)] >> META_SAMPLE) & META_SAMPLE_MASK;
    used[pixel].push_back(std::uint64_t{rows[row(ROW_KEY)]} << 32 | sample);
    // And the sample lies in its pixel: row 0 is the top.
    const float x = floats[row(ROW_ORIGIN)] + width / 2.0f, y = height / 2.0f - floats[row(ROW_ORIGIN + 1)];
    ASSERT_EQ(static_cast<std::uint32_t>(x), pixel % width);
    ASSERT_EQ(static_cast<std::uint32_t>(y), pixel / width);
  }
  for (auto& one : used) {
    std::sort(one.begin(), one.end());
    EXPECT_EQ(std::adjacent_find(one.begin(), one.end()), one.end());
  }
}

TEST_P(Sampling, SinesOfATurn) {
  constexpr std::size_t count = 1 << 20;
  std::vector<float> u(count);
  for (std::size_t i = 0; i < count; ++i) u[i] = static_cast<float>(i) / (count - 1);  // both ends included
  cl::Kernel kernel(program_, "turn");
  cl::Buffer in = bench_.buffer(u), s = bench_.space(count), c = bench_.space(count);
  set_arguments(kernel, 0, in, s, c);
  bench_.run(kernel, count);
  const auto sine = bench_.read<float>(s, count), cosine = bench_.read<float>(c, count);
  double worst = 0;
  for (std::size_t i = 0; i < count; ++i) {
    worst = std::max(worst, std::abs(sine[i] - std::sin(2 * M_PI * u[i])));
    worst = std::max(worst, std::abs(cosine[i] - std::cos(2 * M_PI * u[i])));
  }
  std::printf("  largest error %.2e\n", worst);
  EXPECT_LT(worst, 2e-7);
}

TEST_P(Sampling, CosineLobe) {
  constexpr std::size_t count = 1'000'000;
  cl::Kernel kernel(program_, "cosine_lobe");
  cl::Buffer x = bench_.space(count), y = bench_.space(count), z = bench_.space(count);
  set_arguments(kernel, 0, cl_uint{17}, x, y, z);
  bench_.run(kernel, count);
  const auto dx = bench_.read<float>(x, count), dy = bench_.read<float>(y, count), dz = bench_.read<float>(z, count);
  constexpr std::size_t nz = 31, nphi = 51;
  std::vector<double> seen(nz * nphi), expected(nz * nphi);
  double longest = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double length = std::sqrt(double{dx[i]} * dx[i] + double{dy[i]} * dy[i] + double{dz[i]} * dz[i]);
    longest = std::max(longest, std::abs(length - 1));
    const double turn = std::atan2(dy[i], dx[i]) / (2 * M_PI);
    const auto row = std::min<std::size_t>(static_cast<std::size_t>(nz * double{dz[i]}), nz - 1);
    const auto column = std::min<std::size_t>(static_cast<std::size_t>(nphi * (turn - std::floor(turn))), nphi - 1);
    ++seen[row * nphi + column];
  }
  // The integral of z / pi over a cell of z: (b^2 - a^2) / 2 * 2 pi / nphi / pi.
  for (std::size_t r = 0; r < nz; ++r)
    for (std::size_t k = 0; k < nphi; ++k)
      expected[r * nphi + k] = (2.0 * static_cast<double>(r) + 1) / (nz * nz * nphi);
  const ChiSquare chi = chi_square(seen, expected);
  std::printf("  chi-square %.1f of %zu degrees, p = %.3f; lengths within %.1e of 1\n", chi.statistic, chi.degrees,
              chi.p, longest);
  EXPECT_GE(chi.p, kFamily);
  EXPECT_LT(longest, 4e-7);
}

TEST_P(Sampling, Triangle) {
  constexpr std::size_t count = 1'000'000, n = 41;
  cl::Kernel kernel(program_, "triangle");
  cl::Buffer a = bench_.space(count), b = bench_.space(count);
  set_arguments(kernel, 0, cl_uint{18}, a, b);
  bench_.run(kernel, count);
  const auto b1 = bench_.read<float>(a, count), b2 = bench_.read<float>(b, count);
  std::vector<double> seen(n * n), expected(n * n);
  for (std::size_t i = 0; i < count; ++i) {
    ASSERT_GE(b1[i], 0);
    ASSERT_GE(b2[i], 0);
    ASSERT_LE(b1[i] + b2[i], 1 + 1e-6);
    ++seen[std::min<std::size_t>(static_cast<std::size_t>(n * double{b1[i]}), n - 1) * n +
           std::min<std::size_t>(static_cast<std::size_t>(n * double{b2[i]}), n - 1)];
  }
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; i + j < n; ++j) expected[i * n + j] = i + j + 1 == n ? 0.5 : 1;
  const ChiSquare chi = chi_square(seen, expected);
  std::printf("  chi-square %.1f of %zu degrees, p = %.3f\n", chi.statistic, chi.degrees, chi.p);
  EXPECT_GE(chi.p, kFamily);
}

}  // namespace
}  // namespace gleaner::test
