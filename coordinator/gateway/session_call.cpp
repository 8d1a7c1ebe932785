#include "coordinator/gateway/session_call.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <future>
#include <thread>
#include <utility>

#include "coordinator/artifacts/scene_lineage.h"
#include "coordinator/film/write.h"
#include "coordinator/gateway/convert.h"
#include "coordinator/plan/methods.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;

namespace {

constexpr std::chrono::milliseconds look_interval{50};  // at whether the caller is still there
constexpr std::size_t most_refused = 100;               // words that wait to be told
constexpr Seconds rate_window = 3;                      // over which pictures a second are counted
constexpr std::uint32_t refines_by = 4;                 // samples of a picture over those of the one before
constexpr std::size_t most_looks = 256;  // cameras that a picture may begin with; then the next one stands alone
constexpr std::string_view stage_word = "stage ";  // a skip's words for a stage that was made before

// What makes first pictures come sooner, unless the request says otherwise.
struct QuickSetting {
  std::string_view name;
  const char *first, *refined;
};
constexpr QuickSetting quick_settings[] = {{"links.sample_lights", "1", "0"}, {"links.least_share", "0.01", "0.001"}};

Seconds steady_now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

scene::Triple triple(const pb::Vector3& v) { return {v.x(), v.y(), v.z()}; }

std::shared_ptr<const scene::Scene> base_of(BlobStore& blobs, const pb::SessionOpen& open) {
  for (const std::string* id : {&open.scene_blob(), &open.bvh_blob()})
    if (!(id == &open.bvh_blob() && id->empty()) && !(is_sha256_hex(*id) && blobs.source(*id)))
      throw Error::bad_input("blob " + id->substr(0, 80), "", "to be uploaded first");
  const Blob blob = blobs.get(open.scene_blob());
  if (!blob) throw Error::failed("blob " + open.scene_blob() + " has gone");
  return std::make_shared<const scene::Scene>(scene::parse_scene(*blob, printable(open.scene_name(), most_name_bytes)));
}

Bytes floats_of(const Film& film) {
  const std::size_t pixels = std::size_t{film.width} * film.height;
  Bytes bytes(pixels * 12);
  for (std::size_t c = 0; c < 3; ++c) {
    const Channel* channel = film.find(std::string(1, "RGB"[c]));
    if (!channel) throw Error::failed("a picture without RGB");
    for (std::size_t i = 0; i < pixels; ++i) std::memcpy(&bytes[12 * i + 4 * c], &channel->values[i], 4);
  }
  return bytes;
}

}  // namespace

SessionCall::SessionCall(Farm& farm, BlobStore& blobs, const pb::SessionOpen& open)
    : farm_(farm),
      blobs_(blobs),
      format_(open.format()),
      refine_to_(open.refine_to()),
      denoise_first_(open.settings().denoise().empty() ? Denoise::off : from_proto(open.settings()).denoise),
      denoise_refined_(open.settings().denoise().empty() ? Denoise::fast : denoise_first_),
      base_(base_of(blobs, open)),
      rest_bounds_(scene::bounds_of(*base_)),
      posed_(base_),
      scene_(base_),
      changed_(steady_now()) {
  if (!std::isfinite(open.exposure_stops()) || std::abs(open.exposure_stops()) > 100)
    throw Error::bad_input("request", "exposure_stops", "-100 to 100");
  if (open.scene_name().empty() || open.scene_name().size() > most_name_bytes)
    throw Error::bad_input("request", "scene_name", "1 to 256 bytes");
  request_.scene_name = printable(open.scene_name(), most_name_bytes);
  request_.settings = from_proto(open.settings());
  request_.exposure_stops = open.exposure_stops();
  // A worker that exchanges alone waits for nobody.
  request_.settings.set.try_emplace("links.solo_exchange", "1");
  for (const auto& [name, value] : request_.settings.set) given_.insert(name);
  first_spp_ = request_.settings.spp;
  camera_ = request_.settings.camera;
  FrameScene& shown = request_.scenes.emplace_back();
  shown.scene_blob = open.scene_blob();
  shown.bvh_blob = open.bvh_blob();
  describe(scene_.state());
  check_settings(request_.settings, shown_);
}

// What the farm is told of the scene in a state.
void SessionCall::describe(const scene::FrameState& state) {
  auto bytes = std::make_shared<const Bytes>(scene::serialize(state));
  if (state_ && *state_ == *bytes) return;
  looks_.clear();
  posed_.show(state, request_.scene_name);
  shown_ = summarize(*posed_.scene());
  FrameScene& shown = request_.scenes.front();
  shown_.rest_bounds = rest_bounds_;
  shown_.lineage = lineage_of(shown.scene_blob, *base_, state);
  shown.summary = shown_;
  state_ = std::move(bytes);
  shown.state_blob = state.empty() ? std::string() : blobs_.lend(state_);
}

// Cameras of the pictures of this state, with the next one's. Where a picture may have a few new records only, even one
// that shows the same adds to them.
std::vector<scene::Camera> SessionCall::looks_with(const scene::Camera& camera) const {
  std::vector<scene::Camera> looks = looks_;
  const bool same = !looks.empty() && std::memcmp(&looks.back(), &camera, sizeof camera) == 0;
  if (same && whole_setting(request_.settings, "splat.new_records").value_or(0) == 0) return looks;
  if (looks.size() >= most_looks) looks.clear();
  looks.push_back(camera);
  return looks;
}

void SessionCall::run(grpc::ServerContext& context, Stream& stream) {
  std::jthread reader([&] { read(context, stream); });
  const std::unique_ptr<SessionCall, void (*)(SessionCall*)> ends(this, [](SessionCall* self) { self->end(); });
  // A picture goes out while the next one is rendered.
  std::future<bool> sent;
  try {
    while (const std::optional<Wanted> wanted = next(stream)) {
      std::optional<Rendered> rendered = render(*wanted);
      if (!rendered) continue;
      if (sent.valid() && !sent.get()) break;
      sent = std::async(std::launch::async, [this, &stream, picture = std::move(*rendered)] {
        const pb::SessionPicture out = picture_of(picture);
        std::lock_guard lock(write_mutex_);
        return stream.Write(out);
      });
    }
    if (sent.valid()) sent.get();
  } catch (...) {
    context.TryCancel();  // or the reader would wait for the caller
    throw;
  }
}

void SessionCall::end() {
  stop_making_.request_stop();
  std::lock_guard lock(mutex_);
  ended_ = true;
  ends_.notify_all();
}

void SessionCall::read(const grpc::ServerContext& context, Stream& stream) {
  pb::SessionRequest request;
  while (stream.Read(&request)) {
    std::string why;
    try {
      if (request.request_case() != pb::SessionRequest::kChange)
        throw Error::bad_input("request", "", "a change of the scene");
      take(request.change());
      continue;
    } catch (const Error& error) {
      why = error.what();
    }
    std::lock_guard lock(mutex_);
    if (refused_.size() < most_refused) refused_.push_back({request.change().number(), why});
    wakes_.notify_all();
  }
  std::unique_lock lock(mutex_);
  over_ = true;
  if (refining_) stop_.request_stop();
  wakes_.notify_all();
  // Who has said all waits for the last picture, or goes away at any time: before it is begun, too.
  while (!ended_ && !context.IsCancelled()) ends_.wait_for(lock, look_interval, [&] { return ended_; });
  if (ended_) return;
  gone_ = true;
  stop_.request_stop();
  wakes_.notify_all();
}

void SessionCall::take(const pb::SessionChange& change) {
  std::lock_guard lock(mutex_);
  if (change.number() <= received_)
    throw Error::bad_input("change", "number", "more than " + std::to_string(received_),
                           std::to_string(change.number()));
  scene::EditedScene changed = scene_;
  for (const pb::LightChange& light : change.lights()) {
    scene::LightChange to;
    to.light = light.light();
    if (light.has_position()) to.position = triple(light.position());
    if (light.has_direction()) to.direction = triple(light.direction());
    if (light.has_intensity()) to.intensity = triple(light.intensity());
    changed.apply(to);
  }
  for (const pb::MaterialChange& material : change.materials()) {
    scene::MaterialChange to;
    to.material = material.material();
    if (material.has_base_color()) to.base_color = triple(material.base_color());
    if (material.has_emission()) to.emission = triple(material.emission());
    changed.apply(to);
  }
  for (const pb::ObjectChange& object : change.objects()) {
    scene::ObjectChange to;
    to.matrix = object.matrix();
    if (object.placement_size() != static_cast<int>(to.placement.size()))
      throw Error::bad_input("change", "placement", "12 numbers", std::to_string(object.placement_size()));
    std::ranges::copy(object.placement(), to.placement.begin());
    changed.apply(to);
  }
  const scene::Camera camera = change.has_camera() ? from_proto(change.camera()) : camera_;
  scene_ = std::move(changed);
  camera_ = camera;
  received_ = change.number();
  if (!changed_) changed_ = steady_now();
  shown_spp_ = 0;
  wakes_.notify_all();
  if (refining_) stop_.request_stop();
}

std::optional<SessionCall::Wanted> SessionCall::next(Stream& stream) {
  std::unique_lock lock(mutex_);
  for (;;) {
    // The last picture is of the scene as it is, its links too.
    wakes_.wait(lock, [&] {
      return changed_ || may_refine() || links_made_ || !refused_.empty() || (over_ && (gone_ || !lags_));
    });
    if (refused_.empty()) break;
    pb::SessionPicture no;
    no.set_received(refused_.front().number);
    no.set_refused(refused_.front().why);
    refused_.pop_front();
    lock.unlock();
    {
      std::lock_guard write_lock(write_mutex_);
      stream.Write(no);
    }
    lock.lock();
  }
  if (over_ && (gone_ || (!changed_ && !lags_))) return std::nullopt;
  if (links_made_) take_links();
  refining_ = !changed_;
  const bool refines = !changed_ && !lags_;
  stop_ = std::stop_source();
  return Wanted{.change = received_,
                .state = scene_.state(),
                .camera = camera_,
                .spp = refines ? std::min(shown_spp_ * refines_by, refine_to_) : first_spp_,
                .refines = refines,
                .changed = std::exchange(changed_, std::nullopt)};
}

// Pictures that are refined anyway need not wait for links. Those of rough metal are also between lobes, which a plan
// does not look for in an earlier scene.
bool SessionCall::may_lag() const {
  return request_.settings.method == "links" && refine_to_ > first_spp_ &&
         !flag_setting(request_.settings, "links.metal").value_or(false);
}

SessionCall::Links SessionCall::current_links(std::uint64_t change) const {
  return {change, shown_.lineage.geometry, request_.scenes.front().state_blob, state_};
}

// By a picture of the state that is shown, which nobody sees, behind those that come meanwhile.
void SessionCall::make_links(std::uint64_t change) {
  if (making_.valid()) return;
  const auto make = [this, request = request_, shown = shown_,
                     links = current_links(change)]() -> std::optional<Links> {
    const std::unique_ptr<SessionCall, void (*)(SessionCall*)> tells(this, [](SessionCall* self) {
      std::lock_guard lock(self->mutex_);
      self->links_made_ = true;
      self->wakes_.notify_all();
    });
    if (!farm_.show(request, shown, stop_making_.get_token(), /*behind=*/true)) return std::nullopt;
    return links;
  };
  making_ = std::async(std::launch::async, make);
}

// Rethrows what making them has thrown. The lock is held.
void SessionCall::take_links() {
  links_made_ = false;
  if (std::optional<Links> made = making_.get()) links_ = std::move(made);
}

std::optional<SessionCall::Rendered> SessionCall::render(const Wanted& wanted) {
  describe(wanted.state);
  request_.settings.camera = wanted.camera;
  request_.settings.denoise = farm_.can_denoise() ? (wanted.refines ? denoise_refined_ : denoise_first_) : Denoise::off;
  request_.settings.spp = wanted.spp;
  request_.settings.looks = looks_with(wanted.camera);
  for (const QuickSetting& setting : quick_settings)
    if (!given_.contains(std::string(setting.name)))
      request_.settings.set[std::string(setting.name)] = wanted.refines ? setting.refined : setting.first;
  const bool lags = may_lag() && links_ && links_->geometry != shown_.lineage.geometry;
  JobRequest request = request_;
  SceneSummary shown = shown_;
  if (lags) {
    request.scenes.front().earlier_blob = links_->blob;
    shown.lineage.earlier_geometry = links_->geometry;
  }
  std::optional<Farm::Picture> picture = farm_.show(request, shown, stop_.get_token());
  // Not before the picture is there: nothing of theirs comes before it.
  if (lags) make_links(wanted.change);
  std::lock_guard lock(mutex_);
  refining_ = false;
  if (!picture) return std::nullopt;
  if (!lags) links_ = current_links(wanted.change);
  lags_ = lags;
  looks_ = request_.settings.looks;
  if (!changed_) shown_spp_ = wanted.spp;
  return Rendered{std::move(*picture), wanted.change,  wanted.spp,
                  wanted.changed,      links_->change, !changed_ && !lags && !may_refine()};
}

pb::SessionPicture SessionCall::picture_of(const Rendered& rendered) {
  const Farm::Picture& picture = rendered.picture;
  pb::SessionPicture out;
  const Bytes bytes = format_ == pb::PICTURE_FORMAT_RGB8     ? encode_rgb8(picture.film, request_.exposure_stops)
                      : format_ == pb::PICTURE_FORMAT_RGB32F ? floats_of(picture.film)
                                                             : encode_fast_png(picture.film, request_.exposure_stops);
  out.set_picture(bytes.data(), bytes.size());
  out.set_format(format_);
  out.set_shows(rendered.change);
  out.set_links_of(rendered.links);
  out.set_width(picture.film.width);
  out.set_height(picture.film.height);
  out.set_samples_per_pixel(rendered.spp);
  out.set_last(rendered.last);
  out.set_seconds(picture.report.seconds);
  for (const StageReport& stage : picture.report.stages) out.add_made(stage.name);
  for (const Skip& skip : picture.report.skips)
    if (skip.what.starts_with(stage_word)) out.add_reused(skip.what.substr(stage_word.size()));
  const Seconds now = steady_now();
  if (rendered.changed) {
    out.set_latency_seconds(now - *rendered.changed);
    pictures_.push_back(now);
    while (now - pictures_.front() > rate_window) pictures_.pop_front();
  }
  if (pictures_.size() > 1 && now > pictures_.front())
    out.set_frames_per_second(static_cast<double>(pictures_.size() - 1) / (now - pictures_.front()));
  std::lock_guard lock(mutex_);
  out.set_received(received_);
  return out;
}

}  // namespace gleaner::gateway
