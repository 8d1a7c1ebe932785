// What the program says of animations and sequences that cannot be: status 3, the element, and no picture.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "tests/farm/processes.h"
#include "tests/unit/import_files.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using scene::GltfFile;
using testing::AllOf;
using testing::HasSubstr;

const fs::path programs = GLEANER_BIN_DIR;

class BadMotion : public testing::Test {
 protected:
  Ran gleaner(std::vector<std::string> words) {
    words.insert(words.begin(), (programs / "gleaner").string());
    Process process(words, folder_.path() / "gleaner");
    Ran ran;
    ran.status = process.wait();
    ran.out = process.out();
    ran.err = process.err();
    return ran;
  }
  Ran render(const fs::path& scene, const std::string& frames = "1-3") {
    return gleaner({"render", scene.string(), "-o", picture().string(), "--frames", frames, "--fps", "2", "--size",
                    "16x12", "--spp", "4", "--look-at", "0,0,4,0,0,0", "--report",
                    (folder_.path() / "report.json").string()});
  }
  fs::path picture() const { return folder_.path() / "picture.exr"; }
  bool any_picture() const {
    for (const auto& entry : fs::directory_iterator(folder_.path()))
      if (entry.path().extension() == ".exr") return true;
    return false;
  }

  TemporaryFolder folder_;
};

// A triangle on a skin of two joints, of which one turns, and which rises.
GltfFile good_file() {
  GltfFile file = scene::triangle_file();
  file.json["materials"][0]["emissiveFactor"] = {1, 1, 1};
  const std::size_t times = file.add(std::vector<float>{0, 1, 2}, 5126, "SCALAR");
  const std::size_t turns = file.add(std::vector<float>{0, 0, 0, 1, 0, 0, 0.6f, 0.8f, 0, 0, 0, 1}, 5126, "VEC4");
  const std::size_t rises = file.add(std::vector<float>{0, 0, 0, 0, 0.5f, 0, 0, 1, 0}, 5126, "VEC3");
  file.primitive()["attributes"]["JOINTS_0"] =
      file.add(std::vector<std::uint8_t>{0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0}, 5121, "VEC4");
  file.primitive()["attributes"]["WEIGHTS_0"] =
      file.add(std::vector<float>{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}, 5126, "VEC4");
  json& j = file.json;
  j["nodes"][0]["skin"] = 0;
  j["nodes"].push_back({{"name", "joint a"}});
  j["nodes"].push_back({{"name", "joint b"}});
  j["scenes"][0]["nodes"] = {0, 1, 2};
  j["skins"] = {{{"joints", {1, 2}}}};
  j["animations"] = {{{"channels",
                       {{{"sampler", 0}, {"target", {{"node", 1}, {"path", "rotation"}}}},
                        {{"sampler", 1}, {"target", {{"node", 2}, {"path", "translation"}}}}}},
                      {"samplers", {{{"input", times}, {"output", turns}}, {{"input", times}, {"output", rises}}}}}};
  return file;
}

TEST_F(BadMotion, AnAnimationThatCannotBeEndsWithStatus3) {
  struct Case {
    const char* what;
    std::function<void(GltfFile&)> damage;
    std::vector<std::string> words;
  };
  const auto animation = [](GltfFile& f) -> json& { return f.json["animations"][0]; };
  const std::vector<Case> cases = {
      {"a node that is not there",
       [&](GltfFile& f) { animation(f)["channels"][1]["target"]["node"] = 70; },
       {"animations[0].channels[1].target.node", "70"}},
      {"times that do not rise",
       [&](GltfFile& f) {
         animation(f)["samplers"][1]["input"] = f.add(std::vector<float>{0, 1, 1}, 5126, "SCALAR");
       },
       {"animations[0].samplers[1].input", "rise"}},
      {"counts that do not fit",
       [&](GltfFile& f) {
         animation(f)["samplers"][0]["output"] = f.add(std::vector<float>{0, 0, 0, 1, 0, 0, 0, 1}, 5126, "VEC4");
       },
       {"animations[0].samplers[0].output", "3 values of 4"}},
      {"a joint of the skin that is no node",
       [](GltfFile& f) { f.json["skins"][0]["joints"][1] = 9; },
       {"skins[0].joints[1]", "9"}},
      {"a vertex's joint that the skin lacks",
       [](GltfFile& f) {
         f.primitive()["attributes"]["JOINTS_0"] =
             f.add(std::vector<std::uint8_t>{0, 1, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0}, 5121, "VEC4");
       },
       {"meshes[0].primitives[0].attributes.JOINTS_0", "joints below 2"}},
      {"NaN among the values",
       [&](GltfFile& f) {
         animation(f)["samplers"][1]["output"] = f.add(std::vector<float>{0, 0, 0, 0, NAN, 0, 0, 1, 0}, 5126, "VEC3");
       },
       {"animations[0].samplers[1].output", "finite"}},
      {"NaN among the times",
       [&](GltfFile& f) {
         animation(f)["samplers"][1]["input"] = f.add(std::vector<float>{0, NAN, 2}, 5126, "SCALAR");
       },
       {"animations[0].samplers[1].input", "finite"}},
  };
  const fs::path scene = folder_.path() / "moving.glb";
  const auto write = [&](const GltfFile& file) { std::ofstream(scene, std::ios::binary) << file.glb(); };
  for (const Case& c : cases) {
    GltfFile file = good_file();
    c.damage(file);
    write(file);
    for (const Ran& ran : {render(scene), gleaner({"info", scene.string()})}) {
      EXPECT_EQ(ran.status, 3) << c.what << ": " << ran.err;
      EXPECT_THAT(ran.err, HasSubstr("moving.glb")) << c.what;
      for (const std::string& word : c.words) EXPECT_THAT(ran.err, HasSubstr(word)) << c.what;
    }
    EXPECT_FALSE(any_picture()) << c.what;
  }
  write(good_file());
  const Ran ran = render(scene);
  EXPECT_EQ(ran.status, 0) << ran.err;
  EXPECT_TRUE(any_picture());
}

// A triangle that glows, at a height of its own.
std::string glowing(double height, const std::string& more = "") {
  const std::string y = std::to_string(height), top = std::to_string(height + 1);
  return "mtllib glow.mtl\nusemtl glow\nv -1 " + y + " 0\nv 1 " + y + " 0\nv 0 " + top + " 0\nf 1 2 3\n" + more;
}

class ObjSequence : public BadMotion {
 protected:
  void SetUp() override { std::ofstream(folder_.path() / "glow.mtl") << "newmtl glow\nKd 0.5 0.5 0.5\nKe 1 2 3\n"; }
  void write(int frame, const std::string& text) {
    std::ofstream(folder_.path() / ("model_000" + std::to_string(frame) + ".obj")) << text;
  }
  std::string pixels(const std::string& report) {
    return json::parse(read_text(folder_.path() / report))["pixels_sha256"];
  }
};

TEST_F(ObjSequence, AFileThatLacksEndsWithStatus3BeforeAnythingIsRendered) {
  write(1, glowing(0));
  write(3, glowing(0.2));
  const Ran ran = render(folder_.path() / "model_####.obj");
  EXPECT_EQ(ran.status, 3) << ran.err;
  EXPECT_THAT(ran.err, AllOf(HasSubstr("model_0002.obj"), HasSubstr("frame 2")));
  EXPECT_FALSE(any_picture());
}

// Where each frame is a scene of its own, what is wrong with one is found when its turn has come.
TEST_F(ObjSequence, AFrameThatFailsDoesNotEndTheOthers) {
  for (int frame = 1; frame <= 5; ++frame) write(frame, glowing(0.1 * frame, frame == 2 ? "v 0 -1 0\nf 1 2 4\n" : ""));
  write(3, glowing(0.3, "f 1 2 9\n"));
  const Ran ran = render(folder_.path() / "model_####.obj", "1-5");
  EXPECT_EQ(ran.status, 3) << ran.err;
  EXPECT_THAT(ran.err, AllOf(HasSubstr("1 of 5 frames failed; first frame 3: "), HasSubstr("model_0003.obj")));
  for (int frame = 1; frame <= 5; ++frame)
    EXPECT_EQ(fs::exists(folder_.path() / ("picture_000" + std::to_string(frame) + ".exr")), frame != 3) << frame;
}

TEST_F(ObjSequence, EachFrameIsItsFilesPicture) {
  for (const bool same_topology : {true, false}) {
    for (int frame = 1; frame <= 3; ++frame)
      write(frame, glowing(0.3 * frame, same_topology || frame < 3 ? "" : "v 0 -1 0\nf 1 2 4\n"));
    const Ran ran = render(folder_.path() / "model_####.obj");
    ASSERT_EQ(ran.status, 0) << ran.err;
    std::vector<std::string> all;
    for (int frame = 1; frame <= 3; ++frame) all.push_back(pixels("report_000" + std::to_string(frame) + ".json"));
    EXPECT_NE(all[0], all[1]);
    for (int frame = 1; frame <= 3; ++frame) {
      const fs::path file = folder_.path() / ("model_000" + std::to_string(frame) + ".obj");
      const Ran alone =
          gleaner({"render", file.string(), "-o", (folder_.path() / "alone.exr").string(), "--size", "16x12", "--spp",
                   "4", "--look-at", "0,0,4,0,0,0", "--report", (folder_.path() / "alone.json").string()});
      ASSERT_EQ(alone.status, 0) << alone.err;
      EXPECT_EQ(all[static_cast<std::size_t>(frame - 1)], pixels("alone.json")) << "frame " << frame;
    }
  }
}

}  // namespace
}  // namespace gleaner::test
