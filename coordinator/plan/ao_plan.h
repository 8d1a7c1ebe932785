#pragma once
// Method `ao`: ambient occlusion, which look-dev people use as a clay preview. The smallest method, and the model of
// how to add one (docs/how-to/add-a-method.md).

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

Method ao_method();

}  // namespace gleaner::coordinator
