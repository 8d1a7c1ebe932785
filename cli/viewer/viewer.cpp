#include "cli/viewer/viewer.h"

#include <sys/random.h>

#include <array>
#include <charconv>
#include <chrono>
#include <utility>

#include "cli/viewer/picture_json.h"
#include "cli/viewer/viewer_files.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;
using nlohmann::json;
using web::Answer;

namespace {

constexpr std::chrono::seconds longest_wait{10};   // for a picture, before the page asks again
constexpr unsigned most_waiting = 8;               // pages that wait for pictures, each in a thread
constexpr std::size_t threads = most_waiting + 4;  // of these, for changes
constexpr std::size_t largest_change = 256 << 10;
constexpr std::size_t most_refusal_bytes = 1000;  // it travels in a header

std::string random_word() {
  std::array<unsigned char, 16> bytes;
  if (::getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size()))
    throw Error::failed("the system gives no random numbers");
  std::string word;
  for (const unsigned char byte : bytes) {
    word += "0123456789abcdef"[byte >> 4];
    word += "0123456789abcdef"[byte & 15];
  }
  return word;
}

Answer json_answer(int status, const json& words) {
  return {
      .type = "application/json", .body = words.dump(-1, ' ', false, json::error_handler_t::replace), .status = status};
}

}  // namespace

Viewer::Viewer(const std::string& listen, ViewerScene scene, std::function<void(pb::SessionChange)> say)
    : scene_(std::move(scene)),
      say_(std::move(say)),
      secret_(random_word()),
      server_({.option = "--web",
               .listen = listen,
               .secret = secret_,
               .threads = threads,
               .largest_body = largest_change}) {
  server_.add_files("/", web::common_files());
  server_.add_files("/", viewer_files());
  server_.get("/scene.json", [this](const web::Request&) {
    std::lock_guard lock(mutex_);
    json words = scene_.json();
    words["change"] = said_;
    return json_answer(200, words);
  });
  server_.get("/picture", [this](const web::Request& request) {
    const auto seen = request.parameters.find("after");
    return picture_after(seen == request.parameters.end() ? "0" : seen->second);
  });
  server_.post("/change", [this](const web::Request& request) { return take(request.body); });
  server_.start();
}

Viewer::~Viewer() {
  {
    std::lock_guard lock(mutex_);
    ending_ = true;
  }
  wakes_.notify_all();
  server_.stop();
}

std::string Viewer::url() const { return "http://" + server_.address() + "/" + secret_ + "/"; }

void Viewer::show(const pb::SessionPicture& picture) {
  const std::size_t bytes = std::size_t{3} * picture.width() * picture.height();
  if (picture.refused().empty() && (picture.format() != pb::PICTURE_FORMAT_RGB8 || picture.picture().size() != bytes))
    throw Error::failed("a picture of another size than it says");
  std::lock_guard lock(mutex_);
  ++shown_;
  if (picture.refused().empty()) {
    words_ = picture_json(picture);
    words_["width"] = picture.width();
    words_["height"] = picture.height();
    pixels_ = std::make_shared<const std::string>(picture.picture());
  } else {
    refused_ = picture.refused().substr(0, most_refusal_bytes);
    refused_at_ = shown_;
  }
  wakes_.notify_all();
}

Answer Viewer::picture_after(const std::string& text) {
  std::uint64_t seen = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), seen);
  if (error != std::errc{} || end != text.data() + text.size())
    return web::text_answer(400, "after: expected a number\n");
  std::unique_lock lock(mutex_);
  if (seen > shown_) seen = 0;  // of another session at this address
  if (waiting_ >= most_waiting) return web::text_answer(503, "too many pages of this session are open\n");
  ++waiting_;
  wakes_.wait_for(lock, longest_wait, [&] { return ending_ || (shown_ > seen && pixels_); });
  --waiting_;
  if (ending_ || shown_ == seen || !pixels_) return {.type = {}, .body = {}, .status = 204};
  json words = words_;
  words["number"] = shown_;
  words["change"] = said_;
  if (refused_at_ > seen) words["refused"] = refused_;
  const std::shared_ptr<const std::string> pixels = pixels_;
  lock.unlock();
  Answer answer{.type = "application/octet-stream", .body = *pixels};
  answer.headers["Gleaner-Picture"] = words.dump(-1, ' ', true, json::error_handler_t::replace);
  return answer;
}

Answer Viewer::take(const std::string& body) {
  const json words = json::parse(body, nullptr, false);
  std::lock_guard lock(mutex_);
  try {
    pb::SessionChange change = scene_.change(words);
    change.set_number(++said_);
    say_(std::move(change));
  } catch (const Error& error) {
    return json_answer(400, {{"refused", error.what()}});
  }
  return json_answer(200, {{"change", said_}});
}

}  // namespace gleaner::cli
