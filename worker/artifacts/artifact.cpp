#include "worker/artifacts/artifact.h"

#include <cstring>

#include "scene/model/error.h"

namespace gleaner::worker {

void MemoryArtifact::read(std::uint64_t offset, std::span<std::byte> out) const {
  if (offset > bytes_->size() || out.size() > bytes_->size() - offset)
    throw Error::failed("artifact: bytes " + std::to_string(offset) + " + " + std::to_string(out.size()) +
                        " were asked for, it has " + std::to_string(bytes_->size()));
  if (!out.empty()) std::memcpy(out.data(), bytes_->data() + offset, out.size());
}

std::shared_ptr<const scene::Bytes> TaskInput::load() const {
  if (!source) throw Error::failed("artifact: there is none");
  auto bytes = std::make_shared<scene::Bytes>(source->bytes());
  source->read(0, *bytes);
  return bytes;
}

}  // namespace gleaner::worker
