#include "coordinator/gateway/address.h"

#include <arpa/inet.h>
#include <netdb.h>
#include <netinet/in.h>

#include <charconv>
#include <memory>

#include "scene/model/error.h"

namespace gleaner::gateway {

namespace {

bool is_loopback(const sockaddr& address) {
  if (address.sa_family == AF_INET) {
    const auto& v4 = reinterpret_cast<const sockaddr_in&>(address);
    return ntohl(v4.sin_addr.s_addr) >> 24 == 127;
  }
  if (address.sa_family != AF_INET6) return false;
  const in6_addr& v6 = reinterpret_cast<const sockaddr_in6&>(address).sin6_addr;
  return IN6_IS_ADDR_LOOPBACK(&v6) || (IN6_IS_ADDR_V4MAPPED(&v6) && v6.s6_addr[12] == 127);
}

}  // namespace

ListenAddress parse_listen_address(const std::string& option, const std::string& text) {
  const auto refuse = [&] {
    return Error::usage(option + ": expected HOST:PORT or [IPV6]:PORT, found '" + text.substr(0, 200) + "'");
  };
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos) throw refuse();
  ListenAddress address{text.substr(0, colon), 0};
  const char *begin = text.data() + colon + 1, *end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(begin, end, address.port);
  if (error != std::errc{} || stop != end || address.port < 0 || address.port > 65535) throw refuse();
  std::string& host = address.host;
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  } else if (host.find_first_of(":[]/") != std::string::npos) {
    throw refuse();  // an IPv6 address without its brackets, or a scheme
  }
  return address;
}

bool is_loopback(const ListenAddress& address) {
  if (address.host.empty()) return false;
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (::getaddrinfo(address.host.c_str(), nullptr, &hints, &found) != 0) return false;
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner(found, &::freeaddrinfo);
  for (const addrinfo* entry = found; entry; entry = entry->ai_next)
    if (!is_loopback(*entry->ai_addr)) return false;
  return found != nullptr;
}

}  // namespace gleaner::gateway
