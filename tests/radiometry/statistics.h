#pragma once
// What tests of noisy quantities share: distributions, a t-test, a pooled chi-square test, Sidak's correction.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>
#include <vector>

namespace gleaner::test {

// Mean and standard error of independent values (Welford).
struct Sample {
  std::size_t count = 0;
  double mean = 0, square = 0;

  void add(double value) {
    const double before = value - mean;
    mean += before / static_cast<double>(++count);
    square += before * (value - mean);
  }
  double variance() const { return count > 1 ? square / static_cast<double>(count - 1) : 0; }
  double standard_error() const { return std::sqrt(variance() / static_cast<double>(count)); }
};

// Regularized upper incomplete gamma function Q(a, x): series below a + 1, Lentz's continued fraction above.
inline double gamma_q(double a, double x) {
  if (!(x > 0)) return 1;
  const double front = std::exp(-x + a * std::log(x) - std::lgamma(a));
  if (x < a + 1) {
    double term = 1 / a, sum = term;
    for (double n = a + 1; std::abs(term) > 1e-16 * std::abs(sum); ++n) sum += term *= x / n;
    return 1 - front * sum;
  }
  double b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
  for (int i = 1; i < 100000; ++i) {
    const double an = -i * (i - a);
    b += 2;
    d = 1 / (an * d + b);
    c = b + an / c;
    h *= d * c;
    if (std::abs(d * c - 1) < 1e-15) break;
  }
  return front * h;
}

// Regularized incomplete beta function I_x(a, b) by Lentz's continued fraction.
inline double beta_i(double a, double b, double x) {
  if (x <= 0) return 0;
  if (x >= 1) return 1;
  if (x > (a + 1) / (a + b + 2)) return 1 - beta_i(b, a, 1 - x);
  const double front =
      std::exp(a * std::log(x) + b * std::log1p(-x) + std::lgamma(a + b) - std::lgamma(a) - std::lgamma(b)) / a;
  constexpr double tiny = 1e-300;
  double c = 1, d = 1 / std::max(1 - (a + b) * x / (a + 1), tiny), h = d;
  for (int m = 1; m < 10000; ++m) {
    const double even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m));
    const double odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1));
    double change = 1;
    for (const double step : {even, odd}) {
      d = 1 + step * d;
      c = 1 + step / c;
      d = 1 / (std::abs(d) < tiny ? tiny : d);
      c = std::abs(c) < tiny ? tiny : c;
      h *= change = d * c;
    }
    if (std::abs(change - 1) < 1e-15) break;
  }
  return front * h;
}

// Chance that |t| is exceeded by Student's t with so many degrees of freedom.
inline double student_p(double t, double degrees) { return beta_i(degrees / 2, 0.5, degrees / (degrees + t * t)); }

// Chance that chi-square with so many degrees of freedom exceeds x.
inline double chi_square_p(double x, double degrees) { return gamma_q(degrees / 2, x / 2); }

// The level of one of `tests` independent tests that together raise a false alarm with chance `family`.
inline double sidak(double family, std::size_t tests) {
  return -std::expm1(std::log1p(-family) / static_cast<double>(tests));
}

// |t| beyond which Student's t with so many degrees of freedom lies with chance p, by bisection.
inline double student_critical(double p, double degrees) {
  double low = 0, high = 1;
  while (student_p(high, degrees) > p) high *= 2;
  for (int i = 0; i < 100; ++i) (student_p((low + high) / 2, degrees) > p ? low : high) = (low + high) / 2;
  return high;
}

struct ChiSquare {
  double statistic = 0, p = 1;
  std::size_t degrees = 0;
};

// Observed counts against expected ones (made to have the same total). Cells that expect less than 5 are pooled, the
// smallest first. Where something was seen in cells that expect nothing at all, p is 0.
inline ChiSquare chi_square(const std::vector<double>& observed, std::vector<double> expected) {
  const double seen = std::accumulate(observed.begin(), observed.end(), 0.0);
  const double total = std::accumulate(expected.begin(), expected.end(), 0.0);
  std::vector<std::size_t> order(expected.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return expected[a] < expected[b]; });
  ChiSquare result;
  double pooled_seen = 0, pooled_expected = 0;
  std::size_t cells = 0;
  const auto close = [&](double o, double e) {
    result.statistic += (o - e) * (o - e) / e;
    ++cells;
  };
  for (const std::size_t i : order) {
    const double e = expected[i] * seen / total;
    if (e >= 5 && pooled_expected == 0) {
      if (pooled_seen > 0) return {std::numeric_limits<double>::infinity(), 0, 0};
      close(observed[i], e);
      continue;
    }
    pooled_seen += observed[i];
    pooled_expected += e;
    if (pooled_expected >= 5) {
      close(pooled_seen, pooled_expected);
      pooled_seen = pooled_expected = 0;
    }
  }
  if (pooled_seen > 0 || pooled_expected > 0) close(pooled_seen, std::max(pooled_expected, 1e-300));
  result.degrees = cells > 1 ? cells - 1 : 1;
  result.p = chi_square_p(result.statistic, static_cast<double>(result.degrees));
  return result;
}

}  // namespace gleaner::test
