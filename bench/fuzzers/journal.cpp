// libFuzzer: what a coordinator reads of its journal. The first byte chooses: a job's request, its frames, a farm's
// start on a row of each kind, the database's file.

#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "bench/fuzzers/called_farm.h"
#include "bench/fuzzers/seeds.h"
#include "coordinator/jobs/request_codec.h"
#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/sqlite_journal.h"
#include "scene/model/error.h"

using namespace gleaner;
using namespace gleaner::coordinator;

namespace {

std::span<const std::byte> bytes_of(const std::string& text) { return std::as_bytes(std::span(text)); }
scene::Bytes copy_of(const std::string& text) {
  const auto bytes = bytes_of(text);
  return {bytes.begin(), bytes.end()};
}

// Holds one job, in the fuzzer's words.
class OneJob final : public Journal {
 public:
  explicit OneJob(std::vector<std::string> words) : words_(std::move(words)) { words_.resize(5); }
  std::string name() const override { return "a fuzzer's"; }
  std::uint64_t begin() override { return 1; }
  std::vector<JournalJob> jobs() override {
    return {{.id = words_[0], .state = words_[1], .message = words_[2], .request = copy_of(words_[3])}};
  }
  Bytes frames(const std::string&) override { return copy_of(words_[4]); }
  std::vector<JournalFrame> frames_over(const std::string& job) override {
    std::vector<JournalFrame> all;
    for (const char letter : words_[2])
      all.push_back({.job = job, .frame = static_cast<std::uint8_t>(letter), .failure = {}});
    return all;
  }
  std::vector<JournalRange> ranges(const std::string&, std::uint64_t) override { return {}; }
  void add(const JournalJob&, const Bytes&) override {}
  void write(const JournalChanges&) override {}

 private:
  std::vector<std::string> words_;
};

const std::filesystem::path& folder() {
  static const test::TemporaryFolder made;
  return made.path();
}

JobRequest request() {
  JobRequest job;
  job.scene_name = "fake.glb";
  job.scenes = {{std::string(64, 'a'), {}, {}, {}}};
  job.settings = test::fake_settings();
  job.settings.set["key"] = "value";
  job.after = {"other"};
  job.numbers = {1, 5};
  return job;
}

std::string text_of(const Bytes& bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

void start_farm(std::vector<std::string> words) {
  static auto* blobs = new BlobStore;
  FarmSettings settings;
  settings.plan = test::make_fake_plan;
  settings.check = test::check_fake_settings;
  settings.log = [](const std::string&) {};
  settings.paths = [](const std::string&, std::uint32_t) { return FramePaths{folder() / "frame.exr", {}, {}}; };
  settings.journal = std::make_shared<JournalWriter>(std::make_unique<OneJob>(std::move(words)), settings.log);
  const Farm farm(settings, *blobs);
  for (const JobStatus& job : farm.list()) farm.why(job.id);
}

void open_file(std::span<const std::uint8_t> bytes) {
  const std::filesystem::path file = folder() / "journal.sqlite";
  for (const char* end : {"-wal", "-shm"}) std::filesystem::remove(file.string() + end);
  std::ofstream(file, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<long>(bytes.size()));
  const auto journal = open_sqlite_journal(file, 0);
  for (const JournalJob& job : journal->jobs()) {
    journal->frames(job.id);
    journal->frames_over(job.id);
    journal->ranges(job.id, 0);
  }
}

}  // namespace

std::vector<std::string> fuzz::seeds() {
  const std::string asked = text_of(encode_request(request())), frames = text_of(encode_frames(request()));
  std::vector<std::string> all = {std::string(1, '\0') + asked, std::string(1, '\1') + frames,
                                  fuzz::input_of(2, {"a", "queued", std::string(1, '\0'), asked, frames}),
                                  fuzz::input_of(2, {"a", "failed", "why", asked, frames})};
  const std::filesystem::path file = folder() / "seed.sqlite";
  {
    auto journal = open_sqlite_journal(file);
    journal->add({.id = "a", .state = "queued", .message = {}, .request = encode_request(request())},
                 encode_frames(request()));
  }
  std::ifstream in(file, std::ios::binary);
  all.push_back(std::string(1, '\3') + std::string(std::istreambuf_iterator<char>(in), {}));
  return all;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string rest(reinterpret_cast<const char*>(data) + 1, size - 1);
  try {
    switch (data[0] % 4) {
      case 0:
        decode_request(bytes_of(rest));
        break;
      case 1: {
        JobRequest read;
        decode_frames(bytes_of(rest), read);
        break;
      }
      case 2:
        start_farm(fuzz::messages_of({data + 1, size - 1}));
        break;
      default:
        open_file({data + 1, size - 1});
    }
  } catch (const Error&) {  // said and refused
  }
  return 0;
}
