// The table of methods and settings, and what is made of it.

#include "coordinator/plan/methods.h"
#include "coordinator/plan/vpl_settings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <set>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

FrameSettings frame(const std::map<std::string, std::string>& set, const std::string& method = "vpl") {
  FrameSettings settings;
  settings.method = method;
  settings.width = settings.height = 16;
  settings.set = set;
  return settings;
}

std::string refused(const FrameSettings& settings) {
  try {
    make_plan(settings, {});
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::usage);
    return error.what();
  }
  return "accepted";
}

TEST(Methods, NamesAreUniqueAndSaid) {
  std::set<std::string_view> names;
  for (const Method& method : methods()) {
    EXPECT_TRUE(names.insert(method.name).second) << method.name;
    EXPECT_FALSE(method.help.empty()) << method.name;
    EXPECT_THAT(method_names(), HasSubstr(std::string(method.name)));
    for (const Setting& setting : method.settings) {
      for (const std::string_view name : {setting.name, setting.old_name})
        EXPECT_TRUE(name.empty() || names.insert(name).second) << name;
      EXPECT_TRUE(setting.name.starts_with(std::string(method.name) + ".")) << setting.name;
      EXPECT_FALSE(setting.help.empty() || setting.usual.empty()) << setting.name;
      EXPECT_LT(setting.least, setting.most) << setting.name;
      EXPECT_THAT(settings_help(), HasSubstr(std::string(setting.help)));
    }
  }
}

// Each setting of the table takes the ends of its range, and nothing beyond them.
// Importers ask the table; whoever makes a scene otherwise is told.
TEST(Methods, InstancesAreTakenOrRefusedAsTheTableSays) {
  SceneSummary scene;
  scene.needs.instances = true;
  for (const Method& method : methods())
    if (method.takes_instances)
      EXPECT_NO_THROW(make_plan(frame({}, std::string(method.name)), scene)) << method.name;
    else
      EXPECT_THROW(make_plan(frame({}, std::string(method.name)), scene), Error) << method.name;
  EXPECT_FALSE(method_of("links").takes_instances);
}

TEST(Methods, RangesHold) {
  const auto with = [](const Setting& setting, const std::string& value) {
    return refused(frame({{std::string(setting.name), value}}));
  };
  const auto text = [](double value) {
    char buffer[40];
    std::snprintf(buffer, sizeof buffer, "%.10g", value);
    return std::string(buffer);
  };
  for (const Method& method : methods())
    for (const Setting& setting : method.settings) {
      EXPECT_EQ(with(setting, text(setting.least)), "accepted") << setting.name;
      const double above = setting.type == SettingType::real ? setting.most * 1.01 : setting.most + 1;
      for (const std::string& value : {text(above), text(setting.least - 1), std::string("x"), std::string(""),
                                       std::string("nan"), std::string("1 ")})
        EXPECT_THAT(with(setting, value), HasSubstr("--set " + std::string(setting.name) + ": expected"))
            << setting.name << " = " << value;
    }
}

TEST(Methods, ErrorsNameWhatIsKnown) {
  EXPECT_THAT(refused(frame({}, "magic")), HasSubstr("--method: expected " + method_names() + ", found magic"));
  const std::string unknown = refused(frame({{"vpl.size", "3"}}));
  EXPECT_THAT(unknown, HasSubstr("--set vpl.size: no such setting"));
  EXPECT_THAT(unknown, HasSubstr("depth"));
  EXPECT_THAT(unknown, HasSubstr("vpl.residual_threshold"));
  // A setting of another method is no error, a malformed one is.
  EXPECT_EQ(refused(frame({{"vpl.count", "100"}}, "path")), "accepted");
  EXPECT_THAT(refused(frame({{"vpl.count", "many"}}, "path")), HasSubstr("--set vpl.count: expected a whole number"));
  EXPECT_THAT(refused(frame({{"vpl.samples", "12"}})), HasSubstr("power of two"));
}

TEST(Methods, OldNamesAreUnderstoodWithAWarning) {
  std::map<std::string, std::string> set = {{"vpl.sets", "2"}, {"vpl.doubt", "0.1"}, {"vpl.count", "100"}};
  EXPECT_THAT(rename_old_settings(set), ElementsAre(HasSubstr("vpl.sets is now called vpl.passes"),
                                                    HasSubstr("vpl.doubt is now called vpl.residual_threshold")));
  EXPECT_EQ(set, (std::map<std::string, std::string>{
                     {"vpl.passes", "2"}, {"vpl.residual_threshold", "0.1"}, {"vpl.count", "100"}}));
  EXPECT_TRUE(rename_old_settings(set).empty());
  for (const auto& [old_name, name] : {std::pair{"vpl.sets", "vpl.passes"},
                                       {"vpl.draw", "vpl.random_representative"},
                                       {"vpl.doubt", "vpl.residual_threshold"},
                                       {"vpl.least", "vpl.contribution_cutoff"}}) {
    EXPECT_EQ(make_plan(frame({{old_name, "1"}}), {})->parameters_json(),
              make_plan(frame({{name, "1"}}), {})->parameters_json())
        << old_name;
    EXPECT_THAT(refused(frame({{old_name, "1"}, {name, "1"}})), HasSubstr("expected one of them"));
  }
}

// Who sets all counts gets the error that they stand for; other frames weigh it against the noise of their samples.
TEST(Methods, CountsThatAreSetHaveASmallResidualThreshold) {
  const auto threshold = [](std::map<std::string, std::string> set, std::uint32_t spp) {
    FrameSettings settings = frame(std::move(set));
    settings.spp = spp;
    return make_vpl_settings(settings).residual_threshold;
  };
  const std::map<std::string, std::string> counts = {
      {"vpl.count", "1000"}, {"vpl.clusters", "100"}, {"vpl.point_clusters", "100"}};
  for (const std::uint32_t spp : {4u, 64u, 1024u}) EXPECT_EQ(threshold(counts, spp), 0.02);
  for (const auto& [missing, value] : counts) {
    std::map<std::string, std::string> some = counts;
    some.erase(missing);
    EXPECT_EQ(threshold(some, 4), 0.2);
    EXPECT_EQ(threshold(some, 64), 0.025);
  }
  std::map<std::string, std::string> all = counts;
  all["vpl.residual_threshold"] = "0.3";
  EXPECT_EQ(threshold(all, 64), 0.3);
}

TEST(Methods, ReferencePageIsUpToDate) {
  std::ifstream file(GLEANER_SOURCE_DIR "/docs/reference/settings.md");
  const std::string page{std::istreambuf_iterator<char>(file), {}};
  EXPECT_EQ(page, settings_page()) << "build/bin/gleaner methods --markdown > docs/reference/settings.md";
}

}  // namespace
}  // namespace gleaner::coordinator
