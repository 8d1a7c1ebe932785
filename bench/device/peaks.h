#pragma once
// What the device does at best, measured: bytes and multiply-adds per second.

#include "worker/device/device.h"

namespace gleaner::bench {

struct Peaks {
  double bytes = 0;  // per second, read plus written by a copy of buffers larger than caches
  double flops = 0;  // 32-bit floating-point operations per second, of independent chains of multiply-adds
};
Peaks measure_peaks(const worker::Device& device);

}  // namespace gleaner::bench
