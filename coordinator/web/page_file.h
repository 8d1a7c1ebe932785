#pragma once
// A file of a web page, as it was when the program was built.

#include <string_view>
#include <vector>

namespace gleaner::web {

struct PageFile {
  std::string_view path;  // as the page's other files name it; "index.html" is the page
  std::string_view text;
};

// What our pages share: the folder common/.
const std::vector<PageFile>& common_files();

}  // namespace gleaner::web
