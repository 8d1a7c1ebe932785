#include "scene/files/warnings.h"

namespace gleaner::scene {

void Warnings::add(const std::string& where, const std::string& what) {
  const auto [place, is_new] = by_what_.try_emplace(what, entries_.size());
  if (is_new) entries_.push_back({where, where, what, 0});
  Entry& entry = entries_[place->second];
  // An element that stands in several places of the scene is met several times in a row.
  if (!is_new && where == entry.last) return;
  entry.last = where;
  ++entry.count;
}

std::vector<std::string> Warnings::list() const {
  std::vector<std::string> all;
  for (const Entry& entry : entries_) {
    std::string text = entry.where.empty() ? entry.what : entry.where + ": " + entry.what;
    if (entry.count > 1) text += " (and " + std::to_string(entry.count - 1) + " more)";
    all.push_back(std::move(text));
  }
  return all;
}

}  // namespace gleaner::scene
