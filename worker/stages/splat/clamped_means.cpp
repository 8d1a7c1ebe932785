#include "worker/stages/splat/clamped_means.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace gleaner::worker {
namespace {

// A cell of more places is split.
constexpr std::size_t kMostMembers = 64;
// Of a distance to a box: no more than that to what is in it, however both are rounded.
constexpr float kBelow = 0.999f;

std::size_t longest_axis(const PointBox& box) {
  std::size_t longest = 0;
  for (std::size_t k = 1; k < 3; ++k)
    if (box.upper[k] - box.lower[k] > box.upper[longest] - box.lower[longest]) longest = k;
  return longest;
}

}  // namespace

float ClampedMeans::clamped(const Vec& position, float mean) const {
  for (const Cell& cell : cells_) {
    if (cell.least + slope_ * kBelow * cell.box.distance(position) >= mean) continue;
    for (const Member& member : cell.members)
      mean = std::min(mean, member.mean + slope_ * distance(member.position, position));
  }
  return mean;
}

void ClampedMeans::clamp_others(const Vec& position, float mean,
                                const std::function<void(std::uint32_t, float)>& changed) {
  for (Cell& cell : cells_) {
    if (cell.most <= mean + slope_ * kBelow * cell.box.distance(position)) continue;
    cell.most = 0;
    for (Member& member : cell.members) {
      const float most = mean + slope_ * distance(member.position, position);
      if (member.mean > most) {
        member.mean = most;
        cell.least = std::min(cell.least, most);
        changed(member.place, most);
      }
      cell.most = std::max(cell.most, member.mean);
    }
  }
}

void ClampedMeans::add(std::uint32_t place, const Vec& position, float mean) {
  const Member added{position, mean, place};
  const auto nearest =
      std::ranges::min_element(cells_, {}, [&](const Cell& cell) { return cell.box.distance(position); });
  if (nearest == cells_.end()) {
    cells_.push_back(cell_of({added}));
    return;
  }
  nearest->box.add(position);
  nearest->least = std::min(nearest->least, mean);
  nearest->most = std::max(nearest->most, mean);
  nearest->members.push_back(added);
  if (nearest->members.size() > kMostMembers) split(*nearest);
}

void ClampedMeans::split(Cell& full) {
  const std::size_t axis = longest_axis(full.box);
  std::vector<Member> lower = std::move(full.members);
  const auto middle = lower.begin() + static_cast<std::ptrdiff_t>(lower.size() / 2);
  std::ranges::nth_element(lower, middle, {}, [axis](const Member& member) { return member.position[axis]; });
  std::vector<Member> upper(middle, lower.end());
  lower.erase(middle, lower.end());
  full = cell_of(std::move(lower));
  cells_.push_back(cell_of(std::move(upper)));
}

ClampedMeans::Cell ClampedMeans::cell_of(std::vector<Member> members) {
  Cell cell{.least = std::numeric_limits<float>::infinity(), .most = 0};
  for (const Member& member : members) {
    cell.box.add(member.position);
    cell.least = std::min(cell.least, member.mean);
    cell.most = std::max(cell.most, member.mean);
  }
  cell.members = std::move(members);
  cell.members.reserve(kMostMembers + 1);
  return cell;
}

}  // namespace gleaner::worker
