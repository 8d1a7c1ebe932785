// Where rays of a record of radiance cache splatting pass through the strata of its hemisphere
// (kernels/splat/strata.h).

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "tests/kernels/kernel_bench.h"

namespace gleaner::test {
namespace {

constexpr const char* kText = R"CL(
#include "kernels/splat/strata.h"
#include "kernels/wide.h"

kernel void strata(uint record, uint polar, uint azimuthal, global float* a, global float* b) {
  vu i = (vu)((uint)get_global_id(0) * LANES) + lane_index();
  vf u0, u1;
  stratum_sample(hash_u((vu)record), i, polar, azimuthal, &u0, &u1);
  scatter_f(a, i, u0);
  scatter_f(b, i, u1);
}
)CL";

struct Points {
  std::vector<float> u0, u1;
};

class Strata : public ::testing::TestWithParam<unsigned> {
 protected:
  Strata() : bench_(GetParam()), program_(bench_.build(kText)) {}

  Points points(cl_uint record, cl_uint polar, cl_uint azimuthal) {
    const std::size_t count = std::size_t{polar} * azimuthal;
    cl::Kernel kernel(program_, "strata");
    cl::Buffer a = bench_.space(count), b = bench_.space(count);
    set_arguments(kernel, 0, record, polar, azimuthal, a, b);
    bench_.run(kernel, count);
    return {bench_.read<float>(a, count), bench_.read<float>(b, count)};
  }

  KernelBench bench_;
  cl::Program program_;
};

INSTANTIATE_TEST_SUITE_P(Lanes, Strata, ::testing::Values(1u, 16u),
                         [](const auto& lanes) { return "LANES" + std::to_string(lanes.param); });

// The most points that a cell of a grid of `columns` by `rows` has. Places in a stratum are multiples of 2^-14 of it,
// which a division may have rounded.
std::size_t fullest(const Points& points, std::size_t columns, std::size_t rows) {
  std::vector<std::size_t> cells(columns * rows);
  const auto cell = [](float u, std::size_t count) {
    return std::min(count - 1, static_cast<std::size_t>(double{u} * static_cast<double>(count) + 1e-5));
  };
  for (std::size_t i = 0; i < points.u0.size(); ++i)
    ++cells[cell(points.u1[i], rows) * columns + cell(points.u0[i], columns)];
  return *std::ranges::max_element(cells);
}

// A (0, m, 2)-net in base 2 (Niederreiter 1987): every grid of 2^k by 2^(m-k) cells has one point a cell.
TEST_P(Strata, OfPowersOfTwoHaveANet) {
  const struct {
    cl_uint polar, azimuthal;
  } grids[] = {{4, 16}, {8, 32}, {16, 64}, {32, 128}, {8, 16}, {16, 32}, {1, 16}};
  for (const auto& [polar, azimuthal] : grids)
    for (cl_uint record = 1; record <= 20; ++record) {
      const Points found = points(record, polar, azimuthal);
      const std::size_t count = found.u0.size();
      for (std::size_t columns = 1; columns <= count; columns *= 2)
        ASSERT_EQ(fullest(found, columns, count / columns), 1u) << polar << " x " << azimuthal << ", record " << record
                                                                << ", cells " << columns << " x " << count / columns;
    }
}

// Whatever the grid: each stratum its own ray, everywhere in it over many records.
TEST_P(Strata, HaveARayEach) {
  const struct { cl_uint polar, azimuthal; } grids[] = {{6, 16}, {7, 48}, {3, 80}, {8, 32}};
  for (const auto& [polar, azimuthal] : grids) {
    double sum0 = 0, sum1 = 0, square0 = 0, square1 = 0;
    constexpr cl_uint records = 200;
    for (cl_uint record = 1; record <= records; ++record) {
      const Points found = points(record, polar, azimuthal);
      ASSERT_EQ(fullest(found, azimuthal, polar), 1u) << polar << " x " << azimuthal << ", record " << record;
      // One stratum of each record: rays of a record are no independent samples.
      const std::size_t at = (record * 7919u) % found.u0.size();
      const double x = double{found.u0[at]} * azimuthal - static_cast<double>(at % azimuthal),
                   y = double{found.u1[at]} * polar - static_cast<double>(at / azimuthal);
      sum0 += x, sum1 += y, square0 += x * x, square1 += y * y;
    }
    // Of uniform numbers, by 4 standard errors.
    EXPECT_NEAR(sum0 / records, 0.5, 4 * std::sqrt(1.0 / 12 / records)) << polar << " x " << azimuthal;
    EXPECT_NEAR(sum1 / records, 0.5, 4 * std::sqrt(1.0 / 12 / records)) << polar << " x " << azimuthal;
    EXPECT_NEAR(square0 / records, 1.0 / 3, 4 * std::sqrt(4.0 / 45 / records)) << polar << " x " << azimuthal;
    EXPECT_NEAR(square1 / records, 1.0 / 3, 4 * std::sqrt(4.0 / 45 / records)) << polar << " x " << azimuthal;
  }
}

}  // namespace
}  // namespace gleaner::test
