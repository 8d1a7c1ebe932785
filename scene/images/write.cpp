#include "scene/images/write.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <memory>

#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

std::unique_ptr<OIIO::ImageOutput> writer_of(const char* format) {
  std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(format);
  if (!output) throw Error::failed("OpenImageIO does not write " + std::string(format) + ": " + OIIO::geterror());
  return output;
}

}  // namespace

std::vector<unsigned char> png_bytes(std::uint32_t width, std::uint32_t height, std::span<const std::uint32_t> texels) {
  const auto output = writer_of("png");
  std::vector<unsigned char> bytes;
  OIIO::Filesystem::IOVecOutput memory(bytes);
  OIIO::ImageSpec spec(static_cast<int>(width), static_cast<int>(height), 4, OIIO::TypeDesc::UINT8);
  spec.alpha_channel = 3;
  spec.attribute("oiio:UnassociatedAlpha", 1);  // our texels are, and must not be divided by their alpha
  output->set_ioproxy(&memory);
  if (!output->open("texture.png", spec) || !output->write_image(OIIO::TypeDesc::UINT8, texels.data()) ||
      !output->close())
    throw Error::failed(output->geterror());
  return bytes;
}

void write_exr(const std::string& path, std::uint32_t width, std::uint32_t height, std::span<const float> rgb) {
  const auto output = writer_of("openexr");
  OIIO::ImageSpec spec(static_cast<int>(width), static_cast<int>(height), 3, OIIO::TypeDesc::FLOAT);
  spec.attribute("compression", "zip");
  if (!output->open(path, spec) || !output->write_image(OIIO::TypeDesc::FLOAT, rgb.data()) || !output->close())
    throw Error::failed(output->geterror());
}

}  // namespace gleaner::scene
