// `gleaner session --web` as people start it: the real programs, and an HTTP client in the browser's place.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <httplib.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/farm/processes.h"

namespace gleaner::test {
namespace {

using nlohmann::json;
using testing::HasSubstr;

const std::filesystem::path programs = GLEANER_BIN_DIR;

class SessionWeb : public testing::Test {
 protected:
  SessionWeb() : scene_((folder_.path() / "lamps.glb").string()) {
    Process made({(programs / "gleaner").string(), "scene", "punctual-lights", "-o", scene_}, folder_.path() / "scene");
    EXPECT_EQ(made.wait(), 0) << made.err();
  }
  std::unique_ptr<Process> begin(const std::vector<std::string>& words, const std::string& coordinator = {}) {
    std::vector<std::string> all = {
        (programs / "gleaner").string(), "session", scene_, "--size", "16x16", "--refine", "0", "--quiet"};
    all.insert(all.end(), words.begin(), words.end());
    return std::make_unique<Process>(all, folder_.path() / std::string("session").append(std::to_string(begun_++)),
                                     std::map<std::string, std::string>{{"GLEANER_COORDINATOR", coordinator}});
  }
  // The page's address, cut where its folder begins.
  static std::pair<std::string, std::string> address_of(Process& session) {
    EXPECT_TRUE(eventually([&] { return session.out().ends_with("/\n") || !session.running(); }, 60)) << session.err();
    const std::string url = session.out().substr(0, session.out().find('\n'));
    const std::size_t folder = url.find('/', std::string("http://").size());
    if (folder == std::string::npos) return {};
    return {url.substr(0, folder), url.substr(folder)};
  }
  // The exit status; -1: it does not end.
  static int end_of(Process& session) {
    return eventually([&] { return !session.running(); }, 60) ? session.wait() : -1;
  }
  // A picture that shows the change, whatever comes before it.
  static json picture_of(httplib::Client& client, const std::string& folder, std::uint64_t change) {
    json words = {{"number", 0}};
    for (int tried = 0; tried < 60; ++tried) {
      const auto answer = client.Get(folder + "picture?after=" + words["number"].dump());
      if (!answer) return httplib::to_string(answer.error());
      if (answer->status != 200) continue;
      EXPECT_EQ(answer->body.size(), 16u * 16 * 3);
      words = json::parse(answer->get_header_value("Gleaner-Picture"));
      if (words.at("shows") == change) return words;
    }
    return "none";
  }
  void talk(Process& session) {
    const auto [server, folder] = address_of(session);
    ASSERT_FALSE(server.empty()) << session.err();
    httplib::Client client(server);
    client.set_read_timeout(60);
    EXPECT_TRUE(picture_of(client, folder, 0).is_object());
    const auto said =
        client.Post(folder + "change", R"({"lights": [{"light": 0, "position": [0, 2, 0]}]})", "application/json");
    ASSERT_TRUE(said);
    EXPECT_EQ(said->status, 200);
    const json words = picture_of(client, folder, 1);
    ASSERT_TRUE(words.is_object()) << words;
    EXPECT_THAT(words.at("reused"), testing::Contains("links.make"));
    // Lights that move keep the links: nothing that makes them has run.
    EXPECT_THAT(words.at("made"), testing::Not(testing::Contains("links.make")));
    session.signal(SIGINT);
    EXPECT_EQ(end_of(session), 0) << session.err();
    EXPECT_EQ(session.err(), "");
  }

  TemporaryFolder folder_;
  std::string scene_;
  int begun_ = 0;
};

TEST_F(SessionWeb, WithAFarmOfItsOwn) { talk(*begin({"--web"})); }

TEST_F(SessionWeb, WithACoordinator) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  farm.add_worker("w");
  ASSERT_TRUE(farm.wait_for_workers(1));
  talk(*begin({"--web", "127.0.0.1:0"}, farm.address()));
}

TEST_F(SessionWeb, ACoordinatorThatGoesEndsIt) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  farm.add_worker("w");
  const auto session = begin({"--web"}, farm.address());
  ASSERT_FALSE(address_of(*session).first.empty()) << session->err();
  farm.coordinator().signal(SIGKILL);
  EXPECT_EQ(end_of(*session), 4) << session->err();  // no connection
}

TEST_F(SessionWeb, IsForThisMachineUnlessSomebodySaysOtherwise) {
  const auto refused = begin({"--web", "0.0.0.0:0"});
  EXPECT_EQ(end_of(*refused), 2);
  EXPECT_THAT(refused->err(), HasSubstr("--insecure"));
  const auto open = begin({"--web", "0.0.0.0:0", "--insecure"});
  EXPECT_THAT(address_of(*open).first, HasSubstr("0.0.0.0:"));
  const auto both = begin({"--web", "-o", "x.png"});
  EXPECT_EQ(end_of(*both), 2);
  const auto nowhere = begin({"--web=nowhere"});
  EXPECT_EQ(end_of(*nowhere), 2);
}

// What goes wrong once the session is open ends it: the farm in the process does not wait for more to be said.
TEST_F(SessionWeb, APortThatIsTakenEndsIt) {
  const auto first = begin({"--web"});
  const std::string address = address_of(*first).first.substr(std::string("http://").size());
  const auto second = begin({"--web", address});
  EXPECT_EQ(end_of(*second), 1) << second->err();
  EXPECT_THAT(second->err(), HasSubstr("cannot listen on " + address));
}

// "--web SCENE": the scene is not taken for an address.
TEST_F(SessionWeb, TheAddressMayBeMissing) {
  Process session({(programs / "gleaner").string(), "session", "--web", scene_, "--size", "16x16", "--quiet"},
                  folder_.path() / "bare", {{"GLEANER_COORDINATOR", ""}});
  EXPECT_THAT(address_of(session).first, HasSubstr("http://127.0.0.1:"));
  session.signal(SIGTERM);
  EXPECT_EQ(end_of(session), 0) << session.err();
}

}  // namespace
}  // namespace gleaner::test
