#include "worker/artifacts/artifact.h"

#include <cstring>

#include "scene/model/error.h"

namespace gleaner::worker {

void ArtifactSource::check_range(std::uint64_t offset, std::uint64_t length) const {
  if (offset > bytes() || length > bytes() - offset)
    throw Error::failed("artifact: bytes " + std::to_string(offset) + " + " + std::to_string(length) +
                        " were asked for, it has " + std::to_string(bytes()));
}

void MemoryArtifact::read(std::uint64_t offset, std::span<std::byte> out) const {
  check_range(offset, out.size());
  if (!out.empty()) std::memcpy(out.data(), bytes_->data() + offset, out.size());
}

std::shared_ptr<const scene::Bytes> TaskInput::load() const {
  if (!source) throw Error::failed("artifact: there is none");
  if (const auto* memory = dynamic_cast<const MemoryArtifact*>(source.get())) return memory->shared();
  auto bytes = std::make_shared<scene::Bytes>(source->bytes());
  source->read(0, *bytes);
  return bytes;
}

}  // namespace gleaner::worker
