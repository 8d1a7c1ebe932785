// What protects a finished picture: it is on disk whole or not at all, and what is read back is what was written.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <random>
#include <thread>

#include "coordinator/film/read.h"
#include "coordinator/film/write.h"
#include "proto/atomic_file.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class FilmFiles : public testing::Test {
 protected:
  FilmFiles() {
    std::string pattern = (fs::temp_directory_path() / "gleaner-film-XXXXXX").string();
    if (!::mkdtemp(pattern.data())) throw std::runtime_error("mkdtemp failed");
    folder_ = pattern;
  }
  ~FilmFiles() override { fs::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::vector<std::string> names() const {
    std::vector<std::string> result;
    for (const auto& entry : fs::directory_iterator(folder_)) result.push_back(entry.path().filename());
    std::ranges::sort(result);
    return result;
  }

  fs::path folder_;
};

// Values that differ everywhere, with the awkward ones among them.
Film sample_film(std::uint32_t width = 37, std::uint32_t height = 19) {
  Film film{width, height, {}};
  float seed = 0;
  for (const char* name : {"R", "G", "B", "direct.R", "depth.Z"})
    for (float& value : film.channel(name).values) value = std::sin(seed += 0.37f) * 100;
  film.channel("R").values[3] = -0.0f;
  film.channel("G").values[4] = std::numeric_limits<float>::denorm_min();
  film.channel("B").values[5] = std::numeric_limits<float>::max();
  return film;
}

std::string read_text(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string failure_of(const std::function<void()>& action, ErrorKind kind) {
  try {
    action();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind) << error.what();
    return error.what();
  }
  ADD_FAILURE() << "no error was thrown";
  return {};
}

TEST_F(FilmFiles, ReadsBackEveryBit) {
  const Film film = sample_film();
  write_exr(film, {{"gleaner.seed", "7"}}, path("a.exr"));
  const Film read = read_exr(path("a.exr"));
  ASSERT_EQ(read.width, film.width);
  ASSERT_EQ(read.height, film.height);
  ASSERT_EQ(read.channels.size(), film.channels.size());
  for (const auto& channel : film.channels) {
    const Channel* found = read.find(channel.name);
    ASSERT_TRUE(found) << channel.name;
    for (std::size_t i = 0; i < channel.values.size(); ++i)
      ASSERT_EQ(std::bit_cast<std::uint32_t>(found->values[i]), std::bit_cast<std::uint32_t>(channel.values[i]))
          << channel.name << " value " << i;
  }
  EXPECT_EQ(pixels_sha256(read), pixels_sha256(film));
  EXPECT_THAT(read_text(path("a.exr")), HasSubstr("gleaner.seed"));
  EXPECT_EQ(names(), std::vector<std::string>{"a.exr"});
}

// What does not shrink is stored as it is, and names over 31 letters need a flag, which OpenEXR 3.1 writes
// and does not ask for.
TEST_F(FilmFiles, RandomBitsAndLongNamesComeBack) {
  Film film{33, 50, {}};
  std::mt19937 bits(7);
  const std::string long_name = "a.layer.with.a.name.of.more.than.thirty.one.letters.R";
  for (const auto& name : {std::string("R"), std::string("G"), std::string("B"), long_name})
    for (float& value : film.channel(name).values)
      value = std::bit_cast<float>(static_cast<std::uint32_t>(bits()) & 0xbfffffffu);  // never infinite or NaN
  write_exr(film, {{"gleaner.an.attribute.of.more.than.thirty.one.letters", "x"}}, path("a.exr"));
  EXPECT_EQ(read_text(path("a.exr")).substr(4, 4), std::string("\2\4\0\0", 4));  // version 2, long names
  const Film read = read_exr(path("a.exr"));
  for (const auto& channel : film.channels) {
    const Channel* found = read.find(channel.name);
    ASSERT_TRUE(found) << channel.name;
    for (std::size_t i = 0; i < channel.values.size(); ++i)
      ASSERT_EQ(std::bit_cast<std::uint32_t>(found->values[i]), std::bit_cast<std::uint32_t>(channel.values[i]));
  }
}

// Computed apart with Python: hashlib.sha256(struct.pack('<6f', 0, 1, 2, 3, 4, 5)).
TEST_F(FilmFiles, HashIsOfInterleavedRowsFromTheTop) {
  Film film{1, 2, {}};
  film.channel("B").values = {2, 5};  // the channels' order in the film does not count, nor do other channels
  film.channel("R").values = {0, 3};
  film.channel("depth.Z").values = {9, 9};
  film.channel("G").values = {1, 4};
  EXPECT_EQ(pixels_sha256(film), "e2c0a71510b5394df7773b63fb5f54372b84c3564e67811bde7d665be227976d");
}

TEST_F(FilmFiles, PngHoldsSrgbOfTheExposedRadiance) {
  Film film{4, 1, {}};
  film.channel("R").values = {0.25f, -1, std::numeric_limits<float>::quiet_NaN(), 1e30f};
  film.channel("G").values = {0.0015f, 0, 0, 0.5f};
  film.channel("B").values = {0.107f, 0, 0, 0.25f};
  write_png(film, path("a.png"), 1);
  const auto encoded = encode_png(film, 1);
  EXPECT_EQ(read_text(path("a.png")), std::string(reinterpret_cast<const char*>(encoded.data()), encoded.size()));
  EXPECT_EQ(names(), std::vector<std::string>{"a.png"});
  // IEC 61966-2-1 of 2 x radiance: 0.5 -> 188, 0.003 -> 9.88, 0.214 -> 127.5
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  ASSERT_TRUE(png_image_begin_read_from_memory(&image, encoded.data(), encoded.size()));
  ASSERT_EQ(image.width, 4u);
  ASSERT_EQ(image.height, 1u);
  image.format = PNG_FORMAT_RGB;
  std::vector<std::uint8_t> values(PNG_IMAGE_SIZE(image));
  ASSERT_TRUE(png_image_finish_read(&image, nullptr, values.data(), 0, nullptr));
  EXPECT_THAT(values, testing::ElementsAre(188, 10, 127, 0, 0, 0, 0, 0, 0, 255, 255, 188));
}

TEST_F(FilmFiles, FailingWriteLeavesTheOldFileAndNothingElse) {
  write_exr(sample_film(), {}, path("a.exr"));
  const std::string before = read_text(path("a.exr"));
  Film broken = sample_film();
  broken.channels[1].values.pop_back();
  EXPECT_THAT(failure_of([&] { write_exr(broken, {}, path("a.exr")); }, ErrorKind::failed), HasSubstr("channel G"));
  EXPECT_EQ(read_text(path("a.exr")), before);
  EXPECT_EQ(names(), std::vector<std::string>{"a.exr"});
}

TEST_F(FilmFiles, MissingFolderIsNamed) {
  const auto message = failure_of([&] { write_exr(sample_film(), {}, path("absent/a.exr")); }, ErrorKind::failed);
  EXPECT_THAT(message, HasSubstr("absent/a.exr"));
  EXPECT_THAT(message, HasSubstr("No such file or directory"));
}

TEST_F(FilmFiles, FolderInTheWayIsNamed) {
  fs::create_directory(path("a.exr"));
  EXPECT_THAT(failure_of([&] { write_exr(sample_film(), {}, path("a.exr")); }, ErrorKind::failed),
              HasSubstr("not a regular file"));
  EXPECT_EQ(names(), std::vector<std::string>{"a.exr"});
}

// A rename would replace a pipe or a device node such as /dev/null by a file.
TEST_F(FilmFiles, SpecialFilesAreLeftAlone) {
  ASSERT_EQ(::mkfifo(path("pipe").c_str(), 0600), 0);
  EXPECT_THAT(failure_of([&] { write_png(sample_film(), path("pipe"), 0); }, ErrorKind::failed),
              HasSubstr("not a regular file"));
  EXPECT_TRUE(fs::is_fifo(path("pipe")));
}

TEST_F(FilmFiles, SymbolicLinksAreFollowed) {
  fs::create_directory(path("real"));
  fs::create_symlink("real/a.png", path("link.png"));
  write_png(sample_film(), path("link.png"), 0);
  EXPECT_TRUE(fs::is_symlink(path("link.png")));
  EXPECT_TRUE(fs::is_regular_file(path("real/a.png")));
}

TEST_F(FilmFiles, UnwritableFolderIsNamed) {
  fs::permissions(folder_, fs::perms::owner_read | fs::perms::owner_exec);
  // Root may write everywhere, so it steps down for this test.
  const bool root = ::geteuid() == 0;
  ASSERT_EQ(root ? ::seteuid(65534) : 0, 0);
  const auto message = failure_of([&] { write_exr(sample_film(), {}, path("a.exr")); }, ErrorKind::failed);
  ASSERT_EQ(root ? ::seteuid(0) : 0, 0);
  fs::permissions(folder_, fs::perms::owner_all);
  EXPECT_THAT(message, HasSubstr("Permission denied"));
  EXPECT_TRUE(names().empty());
}

TEST_F(FilmFiles, FullDiskLeavesTheOldFileAndNothingElse) {
  if (::mount("tmpfs", folder_.c_str(), "tmpfs", 0, "size=256k") != 0)
    GTEST_SKIP() << "NOT CHECKED: a full disk needs a tmpfs of its own, and mounting one failed (not root?)";
  struct Unmount {
    std::string folder;
    ~Unmount() { ::umount2(folder.c_str(), MNT_DETACH); }
  } unmount{folder_.string()};
  write_exr(sample_film(), {}, path("a.exr"));
  const std::string before = read_text(path("a.exr"));
  const auto message = failure_of([&] { write_exr(sample_film(512, 512), {}, path("a.exr")); }, ErrorKind::failed);
  EXPECT_THAT(message, HasSubstr("a.exr"));
  EXPECT_THAT(message, HasSubstr("No space left on device"));
  EXPECT_EQ(read_text(path("a.exr")), before);
  EXPECT_EQ(names(), std::vector<std::string>{"a.exr"});
}

TEST_F(FilmFiles, ConcurrentWritersOfOnePathNeverMix) {
  constexpr int writers = 4, rounds = 20;
  std::vector<std::string> hashes;
  std::vector<Film> films;
  for (int w = 0; w < writers; ++w) {
    films.push_back(sample_film(64, 48));
    for (auto& value : films.back().channel("R").values) value = float(w);
    hashes.push_back(pixels_sha256(films.back()));
  }
  write_exr(films[0], {}, path("a.exr"));
  std::atomic<bool> done{false};
  std::vector<std::string> seen;
  std::thread reader([&] {
    while (!done) seen.push_back(pixels_sha256(read_exr(path("a.exr"))));
  });
  std::vector<std::thread> threads;
  for (int w = 0; w < writers; ++w)
    threads.emplace_back([&, w] {
      for (int round = 0; round < rounds; ++round) write_exr(films[w], {}, path("a.exr"));
    });
  for (auto& thread : threads) thread.join();
  done = true;
  reader.join();
  seen.push_back(pixels_sha256(read_exr(path("a.exr"))));
  for (const auto& hash : seen) ASSERT_THAT(hashes, testing::Contains(hash));
  EXPECT_EQ(names(), std::vector<std::string>{"a.exr"});
}

TEST_F(FilmFiles, DamagedFilesAreBadInput) {
  EXPECT_THAT(failure_of([&] { read_exr(path("absent.exr")); }, ErrorKind::bad_input), HasSubstr("absent.exr"));
  std::ofstream(path("text.exr")) << "this is no picture";
  EXPECT_THAT(failure_of([&] { read_exr(path("text.exr")); }, ErrorKind::bad_input), HasSubstr("text.exr"));
  write_exr(sample_film(), {}, path("a.exr"));
  const std::string whole = read_text(path("a.exr"));
  for (const std::size_t cut : {std::size_t{0}, std::size_t{4}, std::size_t{100}, whole.size() / 2, whole.size() - 1}) {
    std::ofstream(path("cut.exr"), std::ios::binary) << whole.substr(0, cut);
    EXPECT_THAT(failure_of([&] { read_exr(path("cut.exr")); }, ErrorKind::bad_input), HasSubstr("cut.exr")) << cut;
  }
}

// A header may claim any size; the claim is refused before memory is taken for it.
TEST_F(FilmFiles, ClaimedSizeIsCheckedFirst) {
  write_exr(sample_film(), {}, path("a.exr"));
  std::string bytes = read_text(path("a.exr"));
  const auto at = bytes.find("dataWindow");
  ASSERT_NE(at, std::string::npos);
  const std::size_t window = at + sizeof("dataWindow") + sizeof("box2i") + 4;
  const std::int32_t most = 1 << 20;
  bytes.replace(window + 8, 4, reinterpret_cast<const char*>(&most), 4);
  bytes.replace(window + 12, 4, reinterpret_cast<const char*>(&most), 4);
  std::ofstream(path("huge.exr"), std::ios::binary) << bytes;
  EXPECT_THAT(failure_of([&] { read_exr(path("huge.exr")); }, ErrorKind::bad_input), HasSubstr("huge.exr"));
}

TEST_F(FilmFiles, IncompleteFilmsAreRefused) {
  Film film{2, 2, {}};
  film.channel("R");
  film.channel("G");
  EXPECT_THAT(failure_of([&] { pixels_sha256(film); }, ErrorKind::failed), HasSubstr("B"));
  EXPECT_THAT(failure_of([&] { encode_png(film, 0); }, ErrorKind::failed), HasSubstr("B"));
  film.channels.push_back(film.channels.front());
  EXPECT_THAT(failure_of([&] { write_exr(film, {}, path("a.exr")); }, ErrorKind::failed), HasSubstr("twice"));
  EXPECT_THAT(failure_of([&] { write_exr(Film{}, {}, path("a.exr")); }, ErrorKind::failed), HasSubstr("0x0"));
  EXPECT_TRUE(names().empty());
}

}  // namespace
}  // namespace gleaner::coordinator
