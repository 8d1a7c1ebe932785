// Sequences of OBJ files: one moving mesh where the topology stays, a scene a frame where it does not.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "scene/import/import.h"
#include "scene/import/sequence.h"
#include "scene/model/error.h"
#include "tests/unit/import_files.h"

namespace gleaner::scene {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// A bent strip that sways with the frame's number, with normals; as many quads as told.
std::string strip(double frame, int quads = 4, double east = 0) {
  std::string text = "mtllib no.mtl\nusemtl cloth\n";
  for (int i = 0; i <= quads; ++i) {
    const double x = 0.3 * i + east, y = std::sin(0.7 * i + 0.9 * frame), slope = std::cos(0.7 * i + 0.9 * frame);
    for (const double z : {0.0, 1.0})
      text += "v " + std::to_string(x) + " " + std::to_string(y) + " " + std::to_string(z) + "\nvn " +
              std::to_string(-slope) + " 1 0.1\n";
  }
  for (int i = 0; i < quads; ++i) {
    const auto corner = [](int c) { return std::to_string(c) + "//" + std::to_string(c); };
    if (i == quads / 2) text += "g second half, of the same vertices\n";
    text += "f " + corner(2 * i + 1) + " " + corner(2 * i + 2) + " " + corner(2 * i + 4) + "\nf " + corner(2 * i + 1) +
            " " + corner(2 * i + 4) + " " + corner(2 * i + 3) + "\n";
  }
  return text;
}

class ImportSequence : public testing::Test {
 protected:
  std::string pattern() const { return folder_.path("model_####.obj"); }
  static ImportOptions frames(std::uint32_t first, std::uint32_t last, std::uint32_t step = 1) {
    ImportOptions options;
    options.frames = FrameNumbers{first, last, step};
    return options;
  }
  std::string refused(const ImportOptions& options, ErrorKind kind) const {
    try {
      MovingScene(pattern(), options);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), kind);
      return error.what();
    }
    return "";
  }

  Folder folder_;
};

TEST_F(ImportSequence, FramesOfOneTopologyAreStatesOfABase) {
  for (const int frame : {3, 5, 7}) folder_.write("model_000" + std::to_string(frame) + ".obj", strip(frame));
  MovingScene file(pattern(), frames(3, 7, 2));
  EXPECT_TRUE(file.moves());
  EXPECT_TRUE(file.is_sequence());
  EXPECT_EQ(file.base().rig.targets.size(), 3u);
  for (const int frame : {7, 3, 5}) {
    const auto shown = file.at(frame);
    ASSERT_TRUE(shown);
    const Scene scene = posed(file.base(), shown->state, "a test");
    const Scene alone = import_scene(folder_.path("model_000" + std::to_string(frame) + ".obj"));
    EXPECT_EQ(scene.positions, alone.positions) << "to the bit";
    ASSERT_EQ(scene.normals.size(), alone.normals.size());
    for (std::size_t i = 0; i < scene.normals.size(); ++i) EXPECT_NEAR(scene.normals[i], alone.normals[i], 1e-7);
    EXPECT_EQ(file.scene_at(frame).positions, scene.positions);
  }
  EXPECT_NE(file.scene_at(3).positions, file.scene_at(5).positions);
}

TEST_F(ImportSequence, FramesOfOtherTopologiesAreScenesOfTheirOwn) {
  folder_.write("model_0001.obj", strip(1));
  folder_.write("model_0002.obj", strip(2, 6));
  MovingScene file(pattern(), frames(1, 2));
  EXPECT_TRUE(file.moves());
  EXPECT_TRUE(file.base().rig.empty());
  EXPECT_FALSE(file.at(1));
  EXPECT_EQ(file.scene_at(1).triangle_count(), 8u);
  EXPECT_EQ(file.scene_at(2).triangle_count(), 12u);
  ASSERT_FALSE(file.scene_at(2).cameras.empty());
  EXPECT_EQ(file.scene_at(2).cameras[0].camera.origin[0], file.base().cameras[0].camera.origin[0])
      << "the first frame's camera sees all";
}

TEST_F(ImportSequence, AFileThatLacksIsNamed) {
  folder_.write("model_0001.obj", strip(1));
  folder_.write("model_0003.obj", strip(3));
  EXPECT_THAT(refused(frames(1, 3), ErrorKind::bad_input), AllOf(HasSubstr("model_0002.obj"), HasSubstr("frame 2")));
  EXPECT_EQ(refused(frames(1, 3, 2), ErrorKind::bad_input), "");
  EXPECT_THAT(refused({}, ErrorKind::usage), HasSubstr("--frames"));
  folder_.write("model_0002.obj", "v 0 0 zero\n");
  EXPECT_THAT(refused(frames(1, 3), ErrorKind::bad_input), AllOf(HasSubstr("model_0002.obj"), HasSubstr("zero")));
}

TEST_F(ImportSequence, FarFromTheOriginAllFramesHaveOneOrigin) {
  for (const int frame : {1, 2})
    folder_.write("model_000" + std::to_string(frame) + ".obj", strip(0, 4, 1e6 + 3 * (frame - 1)));
  MovingScene file(pattern(), frames(1, 2));
  const Scene first = file.scene_at(1), second = file.scene_at(2);
  EXPECT_GT(file.base().origin[0], 9e5);
  EXPECT_NEAR(second.positions[0] - first.positions[0], 3, 1e-5) << "it has moved";
}

TEST_F(ImportSequence, ANumberHasAsManyDigitsAsItNeeds) {
  EXPECT_EQ(file_of_frame("a#b/m_##.obj", 7), "a#b/m_07.obj");
  EXPECT_EQ(file_of_frame("m_##.obj", 123), "m_123.obj");
  EXPECT_EQ(file_of_frame("#-m_###.obj", 12), "12-m_012.obj");
  EXPECT_TRUE(is_sequence(folder_.path("m_#.obj")));
  EXPECT_FALSE(is_sequence(folder_.path("m.obj")));
  folder_.write("m_#.obj", strip(1));
  EXPECT_FALSE(is_sequence(folder_.path("m_#.obj"))) << "a file of that name is itself";
}

}  // namespace
}  // namespace gleaner::scene
