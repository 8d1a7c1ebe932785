// A double of Open Image Denoise's C interface: it writes down who calls what, fails where $FAKE_OIDN_FAILS says, and
// says that it is of version $FAKE_OIDN_VERSION. Its "denoiser" adds 1 to the picture (with $FAKE_OIDN_DOUBLES:
// doubles it), and halves a guide.

#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace {

std::string calls, failure;

void call(const std::string& name) {
  calls += name + "\n";
  const char* fails = std::getenv("FAKE_OIDN_FAILS");
  if (fails && name == fails) failure = name + " fails as it was told to";
}

struct Buffer {
  std::vector<float> values;
};

struct Filter {
  std::map<std::string, Buffer*> images;
  std::function<bool()> goes_on = [] { return true; };
};

int device, live = 0;

}  // namespace

extern "C" {

const char* fake_oidn_calls() { return calls.c_str(); }
void fake_oidn_forget() {
  calls.clear();
  failure.clear();
}
int fake_oidn_live() { return live; }

void* oidnNewDevice(int type) {
  call("new device " + std::to_string(type));
  if (!failure.empty()) return nullptr;
  ++live;
  return &device;
}
void oidnCommitDevice(void*) { call("commit device"); }
void oidnReleaseDevice(void*) {
  call("release device");
  --live;
}
void oidnSetDeviceBool(void*, const char* name, bool value) { call(std::string(name) + (value ? " on" : " off")); }
int oidnGetDeviceInt(void*, const char* name) {
  if (std::strcmp(name, "type") == 0) return 1;
  const char* version = std::getenv("FAKE_OIDN_VERSION");
  return version ? std::atoi(version) : 20501;
}
int oidnGetDeviceError(void*, const char** message) {
  static std::string told;
  told = failure;
  failure.clear();
  *message = told.c_str();
  return told.empty() ? 0 : 1;
}
void* oidnNewBuffer(void*, std::size_t bytes) {
  call("new buffer");
  ++live;
  return new Buffer{std::vector<float>(bytes / sizeof(float))};
}
void oidnReleaseBuffer(void* buffer) {
  --live;
  delete static_cast<Buffer*>(buffer);
}
void oidnWriteBuffer(void* buffer, std::size_t, std::size_t bytes, const void* from) {
  std::memcpy(static_cast<Buffer*>(buffer)->values.data(), from, bytes);
}
void oidnReadBuffer(void* buffer, std::size_t, std::size_t bytes, void* to) {
  call("read buffer");
  std::memcpy(to, static_cast<Buffer*>(buffer)->values.data(), bytes);
}
void* oidnNewFilter(void*, const char* type) {
  call(std::string("new filter ") + type);
  ++live;
  return new Filter;
}
void oidnSetFilterImage(void* filter, const char* name, void* buffer, int format, std::size_t width, std::size_t height,
                        std::size_t, std::size_t, std::size_t) {
  call(std::string("image ") + name + " " + std::to_string(format) + " " + std::to_string(width) + "x" +
       std::to_string(height));
  static_cast<Filter*>(filter)->images[name] = static_cast<Buffer*>(buffer);
}
void oidnSetFilterBool(void*, const char* name, bool value) { call(std::string(name) + (value ? " on" : " off")); }
void oidnSetFilterProgressMonitorFunction(void* filter, bool (*goes_on)(void*, double), void* user) {
  static_cast<Filter*>(filter)->goes_on = [=] { return goes_on(user, 0.5); };
}
void oidnCommitFilter(void*) { call("commit filter"); }
void oidnExecuteFilter(void* filter) {
  call("execute filter");
  if (!static_cast<Filter*>(filter)->goes_on()) {
    failure = "execution was cancelled";
    return;
  }
  auto& images = static_cast<Filter*>(filter)->images;
  const bool picture = images.contains("color");
  const std::vector<float>& from = images.at(picture                     ? "color"
                                             : images.contains("albedo") ? "albedo"
                                                                         : "normal")
                                       ->values;
  std::vector<float>& to = images.at("output")->values;
  const bool doubles = std::getenv("FAKE_OIDN_DOUBLES");
  for (std::size_t i = 0; i < to.size(); ++i) to[i] = !picture ? from[i] / 2 : doubles ? 2 * from[i] : from[i] + 1;
}
void oidnReleaseFilter(void* filter) {
  --live;
  delete static_cast<Filter*>(filter);
}
#ifndef FAKE_OIDN_PART
void oidnSetFilterInt(void*, const char* name, int value) { call(std::string(name) + " " + std::to_string(value)); }
#endif
}
