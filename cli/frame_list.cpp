#include "cli/frame_list.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <string_view>
#include <vector>

#include "coordinator/jobs/job.h"
#include "scene/model/error.h"

namespace gleaner::cli {

using scene::FrameNumbers;

namespace {

// Takes a number off the front of `text`.
std::optional<std::uint32_t> take_number(std::string_view& text) {
  std::uint32_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{}) return std::nullopt;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return value;
}

bool take(std::string_view& text, char letter) {
  if (text.empty() || text.front() != letter) return false;
  text.remove_prefix(1);
  return true;
}

// One range; the last frame is one that the steps come to.
std::optional<FrameNumbers> parse_range(std::string_view text) {
  const auto first = take_number(text);
  std::optional<std::uint32_t> last = first, step = 1;
  if (take(text, '-')) {
    last = take_number(text);
    if (take(text, 'x')) step = take_number(text);
  }
  if (!first || !last || !step || !text.empty() || *first > *last || *step == 0) return std::nullopt;
  return FrameNumbers{*first, *last - (*last - *first) % *step, *step};
}

}  // namespace

FrameNumbers parse_frame_list(const std::string& text) {
  std::vector<FrameNumbers> ranges;
  std::uint64_t count = 0;
  std::string_view rest = text;
  do {
    const std::size_t comma = std::min(rest.find(','), rest.size());
    const auto range = parse_range(rest.substr(0, comma));
    if (!range)
      throw Error::usage(
          "--frames: expected FIRST-LAST, FIRST-LASTxSTEP with FIRST <= LAST, or several with commas between, found "
          "\"" +
          text + "\"");
    count += range->count();
    ranges.push_back(*range);
    if (comma == rest.size()) break;
    rest.remove_prefix(comma + 1);
  } while (true);
  // Before memory is taken for them.
  if (count > coordinator::most_frames)
    throw Error::usage("--frames: expected at most " + std::to_string(coordinator::most_frames) + " frames, found \"" +
                       text + "\"");
  if (ranges.size() == 1) return ranges.front();
  FrameNumbers frames;
  for (const FrameNumbers& range : ranges)
    for (std::uint64_t i = 0; i < range.count(); ++i) frames.list.push_back(range.at(i));
  std::ranges::sort(frames.list);
  frames.list.erase(std::unique(frames.list.begin(), frames.list.end()), frames.list.end());
  frames.first = frames.list.front();
  frames.last = frames.list.back();
  return frames;
}

}  // namespace gleaner::cli
