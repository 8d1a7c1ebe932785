#pragma once
// The files of the coordinator's page: the folder dashboard/.

#include "coordinator/web/page_file.h"

namespace gleaner::gateway {

const std::vector<web::PageFile>& dashboard_files();

}  // namespace gleaner::gateway
