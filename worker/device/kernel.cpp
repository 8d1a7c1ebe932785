#include "worker/device/kernel.h"

#include <algorithm>

#include "scene/model/error.h"
#include "worker/device/compile_turn.h"

namespace gleaner::worker {
namespace {

// The declaration of `name` that the compiler saw: the one with as many parameters as the driver counts.
const std::vector<KernelParameter>& declaration(const Program& program, const std::string& name,
                                                const cl::Kernel& kernel) {
  const auto count = kernel.getInfo<CL_KERNEL_NUM_ARGS>();
  const std::vector<KernelParameter>* found = nullptr;
  const auto same = [](const KernelParameter& a, const KernelParameter& b) {
    return a.name == b.name && a.kind == b.kind;
  };
  const auto [begin, end] = program.kernels->equal_range(name);
  for (auto it = begin; it != end; ++it) {
    if (it->second.size() != count) continue;
    if (found && !std::ranges::equal(*found, it->second, same))
      throw Error::failed(program.file + ": kernel " + name + " has several declarations of " + std::to_string(count) +
                          " parameters");
    found = &it->second;
  }
  if (!found)
    throw Error::failed(program.file + ": kernel " + name + ": the driver counts " + std::to_string(count) +
                        " parameters, and no declaration has as many");
  return *found;
}

}  // namespace

Kernel::Kernel(const Device& device, const Program& program, const std::string& name)
    : device_(device),
      name_(name),
      file_(program.file),
      options_(program.options),
      mark_(program.mark),
      kernel_(program.handle, name.c_str()),
      parameters_(declaration(program, name, kernel_)),
      set_(parameters_.size()),
      unset_(parameters_.size()) {
  if (!mark_.empty()) mark_ += "." + name;
}

unsigned Kernel::index_of(std::string_view name, KernelParameter::Kind kind) {
  const auto found = std::ranges::find(parameters_, name, &KernelParameter::name);
  if (found == parameters_.end()) throw Error::failed("kernel " + name_ + " has no parameter " + std::string(name));
  if (found->kind != kind) throw Error::failed("kernel " + name_ + ": " + std::string(name) + " is of another type");
  const auto index = static_cast<unsigned>(found - parameters_.begin());
  if (!set_[index]) {
    set_[index] = true;
    --unset_;
  }
  return index;
}

Kernel& Kernel::set(std::string_view name, const cl::Buffer& buffer) {
  kernel_.setArg(index_of(name, KernelParameter::Kind::buffer), buffer);
  return *this;
}
Kernel& Kernel::set(std::string_view name, cl_uint value) {
  kernel_.setArg(index_of(name, KernelParameter::Kind::uint), value);
  return *this;
}
Kernel& Kernel::set(std::string_view name, cl_float value) {
  kernel_.setArg(index_of(name, KernelParameter::Kind::real), value);
  return *this;
}
Kernel& Kernel::set_words(const std::string& name, std::uint64_t value) {
  set(name + "_low", static_cast<cl_uint>(value));
  return set(name + "_high", static_cast<cl_uint>(value >> 32));
}

void Kernel::launch(cl::CommandQueue& queue, const Grid& grid) {
  if (unset_) {
    const auto missing = std::ranges::find(set_, false) - set_.begin();
    throw Error::failed("kernel " + name_ + " was launched without " +
                        parameters_[static_cast<std::size_t>(missing)].name);
  }
  const bool first = !std::exchange(launched_, true);
  if (first && device_.compilers()) device_.compilers()->claim(file_, options_, name_);
  CompileTurn turn(first ? mark_ : std::filesystem::path());
  const bool cpu = device_.info().cpu;
  const std::size_t items = ((cpu ? grid.capacity : grid.work) + grid.per_item - 1) / grid.per_item;
  const std::size_t group = grid.group ? grid.group : cpu ? 8 : 64;
  const bool timed = device_.profile().on();
  cl::Event event;
  queue.enqueueNDRangeKernel(kernel_, cl::NullRange, cl::NDRange((items + group - 1) / group * group),
                             cl::NDRange(group), nullptr, timed ? &event : nullptr);
  turn.done();
  if (timed) device_.profile().add(name_, event, grid.work);
}

void Kernel::launch_idle(cl::CommandQueue& queue) {
  constexpr std::size_t room = 4096;
  const std::vector<std::byte> zeros(room);
  cl::Buffer nothing = device_.make_buffer(room);
  queue.enqueueWriteBuffer(nothing, CL_TRUE, 0, room, zeros.data());
  for (const KernelParameter& parameter : parameters_) {
    if (parameter.kind == KernelParameter::Kind::buffer) set(parameter.name, nothing);
    if (parameter.kind == KernelParameter::Kind::uint) set(parameter.name, cl_uint{0});
    if (parameter.kind == KernelParameter::Kind::real) set(parameter.name, 0.0f);
  }
  launch(queue, {.work = 1, .capacity = 1});
  queue.finish();
}

}  // namespace gleaner::worker
