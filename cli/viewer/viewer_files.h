#pragma once
// The files of a session's page: the folder page/.

#include "coordinator/web/page_file.h"

namespace gleaner::cli {

const std::vector<web::PageFile>& viewer_files();

}  // namespace gleaner::cli
