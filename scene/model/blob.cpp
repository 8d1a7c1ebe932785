#include "scene/model/blob.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "scene/model/sections.h"

namespace gleaner::scene {
namespace {

constexpr char kSceneMagic[8] = {'G', 'L', 'S', 'C', 'E', 'N', 'E', 0};
constexpr char kBvhMagic[8] = {'G', 'L', 'B', 'V', 'H', 0, 0, 0};

enum SceneSection : std::uint32_t {
  kPositions,
  kNormals,
  kUvs,
  kSecondUvs,
  kColors,
  kIndices,
  kTriangleMaterial,
  kMeshes,
  kInstances,
  kMaterials,
  kTextures,
  kTexels,
  kAlbedoTables,
  kLights,
  kCameras,
  kFilms,
  kEnvironmentSize,
  kEnvironment,
  kNameLengths,  // of the scene, its meshes, materials and cameras
  kNames,        // their bytes, one after the other
  kSceneSections,
  // Of a scene with a rig there are these as well.
  kPosedMeshes = kSceneSections,
  kRestPositions,
  kRestNormals,
  kMorphTargets,
  kMorphDeltas,
  kJoints,
  kJointWeights,
  kPosedInstances,
  kStateSizes,  // matrices, morph weights
  kMovingSceneSections
};

enum BvhSection : std::uint32_t { kNodes, kSlots, kParts, kDepth, kBvhSections };

// What NamedCamera holds beside the camera and its name.
struct FilmRecord {
  std::uint32_t width, height;
  float aspect;
};

struct MeshRecord {
  std::uint32_t first_triangle, triangle_count;
  std::uint32_t flags;  // kInstanced, kDeforming
};
constexpr std::uint32_t kInstanced = 1, kDeforming = 2;

// Hands out names in the order in which serialize() wrote them.
class NameReader {
 public:
  NameReader(const SectionReader& reader)
      : reader_(reader), lengths_(reader.read<std::uint32_t>(kNameLengths)), text_(reader.read<char>(kNames)) {}

  std::string next() {
    if (next_ == lengths_.size()) reader_.fail("names", "one for each mesh, material and camera", lengths_.size());
    const std::uint32_t length = lengths_[next_++];
    if (length > text_.size() - used_)
      reader_.fail("names", "at least " + std::to_string(length) + " more bytes", text_.size() - used_);
    used_ += length;
    return {text_.data() + used_ - length, length};
  }

  void finish() const {
    if (next_ != lengths_.size() || used_ != text_.size())
      reader_.fail("names", std::to_string(next_), lengths_.size());
  }

 private:
  const SectionReader& reader_;
  std::vector<std::uint32_t> lengths_;
  std::vector<char> text_;
  std::size_t next_ = 0, used_ = 0;
};

}  // namespace

namespace {

std::uint64_t rig_bytes(const Rig& rig) {
  return sizeof(PosedMesh) * rig.meshes.size() + sizeof(PosedInstance) * rig.instances.size() +
         sizeof(MorphTarget) * rig.targets.size() +
         4 * (rig.positions.size() + rig.normals.size() + rig.deltas.size() + rig.joints.size() +
              rig.joint_weights.size() + 2);
}

void add_rig(SectionWriter& writer, const Rig& rig) {
  writer.add(kPosedMeshes, rig.meshes);
  writer.add(kRestPositions, rig.positions);
  writer.add(kRestNormals, rig.normals);
  writer.add(kMorphTargets, rig.targets);
  writer.add(kMorphDeltas, rig.deltas);
  writer.add(kJoints, rig.joints);
  writer.add(kJointWeights, rig.joint_weights);
  writer.add(kPosedInstances, rig.instances);
  writer.add(kStateSizes, std::vector<std::uint32_t>{rig.matrices, rig.morph_weights});
}

Rig read_rig(const SectionReader& reader) {
  Rig rig;
  rig.meshes = reader.read<PosedMesh>(kPosedMeshes);
  rig.instances = reader.read<PosedInstance>(kPosedInstances);
  if (rig.empty()) reader.fail("posed meshes and instances", "at least one", 0);
  rig.positions = reader.read<float>(kRestPositions);
  rig.normals = reader.read<float>(kRestNormals);
  rig.targets = reader.read<MorphTarget>(kMorphTargets);
  rig.deltas = reader.read<float>(kMorphDeltas);
  rig.joints = reader.read<std::uint32_t>(kJoints);
  rig.joint_weights = reader.read<float>(kJointWeights);
  const std::vector<std::uint32_t> sizes = reader.read<std::uint32_t>(kStateSizes, 2);
  rig.matrices = sizes[0];
  rig.morph_weights = sizes[1];
  return rig;
}

}  // namespace

Bytes serialize(const Scene& scene) {
  std::vector<std::uint32_t> lengths;
  std::vector<char> text;
  const auto name = [&](const std::string& s) {
    lengths.push_back(static_cast<std::uint32_t>(s.size()));
    text.insert(text.end(), s.begin(), s.end());
  };
  std::vector<MeshRecord> meshes;
  std::vector<Camera> cameras;
  std::vector<FilmRecord> films;
  name(scene.name);
  for (const Mesh& m : scene.meshes) {
    name(m.name);
    meshes.push_back(
        {m.first_triangle, m.triangle_count, (m.instanced ? kInstanced : 0u) | (m.deforming ? kDeforming : 0u)});
  }
  for (std::size_t i = 0; i < scene.materials.size(); ++i)
    name(i < scene.material_names.size() ? scene.material_names[i] : std::string());
  for (const NamedCamera& c : scene.cameras) {
    name(c.name);
    cameras.push_back(c.camera);
    films.push_back({c.width, c.height, c.aspect});
  }
  SectionWriter writer(kSceneMagic, scene.rig.empty() ? kSceneSections : kMovingSceneSections);
  writer.expect(4 * (scene.positions.size() + scene.normals.size() + scene.uvs.size() + scene.second_uvs.size() +
                     scene.indices.size() + scene.triangle_material.size() + scene.texels.size() +
                     scene.albedo_tables.size() + scene.environment.radiance.size()) +
                2 * scene.colors.size() + sizeof(Material) * scene.materials.size() +
                sizeof(Texture) * scene.textures.size() + sizeof(Light) * scene.lights.size() +
                sizeof(Camera) * cameras.size() + sizeof(Instance) * scene.instances.size() + text.size() +
                16 * lengths.size() + rig_bytes(scene.rig));
  writer.add(kPositions, scene.positions);
  writer.add(kNormals, scene.normals);
  writer.add(kUvs, scene.uvs);
  writer.add(kSecondUvs, scene.second_uvs);
  writer.add(kColors, scene.colors);
  writer.add(kIndices, scene.indices);
  writer.add(kTriangleMaterial, scene.triangle_material);
  writer.add(kMeshes, meshes);
  writer.add(kInstances, scene.instances);
  writer.add(kMaterials, scene.materials);
  writer.add(kTextures, scene.textures);
  writer.add(kTexels, scene.texels);
  writer.add(kAlbedoTables, scene.albedo_tables);
  writer.add(kLights, scene.lights);
  writer.add(kCameras, cameras);
  writer.add(kFilms, films);
  writer.add(kEnvironmentSize, std::vector<std::uint32_t>{scene.environment.width, scene.environment.height});
  writer.add(kEnvironment, scene.environment.radiance);
  writer.add(kNameLengths, lengths);
  writer.add(kNames, text);
  if (!scene.rig.empty()) add_rig(writer, scene.rig);
  return writer.finish();
}

Scene parse_scene(std::span<const std::byte> bytes, const std::string& origin) {
  const SectionReader reader(bytes, kSceneMagic, {kSceneSections, kMovingSceneSections}, origin);
  Scene scene;
  scene.positions = reader.read<float>(kPositions);
  scene.normals = reader.read<float>(kNormals);
  scene.uvs = reader.read<float>(kUvs);
  scene.second_uvs = reader.read<float>(kSecondUvs);
  scene.colors = reader.read<std::uint16_t>(kColors);
  scene.indices = reader.read<std::uint32_t>(kIndices);
  scene.triangle_material = reader.read<std::uint32_t>(kTriangleMaterial);
  scene.materials = reader.read<Material>(kMaterials);
  scene.textures = reader.read<Texture>(kTextures);
  scene.texels = reader.read<std::uint32_t>(kTexels);
  scene.albedo_tables = reader.read<float>(kAlbedoTables);
  scene.lights = reader.read<Light>(kLights);
  NameReader names(reader);
  scene.name = names.next();
  for (const MeshRecord& m : reader.read<MeshRecord>(kMeshes)) {
    if (m.flags & ~(kInstanced | kDeforming)) reader.fail("mesh flags", "known bits alone", m.flags);
    scene.meshes.push_back(
        {names.next(), m.first_triangle, m.triangle_count, (m.flags & kInstanced) != 0, (m.flags & kDeforming) != 0});
  }
  scene.instances = reader.read<Instance>(kInstances);
  for (std::size_t i = 0; i < scene.materials.size(); ++i) scene.material_names.push_back(names.next());
  const std::vector<Camera> cameras = reader.read<Camera>(kCameras);
  const std::vector<FilmRecord> films = reader.read<FilmRecord>(kFilms, cameras.size());
  for (std::size_t i = 0; i < cameras.size(); ++i)
    scene.cameras.push_back({names.next(), cameras[i], films[i].width, films[i].height, films[i].aspect});
  names.finish();
  const std::vector<std::uint32_t> size = reader.read<std::uint32_t>(kEnvironmentSize, 2);
  scene.environment = {size[0], size[1], reader.read<float>(kEnvironment)};
  if (reader.sections() == kMovingSceneSections) scene.rig = read_rig(reader);
  validate(scene, origin);
  return scene;
}

Bytes serialize(const Bvh& bvh) {
  SectionWriter writer(kBvhMagic, kBvhSections);
  writer.expect(sizeof(BvhNode) * bvh.nodes.size() + 4 * bvh.triangles.size());
  writer.add(kNodes, bvh.nodes);
  writer.add(kSlots, bvh.triangles);
  writer.add(kParts, bvh.parts);
  writer.add(kDepth, std::vector<std::uint32_t>{bvh.max_depth});
  return writer.finish();
}

namespace {

// A traversal that follows these children ends, and never needs a deeper stack than it was promised.
void check_part(const Bvh& bvh, const BvhPart& part, const SectionReader& reader, const std::string& origin) {
  const std::uint32_t end_node = part.first_node + part.nodes;
  std::vector<bool> reached(part.nodes);
  std::vector<std::pair<std::uint32_t, std::uint32_t>> open = {{part.first_node, 1}};  // node, depth of its children
  while (!open.empty()) {
    const auto [index, depth] = open.back();
    open.pop_back();
    const BvhNode& node = bvh.nodes[index];
    const std::string name = "nodes[" + std::to_string(index) + "]";
    if (depth > bvh.max_depth) reader.fail("max_depth", "at least " + std::to_string(depth), bvh.max_depth);
    for (const float* box : {node.lower0, node.upper0, node.lower1, node.upper1})
      if (std::any_of(box, box + 3, [](float x) { return std::isnan(x); }))
        throw Error::bad_input(origin, name, "boxes of numbers", "NaN");
    for (const gl_uint child : node.child) {
      if (child & GLEANER_BVH_LEAF) {
        const std::uint64_t first = child & 0x07ffffffu, count = child >> 27 & 15u;
        if (count > 0 && (first < part.first_slot || first + count > std::uint64_t{part.first_slot} + part.slots))
          reader.fail(name, "a leaf within " + std::to_string(part.slots) + " slots", first + count);
      } else {
        if (child <= index || child >= end_node || reached[child - part.first_node])
          reader.fail(name, "a child behind it that no other node names, below " + std::to_string(end_node), child);
        reached[child - part.first_node] = true;
        open.emplace_back(child, depth + 1);
      }
    }
  }
}

}  // namespace

Bvh parse_bvh(std::span<const std::byte> bytes, std::size_t triangle_count, const std::string& origin) {
  const SectionReader reader(bytes, kBvhMagic, {kBvhSections}, origin);
  Bvh bvh{reader.read<BvhNode>(kNodes), reader.read<std::uint32_t>(kSlots), reader.read<BvhPart>(kParts),
          reader.read<std::uint32_t>(kDepth, 1)[0]};
  for (std::size_t i = 0; i < bvh.triangles.size(); ++i) {
    if (bvh.triangles[i] >= triangle_count)
      reader.fail("triangles[" + std::to_string(i) + "]", "an index below " + std::to_string(triangle_count),
                  bvh.triangles[i]);
  }
  if (bvh.nodes.empty()) reader.fail("nodes", "a root", 0);
  if (bvh.max_depth > kMaxBvhDepth) reader.fail("max_depth", "at most " + std::to_string(kMaxBvhDepth), bvh.max_depth);
  std::uint64_t node = 0, slot = 0;
  for (std::size_t p = 0; p < bvh.parts.size(); ++p) {
    const BvhPart& part = bvh.parts[p];
    const std::string name = "parts[" + std::to_string(p) + "]";
    if (part.first_node != node || part.nodes == 0 || part.nodes > bvh.nodes.size() - node)
      reader.fail(name, "nodes from " + std::to_string(node) + " on, of " + std::to_string(bvh.nodes.size()),
                  part.first_node);
    if (part.first_slot != slot || part.slots > bvh.triangles.size() - slot)
      reader.fail(name, "slots from " + std::to_string(slot) + " on, of " + std::to_string(bvh.triangles.size()),
                  part.first_slot);
    node += part.nodes;
    slot += part.slots;
    check_part(bvh, part, reader, origin);
  }
  if (node != bvh.nodes.size() || slot != bvh.triangles.size())
    reader.fail("parts", "ranges that cover all nodes and slots", node);
  return bvh;
}

}  // namespace gleaner::scene
