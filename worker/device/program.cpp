#include "worker/device/program.h"

#include <algorithm>
#include <cctype>

#include "scene/model/error.h"

namespace gleaner::worker {
namespace {

using Macros = std::map<std::string, std::string, std::less<>>;

bool is_word(char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; }

std::string_view trimmed(std::string_view text) {
  const auto blank = [](char c) { return std::isspace(static_cast<unsigned char>(c)) != 0; };
  while (!text.empty() && blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && blank(text.back())) text.remove_suffix(1);
  return text;
}

// Without comments and with continued lines joined.
std::string plain_text(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (std::size_t i = 0; i < text.size();) {
    if (text.substr(i, 2) == "//") {
      i = std::min(text.find('\n', i), text.size());
    } else if (text.substr(i, 2) == "/*") {
      i = std::min(text.find("*/", i), text.size() - 2) + 2;
    } else if (text.substr(i, 2) == "\\\n") {
      i += 2;
    } else {
      out += text[i++];
    }
  }
  return out;
}

// Macros without parameters.
Macros object_macros(std::string_view text) {
  constexpr std::string_view define = "#define ";
  Macros macros;
  for (std::size_t line = 0; line < text.size();) {
    const std::size_t end = std::min(text.find('\n', line), text.size());
    std::string_view rest = trimmed(text.substr(line, end - line));
    line = end + 1;
    if (!rest.starts_with(define)) continue;
    rest = trimmed(rest.substr(define.size()));
    const auto name_end = std::find_if_not(rest.begin(), rest.end(), is_word) - rest.begin();
    const std::string_view name = rest.substr(0, static_cast<std::size_t>(name_end));
    rest.remove_prefix(name.size());
    if (!rest.starts_with("(")) macros.emplace(name, trimmed(rest));
  }
  return macros;
}

KernelParameter::Kind kind_of(std::string_view type) {
  if (type.find('*') != std::string_view::npos) return KernelParameter::Kind::buffer;
  if (type == "uint") return KernelParameter::Kind::uint;
  if (type == "float") return KernelParameter::Kind::real;
  return KernelParameter::Kind::other;
}

void add_parameters(std::string_view list, const Macros& macros, std::vector<KernelParameter>& out) {
  while (!trimmed(list).empty()) {
    const std::size_t comma = std::min(list.find(','), list.size());
    const std::string_view one = trimmed(list.substr(0, comma));
    list.remove_prefix(std::min(comma + 1, list.size()));
    if (std::all_of(one.begin(), one.end(), is_word)) {
      if (const auto macro = macros.find(one); macro != macros.end()) {
        add_parameters(macro->second, macros, out);
        continue;
      }
    }
    std::size_t name = one.size();
    while (name > 0 && is_word(one[name - 1])) --name;
    out.push_back({std::string(one.substr(name)), kind_of(trimmed(one.substr(0, name)))});
  }
}

// Where the bracket that is open at `at` closes, or npos.
std::size_t closing(std::string_view text, std::size_t at) {
  int depth = 0;
  for (; at < text.size(); ++at) {
    depth += text[at] == '(' ? 1 : text[at] == ')' ? -1 : 0;
    if (depth == 0) return at;
  }
  return std::string_view::npos;
}

}  // namespace

KernelDeclarations parse_kernels(std::string_view source, const std::string& file) {
  const std::string plain = plain_text(source);
  const std::string_view text = plain;
  const Macros macros = object_macros(text);
  KernelDeclarations kernels;
  constexpr std::string_view keyword = "kernel";
  for (std::size_t at = text.find(keyword); at != std::string_view::npos; at = text.find(keyword, at + 1)) {
    const std::size_t after = at + keyword.size();
    if ((at > 0 && is_word(text[at - 1])) || after >= text.size() || is_word(text[after])) continue;
    const std::size_t open = text.find('(', after);
    const std::size_t close = open == std::string_view::npos ? open : closing(text, open);
    if (close == std::string_view::npos) throw Error::failed(file + ": a kernel's parameter list does not end");
    const std::string_view head = trimmed(text.substr(after, open - after));
    std::size_t name = head.size();
    while (name > 0 && is_word(head[name - 1])) --name;
    const std::string_view list = text.substr(open + 1, close - open - 1);
    if (list.find('#') != std::string_view::npos)
      throw Error::failed(file + ": kernel " + std::string(head.substr(name)) +
                          ": preprocessor lines among parameters");
    std::vector<KernelParameter> parameters;
    add_parameters(list, macros, parameters);
    kernels.emplace(head.substr(name), std::move(parameters));
  }
  return kernels;
}

}  // namespace gleaner::worker
