#pragma once
// Who may reach what listens.

#include <string>

namespace gleaner::cli {

// Who reaches a listener in the clear can do everything: it is for this machine's own, unless the user says otherwise.
// Throws Error::usage for an address that other machines reach; `advice` says what to do instead.
void refuse_strangers(const std::string& option, const std::string& listen, const std::string& advice);

}  // namespace gleaner::cli
