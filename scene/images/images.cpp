#include "scene/images/images.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <exception>
#include <fstream>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "scene/files/files.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

// OpenImageIO picks a reader by the file's name and has readers that run programs or make images up; the first bytes
// decide here instead.
const char* format_of(std::string_view head, const std::filesystem::path& path) {
  const auto begins = [&](std::string_view magic) { return head.starts_with(magic); };
  if (begins("\x89PNG")) return "png";
  if (begins("\xff\xd8\xff")) return "jpeg";
  if (begins("BM")) return "bmp";
  if (begins("GIF8")) return "gif";
  if (begins(std::string_view("II*\0", 4)) || begins(std::string_view("MM\0*", 4))) return "tiff";
  if (begins("RIFF") && head.substr(8).starts_with("WEBP")) return "webp";
  const std::string extension = path.extension().string();
  if (extension == ".tga" || extension == ".TGA") return "targa";
  return nullptr;
}

// An image that has been opened: its header is known, its texels are not read.
class OpenImage {
 public:
  OpenImage(const ImageSource& source, const std::string& file) : source_(source), file_(file) {
    const std::string first = head();
    const char* format = format_of(first, source.path);
    if (!format) fail("a PNG or JPEG image", "other bytes");
    if (std::string_view(format) == "gif") check_canvas(first);
    reader_ = OIIO::ImageInput::create(format);
    if (!reader_) fail("an image that OpenImageIO reads", std::string(format) + ": " + OIIO::geterror());
    OIIO::ImageSpec wanted;
    wanted.attribute("oiio:UnassociatedAlpha", 1);
    if (source.path.empty()) {
      if (!reader_->supports("ioproxy")) fail("an embedded image that is PNG or JPEG", format);
      memory_.emplace(const_cast<std::byte*>(source.bytes.data()), source.bytes.size());
      reader_->set_ioproxy(&*memory_);
    }
    const std::string name = source.path.empty() ? "embedded." + std::string(format) : source.path.string();
    decode([&] {
      if (!reader_->open(name, spec_, wanted)) fail("an image", one_line(reader_->geterror()));
    });
    if (!(spec_.width >= 1 && spec_.width <= int(kMaxTextureSide) && spec_.height >= 1 &&
          spec_.height <= int(kMaxTextureSide) && spec_.depth <= 1 && spec_.nchannels >= 1))
      fail("1 to " + std::to_string(kMaxTextureSide) + " texels a side",
           std::to_string(spec_.width) + "x" + std::to_string(spec_.height));
    check_promise(bytes());
  }

  ~OpenImage() {
    if (reader_) reader_->close();
  }

  OpenImage(const OpenImage&) = delete;
  OpenImage& operator=(const OpenImage&) = delete;

  std::uint32_t width() const { return static_cast<std::uint32_t>(spec_.width); }
  std::uint32_t height() const { return static_cast<std::uint32_t>(spec_.height); }
  bool exceeds_bytes() const { return spec_.format.size() > 1; }
  std::uint64_t texels() const { return std::uint64_t(width()) * height(); }

  // Deflate never says more than 1032 bytes with one: a PNG that promises more than its bytes can hold is refused
  // before room is made for it.
  void check_promise(std::uint64_t bytes) const {
    constexpr std::uint64_t most = 1032;
    if (std::string_view(reader_->format_name()) != "png") return;
    const std::uint64_t bits = spec_.format.size() * 8 * std::uint64_t(spec_.nchannels);
    // Palettes and one-bit images are unpacked to bytes by the reader: 1 bit a pixel is the least.
    if (std::uint64_t(spec_.height) * (std::uint64_t(spec_.width) * std::min<std::uint64_t>(bits, 1) / 8) >
        most * bytes)
      fail("an image of as many bytes as its " + std::to_string(spec_.width) + "x" + std::to_string(spec_.height) +
               " texels take",
           std::to_string(bytes));
  }

  // Returns what a person may want to know about the image; empty where nothing is.
  std::string read(std::uint32_t* texels) {
    const std::size_t count = std::size_t(width()) * height();
    std::fill_n(texels, count, 0xffffffffu);
    const int channels = std::min(spec_.nchannels, 4);
    decode([&] {
      if (!reader_->read_image(0, 0, 0, channels, OIIO::TypeDesc::UINT8, texels, sizeof *texels))
        fail("an image that can be decoded", one_line(reader_->geterror()));
    });
    // A JPEG that ends too soon is grey from there on and no error to its reader; other complaints are for people.
    const std::string complaint = reader_->geterror();
    if (complaint.find("Premature end") != std::string::npos) fail("a whole image", one_line(complaint));
    if (channels <= 2) spread_grey(texels, count, channels);
    return complaint.empty() ? "" : one_line(complaint);
  }

 private:
  // What readers throw is said in our words.
  template <typename Call>
  void decode(const Call& call) const {
    try {
      call();
    } catch (const Error&) {
      throw;
    } catch (const std::exception& error) {
      fail("an image that can be decoded", std::string("one at which its reader fails: ") + error.what());
    }
  }

  // A GIF's reader takes the memory of its canvas when it opens the file. A code of at most 12 bits stands for at most
  // 4096 texels.
  void check_canvas(const std::string& first) const {
    const auto side = [&](std::size_t at) {
      return static_cast<unsigned char>(first[at]) + 256u * static_cast<unsigned char>(first[at + 1]);
    };
    const std::uint64_t width = side(6), height = side(8);
    const std::string size = std::to_string(width) + "x" + std::to_string(height);
    if (width > kMaxTextureSide || height > kMaxTextureSide)
      fail("1 to " + std::to_string(kMaxTextureSide) + " texels a side", size);
    if (width * height > bytes() * 8 / 9 * 4096)
      fail("an image of as many bytes as its " + size + " texels take", std::to_string(bytes()));
  }

  [[noreturn]] void fail(const std::string& expected, const std::string& found) const {
    const std::string name = source_.path.empty() ? "" : " (" + source_.path.filename().string() + ")";
    throw Error::bad_input(file_, source_.element + name, expected, found);
  }

  static void spread_grey(std::uint32_t* texels, std::size_t count, int channels) {
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint32_t grey = texels[i] & 0xff, alpha = channels == 2 ? texels[i] >> 8 & 0xff : 0xff;
      texels[i] = alpha << 24 | grey << 16 | grey << 8 | grey;
    }
  }

  std::uint64_t bytes() const {
    return source_.path.empty() ? source_.bytes.size() : file_bytes(source_.path, file_, source_.element);
  }

  std::string head() const {
    std::string bytes(16, '\0');
    if (source_.path.empty()) {
      if (source_.bytes.empty()) fail("an image", "0 bytes");
      const std::size_t count = std::min(bytes.size(), source_.bytes.size());
      std::memcpy(bytes.data(), source_.bytes.data(), count);
    } else {
      file_bytes(source_.path, file_, source_.element);
      std::ifstream(source_.path, std::ios::binary).read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    }
    return bytes;
  }

  static std::string one_line(std::string text) {
    std::replace(text.begin(), text.end(), '\n', ' ');
    return text.empty() ? "an unreadable one" : text;
  }

  const ImageSource& source_;
  const std::string& file_;
  std::optional<OIIO::Filesystem::IOMemReader> memory_;  // outlives the reader
  std::unique_ptr<OIIO::ImageInput> reader_;
  OIIO::ImageSpec spec_;
};

}  // namespace

std::vector<DecodedImage> decode_images(const std::vector<ImageSource>& sources, const std::string& file,
                                        std::uint64_t most_texels, std::vector<std::uint32_t>& texels,
                                        Warnings& warnings) {
  std::vector<DecodedImage> images;
  std::uint64_t total = texels.size();
  for (const ImageSource& source : sources) {
    const OpenImage image(source, file);
    images.push_back({static_cast<std::uint32_t>(total), image.width(), image.height()});
    total += std::uint64_t(image.width()) * image.height();
    if (total > std::min<std::uint64_t>(most_texels, kMaxTexels))
      throw Error::bad_input(
          file, source.element,
          "at most " + std::to_string(most_texels) + " texels in all images (--texture-limit sets another number)",
          std::to_string(total));
    if (image.exceeds_bytes()) warnings.add(source.element, "reduced to 8 bits a channel");
  }
  texels.resize(total);

  // Decoders keep copies of what they work on: large images take their turns.
  constexpr std::uint64_t large = std::uint64_t(1) << 24;
  std::mutex one_large_image;
  std::atomic<std::size_t> next = 0;
  std::vector<std::exception_ptr> errors(sources.size());
  std::vector<std::string> remarks(sources.size());
  const auto run = [&] {
    for (std::size_t i; (i = next++) < sources.size();) {
      try {
        OpenImage image(sources[i], file);
        // A file that changed between its two openings must not write past its place.
        if (image.width() != images[i].width || image.height() != images[i].height)
          throw Error::bad_input(file, sources[i].element, "an image that stays the same", "another size");
        std::unique_lock<std::mutex> turn(one_large_image, std::defer_lock);
        if (image.texels() > large) turn.lock();
        remarks[i] = image.read(texels.data() + images[i].first_texel);
      } catch (...) {
        errors[i] = std::current_exception();
      }
    }
  };
  {
    std::vector<std::jthread> helpers;
    const std::size_t threads =
        std::min<std::size_t>(sources.size(), std::max(1u, std::thread::hardware_concurrency()));
    for (std::size_t i = 1; i < threads; ++i) helpers.emplace_back(run);
    run();
  }
  for (const std::exception_ptr& error : errors)
    if (error) std::rethrow_exception(error);
  for (std::size_t i = 0; i < remarks.size(); ++i)
    if (!remarks[i].empty()) warnings.add(sources[i].element, remarks[i]);
  return images;
}

}  // namespace gleaner::scene
