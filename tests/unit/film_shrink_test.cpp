// Small pictures of large films.

#include "coordinator/film/shrink.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "scene/model/error.h"

namespace gleaner::test {
namespace {

using coordinator::Film;
using testing::ElementsAre;

Film ramp(std::uint32_t width, std::uint32_t height) {
  Film film{.width = width, .height = height, .channels = {}};
  float factor = 1;
  for (const char* name : {"R", "G", "B"}) {
    auto& values = film.channel(name).values;
    values.resize(std::size_t{width} * height);
    for (std::size_t k = 0; k < values.size(); ++k) values[k] = factor * static_cast<float>(k);
    factor *= 10;
  }
  film.channel("depth.Z").values.resize(std::size_t{width} * height);
  return film;
}

TEST(Shrink, PixelsAreMeansOfBlocksAndFewerAtTheEdges) {
  // 5 x 3 by blocks of 2 x 2: the last column is one pixel wide, the last row one high.
  const Film small = coordinator::shrink(ramp(5, 3), 3);
  EXPECT_EQ(small.width, 3u);
  EXPECT_EQ(small.height, 2u);
  EXPECT_THAT(small.find("R")->values, ElementsAre(3, 5, 6.5f, 10.5f, 12.5f, 14));
  EXPECT_THAT(small.find("B")->values, ElementsAre(300, 500, 650, 1050, 1250, 1400));
  EXPECT_EQ(small.find("depth.Z"), nullptr);
}

TEST(Shrink, TheLongestSideCountsAndSmallFilmsStay) {
  EXPECT_EQ(coordinator::shrink(ramp(2, 41), 10).height, 9u);  // blocks of 5
  EXPECT_EQ(coordinator::shrink(ramp(2, 41), 10).width, 1u);
  const Film same = coordinator::shrink(ramp(10, 4), 10);
  EXPECT_EQ(same.width, 10u);
  EXPECT_NE(same.find("depth.Z"), nullptr);
}

TEST(Shrink, AFilmWithoutColoursIsRefused) {
  Film film{.width = 4, .height = 4, .channels = {}};
  film.channel("Y");
  EXPECT_THROW(coordinator::shrink(film, 2), Error);
}

}  // namespace
}  // namespace gleaner::test
