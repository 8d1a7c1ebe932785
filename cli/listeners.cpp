#include "cli/listeners.h"

#include "coordinator/gateway/address.h"
#include "scene/model/error.h"

namespace gleaner::cli {

void refuse_strangers(const std::string& option, const std::string& listen, const std::string& advice) {
  if (!gateway::is_loopback(gateway::parse_listen_address(option, listen)))
    throw Error::usage(
        option + " " + listen +
        " is open to other machines, and the connection is neither encrypted nor authenticated: " + advice);
}

}  // namespace gleaner::cli
