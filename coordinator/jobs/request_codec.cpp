#include "coordinator/jobs/request_codec.h"

#include <cstring>
#include <nlohmann/json.hpp>

#include "scene/model/error.h"
#include "scene/model/needs.h"

namespace gleaner::coordinator {

namespace {

using nlohmann::json;
using Binary = json::binary_t;

// Names are bytes that need not be UTF-8, and CBOR's text must be.
Binary binary(const std::string& text) { return Binary({text.begin(), text.end()}); }

std::string text_of(const json& value) {
  const Binary& bytes = value.get_binary();
  return {bytes.begin(), bytes.end()};
}

std::string text_at(const json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() ? std::string() : text_of(*found);
}

Binary cameras(std::span<const scene::Camera> all) {
  const auto* first = reinterpret_cast<const std::uint8_t*>(all.data());
  return Binary({first, first + all.size_bytes()});
}

std::vector<scene::Camera> cameras_of(const json& value) {
  const Binary& bytes = value.get_binary();
  if (bytes.size() % sizeof(scene::Camera) != 0)
    throw Error::failed(std::to_string(bytes.size()) + " bytes of cameras, expected a multiple of " +
                        std::to_string(sizeof(scene::Camera)));
  std::vector<scene::Camera> all(bytes.size() / sizeof(scene::Camera));
  if (!all.empty()) std::memcpy(all.data(), bytes.data(), bytes.size());
  return all;
}

json encode_scene(const FrameScene& scene) {
  const SceneSummary& summary = scene.summary;
  return {{"scene", binary(scene.scene_blob)}, {"bvh", binary(scene.bvh_blob)},
          {"state", binary(scene.state_blob)}, {"needs", summary.needs.bits()},
          {"triangles", summary.triangles},    {"emissive_triangles", summary.emissive_triangles},
          {"lights", summary.lights},          {"lower", summary.bounds.lower},
          {"upper", summary.bounds.upper},     {"roughest_lobe", summary.roughest_lobe}};
}

FrameScene decode_scene(const json& value) {
  FrameScene scene;
  scene.scene_blob = text_at(value, "scene");
  scene.bvh_blob = text_at(value, "bvh");
  scene.state_blob = text_at(value, "state");
  scene.summary.needs = scene::needs_from_bits(value.at("needs").get<std::uint32_t>());
  scene.summary.triangles = value.at("triangles").get<std::uint64_t>();
  scene.summary.emissive_triangles = value.at("emissive_triangles").get<std::uint64_t>();
  scene.summary.lights = value.at("lights").get<std::uint64_t>();
  scene.summary.roughest_lobe = value.value("roughest_lobe", 1.0f);  // older journals do not know
  value.at("lower").get_to(scene.summary.bounds.lower);
  value.at("upper").get_to(scene.summary.bounds.upper);
  scene.summary.rest_bounds = scene.summary.bounds;
  return scene;
}

Bytes cbor(const json& value) {
  const std::vector<std::uint8_t> bytes = json::to_cbor(value);
  const auto* first = reinterpret_cast<const std::byte*>(bytes.data());
  return {first, first + bytes.size()};
}

// Stops where values are nested deeper than any that is written: the library's reader calls itself for each level.
class NestingCheck final : public nlohmann::json_sax<json> {
 public:
  bool too_deep() const { return depth_ > most; }

  bool null() override { return true; }
  bool boolean(bool) override { return true; }
  bool number_integer(number_integer_t) override { return true; }
  bool number_unsigned(number_unsigned_t) override { return true; }
  bool number_float(number_float_t, const string_t&) override { return true; }
  bool string(string_t&) override { return true; }
  bool binary(binary_t&) override { return true; }
  bool key(string_t&) override { return true; }
  bool start_object(std::size_t) override { return ++depth_ <= most; }
  bool start_array(std::size_t) override { return ++depth_ <= most; }
  bool end_object() override { return depth_-- > 0; }
  bool end_array() override { return depth_-- > 0; }
  bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception&) override { return false; }

 private:
  static constexpr int most = 16;
  int depth_ = 0;
};

// Runs `read` on the decoded value; what the library throws is said in words of the journal.
template <typename Read>
auto decode(std::span<const std::byte> bytes, const char* what, const Read& read) {
  try {
    const auto* first = reinterpret_cast<const std::uint8_t*>(bytes.data());
    NestingCheck nesting;
    json::sax_parse(first, first + bytes.size(), &nesting, json::input_format_t::cbor);
    if (nesting.too_deep())
      throw Error::failed(std::string("the journal's record of the job's ") + what +
                          " cannot be read: values are nested too deep");
    return read(json::from_cbor(first, first + bytes.size()));
  } catch (const json::exception& error) {
    throw Error::failed(std::string("the journal's record of the job's ") + what + " cannot be read: " + error.what());
  }
}

}  // namespace

Bytes encode_request(const JobRequest& request) {
  const FrameSettings& settings = request.settings;
  json set = json::array();
  for (const auto& [key, value] : settings.set) set.push_back({binary(key), binary(value)});
  json after = json::array();
  for (const std::string& job : request.after) after.push_back(binary(job));
  return cbor({{"scene", binary(request.scene_name)},
               {"camera_name", binary(request.camera_name)},
               {"method", binary(settings.method)},
               {"width", settings.width},
               {"height", settings.height},
               {"spp", settings.spp},
               {"depth", settings.depth},
               {"seed", settings.seed},
               {"camera", cameras({&settings.camera, 1})},
               {"target_error", settings.target_error},
               {"denoise", word_of(settings.denoise)},
               {"set", set},
               {"first_frame", request.first_frame},
               {"last_frame", request.last_frame},
               {"frame_step", request.frame_step},
               {"numbers", request.numbers},
               {"name", binary(request.name)},
               {"owner", binary(request.owner)},
               {"priority", request.priority},
               {"after", after},
               {"request_id", binary(request.request_id)},
               {"content", binary(request.content)},
               {"exposure_stops", request.exposure_stops},
               {"time_limit", request.time_limit}});
}

Bytes encode_frames(const JobRequest& request) {
  json scenes = json::array();
  for (const FrameScene& scene : request.scenes) scenes.push_back(encode_scene(scene));
  return cbor({{"scenes", scenes}, {"cameras", cameras(request.cameras)}});
}

JobRequest decode_request(std::span<const std::byte> bytes) {
  return decode(bytes, "request", [](const json& value) {
    JobRequest request;
    FrameSettings& settings = request.settings;
    request.scene_name = text_at(value, "scene");
    request.camera_name = text_at(value, "camera_name");
    settings.method = text_at(value, "method");
    settings.width = value.at("width").get<std::uint32_t>();
    settings.height = value.at("height").get<std::uint32_t>();
    settings.spp = value.at("spp").get<std::uint32_t>();
    settings.depth = value.at("depth").get<std::uint32_t>();
    settings.seed = value.at("seed").get<std::uint64_t>();
    const auto camera = cameras_of(value.at("camera"));
    if (camera.size() != 1) throw Error::failed("the journal's record of the job's request has no camera");
    settings.camera = camera.front();
    settings.target_error = value.at("target_error").get<double>();
    settings.denoise = parse_denoise(value.value("denoise", "off"));  // of before it was there: none
    for (const json& entry : value.at("set")) settings.set[text_of(entry.at(0))] = text_of(entry.at(1));
    request.first_frame = value.at("first_frame").get<std::uint32_t>();
    request.last_frame = value.at("last_frame").get<std::uint32_t>();
    request.frame_step = value.value("frame_step", request.frame_step);
    // Requests of earlier versions have none of these.
    request.numbers = value.value("numbers", request.numbers);
    request.name = text_at(value, "name");
    request.owner = text_at(value, "owner");
    request.priority = value.value("priority", request.priority);
    if (const auto after = value.find("after"); after != value.end())
      for (const json& job : *after) request.after.push_back(text_of(job));
    request.request_id = text_at(value, "request_id");
    request.content = text_at(value, "content");
    request.exposure_stops = value.at("exposure_stops").get<double>();
    request.time_limit = value.at("time_limit").get<double>();
    return request;
  });
}

void decode_frames(std::span<const std::byte> bytes, JobRequest& request) {
  decode(bytes, "frames", [&](const json& value) {
    for (const json& scene : value.at("scenes")) request.scenes.push_back(decode_scene(scene));
    request.cameras = cameras_of(value.at("cameras"));
  });
}

}  // namespace gleaner::coordinator
