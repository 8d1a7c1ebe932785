#pragma once
// HOST:PORT of a listener, and whether other machines can reach it.

#include <string>

namespace gleaner::gateway {

struct ListenAddress {
  std::string host;  // without the brackets of an IPv6 address; empty: all of this machine's addresses
  int port = 0;      // 0: any free one
};

// "HOST:PORT" or "[IPV6]:PORT". Throws Error::usage for anything else; `option` is what the message calls it.
ListenAddress parse_listen_address(const std::string& option, const std::string& text);

// True where every address that the host stands for is this machine's loopback; a host that nobody knows is not.
bool is_loopback(const ListenAddress& address);

}  // namespace gleaner::gateway
