#include "worker/device/kernel_compilers.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <istream>
#include <ostream>
#include <sstream>

#include "scene/model/error.h"
#include "worker/device/kernel.h"

namespace gleaner::worker {

// A process whose standard input and output are a socket to this one.
class KernelCompilers::Child {
 public:
  explicit Child(const std::vector<std::string>& command) {
    int ends[2];
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) return;
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    for (const int standard : {STDIN_FILENO, STDOUT_FILENO})
      posix_spawn_file_actions_adddup2(&actions, ends[1], standard);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    std::vector<char*> arguments;
    for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    if (::posix_spawn(&id_, arguments[0], &actions, nullptr, arguments.data(), environ) != 0) id_ = -1;
    posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    socket_ = ends[0];
  }
  ~Child() {
    if (socket_ >= 0) ::close(socket_);
    if (id_ > 0) ::waitpid(id_, nullptr, 0);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  bool started() const { return id_ > 0; }
  // From another thread: answers() fails. What the process itself has started may go on, without a listener.
  void end() {
    if (!started()) return;
    ::kill(id_, SIGKILL);
    ::shutdown(socket_, SHUT_RDWR);
  }
  // False: the process is gone.
  bool answers(const std::string& line) {
    for (std::size_t sent = 0; sent < line.size();) {
      const ssize_t n = ::send(socket_, line.data() + sent, line.size() - sent, MSG_NOSIGNAL);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      sent += static_cast<std::size_t>(n);
    }
    for (char c = 0;;) {
      const ssize_t n = ::recv(socket_, &c, 1, 0);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      if (c == '\n') return true;
    }
  }

 private:
  pid_t id_ = -1;
  int socket_ = -1;
};

namespace {

std::vector<std::string> with_device(std::vector<std::string> command, int device) {
  command.push_back(std::to_string(device));
  return command;
}

}  // namespace

KernelCompilers::KernelCompilers(std::vector<std::string> command, int device, unsigned processes, Compiled compiled)
    : command_(with_device(std::move(command), device)), processes_(processes), compiled_(std::move(compiled)) {}

KernelCompilers::~KernelCompilers() {
  {
    std::lock_guard lock(mutex_);
    ended_ = true;
    for (Child* child : children_) child->end();
  }
  changed_.notify_all();
}

void KernelCompilers::ask(const std::string& file, const std::string& options,
                          const std::vector<std::string>& kernels) {
  std::lock_guard lock(mutex_);
  const auto add = [&](Unit unit) {
    if (states_.emplace(unit, State::waits).second) queue_.push_back(std::move(unit));
  };
  add({file, options, {}});
  for (const std::string& kernel : kernels) add({file, options, kernel});
  start();
}

void KernelCompilers::ask_kernels(const std::string& file, const std::string& options,
                                  const std::vector<std::string>& kernels) {
  std::lock_guard lock(mutex_);
  states_[{file, options, {}}] = State::done;
  for (const std::string& kernel : kernels) {
    Unit unit{file, options, kernel};
    if (states_.emplace(unit, State::waits).second) queue_.push_front(std::move(unit));
  }
  start();
}

void KernelCompilers::claim(const std::string& file, const std::string& options, const std::string& kernel) {
  std::unique_lock lock(mutex_);
  const Unit unit{file, options, kernel};
  State& state = states_.try_emplace(unit, State::done).first->second;
  if (state == State::waits) {
    std::erase(queue_, unit);
    // A program that is being built here has no kernels that others could compile, until ask_kernels().
    if (kernel.empty())
      std::erase_if(queue_, [&](const Unit& other) { return other.program() == unit && states_.erase(other) > 0; });
    state = State::done;
  }
  changed_.wait(lock, [&] { return state == State::done || ended_; });
}

// With the lock. As many as there are units, those that are being compiled included.
void KernelCompilers::start() {
  while (!ended_ && threads_.size() < std::min<std::size_t>(processes_, busy_ + queue_.size()))
    threads_.emplace_back([this] { serve(); });
  changed_.notify_all();
}

// The next unit whose program is built, or a program; waits for one. False: there will be none.
bool KernelCompilers::take(Unit& unit) {
  std::unique_lock lock(mutex_);
  auto next = queue_.end();
  changed_.wait(lock, [&] {
    next = std::ranges::find_if(
        queue_, [&](const Unit& one) { return one.kernel.empty() || states_[one.program()] == State::done; });
    return ended_ || next != queue_.end();
  });
  if (ended_) return false;
  unit = std::move(*next);
  queue_.erase(next);
  states_[unit] = State::runs;
  ++busy_;
  return true;
}

void KernelCompilers::finish(const Unit& unit, bool compiled) {
  bool whole = compiled;
  {
    std::lock_guard lock(mutex_);
    states_[unit] = State::done;
    --busy_;
    for (const auto& [other, state] : states_)
      whole = whole && (other.program() != unit.program() || state == State::done);
  }
  changed_.notify_all();
  if (whole) compiled_(unit.file, unit.options);
}

void KernelCompilers::serve() {
  Child child(command_);
  {
    std::lock_guard lock(mutex_);
    children_.push_back(&child);
    if (ended_) child.end();
  }
  bool lives = child.started();
  for (Unit unit; lives && take(unit);) {
    lives = child.answers(unit.file + "\t" + unit.options + "\t" + unit.kernel + "\n");
    finish(unit, lives);
  }
  std::lock_guard lock(mutex_);
  std::erase(children_, &child);
}

void serve_kernel_compiler(const DeviceChoice& choice, std::istream& in, std::ostream& out) {
  const Device device(choice);
  cl::CommandQueue queue = device.make_queue();
  for (std::string line; std::getline(in, line);) {
    std::istringstream words(line);
    std::string file, options, kernel;
    std::getline(words, file, '\t');
    std::getline(words, options, '\t');
    std::getline(words, kernel, '\t');
    try {
      const Program program = device.build(file, options);
      if (!kernel.empty()) Kernel(device, program, kernel).launch_idle(queue);
      out << "compiled\n" << std::flush;
    } catch (const std::exception& error) {
      // Who asked builds it as well, and gets the same error there. A kernel may also be none of this variant's.
      out << "failed\n" << std::flush;
    }
  }
}

}  // namespace gleaner::worker
