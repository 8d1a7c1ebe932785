#include "coordinator/gateway/listener.h"

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "coordinator/gateway/address.h"
#include "scene/model/error.h"

namespace gleaner::gateway {

namespace {

constexpr int backlog = 4096;
constexpr std::size_t kept_for_files = 64;     // descriptors, or a quarter of what there may be
constexpr std::chrono::milliseconds full{20};  // between looks at a socket that nobody can be accepted from

// A descriptor that is closed with its object.
class Descriptor {
 public:
  explicit Descriptor(int number = -1) : number_(number) {}
  ~Descriptor() { reset(); }
  Descriptor(Descriptor&& other) noexcept : number_(std::exchange(other.number_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    reset(std::exchange(other.number_, -1));
    return *this;
  }
  int get() const { return number_; }
  int release() { return std::exchange(number_, -1); }
  void reset(int number = -1) {
    if (number_ >= 0) ::close(number_);
    number_ = number;
  }

 private:
  int number_;
};

std::string reason(int code) { return std::generic_category().message(code); }

// Both families at once where the host stands for all of this machine's addresses and IPv6 is there.
std::vector<std::pair<sockaddr_storage, socklen_t>> addresses_of(const ListenAddress& wanted) {
  const bool all = wanted.host.empty() || wanted.host == "0.0.0.0" || wanted.host == "::";
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE;
  addrinfo* found = nullptr;
  if (const int code = ::getaddrinfo(all ? nullptr : wanted.host.c_str(), "0", &hints, &found); code != 0)
    throw Error::failed(std::string(::gai_strerror(code)));
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner(found, &::freeaddrinfo);
  std::vector<std::pair<sockaddr_storage, socklen_t>> addresses;
  for (const addrinfo* entry = found; entry; entry = entry->ai_next) {
    if (entry->ai_family != AF_INET && entry->ai_family != AF_INET6) continue;
    auto& [address, length] = addresses.emplace_back();
    std::copy_n(reinterpret_cast<const char*>(entry->ai_addr), entry->ai_addrlen, reinterpret_cast<char*>(&address));
    length = entry->ai_addrlen;
  }
  if (all)  // IPv6 first: its wildcard takes IPv4 too
    std::stable_sort(addresses.begin(), addresses.end(), [](const auto& a, const auto& b) {
      return a.first.ss_family == AF_INET6 && b.first.ss_family != AF_INET6;
    });
  return addresses;
}

void set_port(sockaddr_storage& address, int port) {
  const auto number = htons(static_cast<std::uint16_t>(port));
  if (address.ss_family == AF_INET)
    reinterpret_cast<sockaddr_in&>(address).sin_port = number;
  else
    reinterpret_cast<sockaddr_in6&>(address).sin6_port = number;
}

int port_of(int socket) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  if (::getsockname(socket, reinterpret_cast<sockaddr*>(&address), &length) != 0) return 0;
  return ntohs(address.ss_family == AF_INET ? reinterpret_cast<const sockaddr_in&>(address).sin_port
                                            : reinterpret_cast<const sockaddr_in6&>(address).sin6_port);
}

// A socket that listens there; errno says why there is none.
Descriptor listen_at(const sockaddr_storage& address, socklen_t length, bool both_families) {
  Descriptor socket(::socket(address.ss_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (socket.get() < 0) return socket;
  const int yes = 1, no = 0;
  // Not SO_REUSEPORT: a second coordinator would take half of the first one's calls. Connections inherit the others.
  ::setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  ::setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
  if (address.ss_family == AF_INET6)
    ::setsockopt(socket.get(), IPPROTO_IPV6, IPV6_V6ONLY, both_families ? &no : &yes, sizeof yes);
  if (::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), length) != 0 ||
      ::listen(socket.get(), backlog) != 0) {
    const int code = errno;
    socket.reset();
    errno = code;
  }
  return socket;
}

std::size_t descriptor_limit() {
  rlimit limit{};
  return ::getrlimit(RLIMIT_NOFILE, &limit) == 0 ? static_cast<std::size_t>(limit.rlim_cur) : 1024;
}

}  // namespace

struct Listener::Impl {
  void bind(const ListenAddress& wanted);
  void run();
  // Takes what waits at the socket. False: no more can be taken at the moment.
  bool accept_all(int socket);

  std::function<void(int)> take;
  std::vector<Descriptor> sockets;
  Descriptor wake{::eventfd(0, EFD_CLOEXEC)};
  Descriptor spare{::open("/dev/null", O_RDONLY | O_CLOEXEC)};  // given up to be able to turn somebody away
  int port = 0;
  std::thread thread;
};

void Listener::Impl::bind(const ListenAddress& wanted) {
  const bool all = wanted.host.empty() || wanted.host == "0.0.0.0" || wanted.host == "::";
  port = wanted.port;
  int code = EADDRNOTAVAIL;
  for (auto [address, length] : addresses_of(wanted)) {
    set_port(address, port);
    Descriptor socket = listen_at(address, length, all);
    if (socket.get() < 0) {
      code = errno;
      if (code == EAFNOSUPPORT || code == EADDRNOTAVAIL) continue;  // a family that this machine does not speak
      throw Error::failed(reason(code));
    }
    port = port_of(socket.get());
    sockets.push_back(std::move(socket));
    if (all) break;
  }
  if (sockets.empty()) throw Error::failed(reason(code));
}

bool Listener::Impl::accept_all(int socket) {
  // Files must be opened whatever peers do: numbers are given out from below.
  const std::size_t limit = descriptor_limit();
  const std::size_t most = limit - std::min(kept_for_files, limit / 4);
  for (;;) {
    Descriptor connection(::accept4(socket, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (connection.get() >= 0) {
      if (static_cast<std::size_t>(connection.get()) < most) {
        take(connection.release());
      }
      continue;
    }
    if (errno == EINTR || errno == ECONNABORTED) continue;
    const int code = errno;
    if (code == EMFILE || code == ENFILE) {
      // Who waits is turned away, or the socket would stay readable.
      spare.reset();
      Descriptor(::accept4(socket, nullptr, nullptr, SOCK_CLOEXEC)).reset();
      spare.reset(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    }
    return code == EAGAIN || code == EWOULDBLOCK;
  }
}

void Listener::Impl::run() {
  std::vector<pollfd> ready;
  for (const Descriptor& socket : sockets) ready.push_back({socket.get(), POLLIN, 0});
  ready.push_back({wake.get(), POLLIN, 0});
  for (;;) {
    if (::poll(ready.data(), ready.size(), -1) < 0 && errno != EINTR) std::this_thread::sleep_for(full);
    if (ready.back().revents != 0) return;
    for (const Descriptor& socket : sockets)
      if (!accept_all(socket.get())) std::this_thread::sleep_for(full);
  }
}

Listener::Listener(const std::string& listen, std::function<void(int)> take) : impl_(std::make_unique<Impl>()) {
  impl_->take = std::move(take);
  try {
    impl_->bind(parse_listen_address("--listen", listen));
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::failed) throw;
    throw Error::failed("cannot listen on " + listen + ": " + error.what() +
                        "; is the port taken, or the address not this machine's?");
  }
}

Listener::~Listener() { stop(); }

int Listener::port() const { return impl_->port; }

void Listener::start() {
  impl_->thread = std::thread([impl = impl_.get()] { impl->run(); });
}

void Listener::stop() {
  if (impl_->thread.joinable()) {
    const std::uint64_t one = 1;
    static_cast<void>(!::write(impl_->wake.get(), &one, sizeof one));
    impl_->thread.join();
  }
  impl_->sockets.clear();
}

void raise_descriptor_limit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur == limit.rlim_max) return;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);  // where it is not granted, the limit stays
}

}  // namespace gleaner::gateway
