// Frames side by side may ask for the same artifact at the same time. The stage that asked first runs; the others
// follow it: they get what it made, and where it ends without having made it, the first of them runs in its place.

#include <utility>

#include "coordinator/jobs/engine.h"

namespace gleaner::coordinator {

bool Farm::Impl::follow(const std::shared_ptr<RunningStage>& stage) {
  if (!stage->spec.output.reusable) return false;
  for (const auto& [id, other] : active_stages) {
    if (other->artifact != stage->artifact || other->computes_again || other->recheck) continue;
    if (other->frame == stage->frame) continue;
    stage->again.clear();  // what exists by then is looked at when it runs itself
    stage->follows = other;
    other->followers.push_back(stage);
    stage->frame->stages.push_back(stage);
    return true;
  }
  return false;
}

void Farm::Impl::deliver_to_followers(RunningStage& stage) {
  for (const auto& follower : std::exchange(stage.followers, {})) {
    follower->follows.reset();
    follower->records = stage.records;
    follower->index = stage.index;
    follower->facts = stage.facts;
    follower->complete = true;
    if (stage.collected()) remember_output(*follower);
    // A liar among those that made it has had a part in the other frame as well.
    follower->frame->makers.insert(stage.frame->makers.begin(), stage.frame->makers.end());
    std::erase(follower->frame->stages, follower);  // it is no work of this frame
    hand_over(follower, "made at the same time for another frame");
  }
}

void Farm::Impl::release_followers(RunningStage& stage) {
  if (stage.follows) std::erase_if(stage.follows->followers, [&](const auto& other) { return other.get() == &stage; });
  stage.follows.reset();
  auto followers = std::exchange(stage.followers, {});
  if (followers.empty()) return;
  const std::shared_ptr<RunningStage> next = followers.front();
  followers.erase(followers.begin());
  next->follows.reset();
  for (const auto& follower : followers) follower->follows = next;
  next->followers = std::move(followers);
  if (next->retained()) {
    start_in_place(next);
  } else {
    next->frame->to_start.push_back(next);  // it needs memory, for which its own thread sees
    next->frame->events.notify_all();
  }
}

void Farm::Impl::start_in_place(const std::shared_ptr<RunningStage>& stage) {
  std::erase(stage->frame->stages, stage);
  if (stage->retained() && retain_output(*stage)) {
    hand_over(stage, "made before for another frame");
    return;
  }
  start(stage);
  if (stage->retained()) deliver_if_complete(stage);
}

bool Farm::Impl::start_what_follows_no_more(Frame& frame, std::unique_lock<std::mutex>& lock) {
  if (frame.to_start.empty()) return false;
  const auto stages = std::exchange(frame.to_start, {});
  for (const auto& stage : stages) start_in_place(stage);
  offer_to_all();
  lock.unlock();
  for (const auto& stage : stages) prepare(*stage);
  lock.lock();
  return true;
}

}  // namespace gleaner::coordinator
