#pragma once
// SHA-256, the name that bytes go by.

#include "proto/sha256.h"

namespace gleaner::coordinator {

using gleaner::is_sha256_hex;
using gleaner::Sha256;
using gleaner::sha256_hex;

}  // namespace gleaner::coordinator
