#pragma once
// Which parts of retained artifacts exist, and which workers hold them. A pure state machine: it is told of parts,
// losses and releases, and says which items must be computed (again). It holds no records.
//
// Parts of an artifact do not overlap; each is what one batch made. Copies of a part that devices of one kind made have
// one digest, or somebody's records are wrong: then neither copy counts, the items are computed a third time, by
// another worker, and the digest that two workers agree on is taken.

#include <cstdint>
#include <list>
#include <map>
#include <string>
#include <vector>

#include "coordinator/plan/plan.h"
#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

struct ArtifactLayout {
  std::uint64_t items = 0;
  std::uint32_t record_bytes = 0;
  bool counted = false;
  std::uint32_t most_records = 1;  // of one item
};

struct Part {
  ItemRange items;
  std::uint64_t bytes = 0;  // of its image: of a counted artifact the counts (4 bytes an item), then the records
  std::uint64_t records = 0;
  std::string digest;         // 32 bytes
  std::string device_kind{};  // devices of one kind make the same bytes
};

struct HeldPart : Part {
  std::vector<WorkerId> holders;     // who made it first
  std::uint64_t records_before = 0;  // of the artifact's items before; right once all of those exist
};

// Who says that a part has this digest. The worker may be gone.
struct PartClaim {
  WorkerId worker = 0;
  std::string digest, device_kind;
};

enum class PartVerdict {
  added,        // the first copy
  copy,         // the same bytes again: one holder more
  other_kind,   // other bytes, made by a device of another kind: not taken
  overlaps,     // some of the items exist in other parts: not taken
  wrong_shape,  // items or sizes that the layout does not allow: not taken
  unknown,      // no such artifact (any more): not taken
  disputed,     // other bytes: no copy counts, the items are missing again
};

struct PartOutcome {
  PartVerdict verdict = PartVerdict::unknown;
  // Disputed: all of them so far; what their workers hold does not count. Two that agree would have settled it.
  std::vector<PartClaim> claims{};
  unsigned rounds = 0;               // disputed: how often so far, of these items
  std::vector<WorkerId> outvoted{};  // added: whose records differed from those that two workers agree on
};

// Items that must be computed.
struct Gap {
  ItemRange items;
  bool in_one_piece = false;      // by one worker, so that its digest can be compared
  std::vector<WorkerId> avoid{};  // workers whose answers are in dispute, or who handed out other bytes
};

class ArtifactRegistry {
 public:
  // None of its items exist. One that is known stays as it is.
  void add(const ArtifactId& id, const ArtifactLayout& layout);
  bool has(const ArtifactId& id) const { return artifacts_.contains(id); }
  const ArtifactLayout& layout(const ArtifactId& id) const { return artifacts_.at(id).layout; }

  PartOutcome accept(const ArtifactId& id, const Part& part, WorkerId holder);
  // The worker is gone. What exists no longer: artifact -> items, in order.
  std::map<ArtifactId, std::vector<ItemRange>> worker_lost(WorkerId worker);
  // The holder's copy of the part that begins at `first` and has this digest turned out to be other bytes. True: nobody
  // else holds it, its items are missing.
  bool drop_copy(const ArtifactId& id, std::uint64_t first, const std::string& digest, WorkerId holder);
  // It is forgotten. Who held parts of it.
  std::vector<WorkerId> release(const ArtifactId& id);

  // All items of the range exist. False for unknown artifacts, true for an empty range of a known one.
  bool exists(const ArtifactId& id, const ItemRange& items) const;
  bool whole(const ArtifactId& id) const;
  // What of the range does not exist, in order.
  std::vector<Gap> gaps(const ArtifactId& id, const ItemRange& within) const;
  std::vector<Gap> gaps(const ArtifactId& id) const;
  // Parts that hold items of the range, in order.
  std::vector<HeldPart> parts(const ArtifactId& id, const ItemRange& items);
  std::uint64_t bytes(const ArtifactId& id) const;    // of the images of its parts, each counted once
  std::uint64_t records(const ArtifactId& id) const;  // of its parts

  // For who places work: the workers that hold most bytes of the inputs, all those that share the first place.
  std::vector<WorkerId> hold_most(const std::vector<ArtifactId>& inputs) const;

  // Artifacts that nothing needs at present but that may be read again. keep() puts one first among them; those that no
  // longer fit into `most_bytes`, the least recently used first, are returned: release() them. take() removes it from
  // them; false: it was not among them.
  std::vector<ArtifactId> keep(const ArtifactId& id, std::uint64_t most_bytes);
  bool take(const ArtifactId& id);

 private:
  struct Artifact {
    ArtifactLayout layout;
    std::map<std::uint64_t, HeldPart> parts;  // by first item
    struct Claims {
      std::uint64_t count = 0;
      std::vector<PartClaim> all;
      bool disputed = false;          // else they are of copies that were lost
      std::vector<WorkerId> avoid{};  // whose copies turned out to be other bytes
      unsigned rounds = 0;            // how often they were disputed
    };
    std::map<std::uint64_t, Claims> claims;  // by first item, of items that are missing
    std::uint64_t existing_items = 0, bytes = 0, records = 0;
    bool numbered = true;  // records_before of the parts is right
  };

  static bool fits(const ArtifactLayout& layout, const Part& part);
  void lose_part(Artifact& artifact, const ArtifactId& id, std::map<std::uint64_t, HeldPart>::iterator at);
  void forget_holder(const ArtifactId& id, WorkerId worker);
  static void number_records(Artifact& artifact);

  std::map<ArtifactId, Artifact> artifacts_;
  std::map<WorkerId, std::map<ArtifactId, std::uint64_t>> held_;  // worker -> artifact -> parts of it that it holds
  std::list<ArtifactId> kept_;                                    // last used first
};

}  // namespace gleaner::coordinator
