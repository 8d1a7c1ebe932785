// `gleaner session`: a scene that its user changes, and pictures of it.

#include <CLI/CLI.hpp>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <memory>
#include <mutex>
#include <set>
#include <span>
#include <string>
#include <thread>
#include <utility>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/frame_options.h"
#include "cli/program.h"
#include "cli/session_stream.h"
#include "cli/session_web.h"
#include "cli/session_words.h"
#include "cli/viewer/picture_json.h"
#include "coordinator/film/write.h"
#include "proto/atomic_file.h"
#include "scene/import/sequence.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;
namespace fs = std::filesystem;

namespace {

// Where pictures go, and what is said of each.
class Pictures {
 public:
  explicit Pictures(const SessionOptions& options) : output_(options.output), quiet_(options.frame.quiet) {
    const std::string ending = fs::path(output_).extension().string();
    if (output_.empty() || output_ == "-")
      format_ = pb::PICTURE_FORMAT_RGB8;
    else if (ending == ".exr")
      format_ = pb::PICTURE_FORMAT_RGB32F;
    else if (ending != ".png")
      throw Error::usage("-o: expected a name that ends in .png or .exr, or -, found \"" + output_ + "\"");
  }
  pb::PictureFormat format() const { return format_; }

  void take(const pb::SessionPicture& picture) {
    write(picture);
    if (quiet_) return;
    (output_ == "-" ? std::cerr : std::cout) << picture_json(picture).dump() << std::endl;
  }

 private:
  void write(const pb::SessionPicture& picture) {
    const std::string& bytes = picture.picture();
    const std::size_t pixels = std::size_t{picture.width()} * picture.height();
    if (output_.empty()) return;
    if (output_ == "-") {
      std::printf("P6\n%u %u\n255\n", picture.width(), picture.height());
      std::fwrite(bytes.data(), 1, bytes.size(), stdout);
      std::fflush(stdout);
      return;
    }
    fs::path path = output_;
    if (const std::string name = path.filename().string(); name.find('#') != std::string::npos)
      path = path.parent_path() / scene::file_of_frame(name, ++count_);
    if (format_ == pb::PICTURE_FORMAT_PNG) {
      write_atomically(path.string(), std::as_bytes(std::span(bytes)));
      return;
    }
    if (bytes.size() != pixels * 12) throw Error::failed("a picture of another size than it says");
    coordinator::Film film{picture.width(), picture.height(), {}};
    for (std::size_t c = 0; c < 3; ++c) {
      std::vector<float>& values = film.channel(std::string(1, "RGB"[c])).values;
      values.resize(pixels);
      for (std::size_t i = 0; i < pixels; ++i) std::memcpy(&values[i], &bytes[12 * i + 4 * c], 4);
    }
    coordinator::write_exr(film, {}, path.string());
  }

  std::string output_;
  bool quiet_;
  pb::PictureFormat format_ = pb::PICTURE_FORMAT_PNG;
  std::uint32_t count_ = 0;
};

// What was said, and what of it has been shown.
class Conversation {
 public:
  Conversation(Client::Session& stream, Pictures& pictures) : stream_(stream), pictures_(pictures) {}

  void say(pb::SessionRequest request) {
    if (request.has_change()) {
      std::lock_guard lock(mutex_);
      request.mutable_change()->set_number(++said_);
      open_.insert(said_);
      settled_ = false;
    }
    if (!stream_.Write(request)) over();
  }
  // Until all that was said is shown, or settled; or the other side is gone.
  void wait(SessionPause pause) {
    std::unique_lock lock(mutex_);
    wakes_.wait(lock,
                [&] { return over_ || (open_.empty() && (settled_ || (pause == SessionPause::shown && seen_))); });
  }
  bool is_over() {
    std::lock_guard lock(mutex_);
    return over_;
  }

  void listen() {
    const std::unique_ptr<Conversation, void (*)(Conversation*)> ends(this, [](Conversation* self) { self->over(); });
    pb::SessionPicture picture;
    while (stream_.Read(&picture)) {
      if (picture.refused().empty())
        pictures_.take(picture);
      else
        std::cerr << "gleaner: warning: " << printable_lines(picture.refused()) << "\n";
      std::lock_guard lock(mutex_);
      if (picture.refused().empty()) {
        open_.erase(open_.begin(), open_.upper_bound(picture.shows()));
        seen_ = true;
        settled_ = picture.last() && open_.empty();
      } else {
        open_.erase(picture.received());
      }
      wakes_.notify_all();
    }
  }

 private:
  void over() {
    std::lock_guard lock(mutex_);
    over_ = true;
    wakes_.notify_all();
  }

  Client::Session& stream_;
  Pictures& pictures_;
  std::mutex mutex_;
  std::condition_variable wakes_;
  std::uint64_t said_ = 0;
  std::set<std::uint64_t> open_;  // changes that no picture has shown
  bool seen_ = false;             // a picture has come
  bool settled_ = false;          // none follows
  bool over_ = false;
};

void converse(Conversation& talk, const SessionWords& words) {
  for (std::string line; !talk.is_over() && std::getline(std::cin, line);) {
    SessionWords::Meaning meaning;
    try {
      meaning = words.read(line);
    } catch (const Error& error) {
      std::cerr << "gleaner: warning: " << printable_lines(error.what()) << "\n";
      continue;
    }
    if (std::holds_alternative<SessionEnd>(meaning)) return;
    if (const auto* pause = std::get_if<SessionPause>(&meaning)) talk.wait(*pause);
    if (auto* change = std::get_if<pb::SessionChange>(&meaning)) {
      pb::SessionRequest request;
      *request.mutable_change() = std::move(*change);
      talk.say(std::move(request));
    }
  }
  talk.wait(SessionPause::shown);
}

int session_by_words(const SessionOptions& options) {
  Pictures pictures(options);
  SessionScene scene = load_session_scene(options);
  const SessionWords words(scene.frame.scene, scene.frame.settings, scene.objects);
  SessionStream stream(options, std::move(scene.frame), pictures.format());
  Conversation talk(stream.stream(), pictures);
  std::exception_ptr failure;
  {
    std::jthread listener([&] {
      try {
        talk.listen();
      } catch (...) {
        failure = std::current_exception();
        stream.cancel();
      }
    });
    converse(talk, words);
    stream.stream().WritesDone();
  }
  if (failure) std::rethrow_exception(failure);
  stream.end();
  return 0;
}

int session(const SessionOptions& options) {
  if (options.web.empty()) return session_by_words(options);
  if (!options.output.empty()) throw Error::usage("-o: expected none with --web, which shows pictures in a browser");
  return session_in_browser(options);
}

}  // namespace

void add_session(CLI::App& app, Run& run) {
  auto options = std::make_shared<SessionOptions>();
  options->frame.method = "links";
  options->frame.spp = 1;
  options->frame.denoise.clear();  // refined pictures are, first ones are not
  CLI::App* command =
      app.add_subcommand("session", "Change a scene's lights, materials, objects and camera, and see it");
  add_frame_options(*command, options->frame);
  command->footer(std::string(SessionWords::help()) + "\n" + command->get_footer());
  command
      ->add_option("--coordinator", options->coordinator,
                   "HOST:PORT of a farm (default: $GLEANER_COORDINATOR, else a farm of this process's own)")
      ->envname("GLEANER_COORDINATOR");
  command->add_option("-o,--output", options->output,
                      "OUT.png or OUT.exr: the newest picture; OUT_####.png: all of them; -: PPM pictures, one behind "
                      "the other, on standard output");
  command
      ->add_option("--refine", options->refine_to,
                   "samples a pixel up to which a picture is refined while nothing changes")
      ->capture_default_str()
      ->check(CLI::Range(0u, 1u << 20));
  command->add_option("--movable", options->movable, "a mesh that is to move, by its name")
      ->take_all()
      ->allow_extra_args(false);
  add_keys_option(*command);
  command->add_flag("--web{127.0.0.1:0}", options->web,
                    "HOST:PORT: pictures in a browser, where lights, materials and the camera can be changed with the "
                    "mouse (default: a free port of 127.0.0.1). Prints the page's address on standard output");
  command->add_flag(
      "--insecure", options->insecure,
      "other machines may reach --web, without encryption; who knows the page's address may change the scene");
  command->add_option("--workers", options->workers, "workers of the embedded farm")
      ->capture_default_str()
      ->check(CLI::Range(1u, 256u));
  command->add_option("--device", options->device, "OpenCL device, as `gleaner devices` counts");
  command->add_option("--trace", options->trace, "auto, embree or opencl")->capture_default_str();
  command->callback([options, &run] { run = [options] { return session(*options); }; });
}

}  // namespace gleaner::cli
