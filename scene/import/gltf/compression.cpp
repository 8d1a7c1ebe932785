#include "scene/import/gltf/compression.h"

#include <draco/compression/decode.h>
#include <meshoptimizer.h>

#include <memory>

#include "scene/model/limits.h"

namespace gleaner::scene::gltf {
namespace {

// No codec of meshoptimizer says more than this many bytes with one: sixteen zeros take two bits.
constexpr std::uint64_t kMostExpansion = 64;

// Bytes of an element that a filter works on.
bool filter_takes(const std::string& filter, std::size_t stride) {
  if (filter == "OCTAHEDRAL") return stride == 4 || stride == 8;
  if (filter == "QUATERNION") return stride == 8;
  return stride % 4 == 0;
}

void unfilter(const std::string& filter, void* data, std::size_t count, std::size_t stride) {
  if (filter == "OCTAHEDRAL") meshopt_decodeFilterOct(data, count, stride);
  if (filter == "QUATERNION") meshopt_decodeFilterQuat(data, count, stride);
  if (filter == "EXPONENTIAL") meshopt_decodeFilterExp(data, count, stride);
}

}  // namespace

std::vector<std::byte> meshopt_decoded(const Element& compression, std::span<const std::byte> encoded) {
  const std::size_t count = compression.at("count").count(1, 0xffffffffu);
  const std::string& mode = compression.at("mode").text();
  const std::string filter = compression.find("filter") ? compression.at("filter").text() : "NONE";
  const bool is_vertices = mode == "ATTRIBUTES";
  if (!is_vertices && mode != "TRIANGLES" && mode != "INDICES")
    compression.at("mode").fail("ATTRIBUTES, TRIANGLES or INDICES");
  if (filter != "NONE" && filter != "OCTAHEDRAL" && filter != "QUATERNION" && filter != "EXPONENTIAL")
    compression.at("filter").fail("NONE, OCTAHEDRAL, QUATERNION or EXPONENTIAL");
  const Element stride_element = compression.at("byteStride");
  const std::size_t stride = stride_element.count(1, 256);
  if (is_vertices ? stride % 4 != 0 : stride != 2 && stride != 4)
    stride_element.fail(is_vertices ? "a multiple of 4" : "2 or 4");
  if (is_vertices && filter != "NONE" && !filter_takes(filter, stride))
    stride_element.fail("a size of elements that the filter " + filter + " takes");
  if (mode == "TRIANGLES" && count % 3 != 0) compression.at("count").fail("a multiple of 3");
  if (count * std::uint64_t(stride) > kMostExpansion * encoded.size() + 4096)
    compression.at("count").fail("at most what " + std::to_string(encoded.size()) + " compressed bytes can hold");
  std::vector<std::byte> bytes(count * stride);
  const auto* from = reinterpret_cast<const unsigned char*>(encoded.data());
  const int result = is_vertices ? meshopt_decodeVertexBuffer(bytes.data(), count, stride, from, encoded.size())
                     : mode == "TRIANGLES"
                         ? meshopt_decodeIndexBuffer(bytes.data(), count, stride, from, encoded.size())
                         : meshopt_decodeIndexSequence(bytes.data(), count, stride, from, encoded.size());
  if (result != 0) compression.fail("data that meshoptimizer can decode", "damaged or of a newer version");
  if (is_vertices) unfilter(filter, bytes.data(), count, stride);
  return bytes;
}

DracoMesh draco_decoded(const Element& compression, std::span<const std::byte> encoded, std::size_t most_vertices,
                        std::size_t most_triangles) {
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(encoded.data()), encoded.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
  if (!decoded.ok()) compression.fail("data that Draco can decode", decoded.status().error_msg_string());
  const std::unique_ptr<draco::Mesh> source = std::move(decoded).value();
  if (source->num_points() > most_vertices || source->num_faces() > most_triangles)
    compression.fail("at most " + std::to_string(most_vertices) + " vertices and " + std::to_string(most_triangles) +
                         " triangles, as its accessors say",
                     std::to_string(source->num_points()) + " and " + std::to_string(source->num_faces()));
  DracoMesh mesh;
  mesh.vertices = source->num_points();
  mesh.indices.reserve(3 * std::size_t(source->num_faces()));
  for (draco::FaceIndex f(0); f < source->num_faces(); ++f)
    for (const draco::PointIndex& corner : source->face(f)) {
      if (corner.value() >= mesh.vertices) compression.fail("corners among its vertices", "others");
      mesh.indices.push_back(corner.value());
    }
  const Element attributes = compression.at("attributes");
  if (!attributes.is_object()) attributes.fail("an object");
  for (const auto& [name, unused] : attributes.json().items()) {
    const Element id = attributes.at(name.c_str());
    const draco::PointAttribute* from =
        source->GetAttributeByUniqueId(static_cast<std::uint32_t>(id.count(0, 0xffffffffu)));
    if (!from) id.fail("an attribute of the Draco mesh");
    DracoMesh::Attribute to;
    to.components = static_cast<std::size_t>(from->num_components());
    if (to.components < 1 || to.components > 4) id.fail("1 to 4 components", std::to_string(to.components));
    to.values.resize(to.components * mesh.vertices);
    for (draco::PointIndex p(0); p < source->num_points(); ++p)
      if (!from->ConvertValue<float>(from->mapped_index(p), static_cast<std::int8_t>(to.components),
                                     &to.values[to.components * p.value()]))
        id.fail("values that are numbers", "others");
    mesh.attributes.emplace(name, std::move(to));
  }
  return mesh;
}

}  // namespace gleaner::scene::gltf
