#include "coordinator/film/exposure.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

namespace gleaner::coordinator {
namespace {

// What the darkest grey but black of 8 bits needs, and what white does (write.cpp: encode_png).
constexpr double kLeastGrey = 0.5 / 255 / 12.92, kWhite = 1;

std::string stops_text(double stops) {
  char text[32];
  std::snprintf(text, sizeof text, "%+.1f", stops);
  return text;
}

}  // namespace

std::string exposure_warning(const Film& film, double exposure_stops) {
  const Channel* planes[] = {film.find("R"), film.find("G"), film.find("B")};
  if (!planes[0] || !planes[1] || !planes[2] || planes[0]->values.empty()) return {};
  const double scale = std::exp2(exposure_stops);
  const std::size_t pixels = planes[0]->values.size();
  std::size_t white = 0, black = 0;
  const auto range = [&](std::size_t i) {
    return std::minmax({planes[0]->values[i], planes[1]->values[i], planes[2]->values[i]});
  };
  for (std::size_t i = 0; i < pixels; ++i) {
    const auto [least, most] = range(i);
    white += scale * double{least} >= kWhite;
    black += !(scale * double{most} >= kLeastGrey);
  }
  const std::size_t others = pixels / 1000;
  const bool all_white = white + others >= pixels, all_black = black + others >= pixels;
  if (!all_white && !all_black) return {};
  std::vector<float> levels;  // brightest channel of each pixel that has light
  for (std::size_t i = 0; i < pixels; ++i)
    if (const float most = range(i).second; most > 0 && std::isfinite(most)) levels.push_back(most);
  if (levels.empty()) return "the picture is black from end to end: no light reaches what the camera sees";
  // The middle of a white picture becomes a middle grey. Of a black one little may have light at all: the brightest
  // hundredth of that comes close to white.
  const std::size_t at = all_white ? levels.size() / 2 : levels.size() - 1 - levels.size() / 100;
  std::nth_element(levels.begin(), levels.begin() + static_cast<std::ptrdiff_t>(at), levels.end());
  const double stops = std::log2((all_white ? 0.18 : 0.5) / levels[at]);
  return std::string("the picture is ") + (all_white ? "white" : "black") + " from end to end at exposure " +
         stops_text(exposure_stops) + "; --exposure " + stops_text(stops) + " would show something";
}

}  // namespace gleaner::coordinator
