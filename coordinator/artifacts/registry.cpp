#include "coordinator/artifacts/registry.h"

#include <algorithm>
#include <iterator>

namespace gleaner::coordinator {

namespace {

constexpr std::uint64_t count_bytes = 4;

// The first part that may hold items from `item` on.
template <typename Parts>
auto first_at(Parts& parts, std::uint64_t item) {
  auto at = parts.upper_bound(item);
  if (at == parts.begin()) return at;
  const auto before = std::prev(at);
  return before->first + before->second.items.count > item ? before : at;
}

}  // namespace

void ArtifactRegistry::add(const ArtifactId& id, const ArtifactLayout& layout) {
  artifacts_.try_emplace(id).first->second.layout = layout;
}

bool ArtifactRegistry::fits(const ArtifactLayout& layout, const Part& part) {
  const auto& [first, count] = part.items;
  if (count == 0 || first >= layout.items || count > layout.items - first || part.digest.size() != 32) return false;
  if (!layout.counted) return part.records == count && part.bytes == count * layout.record_bytes;
  return part.records <= count * layout.most_records &&
         part.bytes == count * count_bytes + part.records * layout.record_bytes;
}

PartOutcome ArtifactRegistry::accept(const ArtifactId& id, const Part& part, WorkerId holder) {
  const auto found = artifacts_.find(id);
  if (found == artifacts_.end()) return {.verdict = PartVerdict::unknown};
  Artifact& artifact = found->second;
  if (!fits(artifact.layout, part)) return {.verdict = PartVerdict::wrong_shape};
  const PartClaim claim{holder, part.digest, part.device_kind};
  const auto unlike = [&](const PartClaim& other) {
    return other.digest != claim.digest && other.device_kind == claim.device_kind;
  };

  if (const auto at = first_at(artifact.parts, part.items.first);
      at != artifact.parts.end() && at->first < part.items.first + part.items.count) {
    HeldPart& there = at->second;
    if (there.items.first != part.items.first || there.items.count != part.items.count)
      return {.verdict = PartVerdict::overlaps};
    if (there.digest == part.digest) {
      if (std::find(there.holders.begin(), there.holders.end(), holder) == there.holders.end()) {
        there.holders.push_back(holder);
        ++held_[holder][id];
      }
      return {.verdict = PartVerdict::copy};
    }
    if (there.device_kind != part.device_kind) return {.verdict = PartVerdict::other_kind};
    PartOutcome out{.verdict = PartVerdict::disputed};
    for (const WorkerId worker : there.holders) out.claims.push_back({worker, there.digest, there.device_kind});
    out.claims.push_back(claim);
    lose_part(artifact, id, at);
    artifact.claims[part.items.first] = {part.items.count, out.claims, true, {}, 1};
    out.rounds = 1;
    return out;
  }

  PartOutcome out{.verdict = PartVerdict::added};
  if (const auto at = artifact.claims.find(part.items.first);
      at != artifact.claims.end() && at->second.count == part.items.count) {
    std::vector<PartClaim>& all = at->second.all;
    const bool agrees = std::any_of(all.begin(), all.end(), [&](const PartClaim& other) {
      return other.digest == claim.digest && other.worker != claim.worker;
    });
    if (!agrees && std::any_of(all.begin(), all.end(), unlike)) {
      // A worker that answers again has one vote, its last.
      std::erase_if(all, [&](const PartClaim& other) { return other.worker == holder; });
      all.push_back(claim);
      at->second.disputed = true;
      return {.verdict = PartVerdict::disputed, .claims = all, .rounds = ++at->second.rounds};
    }
    for (const PartClaim& other : all)
      if (unlike(other)) out.outvoted.push_back(other.worker);
  }
  // Claims of ranges that were cut differently can be compared with nothing any more.
  std::erase_if(artifact.claims, [&](const auto& entry) {
    return entry.first < part.items.first + part.items.count && entry.first + entry.second.count > part.items.first;
  });
  HeldPart held{part, {holder}, 0};
  artifact.parts.emplace(part.items.first, std::move(held));
  artifact.existing_items += part.items.count;
  artifact.bytes += part.bytes;
  artifact.records += part.records;
  artifact.numbered = false;
  ++held_[holder][id];
  return out;
}

void ArtifactRegistry::forget_holder(const ArtifactId& id, WorkerId worker) {
  const auto at = held_.find(worker);
  if (at == held_.end()) return;
  if (const auto parts = at->second.find(id); parts != at->second.end() && --parts->second == 0)
    at->second.erase(parts);
  if (at->second.empty()) held_.erase(at);
}

// The part's items are missing from now on.
void ArtifactRegistry::lose_part(Artifact& artifact, const ArtifactId& id,
                                 std::map<std::uint64_t, HeldPart>::iterator at) {
  const HeldPart& part = at->second;
  for (const WorkerId worker : part.holders) forget_holder(id, worker);
  artifact.existing_items -= part.items.count;
  artifact.bytes -= part.bytes;
  artifact.records -= part.records;
  artifact.numbered = false;
  artifact.parts.erase(at);
}

std::map<ArtifactId, std::vector<ItemRange>> ArtifactRegistry::worker_lost(WorkerId worker) {
  std::map<ArtifactId, std::vector<ItemRange>> lost;
  const auto held = held_.find(worker);
  if (held == held_.end()) return lost;
  const auto artifacts = std::move(held->second);
  held_.erase(held);
  for (const auto& [id, count] : artifacts) {
    Artifact& artifact = artifacts_.at(id);
    for (auto at = artifact.parts.begin(); at != artifact.parts.end();) {
      HeldPart& part = (at++)->second;
      if (std::erase(part.holders, worker) == 0 || !part.holders.empty()) continue;
      // What it said of the part still counts: whoever computes it again must come to the same.
      artifact.claims[part.items.first] = {part.items.count, {{worker, part.digest, part.device_kind}}, false, {}};
      lost[id].push_back(part.items);
      lose_part(artifact, id, std::prev(at));
    }
  }
  return lost;
}

bool ArtifactRegistry::drop_copy(const ArtifactId& id, std::uint64_t first, const std::string& digest,
                                 WorkerId holder) {
  const auto found = artifacts_.find(id);
  if (found == artifacts_.end()) return false;
  Artifact& artifact = found->second;
  const auto at = artifact.parts.find(first);
  if (at == artifact.parts.end() || at->second.digest != digest) return false;
  HeldPart& part = at->second;
  if (std::erase(part.holders, holder) == 0) return false;
  forget_holder(id, holder);
  if (!part.holders.empty()) return false;
  artifact.claims[first] = {part.items.count, {{holder, part.digest, part.device_kind}}, false, {holder}};
  lose_part(artifact, id, at);
  return true;
}

std::vector<WorkerId> ArtifactRegistry::release(const ArtifactId& id) {
  kept_.remove(id);
  if (artifacts_.erase(id) == 0) return {};
  std::vector<WorkerId> holders;
  for (auto at = held_.begin(); at != held_.end();) {
    if (at->second.erase(id) > 0) holders.push_back(at->first);
    at = at->second.empty() ? held_.erase(at) : std::next(at);
  }
  return holders;
}

bool ArtifactRegistry::exists(const ArtifactId& id, const ItemRange& items) const {
  return has(id) && gaps(id, items).empty();
}

bool ArtifactRegistry::whole(const ArtifactId& id) const {
  const auto at = artifacts_.find(id);
  return at != artifacts_.end() && at->second.existing_items == at->second.layout.items;
}

std::vector<Gap> ArtifactRegistry::gaps(const ArtifactId& id) const {
  const auto at = artifacts_.find(id);
  if (at == artifacts_.end()) return {};
  return gaps(id, {0, at->second.layout.items});
}

std::vector<Gap> ArtifactRegistry::gaps(const ArtifactId& id, const ItemRange& within) const {
  std::vector<Gap> all;
  const auto found = artifacts_.find(id);
  if (found == artifacts_.end()) return all;
  const Artifact& artifact = found->second;
  const std::uint64_t end = std::min(artifact.layout.items, within.first + within.count);

  // A run of missing items, cut where ranges begin and end that not everybody may compute.
  const auto add = [&](std::uint64_t first, std::uint64_t last) {
    for (const auto& [start, claims] : artifact.claims) {
      if ((!claims.disputed && claims.avoid.empty()) || start < first || start + claims.count > last) continue;
      if (start > first) all.push_back({{first, start - first}, false, {}});
      Gap gap{{start, claims.count}, claims.disputed, claims.avoid};
      if (claims.disputed)
        for (const PartClaim& claim : claims.all) gap.avoid.push_back(claim.worker);
      all.push_back(std::move(gap));
      first = start + claims.count;
    }
    if (first < last) all.push_back({{first, last - first}, false, {}});
  };
  std::uint64_t next = within.first;
  for (auto at = first_at(artifact.parts, within.first); at != artifact.parts.end() && at->first < end; ++at) {
    if (at->first > next) add(next, at->first);
    next = at->first + at->second.items.count;
  }
  if (next < end) add(next, end);
  return all;
}

void ArtifactRegistry::number_records(Artifact& artifact) {
  std::uint64_t records = 0;
  for (auto& [first, part] : artifact.parts) {
    part.records_before = records;
    records += part.records;
  }
  artifact.numbered = true;
}

std::vector<HeldPart> ArtifactRegistry::parts(const ArtifactId& id, const ItemRange& items) {
  std::vector<HeldPart> all;
  const auto found = artifacts_.find(id);
  if (found == artifacts_.end()) return all;
  Artifact& artifact = found->second;
  if (!artifact.numbered) number_records(artifact);
  for (auto at = first_at(artifact.parts, items.first);
       at != artifact.parts.end() && at->first < items.first + items.count; ++at)
    all.push_back(at->second);
  return all;
}

std::uint64_t ArtifactRegistry::bytes(const ArtifactId& id) const {
  const auto at = artifacts_.find(id);
  return at == artifacts_.end() ? 0 : at->second.bytes;
}

std::uint64_t ArtifactRegistry::records(const ArtifactId& id) const {
  const auto at = artifacts_.find(id);
  return at == artifacts_.end() ? 0 : at->second.records;
}

std::vector<WorkerId> ArtifactRegistry::hold_most(const std::vector<ArtifactId>& inputs) const {
  std::map<WorkerId, std::uint64_t> bytes;
  for (const ArtifactId& id : inputs) {
    const auto found = artifacts_.find(id);
    if (found == artifacts_.end()) continue;
    for (const auto& [first, part] : found->second.parts)
      for (const WorkerId worker : part.holders) bytes[worker] += part.bytes;
  }
  std::uint64_t most = 1;  // who holds nothing is not preferred
  std::vector<WorkerId> workers;
  for (const auto& [worker, held] : bytes) {
    if (held > most) workers.clear();
    if (held >= most) workers.push_back(worker);
    most = std::max(most, held);
  }
  return workers;
}

std::vector<ArtifactId> ArtifactRegistry::keep(const ArtifactId& id, std::uint64_t most_bytes) {
  kept_.remove(id);
  if (has(id)) kept_.push_front(id);
  std::vector<ArtifactId> over;
  std::uint64_t sum = 0;
  for (auto at = kept_.begin(); at != kept_.end();) {
    sum += bytes(*at);
    // One that is not whole any more is worth nothing: nobody computes what nobody needs.
    if (sum <= most_bytes && whole(*at)) {
      ++at;
      continue;
    }
    sum -= bytes(*at);
    over.push_back(*at);
    at = kept_.erase(at);
  }
  return over;
}

bool ArtifactRegistry::take(const ArtifactId& id) {
  const auto at = std::find(kept_.begin(), kept_.end(), id);
  if (at == kept_.end()) return false;
  kept_.erase(at);
  return true;
}

}  // namespace gleaner::coordinator
