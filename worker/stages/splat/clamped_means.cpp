#include "worker/stages/splat/clamped_means.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace gleaner::worker {
namespace {

// A leaf of more places is split.
constexpr std::size_t kMostMembers = 16;
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
  if (!nodes_.empty()) lower(0, position, mean);
  return mean;
}

void ClampedMeans::lower(std::size_t number, const Vec& position, float& mean) const {
  const Node& node = nodes_[number];
  if (node.least + slope_ * kBelow * node.box.distance(position) >= mean) return;
  for (const Member& member : node.members)
    mean = std::min(mean, member.mean + slope_ * distance(member.position, position));
  if (!node.left) return;
  lower(node.left, position, mean);
  lower(node.right, position, mean);
}

void ClampedMeans::clamp_others(const Vec& position, float mean,
                                const std::function<void(std::uint32_t, float)>& changed) {
  if (!nodes_.empty()) lower_others(0, position, mean, changed);
}

void ClampedMeans::lower_others(std::size_t number, const Vec& position, float mean,
                                const std::function<void(std::uint32_t, float)>& changed) {
  Node& node = nodes_[number];
  if (node.most <= mean + slope_ * kBelow * node.box.distance(position)) return;
  node.most = 0;
  for (Member& member : node.members) {
    const float most = mean + slope_ * distance(member.position, position);
    if (member.mean > most) {
      member.mean = most;
      node.least = std::min(node.least, most);
      changed(member.place, most);
    }
    node.most = std::max(node.most, member.mean);
  }
  if (!node.left) return;
  for (const std::size_t child : {node.left, node.right}) {
    lower_others(child, position, mean, changed);
    node.least = std::min(node.least, nodes_[child].least);
    node.most = std::max(node.most, nodes_[child].most);
  }
}

void ClampedMeans::add(std::uint32_t place, const Vec& position, float mean) {
  const Member added{position, mean, place};
  if (nodes_.empty()) {
    nodes_.push_back(leaf_of({added}));
    return;
  }
  for (std::size_t number = 0;;) {
    Node& node = nodes_[number];
    node.box.add(position);
    node.least = std::min(node.least, mean);
    node.most = std::max(node.most, mean);
    if (!node.left) {
      node.members.push_back(added);
      if (node.members.size() > kMostMembers) split(number);
      return;
    }
    const bool right = nodes_[node.right].box.distance(position) < nodes_[node.left].box.distance(position);
    number = right ? node.right : node.left;
  }
}

void ClampedMeans::split(std::size_t full) {
  const std::size_t axis = longest_axis(nodes_[full].box);
  std::vector<Member> lower = std::move(nodes_[full].members);
  const auto middle = lower.begin() + static_cast<std::ptrdiff_t>(lower.size() / 2);
  std::ranges::nth_element(lower, middle, {}, [axis](const Member& member) { return member.position[axis]; });
  std::vector<Member> upper(middle, lower.end());
  lower.erase(middle, lower.end());
  nodes_[full].members = {};
  nodes_[full].left = nodes_.size();
  nodes_[full].right = nodes_.size() + 1;
  nodes_.push_back(leaf_of(std::move(lower)));
  nodes_.push_back(leaf_of(std::move(upper)));
}

ClampedMeans::Node ClampedMeans::leaf_of(std::vector<Member> members) {
  Node leaf{.least = std::numeric_limits<float>::infinity(), .most = 0};
  for (const Member& member : members) {
    leaf.box.add(member.position);
    leaf.least = std::min(leaf.least, member.mean);
    leaf.most = std::max(leaf.most, member.mean);
  }
  leaf.members = std::move(members);
  return leaf;
}

}  // namespace gleaner::worker
