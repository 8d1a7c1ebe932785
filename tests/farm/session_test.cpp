// Sessions: a scene that somebody changes, and pictures of it, of a farm of this process's own with its devices.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "cli/embedded.h"
#include "coordinator/blobs/sha256.h"
#include "coordinator/gateway/convert.h"
#include "gleaner/v1/farm.grpc.pb.h"
#include "scene/library/library.h"
#include "scene/model/edited_scene.h"
#include "scene/model/error.h"
#include "worker/denoise/denoiser.h"

namespace gleaner::test {
namespace {

namespace pb = gleaner::v1;
using testing::Contains;
using testing::Each;
using testing::IsSupersetOf;
using testing::Not;
using testing::StartsWith;

// The Cornell box with a point light before its lamp; a box of it can be moved by matrix 0.
scene::Scene lit_box() {
  scene::Scene scene = scene::make_scene("cornell-box", {});
  scene.lights = scene::make_scene("furnace-point").lights;
  for (int k = 0; k < 3; ++k) scene.lights[0].position[k] = 0.5f * scene.cameras.front().camera.origin[k];
  scene::make_movable(scene, scene.meshes.back().name);
  return scene;
}

class Session : public testing::Test {
 protected:
  Session() : farm_(settings()), stub_(pb::Farm::NewStub(farm_.channel())) {}

  static cli::EmbeddedSettings settings() {
    cli::EmbeddedSettings settings;
    settings.device.trace = worker::TraceKind::embree;
    settings.paths = [](const std::string&, std::uint32_t) -> coordinator::FramePaths {
      ADD_FAILURE() << "a session wants no files";
      return {};
    };
    return settings;
  }

  pb::SessionRequest opening(const scene::Scene& scene, std::uint32_t refine_to = 0) {
    coordinator::FrameSettings frame;
    frame.method = "links";
    frame.width = frame.height = 32;
    frame.spp = 1;
    frame.set = {{"links.vertices", "400"}, {"links.directions", "64"}};
    frame.camera = scene.cameras.front().camera;
    frame.camera.half_width = frame.camera.half_height;
    pb::SessionRequest request;
    pb::SessionOpen& open = *request.mutable_open();
    open.set_scene_name("box");
    open.set_scene_blob(farm_.blobs().put(scene::serialize(scene)));
    *open.mutable_settings() = gateway::to_proto(frame);
    open.set_format(pb::PICTURE_FORMAT_RGB32F);
    open.set_refine_to(refine_to);
    return request;
  }

  // Says all of it, one after the other's picture, and returns the pictures; an empty one where a change was refused.
  std::vector<pb::SessionPicture> pictures(const std::vector<pb::SessionRequest>& requests) {
    grpc::ClientContext context;
    auto stream = stub_->Session(&context);
    std::vector<pb::SessionPicture> all;
    for (const pb::SessionRequest& request : requests) {
      stream->Write(request);
      EXPECT_TRUE(stream->Read(&all.emplace_back()));
    }
    stream->WritesDone();
    pb::SessionPicture more;
    while (stream->Read(&more)) all.push_back(more);
    const grpc::Status status = stream->Finish();
    EXPECT_TRUE(status.ok()) << status.error_message();
    return all;
  }

  cli::EmbeddedFarm farm_;
  std::unique_ptr<pb::Farm::Stub> stub_;
};

pb::SessionRequest change(std::uint64_t number) {
  pb::SessionRequest request;
  request.mutable_change()->set_number(number);
  return request;
}

pb::SessionRequest light_at(std::uint64_t number, float x, std::uint32_t light = 0) {
  pb::SessionRequest request = change(number);
  pb::LightChange& moved = *request.mutable_change()->add_lights();
  moved.set_light(light);
  moved.mutable_position()->set_x(x);
  moved.mutable_position()->set_y(0.8f);
  moved.mutable_position()->set_z(0.3f);
  return request;
}

// The camera of `frame`, elsewhere.
pb::SessionRequest camera_at(std::uint64_t number, const pb::FrameSettings& frame, float x) {
  pb::SessionRequest request = change(number);
  *request.mutable_change()->mutable_camera() = frame.camera();
  request.mutable_change()->mutable_camera()->mutable_origin()->set_x(x);
  return request;
}

pb::SessionRequest box_at(std::uint64_t number, double x) {
  pb::SessionRequest request = change(number);
  pb::ObjectChange& moved = *request.mutable_change()->add_objects();
  for (int k = 0; k < 12; ++k) moved.add_placement(k == 3 ? x : k % 5 == 0 ? 1 : 0);
  return request;
}

bool denoises() {
  try {
    return !worker::denoiser_version().empty();
  } catch (const Error&) {
    return false;
  }
}

std::vector<std::string> made(const pb::SessionPicture& picture) {
  return {picture.made().begin(), picture.made().end()};
}
std::vector<std::string> reused(const pb::SessionPicture& picture) {
  return {picture.reused().begin(), picture.reused().end()};
}

TEST_F(Session, HoldsLinksUntilWhatTheyDependOnChanges) {
  const scene::Scene scene = lit_box();
  pb::SessionRequest camera = change(2);
  *camera.mutable_change()->mutable_camera() = opening(scene).open().settings().camera();
  camera.mutable_change()->mutable_camera()->mutable_origin()->set_x(0.1f);
  pb::SessionRequest paint = change(3);
  paint.mutable_change()->add_materials()->mutable_base_color()->set_x(0.25f);
  const std::vector<pb::SessionPicture> all =
      pictures({opening(scene), light_at(1, 0.2f), camera, paint, box_at(4, 0.1), box_at(5, 0)});
  ASSERT_EQ(all.size(), 6u);
  const std::vector<std::string> links = {"links.mesh", "links.probe", "links.make"};
  EXPECT_THAT(made(all[0]), IsSupersetOf(links));
  // A light moves: light flows over the links that are there.
  EXPECT_THAT(reused(all[1]), IsSupersetOf(links));
  EXPECT_THAT(reused(all[1]), Contains("links.albedo"));
  EXPECT_THAT(made(all[1]), IsSupersetOf({"links.light", "links.exchange", "links.smooth", "links.shade"}));
  EXPECT_THAT(made(all[1]), Each(Not(testing::AnyOf("links.mesh", "links.probe", "links.make", "links.albedo"))));
  // The camera alone: the light is there too.
  EXPECT_THAT(reused(all[2]), IsSupersetOf({"links.light", "links.exchange", "links.smooth"}));
  // A colour.
  EXPECT_THAT(reused(all[3]), IsSupersetOf(links));
  EXPECT_THAT(made(all[3]), IsSupersetOf({"links.albedo", "links.light", "links.exchange"}));
  // An object takes the links away; back at its place they are there again.
  EXPECT_THAT(made(all[4]), IsSupersetOf(links));
  EXPECT_THAT(reused(all[5]), IsSupersetOf(links));
  for (std::size_t k = 0; k < all.size(); ++k) {
    EXPECT_EQ(all[k].shows(), k);
    EXPECT_EQ(all[k].received(), k);
    EXPECT_TRUE(all[k].last());
    EXPECT_EQ(all[k].picture().size(), 32u * 32 * 12);
    EXPECT_GT(all[k].latency_seconds(), 0);
    if (k > 0) {
      EXPECT_NE(all[k].picture(), all[k - 1].picture()) << k;
    }
  }
  // Nobody else sees a session's frames.
  EXPECT_TRUE(farm_.farm().list().empty());
}

// A picture is that of the scene as it is, whatever it was before.
TEST_F(Session, PicturesAreThoseOfTheirScenes) {
  const scene::Scene scene = lit_box();
  // Where light bends is looked for in the base at rest, which is another scene's base elsewhere.
  const auto evenly_divided = [&](const scene::Scene& base) {
    pb::SessionRequest request = opening(base);
    (*request.mutable_open()->mutable_settings()->mutable_set())["links.refine"] = "0";
    return request;
  };
  const std::vector<pb::SessionPicture> all =
      pictures({evenly_divided(scene), light_at(1, 0.2f), box_at(2, 0.1), light_at(3, -0.1f)});
  ASSERT_EQ(all.size(), 4u);
  scene::EditedScene edited(std::make_shared<const scene::Scene>(scene));
  edited.apply(scene::LightChange{0, scene::Triple{-0.1f, 0.8f, 0.3f}, {}, {}});
  edited.apply(scene::ObjectChange{0, {1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0}});
  scene::Scene own = posed(scene, edited.state(), "own");
  EXPECT_EQ(pictures({evenly_divided(own)}).at(0).picture() == all[3].picture(), true);
}

// An object moves: its picture comes at once, with light over the links that there are, and says so. Once there are new
// ones, a picture follows that is the scene's.
TEST_F(Session, PicturesDoNotWaitForLinks) {
  const scene::Scene scene = lit_box();
  const auto until_last = [](auto& stream) {
    std::vector<pb::SessionPicture> all(1);
    while (stream.Read(&all.back()) && !all.back().last()) all.emplace_back();
    return all;
  };
  // Where light bends is looked for in the base at rest, which is another scene's base elsewhere.
  const auto evenly_divided = [&](const scene::Scene& base) {
    pb::SessionRequest request = opening(base, 4);
    (*request.mutable_open()->mutable_settings()->mutable_set())["links.refine"] = "0";
    // Where there is a denoiser, pictures that are refined are denoised: none of one sample may be.
    request.mutable_open()->mutable_settings()->set_denoise("");
    return request;
  };
  if (denoises())
    while (!farm_.farm().can_denoise()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  grpc::ClientContext context;
  const auto stream = stub_->Session(&context);
  stream->Write(evenly_divided(scene));
  for (const pb::SessionPicture& picture : until_last(*stream)) EXPECT_EQ(picture.links_of(), 0u);
  stream->Write(box_at(1, 0.1));
  const std::vector<pb::SessionPicture> moved = until_last(*stream);
  ASSERT_GE(moved.size(), 3u);
  EXPECT_EQ(moved[0].shows(), 1u);
  EXPECT_EQ(moved[0].links_of(), 0u);
  EXPECT_THAT(reused(moved[0]), Contains("links.earlier_make"));
  EXPECT_THAT(made(moved[0]), testing::AllOf(Not(Contains("links.make")), Contains("links.light")));
  EXPECT_EQ(moved[1].links_of(), 1u);
  EXPECT_EQ(moved[1].samples_per_pixel(), 1u);
  EXPECT_THAT(reused(moved[1]), Contains("links.make"));
  EXPECT_NE(moved[1].picture() == moved[0].picture(), true) << "the links are the same";
  EXPECT_EQ(moved.back().samples_per_pixel(), 4u);
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());

  scene::EditedScene edited(std::make_shared<const scene::Scene>(scene));
  edited.apply(scene::ObjectChange{0, {1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0}});
  grpc::ClientContext own_context;
  const auto own = stub_->Session(&own_context);
  own->Write(evenly_divided(posed(scene, edited.state(), "own")));
  EXPECT_EQ(until_last(*own).back().picture() == moved.back().picture(), true);
  own->WritesDone();
  EXPECT_TRUE(own->Finish().ok());
}

// Whoever says all at once gets the scene as it is in the end, links too.
TEST_F(Session, LinksCatchUpWithWhatIsDragged) {
  grpc::ClientContext context;
  const auto stream = stub_->Session(&context);
  stream->Write(opening(lit_box(), 4));
  pb::SessionPicture picture;
  ASSERT_TRUE(stream->Read(&picture));
  for (std::uint64_t k = 1; k <= 6; ++k) stream->Write(box_at(k, 0.02 * static_cast<double>(k)));
  stream->WritesDone();
  std::uint64_t shown = 0, known = 0;
  while (stream->Read(&picture)) {
    EXPECT_GE(picture.shows(), shown);
    EXPECT_GE(picture.links_of(), known);
    EXPECT_LE(picture.links_of(), picture.shows());
    shown = picture.shows();
    known = picture.links_of();
  }
  EXPECT_TRUE(stream->Finish().ok());
  EXPECT_EQ(shown, 6u);
  EXPECT_EQ(known, 6u);
}

TEST_F(Session, RefinesWhileNothingChanges) {
  const std::vector<pb::SessionPicture> all = [&] {
    grpc::ClientContext context;
    auto stream = stub_->Session(&context);
    stream->Write(opening(lit_box(), 8));
    std::vector<pb::SessionPicture> until_last(1);
    while (stream->Read(&until_last.back()) && !until_last.back().last()) until_last.emplace_back();
    stream->WritesDone();
    return until_last;
  }();
  ASSERT_EQ(all.size(), 3u);
  EXPECT_EQ(all[0].samples_per_pixel(), 1u);
  EXPECT_EQ(all[1].samples_per_pixel(), 4u);
  EXPECT_EQ(all[2].samples_per_pixel(), 8u);
  // More bounces, once; then pixels alone.
  EXPECT_THAT(made(all[1]), Contains("links.exchange"));
  EXPECT_THAT(reused(all[1]), Contains("links.light"));
  EXPECT_THAT(reused(all[2]), Contains("links.smooth"));
}

TEST_F(Session, RefinedPicturesAreDenoised) {
  try {
    worker::denoiser_version();
  } catch (const Error& error) {
    GTEST_SKIP() << error.what();
  }
  while (!farm_.farm().can_denoise()) std::this_thread::sleep_for(std::chrono::milliseconds(10));  // workers join
  const auto shown = [&](const std::string& denoise, std::uint32_t spp = 1) {
    grpc::ClientContext context;
    auto stream = stub_->Session(&context);
    pb::SessionRequest open = opening(lit_box(), 4);
    open.mutable_open()->mutable_settings()->set_denoise(denoise);
    open.mutable_open()->mutable_settings()->set_samples_per_pixel(spp);
    stream->Write(open);
    std::vector<bool> denoised;
    pb::SessionPicture picture;
    while (stream->Read(&picture)) {
      const std::vector<std::string> stages = made(picture);
      denoised.push_back(std::ranges::find(stages, "denoise") != stages.end());
      if (picture.last()) break;
    }
    stream->WritesDone();
    return denoised;
  };
  EXPECT_EQ(shown(""), (std::vector<bool>{false, true}));
  EXPECT_EQ(shown("off"), (std::vector<bool>{false, false}));
  EXPECT_EQ(shown("fast", 2), (std::vector<bool>{true, true}));
}

// Cameras see records of those before them, until anything but the camera changes.
TEST_F(Session, KeepsCacheRecordsWhileOnlyTheCameraMoves) {
  const scene::Scene scene = lit_box();
  pb::SessionRequest open = opening(scene);
  pb::FrameSettings& frame = *open.mutable_open()->mutable_settings();
  frame.set_method("splat");
  frame.clear_set();
  (*frame.mutable_set())["splat.accuracy"] = "0.4";
  (*frame.mutable_set())["splat.gather_rays"] = "64";
  const std::vector<pb::SessionPicture> all = pictures(
      {open, camera_at(1, frame, 0.1f), camera_at(2, frame, 0.2f), light_at(3, 0.2f), camera_at(4, frame, 0.1f)});
  ASSERT_EQ(all.size(), 5u);
  EXPECT_THAT(made(all[0]), IsSupersetOf({"splat.extend.0", "splat.gather.0"}));
  EXPECT_THAT(reused(all[1]), IsSupersetOf({"splat.extend.0", "splat.gather.0"}));
  EXPECT_THAT(made(all[1]), Contains("splat.extend.1"));
  EXPECT_THAT(reused(all[2]), IsSupersetOf({"splat.extend.0", "splat.gather.0", "splat.extend.1"}));
  EXPECT_THAT(made(all[2]), Contains("splat.extend.2"));
  // A light moves: one camera's records, and no more.
  EXPECT_THAT(made(all[3]), Contains("splat.gather.0"));
  EXPECT_THAT(made(all[3]), Not(Contains("splat.extend.1")));
  EXPECT_THAT(reused(all[4]), Contains("splat.gather.0"));
}

TEST_F(Session, KeepsShadingClustersWhileOnlyTheCameraMoves) {
  const scene::Scene scene = lit_box();
  pb::SessionRequest open = opening(scene);
  pb::FrameSettings& frame = *open.mutable_open()->mutable_settings();
  frame.set_method("photon");
  frame.clear_set();
  for (const auto& [name, value] :
       {std::pair{"photon.count", "2000"}, {"photon.clusters", "50"}, {"photon.gather_rays", "64"}})
    (*frame.mutable_set())[name] = value;
  const std::vector<pb::SessionPicture> all =
      pictures({open, camera_at(1, frame, 0.1f), light_at(2, 0.2f), camera_at(3, frame, 0.2f)});
  ASSERT_EQ(all.size(), 4u);
  EXPECT_THAT(made(all[0]), IsSupersetOf({"photon.extend.0", "photon.extend_gather.0"}));
  EXPECT_THAT(reused(all[1]), IsSupersetOf({"photon.map.global", "photon.extend.0", "photon.extend_gather.0"}));
  EXPECT_THAT(made(all[1]), Contains("photon.extend.1"));
  // A light moves: other light arrives at one camera's sample points.
  EXPECT_THAT(made(all[2]), Contains("photon.extend_gather.0"));
  EXPECT_THAT(made(all[2]), Not(Contains("photon.extend.1")));
  EXPECT_THAT(reused(all[3]), IsSupersetOf({"photon.extend.0", "photon.extend_gather.0"}));
}

TEST_F(Session, RefusesWhatTheSceneLacksAndGoesOn) {
  const scene::Scene scene = lit_box();
  pb::SessionRequest half = light_at(3, 0.4f);  // right, and then wrong
  half.mutable_change()->add_materials()->set_material(100000);
  pb::SessionRequest dark = change(4);
  dark.mutable_change()->add_materials()->mutable_base_color()->set_y(-1);
  const std::vector<pb::SessionPicture> all =
      pictures({opening(scene), light_at(1, 0.2f, 1), light_at(2, std::nanf("")), half, dark, box_at(5, 1e300),
                light_at(6, 0.2f)});
  ASSERT_EQ(all.size(), 7u);
  for (std::size_t k = 1; k <= 5; ++k) {
    EXPECT_FALSE(all[k].refused().empty()) << k;
    EXPECT_EQ(all[k].received(), k);
    EXPECT_TRUE(all[k].picture().empty()) << k;
  }
  EXPECT_THAT(all[1].refused(), testing::HasSubstr("light"));
  EXPECT_EQ(all[6].shows(), 6u);
  EXPECT_EQ(pictures({opening(scene), light_at(1, 0.2f)}).at(1).picture() == all[6].picture(), true);
}

// Before its first picture is begun, or while it waits for the last one: nobody is left to render it for.
TEST_F(Session, ACallerThatGoesIsRenderedForNoMore) {
  pb::SessionRequest opening_of_hours = opening(lit_box());
  opening_of_hours.mutable_open()->mutable_settings()->set_samples_per_pixel(1 << 20);
  for (const auto pause : {std::chrono::milliseconds(0), std::chrono::milliseconds(300)})
    for (const bool all_is_said : {false, true}) {
      grpc::ClientContext context;
      auto stream = stub_->Session(&context);
      stream->Write(opening_of_hours);
      if (all_is_said) stream->WritesDone();
      std::this_thread::sleep_for(pause);
      context.TryCancel();
      stream->Finish();
      const auto idle = [&] { return farm_.farm().workers().at(0).leases == 0; };
      bool calm = false;
      for (int tried = 0; tried < 200 && !calm; ++tried) {
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
        calm = idle();
        for (int again = 0; again < 10 && calm; ++again) {  // no stage follows
          std::this_thread::sleep_for(std::chrono::milliseconds(20));
          calm = idle();
        }
      }
      EXPECT_TRUE(calm) << pause.count() << " ms, " << all_is_said;
      if (!calm) return;
    }
}

TEST_F(Session, RefusesToOpenWhatCannotBeRendered) {
  const auto refusal = [&](const pb::SessionRequest& request) {
    grpc::ClientContext context;
    auto stream = stub_->Session(&context);
    stream->Write(request);
    pb::SessionPicture none;
    EXPECT_FALSE(stream->Read(&none));
    return stream->Finish();
  };
  pb::SessionRequest unknown = opening(lit_box()), settings = unknown, method = unknown;
  unknown.mutable_open()->set_scene_blob(std::string(64, 'a'));
  (*settings.mutable_open()->mutable_settings()->mutable_set())["links.directions"] = "17";
  method.mutable_open()->mutable_settings()->set_method("none");
  for (const pb::SessionRequest& request : {unknown, settings, method, change(1)})
    EXPECT_EQ(refusal(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

// What a movable mesh's matrix leaves in place stands where it stood.
TEST(MovableMesh, StandsWhereItStood) {
  const scene::Scene still = scene::make_scene("cornell-textured", {});
  scene::Scene scene = still;
  const std::string name = scene.meshes.back().name;
  EXPECT_EQ(scene::make_movable(scene, name), 0u);
  EXPECT_THROW(scene::make_movable(scene, name), Error);
  EXPECT_THROW(scene::make_movable(scene, "no such mesh"), Error);
  validate(scene, "movable");
  const scene::EditedScene edited(std::make_shared<const scene::Scene>(scene));
  const scene::Scene shown = posed(scene, edited.state(), "shown");
  for (std::size_t c = 0; c < still.indices.size(); ++c)
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_EQ(shown.positions[3 * std::size_t{shown.indices[c]} + k],
                still.positions[3 * std::size_t{still.indices[c]} + k]);
      EXPECT_NEAR(shown.normals[3 * std::size_t{shown.indices[c]} + k],
                  still.normals[3 * std::size_t{still.indices[c]} + k], 1e-6);
    }
}

}  // namespace
}  // namespace gleaner::test
