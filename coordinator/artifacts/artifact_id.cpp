#include "coordinator/artifacts/artifact_id.h"

#include "coordinator/blobs/sha256.h"
#include "gleaner/kernels_build.h"
#include "gleaner/version.h"

namespace gleaner::coordinator {

ArtifactId artifact_id(const SceneLineage& scene, const StageSpec& stage) {
  Sha256 hash;
  // Each field goes in behind its length, so that no two lists of fields give the same bytes.
  const auto add_bytes = [&](std::span<const std::byte> bytes) {
    const std::string length = std::to_string(bytes.size()) + ":";
    hash.update(std::as_bytes(std::span(length)));
    hash.update(bytes);
  };
  const auto add = [&](const std::string& text) { add_bytes(std::as_bytes(std::span(text))); };
  const auto add_number = [&](std::uint64_t number) { add(std::to_string(number)); };

  add(std::string("gleaner artifact ") + version);
  add(kernels_build());
  add(scene.in(stage.pose).of(stage.scene_parts));
  add(stage.kind);
  add_number(stage.items);
  add_number(stage.tile);
  add_number(stage.output.record_bytes);
  add_number(stage.output.counted);
  add_number(stage.output.most_records);
  add_bytes(stage.parameters);
  add_number(stage.inputs.size());
  for (const StageInput& input : stage.inputs) {
    add(input.name);
    add(input.artifact);
    add(input.extent == Extent::own_items ? "own items" : "whole");
  }
  return hash.hex();
}

ArtifactId data_id(std::span<const std::byte> bytes) { return sha256_hex(bytes); }

}  // namespace gleaner::coordinator
