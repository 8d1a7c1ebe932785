// A session's page without its farm: what it is given, what it may say, and who may come.

#include "cli/viewer/viewer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <httplib.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <future>
#include <nlohmann/json.hpp>
#include <optional>
#include <regex>
#include <thread>
#include <vector>

#include "cli/viewer/viewer_files.h"
#include "coordinator/web/page_file.h"
#include "scene/library/library.h"
#include "scene/model/edited_scene.h"
#include "scene/model/error.h"

namespace gleaner::test {
namespace {

namespace pb = gleaner::v1;
using cli::Viewer;
using cli::ViewerScene;
using nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

constexpr const char* markup = "<img src=x onerror=alert(1)>";

ViewerScene lamps() {
  scene::Scene scene = scene::make_scene("punctual-lights", {});
  scene.material_names.front() = markup;
  coordinator::FrameSettings settings;
  settings.width = 4;
  settings.height = 2;
  settings.camera = scene.cameras.front().camera;
  const std::uint32_t matrix = scene::make_movable(scene, "red sphere");
  return {scene, "lamps.glb", settings, {{"red sphere", matrix}}};
}

pb::SessionPicture picture(std::uint64_t shows, char value) {
  pb::SessionPicture picture;
  picture.set_shows(shows);
  picture.set_width(4);
  picture.set_height(2);
  picture.set_format(pb::PICTURE_FORMAT_RGB8);
  picture.set_picture(std::string(24, value));
  picture.set_samples_per_pixel(1);
  picture.add_reused("links.make");
  return picture;
}

class ViewerPage : public testing::Test {
 protected:
  ViewerPage() {
    const std::string url = viewer_.url();
    std::smatch parts;
    EXPECT_TRUE(std::regex_match(url, parts, std::regex("(http://127\\.0\\.0\\.1:[0-9]+)(/[0-9a-f]{32}/)"))) << url;
    server_ = parts[1];
    folder_ = parts[2];
  }
  httplib::Client client() const {
    httplib::Client client(server_);
    client.set_read_timeout(20);
    return client;
  }
  httplib::Result get(const std::string& path) const { return client().Get(folder_ + path); }
  httplib::Result say(const json& words) const { return say(words.dump()); }
  httplib::Result say(const std::string& words) const {
    return client().Post(folder_ + "change", words, "application/json");
  }
  json scene() const { return json::parse(get("scene.json")->body); }
  static json words_of(const httplib::Result& answer) {
    return json::parse(answer->get_header_value("Gleaner-Picture"));
  }

  std::vector<pb::SessionChange> said_;
  Viewer viewer_{"127.0.0.1:0", lamps(), [this](pb::SessionChange change) { said_.push_back(std::move(change)); }};
  std::string server_, folder_;
};

TEST(ViewerFiles, AskNoOtherServerAndSetTextAlone) {
  for (const auto* files : {&cli::viewer_files(), &web::common_files()})
    for (const web::PageFile& file : *files) {
      std::string text(file.text);
      if (const auto at = text.find("http://www.w3.org/2000/svg"); at != std::string::npos) text.erase(at, 26);
      for (const char* word : {"http:", "https:", "@import", "url(", "innerHTML", "outerHTML", "insertAdjacentHTML",
                               "document.write", "eval(", "new Function", "style=\"", "<style", "onclick=", "<script>"})
        EXPECT_THAT(text, Not(HasSubstr(word))) << file.path;
    }
}

TEST_F(ViewerPage, IsThereForWhoKnowsTheAddress) {
  EXPECT_THAT(get("")->body, HasSubstr("<title>Gleaner session</title>"));
  for (const char* file : {"viewer.js", "camera.js", "viewer.css", "base.css", "icon.svg"})
    EXPECT_EQ(get(file)->status, 200) << file;
  EXPECT_EQ(get("scene.json")->status, 200);
  EXPECT_EQ(get("nothing")->status, 404);
}

TEST_F(ViewerPage, AndForNobodyElse) {
  std::string wrong = folder_;
  wrong[1] = wrong[1] == '0' ? '1' : '0';
  for (const std::string& folder :
       {std::string("/"), wrong, folder_.substr(0, folder_.size() - 2) + "/", std::string("//")})
    for (const char* path : {"", "viewer.js", "scene.json", "picture?after=0"}) {
      const auto answer = client().Get(folder + path);
      ASSERT_TRUE(answer);
      EXPECT_EQ(answer->status, 404) << folder << path;
      EXPECT_THAT(answer->body, Not(HasSubstr(folder_.substr(1, 32))));
    }
  const std::string change = R"({"lights": [{"light": 0, "position": [1, 2, 3]}]})";
  EXPECT_EQ(client().Post(wrong + "change", change, "application/json")->status, 404);
  EXPECT_EQ(client().Post("/change", change, "application/json")->status, 404);
  // With the address, but from another site's page, or by its name.
  EXPECT_EQ(client().Post(folder_ + "change", {{"Origin", "http://evil.example"}}, change, "application/json")->status,
            403);
  EXPECT_EQ(client().Post(folder_ + "change", change, "text/plain")->status, 415);
  EXPECT_EQ(client().Get(folder_ + "scene.json", {{"Host", "evil.example:80"}})->status, 403);
  EXPECT_TRUE(said_.empty());
  // Another session has another word.
  const Viewer other("127.0.0.1:0", lamps(), [](const pb::SessionChange&) {});
  EXPECT_THAT(other.url(), Not(HasSubstr(folder_)));
}

TEST_F(ViewerPage, TellsTheSceneAsItIsByNow) {
  const json before = scene();
  EXPECT_EQ(before.at("name"), "lamps.glb");
  EXPECT_EQ(before.at("size"), json({4, 2}));
  ASSERT_EQ(before.at("lights").size(), 3u);
  EXPECT_EQ(before["lights"][0]["type"], "point");
  EXPECT_EQ(before["lights"][1]["type"], "spot");
  EXPECT_EQ(before["lights"][2]["type"], "directional");
  EXPECT_EQ(before["materials"][0]["name"], markup);
  EXPECT_GT(before.at("radius").get<double>(), 0);
  EXPECT_EQ(before.at("change"), 0);
  const auto answer = say(json{{"lights", {{{"light", 1}, {"position", {1, 2, 3}}}}},
                               {"materials", {{{"material", 0}, {"base_color", {0.25, 0.5, 1}}}}}});
  EXPECT_EQ(answer->status, 200);
  EXPECT_EQ(json::parse(answer->body).at("change"), 1);
  const json after = scene();
  EXPECT_EQ(after["lights"][1]["position"], json({1, 2, 3}));
  EXPECT_EQ(after["lights"][1]["intensity"], before["lights"][1]["intensity"]);
  EXPECT_EQ(after["lights"][0], before["lights"][0]);
  EXPECT_EQ(after["materials"][0]["base_color"], json({0.25, 0.5, 1}));
  EXPECT_EQ(after.at("change"), 1);
}

TEST_F(ViewerPage, ChangesGoOutAsTheSessionTakesThem) {
  say(json{{"lights",
            {{{"light", 0}, {"position", {1, 2, 3}}, {"intensity", {4, 5, 6}}},
             {{"light", 2}, {"direction", {0, -2, 0}}}}}});
  say(json{{"materials", {{{"material", 1}, {"emission", {7, 8, 9}}}}}});
  ASSERT_EQ(said_.size(), 2u);
  EXPECT_EQ(said_[0].number(), 1u);
  EXPECT_EQ(said_[1].number(), 2u);
  ASSERT_EQ(said_[0].lights_size(), 2);
  EXPECT_EQ(said_[0].lights(0).position().z(), 3);
  EXPECT_EQ(said_[0].lights(0).intensity().x(), 4);
  EXPECT_FALSE(said_[0].lights(0).has_direction());
  EXPECT_EQ(said_[0].lights(1).light(), 2u);
  EXPECT_FALSE(said_[0].has_camera());
  EXPECT_EQ(said_[1].materials(0).emission().y(), 8);
  EXPECT_FALSE(said_[1].materials(0).has_base_color());
}

TEST_F(ViewerPage, ObjectsMoveByTheMiddleOfTheirBounds) {
  const json before = scene()["objects"];
  ASSERT_EQ(before.size(), 1u);
  EXPECT_EQ(before[0]["name"], "red sphere");
  const auto rest = before[0]["position"].get<std::vector<double>>();
  // What the page says is where the middle is to be; what goes out is how far from where it stood at first.
  for (const double by : {0.25, -1.0}) {
    EXPECT_EQ(
        say(json{{"objects", {{{"object", 0}, {"position", {rest[0] + by, rest[1], rest[2] - 2 * by}}}}}})->status,
        200);
    const pb::ObjectChange& moved = said_.back().objects(0);
    ASSERT_EQ(moved.placement_size(), 12);
    EXPECT_EQ(moved.matrix(), 0u);
    const std::array<double, 12> expected = {1, 0, 0, by, 0, 1, 0, 0, 0, 0, 1, -2 * by};
    for (int k = 0; k < 12; ++k) EXPECT_NEAR(moved.placement(k), expected[static_cast<std::size_t>(k)], 1e-6) << k;
    const auto now = scene()["objects"][0]["position"].get<std::vector<double>>();
    EXPECT_NEAR(now[0], rest[0] + by, 1e-6);
    EXPECT_NEAR(now[2], rest[2] - 2 * by, 1e-6);
  }
}

// Whatever axes a page computes, the session gets unit ones at right angles: it refuses others.
TEST_F(ViewerPage, CamerasAreMadeRightAngled) {
  const json before = scene()["camera"];
  EXPECT_EQ(say(json{{"camera", {{"origin", {1, 2, 3}}, {"forward", {0, 0, -5}}, {"up", {0.1, 1, 0.3}}}}})->status,
            200);
  ASSERT_EQ(said_.size(), 1u);
  const pb::Camera& camera = said_[0].camera();
  EXPECT_EQ(camera.origin().y(), 2);
  EXPECT_EQ(camera.forward().z(), -1);
  EXPECT_NEAR(camera.right().x() * camera.up().x() + camera.right().y() * camera.up().y(), 0, 1e-6);
  EXPECT_NEAR(std::hypot(camera.up().x(), camera.up().y()), 1, 1e-6);
  EXPECT_NEAR(camera.up().z(), 0, 1e-6);
  EXPECT_GT(camera.up().y(), 0.9);
  EXPECT_GT(camera.right().x(), 0.9);
  EXPECT_NEAR(std::hypot(camera.right().x(), camera.right().y(), camera.right().z()), 1, 1e-6);
  EXPECT_EQ(scene()["camera"]["half_width"], before["half_width"]);
  EXPECT_EQ(scene()["camera"]["origin"], json({1, 2, 3}));
}

TEST_F(ViewerPage, WhatIsNoChangeIsRefusedWholly) {
  const json before = scene();
  const std::vector<std::string> wrong = {
      "", "{", "[]", "7", "null", R"({"lights": 1})", R"({"lights": [1]})", R"({"lights": [{}]})",
      R"({"lights": [{"light": 3, "position": [0, 0, 0]}]})", R"({"lights": [{"light": -1, "position": [0, 0, 0]}]})",
      R"({"lights": [{"light": 0.5, "position": [0, 0, 0]}]})", R"({"lights": [{"light": 0, "position": [0, 0]}]})",
      R"({"lights": [{"light": 0, "position": [0, 0, "1"]}]})",
      R"({"lights": [{"light": 0, "position": [1e30, 0, 0]}]})",
      R"({"lights": [{"light": 0, "position": [1e999, 0, 0]}]})",
      R"({"lights": [{"light": 0, "intensity": [-1, 0, 0]}]})", R"({"lights": [{"light": 0, "direction": [0, 0, 0]}]})",
      R"({"lights": [{"light": 18446744073709551616, "position": [0, 0, 0]}]})",
      R"({"materials": [{"material": 0, "base_color": [2, 0, 0]}]})",
      R"({"materials": [{"material": 99, "emission": [2, 0, 0]}]})", R"({"camera": 1})",
      R"({"objects": [{"object": 0}]})", R"({"objects": [{"object": 1, "position": [0, 0, 0]}]})",
      R"({"objects": [{"object": 0, "position": [1e30, 0, 0]}]})", R"({"camera": {"origin": [0, 0, 0]}})",
      R"({"camera": {"origin": [0, 0, 0], "forward": [0, 0, 0], "up": [0, 1, 0]}})",
      R"({"camera": {"origin": [0, 0, 0], "forward": [0, 1, 0], "up": [0, 1, 0]}})",
      R"({"camera": {"origin": [1e30, 0, 0], "forward": [0, 0, 1], "up": [0, 1, 0]}})",
      // The first part is right.
      R"({"lights": [{"light": 0, "position": [9, 9, 9]}, {"light": 7, "position": [0, 0, 0]}]})"};
  for (const std::string& words : wrong) {
    const auto answer = say(words);
    ASSERT_TRUE(answer) << words;
    EXPECT_EQ(answer->status, 400) << words;
    EXPECT_FALSE(json::parse(answer->body).at("refused").get<std::string>().empty()) << words;
  }
  EXPECT_TRUE(said_.empty());
  EXPECT_EQ(scene(), before);
}

TEST_F(ViewerPage, ThePictureIsTheNewestOne) {
  viewer_.show(picture(0, 'a'));
  viewer_.show(picture(1, 'b'));
  const auto first = get("picture?after=0");
  ASSERT_TRUE(first);
  EXPECT_EQ(first->status, 200);
  EXPECT_EQ(first->body, std::string(24, 'b'));
  const json words = words_of(first);
  EXPECT_EQ(words.at("shows"), 1);
  EXPECT_EQ(words.at("width"), 4);
  EXPECT_EQ(words.at("reused"), json({"links.make"}));
  EXPECT_FALSE(words.contains("refused"));
  // Who has it waits for the next one.
  const std::string next = "picture?after=" + words.at("number").dump();
  auto waits = std::async(std::launch::async, [&] { return get(next)->body; });
  EXPECT_EQ(waits.wait_for(std::chrono::milliseconds(200)), std::future_status::timeout);
  viewer_.show(picture(2, 'c'));
  EXPECT_EQ(waits.get(), std::string(24, 'c'));
  // A page of an older session at this address has seen more than there is.
  EXPECT_EQ(get("picture?after=1000")->status, 200);
  for (const char* after : {"x", "-1", "1x", ""})
    EXPECT_EQ(get(std::string("picture?after=") + after)->status, 400) << after;
}

TEST_F(ViewerPage, WhyAChangeWasRefusedIsToldOnce) {
  viewer_.show(picture(0, 'a'));
  pb::SessionPicture refusal;
  refusal.set_received(1);
  refusal.set_refused(std::string("no, ") + markup + std::string(5000, 'x'));
  viewer_.show(refusal);
  const json words = words_of(get("picture?after=1"));
  EXPECT_THAT(words.at("refused"), testing::StartsWith("no, <img"));
  EXPECT_LE(words.at("refused").get<std::string>().size(), 1000u);
  viewer_.show(picture(0, 'a'));
  EXPECT_FALSE(words_of(get("picture?after=" + words.at("number").dump())).contains("refused"));
}

TEST_F(ViewerPage, APictureOfAnotherSizeThanItSaysEndsTheSession) {
  pb::SessionPicture wrong = picture(0, 'a');
  wrong.set_width(5);
  EXPECT_THROW(viewer_.show(wrong), Error);
}

// Pages that wait take threads; changes still come through, and so does the end.
TEST_F(ViewerPage, ManyPagesThatWaitHoldUpNeitherChangesNorTheEnd) {
  std::vector<std::future<int>> pages;
  for (int k = 0; k < 20; ++k)
    pages.push_back(std::async(std::launch::async, [&] { return get("picture?after=0")->status; }));
  // Nothing is shown yet: who has an answer was refused, since all seats are taken.
  const auto answered = [](const std::future<int>& page) {
    return page.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  };
  while (std::ranges::none_of(pages, answered)) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  EXPECT_EQ(say(json{{"lights", {{{"light", 0}, {"position", {1, 2, 3}}}}}})->status, 200);
  viewer_.show(picture(1, 'a'));
  int shown = 0, refused = 0;
  for (auto& page : pages) {
    const int status = page.get();
    shown += status == 200;
    refused += status == 503;
  }
  EXPECT_EQ(shown + refused, 20);
  EXPECT_GE(shown, 8);
  EXPECT_GT(refused, 0);
  std::optional<Viewer> other(std::in_place, "127.0.0.1:0", lamps(), [](const pb::SessionChange&) {});
  const std::string url = other->url();
  auto waits = std::async(std::launch::async, [&] {
    httplib::Client one(url.substr(0, url.find('/', 7)));
    one.set_read_timeout(20);
    const auto answer = one.Get(url.substr(url.find('/', 7)) + "picture?after=0");
    return answer ? answer->status : 0;
  });
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  const auto begun = std::chrono::steady_clock::now();
  other.reset();
  EXPECT_EQ(waits.get(), 204);
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(5));
}

}  // namespace
}  // namespace gleaner::test
