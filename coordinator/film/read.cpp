#include "coordinator/film/read.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfStringAttribute.h>

#include <cstdint>
#include <exception>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

constexpr std::uint64_t most_values = std::uint64_t{1} << 30;

Film read_channels(const std::string& path) {
  Imf::InputFile file(path.c_str());
  const auto window = file.header().dataWindow();
  const auto width = std::int64_t{window.max.x} - window.min.x + 1;
  const auto height = std::int64_t{window.max.y} - window.min.y + 1;

  std::uint64_t count = 0;
  const auto& list = file.header().channels();
  for (auto c = list.begin(); c != list.end(); ++c) {
    if (c.channel().xSampling != 1 || c.channel().ySampling != 1)
      throw Error::bad_input(path, std::string("channel ") + c.name(), "one value a pixel", "a subsampled channel");
    if (c.channel().type != Imf::UINT) ++count;
  }
  if (count == 0) throw Error::bad_input(path, "channels", "at least one float or half channel", "none");
  const auto size = std::to_string(width) + "x" + std::to_string(height);
  if (width < 1 || height < 1 || std::uint64_t(width) > most_values / std::uint64_t(height) / count)
    throw Error::bad_input(path, "data window", "at most 2^30 values in all channels",
                           size + " with " + std::to_string(count) + " channels");

  Film film{static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height), {}};
  film.channels.reserve(count);
  Imf::FrameBuffer buffer;
  const std::size_t row_bytes = sizeof(float) * film.width;
  for (auto c = list.begin(); c != list.end(); ++c) {
    if (c.channel().type == Imf::UINT) continue;
    auto& values = film.channel(c.name()).values;
    buffer.insert(c.name(), Imf::Slice::Make(Imf::FLOAT, values.data(), window, sizeof(float), row_bytes));
  }
  file.setFrameBuffer(buffer);
  file.readPixels(window.min.y, window.max.y);
  return film;
}

// Runs call(path): what OpenEXR throws becomes an error that names the file.
template <typename Call>
auto readable(const std::string& path, Call call) {
  try {
    return call(path);
  } catch (const Error&) {
    throw;
  } catch (const std::exception& error) {
    throw Error::bad_input(path, "", "a readable OpenEXR image", error.what());
  }
}

}  // namespace

Film read_exr(const std::string& path) { return readable(path, read_channels); }

std::map<std::string, std::string> read_exr_texts(const std::string& path) {
  return readable(path, [](const std::string& name) {
    std::map<std::string, std::string> texts;
    const Imf::InputFile file(name.c_str());
    for (auto a = file.header().begin(); a != file.header().end(); ++a)
      if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&a.attribute())) texts[a.name()] = text->value();
    return texts;
  });
}

}  // namespace gleaner::coordinator
