#pragma once
// Processes that compile kernels beside this one. PoCL compiles a kernel when it is first launched, one at a time in an
// OpenCL context, and keeps it on disk: while a first stage compiles and runs, others compile what later stages need.

#include <condition_variable>
#include <deque>
#include <functional>
#include <iosfwd>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "worker/device/device_info.h"

namespace gleaner::worker {

// Thread-safe. A process that fails is done without: what it leaves is compiled here when it is needed, and says there
// what is wrong.
class KernelCompilers {
 public:
  // A program of which nothing is left to compile. Called by any thread.
  using Compiled = std::function<void(const std::string& file, const std::string& options)>;

  // `command` runs serve_kernel_compiler() for the device whose number is appended to it.
  KernelCompilers(std::vector<std::string> command, int device, unsigned processes, Compiled compiled);
  // Ends the processes, whatever they are at.
  ~KernelCompilers();
  KernelCompilers(const KernelCompilers&) = delete;
  KernelCompilers& operator=(const KernelCompilers&) = delete;

  // A program and its kernels, for later: the last asked is the last compiled.
  void ask(const std::string& file, const std::string& options, const std::vector<std::string>& kernels);
  // Kernels of a program that has been built here. The last one first: this process begins with the first.
  void ask_kernels(const std::string& file, const std::string& options, const std::vector<std::string>& kernels);
  // The caller is about to build the program or, with a kernel, to launch that. Returns at once where no process is at
  // it, and then none will be; else when it lies in the cache.
  void claim(const std::string& file, const std::string& options, const std::string& kernel = {});

 private:
  struct Unit {
    std::string file, options, kernel;  // no kernel: the program
    auto operator<=>(const Unit&) const = default;
    Unit program() const { return {file, options, {}}; }
  };
  class Child;
  enum class State { waits, runs, done };

  void start();
  void serve();
  bool take(Unit& unit);
  void finish(const Unit& unit, bool compiled);

  const std::vector<std::string> command_;
  const unsigned processes_;
  const Compiled compiled_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool ended_ = false;
  std::size_t busy_ = 0;  // units that run
  std::deque<Unit> queue_;
  std::map<Unit, State> states_;
  std::vector<Child*> children_;  // of the threads
  std::vector<std::jthread> threads_;
};

// What such a process does: reads lines of file, options and kernel, with tabs between, and answers each with one when
// it is compiled. Ends with the input.
void serve_kernel_compiler(const DeviceChoice& choice, std::istream& in, std::ostream& out);

}  // namespace gleaner::worker
