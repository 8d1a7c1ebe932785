#pragma once
// One call of Farm.Session: changes come in, pictures of the scene as it is by then go out.

#include <grpcpp/grpcpp.h>

#include <condition_variable>
#include <deque>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <stop_token>
#include <string>

#include "coordinator/blobs/store.h"
#include "coordinator/jobs/farm.h"
#include "gleaner/v1/farm.grpc.pb.h"
#include "scene/model/edited_scene.h"

namespace gleaner::gateway {

class SessionCall {
 public:
  using Stream = grpc::ServerReaderWriter<gleaner::v1::SessionPicture, gleaner::v1::SessionRequest>;

  // Throws Error::bad_input and Error::usage for what cannot be rendered.
  SessionCall(coordinator::Farm& farm, coordinator::BlobStore& blobs, const gleaner::v1::SessionOpen& open);

  // Until the caller says no more, or goes away. Throws Error::failed where a frame fails.
  void run(grpc::ServerContext& context, Stream& stream);

 private:
  using Seconds = coordinator::Seconds;

  // What a picture is made of.
  struct Wanted {
    std::uint64_t change = 0;  // number of the last one in it
    scene::FrameState state;
    scene::Camera camera{};
    std::uint32_t spp = 1;
    bool refines = false;            // what a picture has shown, links and all
    std::optional<Seconds> changed;  // when the first change came that no picture has shown
  };
  struct Rendered {
    coordinator::Farm::Picture picture;
    std::uint64_t change = 0;  // as in Wanted
    std::uint32_t spp = 1;
    std::optional<Seconds> changed;
    std::uint64_t links = 0;  // number of the change whose geometry its links are of
    bool last = false;        // nothing had changed by then, and it is not refined
  };
  // Radiance links that the farm holds, by the state that they were made for.
  struct Links {
    std::uint64_t change = 0;
    std::string geometry;  // SceneLineage::geometry
    std::string blob;      // id of the state; empty: the base
    coordinator::Blob state;
  };
  struct Refused {
    std::uint64_t number;
    std::string why;
  };

  void read(const grpc::ServerContext& context, Stream& stream);  // on a thread of its own
  void end();                                                     // nothing more is rendered
  void take(const gleaner::v1::SessionChange& change);
  std::optional<Wanted> next(Stream& stream);  // waits; none: the caller says no more
  // Not before the links are those of what is shown.
  bool may_refine() const { return shown_spp_ > 0 && shown_spp_ < refine_to_ && !lags_; }
  bool may_lag() const;
  Links current_links(std::uint64_t change) const;
  void make_links(std::uint64_t change);
  void take_links();
  std::optional<Rendered> render(const Wanted& wanted);  // none: it was given up
  gleaner::v1::SessionPicture picture_of(const Rendered& rendered);
  void describe(const scene::FrameState& state);
  std::vector<scene::Camera> looks_with(const scene::Camera& camera) const;

  coordinator::Farm& farm_;
  coordinator::BlobStore& blobs_;
  coordinator::JobRequest request_;
  gleaner::v1::PictureFormat format_;
  std::uint32_t first_spp_ = 1, refine_to_;
  // Where a worker can. A first picture is to come soon: it is denoised where the request says so.
  const coordinator::Denoise denoise_first_, denoise_refined_;
  std::set<std::string> given_;  // settings of the request
  std::shared_ptr<const scene::Scene> base_;
  scene::Bounds rest_bounds_;

  // Of the state that was rendered last.
  scene::PosedScene posed_;
  coordinator::Blob state_;
  coordinator::SceneSummary shown_;
  std::vector<scene::Camera> looks_;  // of the pictures of this state, as FrameSettings has them
  std::optional<Links> links_;        // the newest
  std::deque<Seconds> pictures_;      // when first pictures went out, of the last seconds
  std::mutex write_mutex_;            // for messages to the caller

  // Shared with the reader's thread.
  std::mutex mutex_;
  std::condition_variable wakes_;
  scene::EditedScene scene_;
  scene::Camera camera_{};
  std::uint64_t received_ = 0;      // number of the last change
  std::optional<Seconds> changed_;  // as in Wanted: something waits to be shown
  std::uint32_t shown_spp_ = 0;     // of the last picture of the scene as it is; 0: there is none
  std::deque<Refused> refused_;
  bool over_ = false;   // the caller says no more
  bool gone_ = false;   // and is not there any more
  bool ended_ = false;  // run() returns
  std::condition_variable ends_;
  std::stop_source stop_;    // of the frame that is being rendered
  bool refining_ = false;    // it shows no change, and may be given up for one
  bool lags_ = false;        // the last picture's links are those of an earlier geometry
  bool links_made_ = false;  // making_ is over

  // New links, of a state that was shown with older ones.
  std::stop_source stop_making_;
  std::future<std::optional<Links>> making_;
};

}  // namespace gleaner::gateway
